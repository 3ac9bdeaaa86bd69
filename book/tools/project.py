"""Sphinx extension: the repository's address, if pyproject.toml has one, and what a reader can take from a chapter.

A chapter's page has a button that downloads its notebook. With a repository there are an icon on each page and, for a
repository on GitHub, a button that opens the notebook in Colab.
"""

import re
import tomllib
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.config import Config

ROOT = Path(__file__).resolve().parents[2]
PYPROJECT = ROOT / "pyproject.toml"


def source(text: str) -> str:
    """The address "Source" of pyproject.toml's text; empty if there is none."""
    return tomllib.loads(text)["project"].get("urls", {}).get("Source", "").removesuffix("/").removesuffix(".git")


def colab(address: str, notebook: str) -> str:
    """The address of a notebook of the repository in Colab; empty for a repository that Colab cannot open.

    Example:
        >>> colab("https://github.com/somebody/detden", "01-mdp.ipynb")
        'https://colab.research.google.com/github/somebody/detden/blob/main/notebooks/01-mdp.ipynb'
    """
    found = re.fullmatch(r"https://github\.com/([\w.-]+/[\w.-]+)", address)
    root = "https://colab.research.google.com/github"
    return f"{root}/{found[1]}/blob/main/notebooks/{notebook}" if found else ""


def install(address: str) -> str:
    """The cell that makes a notebook run where the library is not, as in Colab; empty without a repository."""
    if not address:
        return ""
    lines = (
        "# In Colab and wherever else the library is missing: install it.",
        "from importlib.util import find_spec",
        "",
        'if find_spec("detden_lite") is None:',
        f'    %pip install -q "detden-lite[look] @ git+{address}"',
    )
    return "\n".join(lines)


def show_repository(app: Sphinx, config: Config) -> None:
    """Add the theme's icon."""
    if address := source(PYPROJECT.read_text("utf-8")):
        icon = dict(name="The source code", url=address, icon="fa-solid fa-code-branch")
        config.html_theme_options["icon_links"] = [icon]


def add_buttons(app: Sphinx, page: str, template: str, context: dict, doctree: object) -> None:
    """The buttons of a chapter, in the theme's list."""
    notebook = f"{Path(page).name}.ipynb"
    if not page.startswith("chapters/"):
        return
    context["header_buttons"] = context.get("header_buttons", [])
    texts = [(context["pathto"](f"notebooks/{notebook}", 1), "Download this chapter as a notebook", "download")]
    if address := colab(source(PYPROJECT.read_text("utf-8")), notebook):
        texts.append((address, "Open this chapter in Colab", "cloud"))
    context["header_buttons"] += [
        dict(type="link", url=url, text="", tooltip=text, icon=f"fa-solid fa-{icon}", label=icon)
        for url, text, icon in texts
    ]


def put_notebooks(app: Sphinx, error: Exception | None) -> None:
    """Put the notebooks beside the pages."""
    from student import write_notebooks  # which needs this module

    if not error and app.builder.format == "html":
        write_notebooks(Path(app.outdir, "notebooks"))


def setup(app: Sphinx) -> dict:
    """Called by Sphinx."""
    app.connect("config-inited", show_repository)
    app.connect("html-page-context", add_buttons, priority=900)  # after the theme's, which begins the list anew
    app.connect("build-finished", put_notebooks)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
