"""The architecture page and the API reference say what the library is."""

import doctest
import inspect
import re
from importlib import import_module

import api_reference
import architecture
import project
import pytest
from conftest import ROOT
from hypothesis import given
from hypothesis import strategies as st

import detden_lite

MODULES = [
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for path in sorted(architecture.LIBRARY.glob("*/*.py"))
    if ">>> " in path.read_text("utf-8")
]
PAGES = {path.stem: path.read_text("utf-8") for path in (ROOT / "book" / "api").glob("*.md")}


def test_the_layers_name_every_room_once():
    named = [room for layer in architecture.layers() for room in layer]
    assert sorted(named) == sorted(path.parent.name for path in architecture.LIBRARY.glob("*/__init__.py"))


def test_the_part_to_read_in_an_afternoon_is_small():
    assert architecture.code_lines(*(p for room in architecture.AFTERNOON for p in architecture.modules(room))) < 3_000


def test_no_room_imports_from_its_own_layer_or_above():
    order = {room: i for i, layer in enumerate(architecture.layers()) for room in layer}
    for room, place in order.items():
        assert all(order[other] > place for other in architecture.imports(room)), room


def test_lines_of_code_are_counted_without_comments_docstrings_and_blanks(tmp_path):
    code = "import math  # here\n\n\ndef f():\n    {doc}\n    return (\n        1\n    )\n"
    source = '"""Doc."""\n\n# why\n' + code.format(doc='"""Doc,\n    of two lines.\n    """')
    (tmp_path / "m.py").write_text(source)
    assert architecture.code_lines(tmp_path / "m.py") == 5


def test_every_room_has_its_paragraph_and_every_module_on_the_path_exists():
    page = (ROOT / "book" / "architecture.md").read_text("utf-8")
    assert all(f"\n**{room}** " in page for layer in architecture.layers() for room in layer)
    path = re.findall(r'(?m)^    "(\w+/\w+\.py)": ', page)
    assert len(path) == 10 and all((architecture.LIBRARY / name).is_file() for name in path)


def test_each_room_of_the_public_face_has_one_place_in_the_reference():
    shown = re.findall(r"```\{public\} (\w+)", "".join(PAGES.values()))
    assert sorted(shown) == sorted(api_reference.rooms())


def test_every_public_constant_is_described():
    described = re.findall(r"```\{py:data\} (\w+)\n:module: detden_lite\n\n\S", "".join(PAGES.values()))
    every = [entry for room in api_reference.rooms() for entry in api_reference.public(room)]
    assert sorted(described) == sorted(name for name, _, value in every if api_reference.kind(value) == "data")


@given(st.lists(st.text("ab|* `"), min_size=1))
def test_only_text_outside_literals_is_escaped(parts):
    text = "``".join(part.replace("`", "") for part in parts)
    escaped = api_reference.escape(text, "|*")
    assert escaped.replace("\\", "") == text
    assert escaped.split("``")[1::2] == text.split("``")[1::2]


def test_the_repository_address_is_one_setting_that_may_be_missing():
    assert project.source('[project]\nname = "x"\n') == project.source("[project]\n[project.urls]\n") == ""
    assert project.source('[project.urls]\nSource = "https://example.org/x"\n') == "https://example.org/x"
    project.source(project.PYPROJECT.read_text("utf-8"))


@pytest.mark.parametrize("name", [name for name in detden_lite.__all__ if inspect.isclass(getattr(detden_lite, name))])
def test_every_public_class_has_an_example_that_runs(name):
    text = inspect.getdoc(getattr(detden_lite, name)) or ""
    assert "\nExample:\n" in text and ">>> " in text.split("\nExample:\n")[1]
    assert getattr(detden_lite, name).__module__ in MODULES


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_of_a_module_give_what_they_print(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert doctest.testmod(import_module(name)).failed == 0
