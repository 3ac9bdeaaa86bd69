"""The directive ``playground`` and the role ``scene`` in a small book of their own."""

import subprocess
import sys
from pathlib import Path

import pytest
from conftest import PLAYGROUND, ROOT, _missing, served
from PIL import Image

PAGE = """# A page

```{playground} scene=hold&seed=3
:film: ../film.mp4
:still: ../still.png
:alt: A robot & its shadow
It *hops*.
```

Now {scene}`as it falls <scene=fall&seed=2>`.
"""


@pytest.fixture(scope="module")
def book(tmp_path_factory) -> Path:
    if not PLAYGROUND.is_dir():
        _missing("the playground is not built")
    folder = tmp_path_factory.mktemp("book")
    (folder / "chapters").mkdir()
    (folder / "conf.py").write_text(
        f"import sys\nsys.path.append({str(ROOT / 'book' / 'tools')!r})\nextensions = ['myst_parser', 'playground']\n"
        "html_theme = 'basic'\nhtml_favicon = 'still.png'\nsource_suffix = {'.md': 'markdown'}\n"
        f"html_extra_path = [{str(PLAYGROUND.parent)!r}]\n"
    )
    (folder / "index.md").write_text("# Book\n\n```{toctree}\nchapters/page\nplayground\n```\n")
    (folder / "playground.md").write_text("# The playground\n")
    (folder / "chapters" / "page.md").write_text(PAGE)
    (folder / "film.mp4").write_bytes(b"no film is played here")
    Image.new("RGB", (90, 30), "teal").save(folder / "still.png")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "-b", "html", str(folder), str(folder / "_build")]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder / "_build"


@pytest.fixture(scope="module")
def address(book):
    with served(book) as site:
        yield f"{site}/chapters/page.html"


@pytest.fixture
def page(browser, address, request):
    context = browser.new_context(**getattr(request, "param", {}))
    context.set_default_timeout(60_000)
    page = context.new_page()
    page.seen = []
    page.on("request", lambda request: page.seen.append(request.url))
    page.goto(address)
    yield page
    context.close()


def test_nothing_is_loaded_before_the_button_is_pressed(page):
    assert page.locator(".playground video").get_attribute("aria-label") == "A robot & its shadow"
    assert page.locator(".playground figcaption em").inner_text() == "hops"
    assert not [url for url in page.seen if "/playground/" in url]


def test_the_button_opens_a_running_robot_in_place_of_the_film(page):
    page.get_by_role("button", name="Open the playground").press("Enter")
    page.wait_for_function("document.querySelector('[data-number=steps]')?.textContent >= 3")
    assert not page.locator(".playground video").is_visible()
    assert page.evaluate("document.activeElement.textContent") == "Pause"
    page.locator(".pg details summary").click()
    assert page.locator("[name=attack]").input_value() == "hand" and page.locator("[name=seed]").input_value() == "3"


@pytest.mark.parametrize("page", [dict(reduced_motion="reduce")], indirect=True)
def test_who_wants_no_motion_starts_it_themselves(page):
    page.get_by_role("button", name="Open the playground").click()
    page.wait_for_selector(".pg[aria-busy=false]")
    assert page.get_by_role("button", name="Run").is_visible() and page.locator(".pg-status").inner_text() == "Ready."


def test_a_robot_that_does_not_load_is_said_to_and_can_be_tried_again(page):
    page.route("**/mujoco.bin", lambda route: route.abort())
    page.get_by_role("button", name="Open the playground").click()
    page.wait_for_function("/could not start/.test(document.querySelector('.pg-status')?.textContent)")
    page.unroute("**/mujoco.bin")
    page.get_by_role("button", name="Try again").click()
    page.wait_for_selector(".pg[aria-busy=false]")


def test_a_scene_is_a_link_to_the_page_of_the_playground(page, address):
    link = page.get_by_role("link", name="as it falls").get_attribute("href")
    assert link == "../playground.html?scene=fall&seed=2"
