"""The buttons of a chapter: its notebook, and with a repository a link to Colab, which a made-up address shows."""

import re

import nbformat
import project
import pytest
import student
from conftest import HTML, ROOT
from test_book import CHAPTERS

ADDRESS = "https://github.com/somebody/detden"


@pytest.fixture
def with_repository(tmp_path, monkeypatch):
    """A pyproject.toml that has an address."""
    text = (ROOT / "pyproject.toml").read_text("utf-8")
    text = re.sub(r"^# Source = .*$", f'Source = "{ADDRESS}.git"', text, flags=re.M)
    (tmp_path / "pyproject.toml").write_text(text, encoding="utf-8")
    monkeypatch.setattr(project, "PYPROJECT", tmp_path / "pyproject.toml")
    monkeypatch.setattr(student, "PYPROJECT", tmp_path / "pyproject.toml")


def buttons(page):
    context = {"pathto": lambda path, resource: f"../{path}", "header_buttons": []}
    project.add_buttons(None, page, "page.html", context, None)
    return {button["tooltip"]: button["url"] for button in context["header_buttons"]}


def test_without_a_repository_a_chapter_has_its_notebook_alone(monkeypatch):
    monkeypatch.setattr(project, "source", lambda text: "")
    assert buttons("chapters/02-attacks") == {"Download this chapter as a notebook": "../notebooks/02-attacks.ipynb"}
    assert buttons("index") == {}


def test_with_one_there_is_a_link_to_colab(with_repository):
    assert buttons("chapters/02-attacks")["Open this chapter in Colab"] == (
        "https://colab.research.google.com/github/somebody/detden/blob/main/notebooks/02-attacks.ipynb"
    )
    config = type("Config", (), {"html_theme_options": {}})
    project.show_repository(None, config)
    assert config.html_theme_options["icon_links"][0]["url"] == ADDRESS


def test_with_one_notebooks_install_the_library_where_it_is_missing(with_repository):
    for text in student.make_notebooks().values():
        first = next(cell for cell in nbformat.reads(text, as_version=4).cells if cell.cell_type == "code")
        assert f'%pip install -q "detden-lite[look] @ git+{ADDRESS}"' in first.source and "find_spec" in first.source


@pytest.mark.parametrize("address", ["", "https://example.org/x/y", "https://github.com/somebody"])
def test_colab_opens_only_repositories_on_github(address):
    assert project.colab(address, "01-mdp.ipynb") == ""


@pytest.mark.parametrize("path", CHAPTERS)
def test_a_built_chapter_offers_its_notebook(path):
    name = path.removeprefix("chapters/").removesuffix(".html")
    assert f'href="../notebooks/{name}.ipynb"' in (HTML / path).read_text("utf-8")
    assert (HTML / "notebooks" / f"{name}.ipynb").read_bytes() == (ROOT / "notebooks" / f"{name}.ipynb").read_bytes()
