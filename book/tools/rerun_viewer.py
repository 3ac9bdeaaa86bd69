"""Sphinx extension with two directives: ``film``, and ``recording``, which a button opens in the page.

A film and a recording are files beside the page's source, with a still picture and an alternative text::

    ```{recording} ../../data/recordings/hopper.rrd
    :film: ../../data/films/hopper.mp4
    :still: ../../data/films/hopper.png
    :alt: Three Hoppers side by side; the attacked one falls after three seconds.
    The caption.
    ```

``film`` takes an .mp4 instead of the .rrd and has no ``film`` option; a recording may go without. The viewer is the
one in the installed rerun-notebook, which is the version of rerun-sdk: it lies in the built book, in a folder named
by that version, and no page loads it before it is asked to.
"""

import gzip
import hashlib
import html
import os
import shutil
import struct
import tempfile
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from sphinx.writers.html5 import HTML5Translator

SOURCES = Path(__file__).resolve().parents[1] / "viewer"
FOLDER = f"_rerun/{version('rerun-notebook')}"
HELP = (
    "In the plots white is the true observation, pink the perturbed one and green the denoised one; the pink robot is "
    "the one that the perturbed observation describes. Drag to turn a scene, scroll to come closer, press the space "
    "bar to play, Escape to leave."
)


class moving_picture(nodes.General, nodes.Element):  # noqa: N801, docutils names nodes so
    """A film or recording; its children are the caption. Files are named as they are in the book's downloads."""


class Film(SphinxDirective):
    """A film with its still before it plays."""

    required_arguments = 1
    final_argument_whitespace = True
    has_content = True
    option_spec: ClassVar = {"still": directives.unchanged_required, "alt": directives.unchanged_required}

    def run(self) -> list[nodes.Node]:
        return [self.picture(film=self._file(self.arguments[0], ".mp4"))]

    def picture(self, **about: object) -> moving_picture:
        for option in ("still", "alt"):
            if option not in self.options:
                raise self.error(f"{self.name} {self.arguments[0]}: the option :{option}: is missing")
        still = self._file(self.options["still"], ".png")
        about |= {"still": still, "size": self._size(self.options["still"]), "alt": self.options["alt"]}
        node = moving_picture("", *self.parse_content_to_nodes(), **about)
        self.set_source_info(node)
        return node

    def _file(self, name: str, suffix: str) -> str:
        relative, absolute = self.env.relfn2path(name)
        if not name.endswith(suffix) or not Path(absolute).is_file():
            raise self.error(f"{self.name}: there is no {suffix} file {name}, seen from the folder of this page")
        self.env.note_dependency(relative)
        return self.env.dlfiles.add_file(self.env.docname, relative)

    def _size(self, name: str) -> tuple[int, int]:
        """Width and height, from the header of a PNG."""
        header = Path(self.env.relfn2path(name)[1]).read_bytes()[:24]
        return struct.unpack(">II", header[16:])


class Recording(Film):
    """A film or still of a recording, and the button that opens it."""

    option_spec: ClassVar = Film.option_spec | {"film": directives.unchanged_required}

    def run(self) -> list[nodes.Node]:
        film = self.options.get("film")
        source = self._file(self.arguments[0], ".rrd")
        size = Path(self.env.relfn2path(self.arguments[0])[1]).stat().st_size
        number = self.env.new_serialno("recording")
        return [self.picture(film=film and self._file(film, ".mp4"), recording=source, bytes=size, number=number)]


def picture_html(node: nodes.Element, downloads: str) -> str:
    """The film of a node, or its still if it has none; ``downloads`` is the address of the folder of both."""

    def address(file: str) -> str:
        return html.escape(f"{downloads}/{file}")

    alt, (width, height) = html.escape(node["alt"]), node["size"]
    still, size = address(node["still"]), f'width="{width}" height="{height}"'
    if not node.get("film"):
        return f'<img src="{still}" {size} alt="{alt}">'
    film = address(node["film"])
    return (
        f'<video controls muted loop playsinline preload="none" poster="{still}" {size} aria-label="{alt}">'
        f'<source src="{film}" type="video/mp4"><a href="{film}">{alt}</a></video>'
    )


def visit_html(translator: HTML5Translator, node: moving_picture) -> None:
    downloads = translator.builder.dlpath
    root, alt = downloads.removesuffix("_downloads"), html.escape(node["alt"])
    parts = ['<figure class="moving-picture">', picture_html(node, downloads)]
    if node.get("recording"):
        viewer = html.escape(f"{root}{FOLDER}/viewer.html?recording=../../_downloads/{node['recording']}")
        stage, megabytes = f"recording-{node['number']}", f"{node['bytes'] / 1e6:.1f} MB"
        file = html.escape(f"{downloads}/{node['recording']}")
        parts.append(
            f'<div class="recording-bar"><button type="button" aria-expanded="false" aria-controls="{stage}" '
            f'data-viewer="{viewer}" data-title="Recording: {alt}">Open the recording</button>'
            f'<a href="{viewer}" target="_blank" rel="noopener">in a tab of its own</a>'
            f'<a href="{file}" download>download it ({megabytes})</a></div>'
            f'<div class="recording-stage" id="{stage}" hidden><p>{HELP}</p></div>'
        )
    translator.body.append("".join(parts) + "<figcaption>")


def depart_html(translator: HTML5Translator, node: moving_picture) -> None:
    translator.body.append("</figcaption></figure>\n")


def show_caption_only(translator: nodes.NodeVisitor, node: moving_picture) -> None:
    """Other formats than HTML have no moving pictures."""


def put_viewer(app: Sphinx, error: Exception | None) -> None:
    """Put the viewer into the built book and remove older ones; it is compressed, which takes long, once a version."""
    if error or app.builder.format != "html":
        return
    folder = Path(app.outdir, FOLDER)
    folder.mkdir(parents=True, exist_ok=True)
    for other in set(folder.parent.iterdir()) - {folder}:
        shutil.rmtree(other)
    for name in ("viewer.html", "viewer.js"):
        shutil.copyfile(SOURCES / "frame" / name, folder / name)
    static = files("rerun_notebook") / "static"
    shutil.copyfile(static / "widget.js", folder / "widget.js")
    packed = folder / "re_viewer.bin"  # no server knows this ending, so none unpacks it on its own
    if not packed.exists():
        handle, partial = tempfile.mkstemp(dir=folder)
        with open(static / "re_viewer_bg.wasm", "rb") as source, open(handle, "wb") as target:
            with gzip.GzipFile("", "wb", 6, target, mtime=0) as archive:
                shutil.copyfileobj(source, archive)
        os.chmod(partial, 0o644)
        os.replace(partial, packed)


def setup(app: Sphinx) -> dict:
    others = {name: (show_caption_only, show_caption_only) for name in ("latex", "text", "man", "texinfo")}
    app.add_node(moving_picture, html=(visit_html, depart_html), **others)
    app.add_directive("film", Film)
    app.add_directive("recording", Recording)
    # Sphinx writes every page anew when this value changes, for they name the viewer's folder and use the page's files.
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in sorted((SOURCES / "page").iterdir())))
    app.add_config_value("rerun_viewer", f"{FOLDER} {digest.hexdigest()}", "html")
    app.connect("config-inited", lambda app, config: config.html_static_path.append(str(SOURCES / "page")))
    app.add_js_file("recording.js")
    app.add_css_file("recording.css")
    app.connect("build-finished", put_viewer)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
