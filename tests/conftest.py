"""A browser and a server for the tests of the built book. What another host is asked for is refused and remembered."""

import os
import shutil
import sys
import threading
from dataclasses import dataclass, field
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "book" / "tools"))

HTML = ROOT / "_build" / "html"
SCREENSHOTS = ROOT / "_build" / "screenshots"
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)
FLAGS = [
    *("--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update"),
    *("--disable-sync", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
]


def _missing(what: str):
    """Skip here; fail in CI, which has to have everything."""
    (pytest.fail if os.environ.get("CI") else pytest.skip)(what)


@dataclass
class Visit:
    """A page in the browser, and everything that went wrong on it."""

    page: object  # playwright.sync_api.Page
    problems: list[str] = field(default_factory=list)


@pytest.fixture(scope="session")
def site():
    """The address of the built book, served on the loopback interface."""
    from serve import make_server

    if not (HTML / "index.html").exists():
        _missing("the book is not built: make book SERVE=0")
    with make_server(HTML) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


@pytest.fixture(scope="session")
def browser():
    """A headless Chromium."""
    from playwright.sync_api import sync_playwright

    if CHROMIUM is None:
        _missing("there is no Chromium to open the book in")
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield chromium
        chromium.close()


@pytest.fixture
def visit(site, browser):
    """``visit("chapters/01-x.html", width=390, dark=True)`` opens a page and waits until it is at rest."""
    contexts = []

    def open_page(path: str, width: int = 1280, dark: bool = False) -> Visit:
        context = browser.new_context(viewport={"width": width, "height": 844})
        contexts.append(context)
        mode = "dark" if dark else "light"
        context.add_init_script(f"localStorage.setItem('mode', '{mode}'); localStorage.setItem('theme', '{mode}')")
        visited = Visit(context.new_page())

        def guard(route):
            if route.request.url.startswith((site, "data:", "blob:")):
                route.continue_()
            else:
                visited.problems.append(f"asked another host: {route.request.url}")
                route.abort()

        context.route("**/*", guard)
        page, problems = visited.page, visited.problems
        page.on("console", lambda message: message.type in ("error", "warning") and problems.append(message.text))
        page.on("pageerror", lambda error: problems.append(f"uncaught: {error}"))
        page.on("requestfailed", lambda request: problems.append(f"failed: {request.url}"))
        page.on("response", lambda answer: answer.status >= 400 and problems.append(f"{answer.status}: {answer.url}"))
        page.goto(f"{site}/{path}", wait_until="networkidle")
        page.evaluate("window.MathJax?.startup?.promise")
        return visited

    yield open_page
    for context in contexts:
        context.close()
