"""The built book without a mouse and without eyes: axe finds no serious barrier, and names say what things are."""

import re

import pytest
from conftest import ROOT, _missing
from test_book import CHAPTERS, PAGES, _paint

AXE = ROOT / "_build" / "axe" / "axe.min.js"
LOOK = """async () => {
  const found = await axe.run(document, {resultTypes: ["violations"]});
  return found.violations.map(v => [v.impact, v.id, v.nodes.map(n => n.html.slice(0, 160))]);
}"""


@pytest.fixture(scope="module", params=PAGES)
def path(request):
    return request.param


@pytest.fixture(scope="module")
def page(visit, path):
    with visit(path) as visited:
        yield visited.page


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_axe_finds_no_serious_violation(page, theme):
    if not AXE.exists():
        _missing(f"there is no axe: make {AXE.relative_to(ROOT).as_posix()}")
    _paint(page, theme)
    page.eval_on_selector_all("main details", "all => all.forEach(details => details.open = true)")
    page.add_script_tag(path=AXE)
    found = page.evaluate(LOOK)
    page.eval_on_selector_all("main details", "all => all.forEach(details => details.open = false)")
    assert [violation for violation in found if violation[0] in ("serious", "critical")] == []


def test_folds_say_what_they_hold(page, path):
    names = [text.strip() for text in page.locator("main summary").all_inner_texts()]
    assert [name for name in names if not name or "Show" in name or "Click" in name] == []
    if path in CHAPTERS:
        chapter = int(re.search(r"chapters/(\d+)", path)[1])
        solutions = [name for name in names if name.startswith("Solution of ")]
        assert solutions == [f"Solution of {chapter}.{i + 1}" for i in range(page.locator(".exercise-stub").count())]


def test_formulas_are_no_tab_stops_but_are_read(page):
    assert page.locator("mjx-container[tabindex]:not([data-scrolls])").count() == 0  # but one that scrolls is
    assert page.locator("mjx-container").count() == page.locator("mjx-container mjx-assistive-mml").count()


def test_sliders_have_a_name_and_a_value_in_the_readers_units(page):
    for widget in page.locator(".widget-slider").all():
        handle, readout = widget.locator("[role=slider]"), widget.locator(".widget-readout")
        label = widget.locator(".widget-label").inner_text()
        assert handle.get_attribute("aria-label") == label != ""
        handle.press("ArrowRight")
        value = "([slider, readout]) => slider.getAttribute('aria-valuetext') === readout.textContent.trim()"
        page.wait_for_function(value, arg=[handle.element_handle(), readout.element_handle()])


@pytest.mark.parametrize("width", [390, 1280])
def test_what_scrolls_can_be_reached_by_key(page, width):
    page.set_viewport_size({"width": width, "height": 844})
    page.eval_on_selector_all("main details", "all => all.forEach(details => details.open = true)")
    stuck = """() => [...document.querySelectorAll(".bd-article *")].filter(e =>
        e.scrollWidth > e.clientWidth + 1 && ["auto", "scroll"].includes(getComputedStyle(e).overflowX)
        && e.tabIndex < 0 && !e.querySelector("a, button, [tabindex='0']")).length === 0"""
    page.wait_for_function(stuck)
    page.eval_on_selector_all("main details", "all => all.forEach(details => details.open = false)")
    page.set_viewport_size({"width": 1280, "height": 844})


def test_tables_have_no_empty_heads(page):
    assert [text for text in page.locator("main th").all_text_contents() if not text.strip()] == []
