"""Sphinx extension with the directive ``playground``: a still with a caption, in whose place a robot can be attacked.

The argument is a query of settings, as ``book/playground/src/scenes.js`` reads them::

    ```{playground} scene=fall
    :still: ../../data/films/hopper-td3-opposite.png
    :alt: A one-legged robot hops, and falls when it is attacked.
    The caption.
    ```

The role ``scene`` is a link to the page of the playground in another state: {scene}`a clean episode <scene=clean>`.

With ``:film:`` a film is in the place of the still. With ``:now:`` the playground opens with the page, in the state of
the page's own address if that has one. What is loaded then lies
in ``playground/`` in the built book; ``build_playground.py`` makes it.
"""

import hashlib
import html
from pathlib import Path
from typing import ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from rerun_viewer import Film, picture_html, show_caption_only
from sphinx.application import Sphinx
from sphinx.util.docutils import ReferenceRole
from sphinx.writers.html5 import HTML5Translator

PAGE = Path(__file__).resolve().parents[1] / "playground" / "page"


class playground(nodes.General, nodes.Element):  # noqa: N801, docutils names nodes so
    """A playground that can be opened; its children are the caption."""


class Playground(Film):
    """The still, the button, and what they open."""

    option_spec: ClassVar = Film.option_spec | {"film": directives.unchanged_required, "now": directives.flag}

    def run(self) -> list[nodes.Node]:
        film = self.options.get("film")
        picture = self.picture(film=film and self._file(film, ".mp4"))
        node = playground("", *picture.children, **picture.attributes)
        node["query"], node["now"] = self.arguments[0], "now" in self.options
        return [node]


class Scene(ReferenceRole):
    """A link to the playground's page, with a query."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        address = self.env.app.builder.get_relative_uri(self.env.docname, "playground")
        return [nodes.reference(self.rawtext, self.title, refuri=f"{address}?{self.target}", internal=True)], []


def visit_html(translator: HTML5Translator, node: playground) -> None:
    downloads = translator.builder.dlpath
    base, query = downloads.removesuffix("_downloads") + "playground/", html.escape(node["query"])
    now = " data-now" if node["now"] else ""
    translator.body.append(
        f'<figure class="playground" data-base="{base}" data-query="{query}"{now}>{picture_html(node, downloads)}'
        '<button type="button" hidden>Open the playground</button>'
        '<div class="playground-stage" hidden></div><figcaption>'
    )


def depart_html(translator: HTML5Translator, node: playground) -> None:
    translator.body.append("</figcaption></figure>\n")


def setup(app: Sphinx) -> dict:
    """Called by Sphinx."""
    app.setup_extension("rerun_viewer")
    others = {name: (show_caption_only, show_caption_only) for name in ("latex", "text", "man", "texinfo")}
    app.add_node(playground, html=(visit_html, depart_html), **others)
    app.add_directive("playground", Playground)
    app.add_role("scene", Scene())
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in sorted(PAGE.iterdir())))
    app.add_config_value("playground", digest.hexdigest(), "html")  # pages are written anew when it changes
    app.connect("config-inited", lambda app, config: config.html_static_path.append(str(PAGE)))
    app.add_js_file("playground.js")
    app.add_css_file("playground.css")
    return {"parallel_read_safe": True, "parallel_write_safe": True}
