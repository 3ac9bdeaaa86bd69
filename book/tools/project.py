"""Sphinx extension that shows the repository's address, if pyproject.toml has one: an icon on each page."""

import tomllib
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.config import Config

PYPROJECT = Path(__file__).resolve().parents[2] / "pyproject.toml"


def source(text: str) -> str:
    """The address "Source" of pyproject.toml's text; empty if there is none."""
    return tomllib.loads(text)["project"].get("urls", {}).get("Source", "")


def show_repository(app: Sphinx, config: Config) -> None:
    """Add the theme's icon."""
    if address := source(PYPROJECT.read_text("utf-8")):
        icon = dict(name="The source code", url=address, icon="fa-solid fa-code-branch")
        config.html_theme_options["icon_links"] = [icon]


def setup(app: Sphinx) -> dict:
    """Called by Sphinx."""
    app.connect("config-inited", show_repository)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
