"""Every chapter has the skeleton that AUTHORING.md asks for."""

import re

import jupytext
import pytest
from exercises import title
from plain_markdown import Directive, blocks
from student import find_chapters


class Chapter:
    """A chapter's cells, and its prose by section."""

    def __init__(self, path):
        self.name, self.number = path.stem, int(path.stem.split("-")[0])
        self.cells = jupytext.read(path, fmt="md:myst").cells
        self.prose = [line for cell in self.cells if cell.cell_type == "markdown" for line in cell.source.split("\n")]
        self.blocks = list(blocks(self.prose))
        self.sections = {"": []}
        for block in self.blocks:
            if isinstance(block, str) and block.startswith("## "):
                self.sections[block[3:].strip()] = []
            list(self.sections.values())[-1].append(block)

    def code(self, tag):
        return [cell for cell in self.cells if cell.cell_type == "code" and tag in cell.metadata.get("tags", [])]


CHAPTERS = [Chapter(path) for path in find_chapters()]


def lines(chapter, section):
    return [block for block in chapter.sections[section] if isinstance(block, str)]


@pytest.fixture(params=CHAPTERS, ids=lambda chapter: chapter.name)
def chapter(request):
    return request.param


def test_chapters_are_numbered_as_they_stand():
    assert [chapter.number for chapter in CHAPTERS] == list(range(1, len(CHAPTERS) + 1))


def test_sections_that_every_chapter_has(chapter):
    names = [name for name in chapter.sections if name]
    assert names[:2] == ["Objectives", "Before you start"]
    assert names[-3:] == ["Summary", "What next", "Further reading"]
    assert all("".join(lines(chapter, name)[1:]).strip() for name in names[-3:]), "an empty section"


def test_objectives_are_numbered(chapter):
    numbers = [int(found[1]) for line in lines(chapter, "Objectives") if (found := re.match(r"(\d+)\. \S", line))]
    assert len(numbers) >= 3 and numbers == list(range(1, len(numbers) + 1))


def test_reading_time_and_prerequisites_are_told(chapter):
    text = lines(chapter, "Before you start")
    assert any(re.match(r"Reading time: about \d+ minutes", line) for line in text)
    assert len([line for line in text if line.startswith("|")]) >= 3, "a table of prerequisites"


def test_questions_to_think_about_have_a_reason_for_every_option(chapter):
    options = re.compile(r"- \*\*([A-Z])\.\*\* \S")
    found = [block for block in chapter.blocks if isinstance(block, Directive)]
    asked = [i for i, block in enumerate(found) if block.options.get("class") == "think"]
    assert asked, "no question to think about"
    for i in asked:
        letters, reasons = ([match[1] for line in found[j].body if (match := options.match(line))] for j in (i, i + 1))
        assert found[i + 1].name == "dropdown" and len(letters) >= 2 and reasons == letters


def test_exercises_are_numbered_and_each_is_followed_by_its_check(chapter):
    exercises = chapter.code("exercise")
    assert len(exercises) >= 2
    code = [cell for cell in chapter.cells if cell.cell_type == "code"]
    for number, cell in enumerate(exercises, start=1):
        assert title(cell.source).startswith(f"Exercise {chapter.number}.{number}: ")
        check = code[code.index(cell) + 1]
        assert "check" in check.metadata.get("tags", []) and re.search(r"\bcheck_\w+\(", check.source)
    assert len(chapter.code("check")) == len(exercises), "a check without its exercise"


def test_a_students_own_gradients_work_everywhere(chapter):
    code = "\n".join(cell.source for cell in chapter.cells if cell.cell_type == "code")
    switch = re.compile(r"set_grad_enabled\(|^torch\.(autograd\.)?(inference_mode|no_grad)\b.*__enter__", re.M)
    assert not switch.search(code), "switch gradients off in a `with torch.no_grad():`, or for one function"


def test_exercises_are_announced_by_a_heading(chapter):
    prose = "\n".join(chapter.prose)
    for cell in chapter.code("exercise"):
        number = title(cell.source).split(":")[0]
        assert re.search(rf"^###+ {number}\b", prose, re.M), f"no heading '### {number}: ...'"


def test_figures_are_described_for_who_cannot_see_them(chapter):
    for block in chapter.blocks:
        if isinstance(block, Directive) and block.name in ("figure", "image", "film", "recording", "playground"):
            assert block.options.get("alt", "").strip(), f"{block.name} {block.argument} has no alt text"
    for cell in chapter.cells:
        if drawn := cell.metadata.get("mystnb", {}).get("figure"):
            assert cell.metadata["mystnb"].get("image", {}).get("alt", "").strip(), f"{drawn['name']} has no alt text"
