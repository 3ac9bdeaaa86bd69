"""The directives ``film`` and ``recording``, and the viewer that a button opens, in a small book of their own."""

import io
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb
from conftest import served
from PIL import Image

TOOLS = Path(__file__).resolve().parents[2] / "book" / "tools"
PAGE = """# A page

```{film} ../data/film.mp4
:still: ../data/still.png
:alt: A film
It *moves*.
```

```{recording} ../data/lines.rrd
:still: ../data/still.png
:alt: Two lines & more
```

```{recording} ../data/lines.rrd
:film: ../data/film.mp4
:still: ../data/still.png
:alt: The same
```
"""


def write_sources(folder: Path, page: str) -> None:
    (folder / "chapters").mkdir(parents=True)
    (folder / "data").mkdir()
    (folder / "conf.py").write_text(
        f"import sys\nsys.path.append({str(TOOLS)!r})\nextensions = ['myst_parser', 'rerun_viewer']\n"
        "html_theme = 'basic'\nhtml_favicon = 'data/still.png'\nsource_suffix = {'.md': 'markdown'}\n"
    )
    (folder / "index.md").write_text("# Book\n\n```{toctree}\nchapters/page\n```\n")
    (folder / "chapters" / "page.md").write_text(page)
    Image.new("RGB", (90, 30), "teal").save(folder / "data" / "still.png")
    (folder / "data" / "film.mp4").write_bytes(b"no film is played here")
    stream = rr.RecordingStream("test", recording_id="lines")
    view = rrb.TimeSeriesView(origin="/", contents="/**")
    stream.save(folder / "data" / "lines.rrd", default_blueprint=rrb.Blueprint(view, collapse_panels=True))
    steps = np.arange(100)
    stream.send_columns("sine", [rr.TimeColumn("step", sequence=steps)], rr.Scalars.columns(scalars=np.sin(steps / 9)))
    stream.disconnect()


def build(folder: Path) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "-b", "html", str(folder), str(folder / "_build")]
    return subprocess.run(command, capture_output=True, text=True)


@pytest.fixture(scope="module")
def book(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("book")
    write_sources(folder, PAGE)
    done = build(folder)
    assert done.returncode == 0, done.stderr
    return folder / "_build"


@pytest.fixture(scope="module")
def address(book):
    with served(book) as site:
        yield f"{site}/"


@pytest.fixture
def page(browser, address):
    page = browser.new_page(viewport={"width": 900, "height": 1200})
    page.set_default_timeout(120_000)  # a viewer starts slowly on a busy machine without a graphics card
    page.seen, page.errors = [], []
    page.on("request", lambda request: page.seen.append(request.url))
    page.on("console", lambda message: message.type == "error" and page.errors.append(message.text))
    page.on("pageerror", lambda error: page.errors.append(str(error)))
    page.goto(address + "chapters/page.html")
    page.wait_for_load_state("networkidle")
    yield page
    page.close()


def outside(page, address: str) -> list[str]:
    return [url for url in page.seen if not url.startswith((address, "data:", "blob:"))]


def coloured(page, selector: str) -> int:
    """How many pixels have a colour, which the grey page that says "Loading" has none of."""
    picture = Image.open(io.BytesIO(page.locator(selector).screenshot())).convert("RGB")
    return int((np.ptp(np.asarray(picture), axis=-1) > 60).sum())


def test_every_file_is_copied_once(book):
    names = sorted(path.name for path in (book / "_downloads").rglob("*.*"))
    assert names == ["film.mp4", "lines.rrd", "still.png"]


def test_a_film_is_labelled_and_loads_nothing_before_it_plays(book):
    html = (book / "chapters" / "page.html").read_text()
    film = html[html.index("<video") : html.index("</video>")]
    assert all(word in film for word in ("controls", "muted", "loop", "playsinline", 'preload="none"'))
    assert 'aria-label="A film"' in film and 'poster="../_downloads/' in film and 'width="90" height="30"' in film
    assert "<em>moves</em>" in html


def test_nothing_of_the_viewer_is_loaded_before_the_button_is_pressed(page, address):
    assert not [url for url in page.seen if "_rerun" in url or url.endswith(".rrd")]
    assert outside(page, address) == []


def test_the_button_opens_a_viewer_that_draws_and_asks_no_other_host(page, address):
    button = page.get_by_role("button", name="Open the recording").first
    button.focus()
    page.keyboard.press("Enter")
    frame = page.frame_locator("iframe[title='Recording: Two lines & more']")
    frame.locator("canvas").wait_for()
    for _ in range(60):
        page.wait_for_timeout(500)
        if coloured(page, "iframe") > 300:
            break
    else:
        pytest.fail("the viewer drew no line")
    assert [url for url in page.seen if url.endswith("lines.rrd") and "viewer.html" not in url]
    assert outside(page, address) == []
    assert page.errors == []


def test_one_viewer_at_a_time_and_escape_gives_the_keyboard_back(page):
    first, second = page.locator(".recording-bar button").all()
    first.click()
    second.click()
    assert page.locator("iframe").count() == 1
    assert [first.get_attribute("aria-expanded"), second.get_attribute("aria-expanded")] == ["false", "true"]
    page.frame_locator("iframe").locator("canvas").wait_for()
    page.frame_locator("iframe").locator("canvas").click()
    page.keyboard.press("Escape")
    assert second.evaluate("button => button === document.activeElement")
    page.keyboard.press("Enter")
    assert page.locator("iframe").count() == 0
    assert second.inner_text() == "Open the recording"


@pytest.mark.parametrize("wanted", ["", "?recording=https://example.org/a.rrd"])
def test_the_viewer_refuses_recordings_of_other_hosts(page, address, book, wanted):
    viewer = next(book.glob("_rerun/*/viewer.html")).relative_to(book)
    page.goto(f"{address}{viewer}{wanted}")
    assert "recordings of this book only" in page.get_by_role("alert").inner_text()
    assert outside(page, address) == []


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("```{recording} ../data/lost.rrd\n:still: ../data/still.png\n:alt: x\n```", "lost.rrd"),
        ("```{recording} ../data/still.png\n:still: ../data/still.png\n:alt: x\n```", "no .rrd file"),
        ("```{film} ../data/film.mp4\n:still: ../data/still.png\n```", ":alt: is missing"),
    ],
)
def test_a_wrong_directive_fails_the_build_and_says_why(tmp_path, wrong, message):
    write_sources(tmp_path, f"# A page\n\n{wrong}\n")
    done = build(tmp_path)
    assert done.returncode != 0
    assert message in done.stderr
