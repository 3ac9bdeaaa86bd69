"""The built book in a real browser: closed, typeset, legible on a phone and in the dark, searchable, and its widgets move."""

import pytest
from conftest import HTML, SCREENSHOTS

PAGES = sorted(path.relative_to(HTML).as_posix() for path in HTML.glob("**/*.html") if "_static" not in path.parts)
CHAPTERS = [page for page in PAGES if page.startswith("chapters/")]
WIDGETS = [page for page in CHAPTERS if "jupyter.widget-view+json" in (HTML / page).read_text(encoding="utf-8")]

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
  const walker = document.createTreeWalker(document.querySelector("article"), NodeFilter.SHOW_TEXT);
  const found = [];
  while (walker.nextNode()) {
    const element = walker.currentNode.parentElement;
    if (!walker.currentNode.data.trim() || !element.checkVisibility({visibilityProperty: true, opacityProperty: true})
        || element.closest("script, style, mjx-assistive-mml, .headerlink")) continue;
    const below = behind(element), ink = over(rgba(getComputedStyle(element).color), below);
    const [low, high] = [luminance(below), luminance(ink)].sort((a, b) => a - b);
    found.push([(high + 0.05) / (low + 0.05), walker.currentNode.data.trim().slice(0, 60)]);
  }
  return found.sort((a, b) => a[0] - b[0]);
}"""


def _photograph(page, path: str, kind: str) -> None:
    SCREENSHOTS.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=SCREENSHOTS / f"{path.replace('/', '-').removesuffix('.html')}-{kind}.png", full_page=True)


def test_the_book_has_pages(site):
    assert "index.html" in PAGES and CHAPTERS


@pytest.mark.parametrize("path", PAGES)
def test_page_is_closed_and_without_errors(visit, path):
    visited = visit(path)
    _photograph(visited.page, path, "desktop")
    assert visited.problems == []


@pytest.mark.parametrize("path", PAGES)
def test_mathematics_is_typeset(visit, path):
    page = visit(path).page
    assert page.locator(".math:not(:has(mjx-container))").count() == 0
    assert page.locator("mjx-merror").count() == 0


@pytest.mark.parametrize("path", PAGES)
def test_images_are_there_and_described(visit, path):
    images = visit(path).page.eval_on_selector_all(
        "img", "all => all.map(i => [i.src.slice(-80), (i.alt || '').trim(), i.complete && i.naturalWidth > 0])"
    )
    assert [image for image in images if not image[1] or not image[2]] == []
    assert [image for image in images if image[1].startswith("../_images")] == [], "alt text is missing"


@pytest.mark.parametrize("path", PAGES)
def test_fits_a_phone(visit, path):
    page = visit(path, width=390).page
    _photograph(page, path, "phone")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("path", PAGES)
def test_text_is_legible(visit, path, dark):
    page = visit(path, dark=dark).page
    assert page.evaluate("document.documentElement.dataset.theme") == ("dark" if dark else "light")
    page.eval_on_selector_all("details", "all => all.forEach(details => details.open = true)")
    if dark:
        _photograph(page, path, "dark")
    assert [pair for pair in page.evaluate(CONTRASTS) if pair[0] < 4.5] == []


def test_search_finds_a_word(visit):
    page = visit("search.html?q=perturbed").page
    page.wait_for_selector("#search-results li a")
    assert page.locator("#search-results a[href*='chapters/']").count() >= 1


@pytest.mark.parametrize("path", CHAPTERS)
def test_solutions_are_folded_below_their_stubs(visit, path):
    page = visit(path).page
    stubs, solutions = page.locator(".exercise-stub"), page.locator(".tag_exercise details")
    assert stubs.count() == solutions.count() >= 2
    for position in range(stubs.count()):
        assert "raise NotImplementedError" in stubs.nth(position).inner_text()
        code = solutions.nth(position).locator("pre")
        assert not code.is_visible()
        solutions.nth(position).locator("summary").click()
        assert code.is_visible()


@pytest.mark.parametrize("path", WIDGETS)
def test_widgets_move_without_a_kernel(visit, path):
    visited = visit(path)
    stacks = visited.page.locator(".widget-subarea .widget-stack")
    assert stacks.count() >= 1, "a widget without a Stack of pictures: see AUTHORING.md"
    for position in range(stacks.count()):
        stack = stacks.nth(position)
        area = stack.locator("xpath=ancestor::*[contains(@class, 'widget-subarea')]")
        shown = stack.locator("> *:visible").inner_html()
        area.locator(".noUi-handle").first.press("ArrowRight")
        visited.page.wait_for_function(
            "([stack, shown]) => [...stack.children].find(c => c.checkVisibility()).innerHTML !== shown",
            arg=[stack.element_handle(), shown],
        )
    assert visited.problems == []
