"""The printed book: as many pages as it should have, its fonts embedded, nothing cut off at the edge of the paper."""

import re
import subprocess
import sys

import pdf
import pytest
import yaml
from conftest import CHROMIUM, HTML, ROOT, _missing

CONTENTS = yaml.safe_load((ROOT / "book" / "_toc.yml").read_text("utf-8"))


@pytest.fixture(scope="module")
def printed(tmp_path_factory):
    """A chapter with films, a widget and wide equations, and the first page. Printing fails if something is cut off."""
    if CHROMIUM is None or not (HTML / "index.html").exists():
        _missing("printing needs the built book, and Chromium")
    target = tmp_path_factory.mktemp("printed") / "book.pdf"
    done = print_book(HTML, target, "index.html", "chapters/06-bound.html", "chapters/02-attacks.html")
    assert done.returncode == 0, done.stderr
    return target.read_bytes()


def print_book(folder, target, *pages):
    """In a process of its own: two browsers of one kind in one process disturb each other."""
    command = [sys.executable, pdf.__file__, folder, target, *pages]
    return subprocess.run(command, capture_output=True, text=True)


def count(pattern: bytes, content: bytes) -> int:
    return len(re.findall(pattern, content))


@pytest.mark.slow
def test_three_pages_of_the_book_are_some_fifty_of_paper(printed):
    assert printed.startswith(b"%PDF-")
    assert 25 <= count(rb"/Type\s*/Page\b", printed) <= 120


@pytest.mark.slow
def test_all_fonts_are_embedded(printed):
    described = count(rb"/Type\s*/FontDescriptor\b", printed)
    drawn = count(rb"/Subtype\s*/Type3\b", printed)  # their letters are drawings in the file itself
    assert described > 3 and described - count(rb"/FontFile[23]?\b", printed) <= drawn


@pytest.mark.slow
def test_it_has_an_outline_and_links_inside(printed):
    assert b"/Outlines" in printed and count(rb"/Subtype\s*/Link\b", printed) > 20
    assert b"127.0.0.1" not in printed, "a link leads to the server that printed the book"


def test_what_is_too_wide_is_told(tmp_path):
    """Planted: a picture that does not shrink."""
    if CHROMIUM is None:
        _missing("there is no Chromium")
    text = '<html><body><article class="bd-article"><h1>x</h1><p><img src="x.svg" style="width: 2000px"></p></article>'
    (tmp_path / "index.html").write_text(text)
    (tmp_path / "x.svg").write_text('<svg xmlns="http://www.w3.org/2000/svg" width="2000" height="10"></svg>')
    done = print_book(tmp_path, tmp_path / "book.pdf", "index.html")
    assert done.returncode == 1 and "cut off at the edge of the paper:\nindex-- IMG" in done.stderr
    assert not (tmp_path / "book.pdf").exists()


def test_all_pages_are_printed_in_the_order_of_the_contents():
    pages = pdf.find_pages(CONTENTS)
    assert pages[0] == "index.html" and pages[-1] == "bibliography.html" and "api/attacks.html" in pages
    assert [page for page in pages if page.startswith("chapters/")] == sorted(
        f"chapters/{path.stem}.html" for path in (ROOT / "book" / "chapters").glob("*.md")
    )
