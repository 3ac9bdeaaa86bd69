"""The playground in a browser: it runs, falls, survives, and works by keyboard and with any setting."""

import re
from contextlib import contextmanager

import pytest
from conftest import ROOT

AXE = ROOT / "_build" / "playground" / "node_modules" / "axe-core" / "axe.min.js"
LONG = 300_000  # milliseconds: a busy machine without a graphics card draws slowly
SERIOUS = """async () => {
    const {violations, passes} = await axe.run(".playground");
    if (passes.length < 10) throw new Error("axe saw next to nothing");
    return violations.filter(v => ["serious", "critical"].includes(v.impact)).map(v => [v.id, v.nodes[0].html]);
}"""


@pytest.fixture
def play(visit):
    """``with play("scene=clean") as page:`` opens the page; whatever goes wrong on it fails the test."""

    @contextmanager
    def open_page(query: str):
        with visit(f"playground.html?{query}") as visited:
            visited.page.wait_for_selector(".pg[aria-busy=false]")
            yield visited.page
            assert visited.problems == []

    return open_page


def number(page, name: str, lane: int = 0) -> int:
    return int(page.locator(".pg-lane").nth(lane).locator(f"[data-number={name}]").inner_text())


def run_to_the_end(page) -> str:
    page.get_by_role("button", name="Run").click()
    ended = "/Fell at|Did not fall/.test(document.querySelector('.pg-status').textContent)"
    page.wait_for_function(ended, timeout=LONG)
    return page.locator(".pg-status").inner_text()


def wait_for_steps(page, steps: int, lane: int = 0) -> None:
    """Wait until a robot has made so many steps."""
    counted = "([steps, lane]) => document.querySelectorAll('[data-number=steps]')[lane].textContent >= steps"
    page.wait_for_function(counted, arg=[steps, lane], timeout=LONG)


def painted(page, selector: str) -> int:
    """How many colours a canvas shows."""
    return page.locator(selector).first.evaluate(
        "c => new Set(new Uint32Array(c.getContext('2d').getImageData(0, 0, c.width, c.height).data.buffer)).size"
    )


def test_it_opens_with_a_robot_and_waits(play):
    with play("") as page:
        assert page.locator(".pg-status").inner_text() == "Ready."
        assert painted(page, ".pg-stage") > 5 and number(page, "steps") == 0
        assert not page.locator(".playground > img").is_visible()


def test_a_clean_robot_walks_five_hundred_steps(play):
    with play("scene=clean&speed=max") as page:
        page.get_by_role("button", name="Run").click()
        wait_for_steps(page, 500)
        assert number(page, "return") > 1_000
        assert "Fell" not in page.locator(".pg-status").inner_text()


@pytest.mark.parametrize("query", ["attack=opposite&timing=always", "attack=corner&seed=0&timing=always"])
def test_a_bare_robot_falls_under_an_attack(play, query):
    with play(f"{query}&speed=max") as page:
        assert "Fell at step" in run_to_the_end(page)
        assert number(page, "strikes") == number(page, "steps") < 500


def test_beside_the_bare_robot_that_falls_the_defended_one_goes_on(play):
    with play("scene=compare&timing=always&speed=max&seed=1") as page:
        page.get_by_role("button", name="Run").click()
        wait_for_steps(page, 500, lane=1)
        page.keyboard.press("p")
        assert number(page, "strikes", 0) == number(page, "steps", 0) < 100
        assert number(page, "alarms", 0) == 0 and number(page, "alarms", 1) > 250
        assert "Fell" not in page.locator(".pg-status").inner_text()
        assert painted(page, ".pg-traces") > 5


def test_the_same_seed_gives_the_same_episode(play):
    with play("attack=opposite&timing=always&speed=max") as page:
        first, second = run_to_the_end(page), run_to_the_end(page)
        assert first == second


@pytest.mark.slow
def test_every_setting_can_be_switched_while_it_runs(play):
    with play("scene=hold") as page:
        page.get_by_role("button", name="Run").click()
        for name in ("compare", "defense", "attack", "timing", "watch", "speed", "algo", "robot"):
            control = page.locator(f".pg-controls [name={name}]")
            if name == "compare":
                control.check()
                continue
            for option in control.locator("option:not([disabled])").all():
                control.select_option(option.get_attribute("value"))
                page.wait_for_selector(".pg[aria-busy=false]")
                if page.get_by_role("button", name="Run").count():  # an episode is over, or another robot has come
                    page.get_by_role("button", name="Run").click()
                page.wait_for_timeout(60)
        page.get_by_label("beside a bare robot").uncheck()
        page.locator("[name=attack]").select_option("hand")
        for slider in page.locator(".pg-sliders input").all():
            slider.fill("1")
        page.get_by_role("button", name="All to zero").click()
        assert page.locator(".pg-sliders output").first.inner_text() == "0.00"


def test_it_works_with_the_keyboard_alone(play):
    with play("scene=clean") as page:
        keys = page.keyboard
        page.get_by_role("heading", name="The playground").click()
        for _ in range(40):
            keys.press("Tab")
            if page.evaluate("document.activeElement.matches('.pg-stage')"):
                break
        keys.press("Space")
        wait_for_steps(page, 20)
        keys.press("p")
        paused = number(page, "steps")
        keys.press("s")
        assert number(page, "steps") == paused + 1
        keys.press("ArrowLeft")
        keys.press("s")
        for _ in range(40):
            keys.press("Tab")
            if page.evaluate("document.activeElement.name") == "attack":
                break
        keys.type("opp")
        while page.locator("[name=timing]").input_value() != "key":
            page.locator("[name=timing]").press("ArrowDown")
        page.locator(".pg-run").focus()
        keys.down("a")
        keys.press("s")
        keys.up("a")
        keys.press("s")
        assert number(page, "strikes") == 1
        keys.press("r")
        assert number(page, "steps") == 0


def test_a_push_moves_the_robot_and_the_ghost_can_be_bent(play):
    with play("attack=hand&timing=always&speed=0.1") as page:
        stage = page.locator(".pg-stage").bounding_box()
        middle = stage["x"] + stage["width"] / 2, stage["y"] + stage["height"] * 0.35
        page.mouse.move(*middle)
        page.mouse.down()
        page.mouse.move(middle[0] + 60, middle[1] - 60, steps=3)
        page.mouse.up()
        assert "1.00" in page.locator(".pg-sliders output").all_inner_texts()
        page.locator("[name=attack]").select_option("none")
        page.locator("[name=speed]").select_option("max")
        page.get_by_role("button", name="Run").click()
        for _ in range(50):
            page.get_by_role("button", name="Push back").click(force=True)
            if "Fell" in page.locator(".pg-status").inner_text():
                break
        assert number(page, "strikes") == 0


def test_a_challenge_gives_a_score(play):
    with play("challenge=one-number&offset=pitch:1&speed=max") as page:
        assert page.locator("[name=defense]").is_disabled()
        assert "Fell at step" in run_to_the_end(page)
        assert re.fullmatch(r"0 of 100 points in “One number”, seed 1.", page.locator(".pg-score").inner_text())
        page.get_by_role("button", name="Leave the challenge").click()
        assert page.locator("[name=defense]").is_enabled() and not page.locator(".pg-challenge").is_visible()


def test_the_link_states_the_settings(play):
    asked = "robot=walker2d&algo=ppo&attack=hand&epsilon=0.5&defense=detector&seed=7&offset=z:0.5,thigh:-1"
    with play(asked) as page:
        linked = page.locator(".pg-link").get_attribute("href").split("?")[1]
    with play(linked) as page:
        assert page.locator("[name=robot]").input_value() == "walker2d"
        assert [page.locator(".pg-sliders output").nth(i).inner_text() for i in (0, 1, 2)] == ["0.50", "0.00", "-1.00"]
        assert page.locator(".pg-link").get_attribute("href").endswith(linked)


def test_a_link_with_nonsense_opens_the_usual_settings(play):
    with play("robot=ant&epsilon=x&seed=-1&steps=1e9&offset=z:NaN,:1&scene=lost&challenge=constructor") as page:
        assert page.locator("[name=robot]").input_value() == "hopper"
        assert page.locator("[name=seed]").input_value() == "1"


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_axe_finds_nothing_serious(play, theme):
    with play("challenge=unheard") as page:
        page.evaluate("theme => (document.documentElement.dataset.theme = theme)", theme)
        page.add_script_tag(path=AXE)
        assert page.evaluate(SERIOUS) == []


def test_on_a_phone_nothing_sticks_out(play):
    with play("scene=compare&attack=hand") as page:
        page.set_viewport_size({"width": 390, "height": 844})
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        assert page.locator(".pg-stage").first.bounding_box()["width"] > 300


def test_without_scripts_there_is_a_still_with_its_caption(site, browser):
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto(f"{site}/playground.html")
    assert page.locator(".playground > img").is_visible()
    assert "needs JavaScript" in page.locator(".playground figcaption").inner_text()
    assert not page.locator(".playground > button").is_visible()
    context.close()
