"""The built book in a real browser: closed, typeset, legible on a phone and in the dark; search and widgets work."""

import re

import pytest
from conftest import HTML, ROOT, SCREENSHOTS

PAGES = sorted(path.relative_to(HTML).as_posix() for path in HTML.glob("**/*.html"))
PAGES = [page for page in PAGES if "/_" not in f"/{page}"]  # such folders hold no pages: static files, the viewer
CHAPTERS = [page for page in PAGES if page.startswith("chapters/")]

# The WCAG contrast of every piece of text with what lies behind it: [[contrast, text], ...], the worst first.
CONTRASTS = """() => {
  const canvas = document.createElement("canvas").getContext("2d", {willReadFrequently: true});
  const rgba = color => { canvas.clearRect(0, 0, 1, 1); canvas.fillStyle = color; canvas.fillRect(0, 0, 1, 1);
                          return [...canvas.getImageData(0, 0, 1, 1).data]; };
  const linear = c => (c /= 255) <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
  const luminance = ([r, g, b]) => 0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b);
  const over = (top, below) => top.slice(0, 3).map((c, i) => c * top[3] / 255 + below[i] * (1 - top[3] / 255));
  const behind = element => {
    if (!element) return [255, 255, 255];
    const color = rgba(getComputedStyle(element).backgroundColor);
    return color[3] === 255 ? color : over(color, behind(element.parentElement));
  };
  const faded = ([r, g, b, a], element) => {
    for (; element; element = element.parentElement) a *= getComputedStyle(element).opacity;
    return [r, g, b, a];
  };
  const walker = document.createTreeWalker(document.querySelector("main"), NodeFilter.SHOW_TEXT);
  const found = [];
  while (walker.nextNode()) {
    const element = walker.currentNode.parentElement;
    if (!walker.currentNode.data.trim() || !element.checkVisibility({visibilityProperty: true, opacityProperty: true})
        || element.closest("script, style, mjx-assistive-mml, .headerlink")) continue;
    const below = behind(element), ink = over(faded(rgba(getComputedStyle(element).color), element), below);
    const [low, high] = [luminance(below), luminance(ink)].sort((a, b) => a - b);
    found.push([(high + 0.05) / (low + 0.05), walker.currentNode.data.trim().slice(0, 60)]);
  }
  return found.sort((a, b) => a[0] - b[0]);
}"""


@pytest.fixture(scope="module", params=PAGES)
def path(request):
    return request.param


@pytest.fixture(scope="module")
def visited(visit, path):
    with visit(path) as visited:
        yield visited


@pytest.fixture
def page(visited):
    """The page as it was opened: wide, light, everything folded."""
    yield visited.page
    visited.page.set_viewport_size({"width": 1280, "height": 844})
    _paint(visited.page, "light")


def _paint(page, theme: str) -> None:
    """Turn the page light or dark at once: without the transitions, in which colours would be met half-way."""
    page.evaluate(
        """theme => {
          const still = document.createElement("style");
          still.textContent = "*, *::before, *::after {transition: none !important; animation: none !important}";
          document.head.append(still);
          document.documentElement.dataset.theme = theme;
        }""",
        theme,
    )


def _photograph(page, path: str, kind: str) -> None:
    SCREENSHOTS.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=SCREENSHOTS / f"{path.replace('/', '-').removesuffix('.html')}-{kind}.png", full_page=True)


def test_the_book_has_pages(site):
    assert "index.html" in PAGES and CHAPTERS


def test_page_is_closed_and_without_errors(visited, path):
    _photograph(visited.page, path, "desktop")
    assert visited.problems == []


def test_mathematics_is_typeset(page):
    assert page.locator(".math:not(:has(mjx-container))").count() == 0
    assert page.locator("mjx-merror").count() == 0
    # A formula in what a cell prints is left as it is, unless the cell's markdown_format is myst.
    without_code = """all => all.map(e => {
        const copy = e.cloneNode(true);
        copy.querySelectorAll("code, pre, script, .math").forEach(part => part.remove());
        return copy.textContent;
    })"""
    prose = page.eval_on_selector_all("main p, main li, main td", without_code)
    assert [text for text in prose if re.search(r"\$[^$]+\$", text)] == []


def test_images_are_there_and_described(page):
    """Where there is no description, docutils writes the image's address in its place."""
    attributes = "i => [i.getAttribute('src').slice(0, 80), i.alt.trim().slice(0, 80), i.complete && !!i.naturalWidth]"
    images = page.eval_on_selector_all("img", f"all => all.map({attributes})")
    assert [source for source, alt, loaded in images if not loaded or alt in ("", source)] == []


def test_fits_a_phone(page, path):
    page.set_viewport_size({"width": 390, "height": 844})
    _photograph(page, path, "phone")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_text_is_legible(page, path, theme):
    _paint(page, theme)
    _photograph(page, path, theme)
    page.eval_on_selector_all("details", "all => all.forEach(details => details.open = true)")
    contrasts = page.evaluate(CONTRASTS)
    page.eval_on_selector_all("details", "all => all.forEach(details => details.open = false)")
    assert [pair for pair in contrasts if pair[0] < 4.5] == []


def test_solutions_are_folded_below_their_stubs(page, path):
    stubs, solutions = page.locator(".exercise-stub"), page.locator(".tag_exercise details")
    assert stubs.count() == solutions.count()
    for position in range(stubs.count()):
        assert "raise NotImplementedError" in stubs.nth(position).inner_text()
        code = solutions.nth(position).locator("pre")
        assert not code.is_visible()
        solutions.nth(position).locator("summary").click()
        assert code.is_visible()


def test_numbers_are_those_of_the_notebooks(page, path):
    """Figures and equations are called in the student's notebook what they are called in the book."""
    if path not in CHAPTERS:
        pytest.skip("has no notebook")
    notebook = (ROOT / "notebooks" / f"{path.removeprefix('chapters/').removesuffix('.html')}.ipynb").read_text("utf-8")
    shown = [text.strip() for text in page.locator(".caption-number").all_inner_texts()]
    assert re.findall(r"\*\*(Figure \d+\.\d+)\.\*\*", notebook) == shown
    equations = [text.strip("()# \n\u00b6") for text in page.locator(".eqno").all_inner_texts()]
    assert re.findall(r"tag\{(\d+\.\d+)\}", notebook) == equations


def test_widgets_move_without_a_kernel(page, visited, path):
    """Every chapter has a widget; the first slider of each, moved by one step, brings other pictures."""
    assert page.locator(".widget-subarea").count() >= (path in CHAPTERS)
    pictures = "widget => [...widget.querySelectorAll('img')].map(image => image.alt + image.src).join()"
    for widget in page.locator(".widget-subarea").all():
        before = widget.evaluate(pictures)
        assert before, "a widget shows no picture: see AUTHORING.md"
        widget.locator(".noUi-handle").first.press("ArrowRight")
        moved = f"([widget, before]) => ({pictures})(widget) !== before"
        page.wait_for_function(moved, arg=[widget.element_handle(), before])
    assert visited.problems == []


def test_the_reader_can_turn_to_the_dark(visit):
    with visit("index.html") as visited:
        for _ in range(3):  # the button goes round: automatic, light, dark
            if visited.page.evaluate("document.documentElement.dataset.theme") != "dark":
                visited.page.locator(".theme-switch-button").first.click()
        assert visited.page.evaluate("document.documentElement.dataset.theme") == "dark"


def test_search_finds_a_word(visit):
    with visit("search.html?q=perturbed") as visited:
        visited.page.wait_for_selector("#search-results li a[href*='chapters/']")
        assert visited.problems == []
