"""The data cards of the victims, and the films of them."""

import json
from dataclasses import replace
from pathlib import Path

import imageio_ffmpeg
import matplotlib.pyplot as plt
import numpy as np
import pytest
from builders import HOPPER, record, run_with_gl, ship_victim

from detden_lite.core import files
from detden_lite.core.estimates import estimate
from detden_lite.core.tasks import TASKS
from detden_lite.looking import figures
from detden_lite.recipe import publish
from detden_lite.recipe.run import Run
from detden_lite.results.bare_victims import UNATTACKED, load_bare
from detden_lite.results.paper import CLEAN, ROWS
from detden_lite.results.published import PUBLISHED
from detden_lite.results.victim_cards import live, load_card, load_cards
from detden_lite.store import manifest

REFERENCES = Path(__file__).resolve().parents[2] / "book" / "references.bib"


def test_each_row_of_the_paper_has_published_returns():
    assert len(ROWS) == len(set(ROWS)) == 10
    assert set(CLEAN) == set(PUBLISHED) == set(ROWS)
    for (task, _), published in PUBLISHED.items():
        assert published.env_id.split("-")[0] == TASKS[task].env_id.split("-")[0]
        assert f"{{{published.reference}," in REFERENCES.read_text("utf-8")


def test_the_papers_td3_returns_are_close_to_the_zoos():
    """It says that it took them from there: two measurements of one policy should not be far apart."""
    for row in ROWS:
        if row[1] == "td3":
            assert CLEAN[row] == pytest.approx(PUBLISHED[row].mean, rel=0.02)


def test_a_card_says_what_the_sidecar_says(tmp_path):
    ship_victim(tmp_path)
    card = load_card("hopper", "td3", tmp_path)
    assert (card.name, card.title, card.task) == ("hopper-td3", "Hopper, TD3", HOPPER)
    assert (card.seed, card.step, card.steps, card.selection_mean) == (1, 2_000, 3_000, 5.0)
    assert card.estimate == estimate(card.returns) and list(card.returns) == list(range(10))
    assert [(curve.seed, list(curve.mean)) for curve in card.curves] == [(0, [1.0, 9.0]), (1, [2.0, 8.0, 4.0])]
    assert card.recipe == dict(net=16) and card.config["actor"] == [11, 16, 3] and "torch" in card.versions
    assert card.fit is None and card.effect_correlation is None


def test_a_card_shows_the_returns_of_the_clean_record(tmp_path):
    """Else one page would have the returns of one processor, and another page those of another."""
    ship_victim(tmp_path)
    clean = record([7.0, 9.0])
    manifest.write_json(tmp_path / "results" / "hopper-td3.none.always.none.json", clean.to_json(), tmp_path)
    card = load_card("hopper", "td3", tmp_path)
    assert list(card.returns) == [7.0, 9.0] and card.estimate == clean.estimate
    assert list(card.first_returns) == list(range(10))


def test_a_card_has_the_fit_of_the_learned_critic(tmp_path):
    ship_victim(tmp_path, "ant", "ppo")
    critic = dict(fit=dict(explained_variance=0.5, action_correlation=0.1))
    manifest.write_json(tmp_path / "ant-ppo" / "critic.json", critic, tmp_path)
    card = load_card("ant", "ppo", tmp_path)
    assert card.fit == critic["fit"] and card.effect_correlation == 0.1
    assert replace(card, fit=dict(effect_correlation=0.4)).effect_correlation == 0.4


def test_shipped_cards_load_in_the_order_of_the_table(tmp_path):
    assert load_cards(tmp_path) == {}
    for row in (("hopper", "ppo"), ("walker2d", "td3"), ("hopper", "td3")):
        ship_victim(tmp_path, *row)
    (tmp_path / "films").mkdir()
    assert list(load_cards(tmp_path)) == [("hopper", "td3"), ("walker2d", "td3"), ("hopper", "ppo")]


def test_an_altered_card_is_refused(tmp_path):
    ship_victim(tmp_path)
    path = tmp_path / "hopper-td3" / "victim.json"
    path.write_text(path.read_text().replace("2000", "9000"))
    with pytest.raises(files.ArtifactError, match=r"victim\.json is truncated or altered"):
        load_cards(tmp_path)


@pytest.mark.parametrize(
    "gap",
    [
        dict(estimate=dict(mean=1.0)),
        dict(recipe=dict(net=16)),
        dict(recipe=[]),
        dict(returns=[[1.0], [2.0, 3.0]]),
        dict(learning_curves=[{}]),
    ],
)
def test_a_card_that_lacks_something_is_refused(tmp_path, gap):
    ship_victim(tmp_path, **gap)
    with pytest.raises(files.ArtifactError, match=r"victim\.json is no victim's card"):
        load_card("hopper", "td3", tmp_path)


def test_the_shipped_cards_load():
    shipped = load_cards()
    assert ("hopper", "td3") in shipped
    for (task, algo), card in shipped.items():
        assert card.name == f"{task}-{algo}" and card.config["actor"][0] == card.task.obs_dim
        chosen = next(curve for curve in card.curves if curve.seed == card.seed)
        assert card.step in chosen.steps
        assert (card.fit is None) == (algo == "td3")
        if (task, algo) in ROWS:
            assert card.estimate == load_bare(task, algo)[UNATTACKED].estimate


def test_learning_curves_mark_the_snapshot_and_the_papers_return(tmp_path):
    ship_victim(tmp_path)
    _, axes = plt.subplots()
    figures.learning_curves(axes, load_card("hopper", "td3", tmp_path))
    (ring,) = [line for line in axes.lines if line.get_marker() == "o"]
    assert (ring.get_xdata()[0], ring.get_ydata()[0]) == (0.002, 8.0)
    blue = [line for line in axes.lines if line.get_color() == figures.BLUE]
    assert [list(line.get_ydata()) for line in blue] == [[2.0, 8.0, 4.0]]
    assert any(set(line.get_ydata()) == {CLEAN["hopper", "td3"]} for line in axes.lines)
    assert axes.get_title(loc="left") == "Hopper, TD3"
    plt.close()


def test_live_observations_are_those_that_change():
    obs = np.array([[0, 1, 5, 2], [0, 2, 5, 2], [0, 1, 5, 3]], dtype=np.float32)
    assert live(obs, dict(first=2, second=2)) == dict(first=(1, 2), second=(1, 2))
    with pytest.raises(ValueError, match="3 observations in all, and obs has 4"):
        live(obs, dict(first=2, second=1))


SCRIPT = """
import sys
from pathlib import Path
from detden_lite.looking import films
from detden_lite.recipe import publish
from detden_lite.recipe.run import Run
from detden_lite.recipe.cli import main
from detden_lite.simulation.rollout import rollout
from detden_lite.recipe.episode_seeds import seeds
root = Path(sys.argv[1])
main(["portrait", "--root", str(root)])
run = Run.of(root, "hopper", "td3", "tiny")
clean = rollout(run.victim(), run.task, seeds("report", 16), steps=run.scale.horizon)
median = list(clean.returns).index(sorted(clean.returns)[8])
films.still(root / "expected.png", run.task, dict(clean=clean), median, seconds=2.0)
"""


@pytest.mark.slow
def test_a_portrait_is_a_small_film_of_the_median_episode(tmp_path):
    root = tmp_path / "run"
    ship_victim(root)
    run_with_gl(SCRIPT, root)

    film, still = (root / "films" / f"hopper-td3-clean.{ending}" for ending in ("mp4", "png"))
    assert still.read_bytes() == (root / "expected.png").read_bytes()
    about = next(imageio_ffmpeg.read_frames(film))
    assert about["codec"] == "h264" and about["duration"] <= 6.1 and film.stat().st_size <= 150_000

    publish.publish(Run.of(root, "hopper", "td3", "tiny"), tmp_path / "data")
    manifest = json.loads((tmp_path / "data" / "manifest.json").read_text())
    assert {f"films/{film.name}", f"films/{still.name}"} <= set(manifest)
    assert list(load_cards(tmp_path / "data")) == [("hopper", "td3")]
