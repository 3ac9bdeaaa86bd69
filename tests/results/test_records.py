"""Records as typed objects and as JSON: nothing is lost between the two, and nothing wrong gets in."""

import json
from dataclasses import FrozenInstanceError, asdict, replace

import numpy as np
import pytest
from builders import HOPPER, make_defense, make_victim, record, steady
from hypothesis import given
from hypothesis import strategies as st

from detden_lite.attacks.noise import UniformNoise
from detden_lite.attacks.timing import Random
from detden_lite.core.budget import Budget
from detden_lite.core.estimates import Estimate
from detden_lite.core.files import ArtifactError
from detden_lite.core.metrics import DetectionDelay, DetectorScores
from detden_lite.results.cells import Cell
from detden_lite.results.records import EpisodeScores, Record, load_record
from detden_lite.simulation.rollout import rollout
from detden_lite.store import manifest

SHIPPED = sorted((manifest.DATA / "results").glob("*.json"))

numbers = st.floats(allow_nan=False, allow_infinity=False, width=32)
counts = st.integers(0, 1_000)
names = st.text("abcdefgh-", min_size=1, max_size=8)
settings = st.dictionaries(names, numbers | counts | names | st.booleans() | st.dictionaries(names, counts), max_size=4)


@st.composite
def records(draw) -> Record:
    """Records of both schemas, with and without each group of entries that may be missing."""
    n = draw(st.integers(1, 4))

    def row(kind) -> tuple:
        return tuple(draw(st.lists(kind, min_size=n, max_size=n)))

    def maybe(kind):
        return draw(st.none() | kind)

    schema, compared = draw(st.sampled_from([1, 2])), draw(st.booleans())
    delay = maybe(st.builds(DetectionDelay, counts, counts, st.none() | numbers, st.none() | counts))
    scores = EpisodeScores(row(counts), row(counts), row(counts), row(st.none() | numbers))
    return Record(
        schema=schema,
        task=draw(names),
        cell=draw(st.builds(Cell, names, names, names)),
        settings=draw(settings),
        seeds=(draw(counts), n),
        returns=row(numbers),
        lengths=row(counts),
        estimate=Estimate(*(draw(numbers) for _ in range(6)), n),
        attack_rate=draw(numbers),
        detector=DetectorScores(draw(numbers), *(maybe(numbers) for _ in range(3))),
        auroc=None if delay is None else maybe(numbers),
        delay=delay,
        denoiser_mae=maybe(numbers),
        auroc_clean=maybe(numbers) if compared else None,
        denoiser_mae_live=maybe(numbers) if compared else None,
        live_dimensions=draw(counts) if compared else None,
        episodes=scores if schema == 2 else None,
        seconds=draw(numbers),
        versions=draw(st.dictionaries(names, names, max_size=3)),
    )


@steady
@given(records())
def test_a_record_survives_json(found: Record):
    again = Record.from_json(json.loads(json.dumps(found.to_json(), allow_nan=False)))
    assert again == found and asdict(again) == asdict(found)


def test_shipped_records_survive_reading_and_writing():
    """Byte for byte, and each entry is found under its name."""
    assert len(SHIPPED) > 400
    for path in SHIPPED:
        found = load_record(path.stem)
        assert manifest.to_json(found.to_json()) == path.read_bytes(), path
        assert found == json.loads(path.read_bytes())


def test_entries_are_read_like_those_of_json():
    found = record([1.0, 2.0])
    assert found["estimate"]["mean"] == found.estimate.mean == 1.5
    assert found["returns"] == [1.0, 2.0] and found.returns == (1.0, 2.0)
    assert Estimate(**found["estimate"]) == found.estimate
    assert found.get("delay", {}) == {} and "auroc" not in found and found.auroc is None
    assert list(found) == list(found.to_json()) == list(found.keys())
    with pytest.raises(KeyError, match="color"):
        found["color"]


def test_a_record_cannot_be_changed():
    found = record([1.0, 2.0])
    with pytest.raises(FrozenInstanceError):
        found.attack_rate = 0.5
    found.to_json()["returns"].append(3.0)
    assert found.returns == (1.0, 2.0)
    assert replace(found, attack_rate=0.5).attack_rate == 0.5


GOOD = record([1.0, 2.0]).to_json()
DELAY = dict(attacks=1, missed=0, mean=0.0, longest=0)
SCORES = dict(attacked=[1, 1], alarms_attacked=[1, 1], alarms_clean=[0, 0], denoiser_mae=[0.1, None])


def without(*names: str) -> dict:
    return {name: value for name, value in GOOD.items() if name not in names}


WRONG = [
    None,
    [],
    3,
    "text",
    {},
    *(without(name) for name in GOOD),
    *(GOOD | {name: None} for name in GOOD if name != "denoiser_mae"),
    *(GOOD | {name: "text"} for name in GOOD if name != "task"),
    *(GOOD | {name: float("nan")} for name in GOOD),
    *(GOOD | {name: [float("inf")]} for name in GOOD),
    GOOD | dict(schema=0),
    GOOD | dict(schema=3),
    GOOD | dict(schema="2"),
    GOOD | dict(schema=None),
    GOOD | dict(schema=2),  # without scores per episode
    GOOD | dict(schema=2, episodes=SCORES | dict(attacked=[1])),
    GOOD | dict(schema=2, episodes=SCORES | dict(attacked=[1, None])),
    GOOD | dict(schema=2, episodes=SCORES | dict(attacked=[1, 0.5])),
    GOOD | dict(episodes=SCORES),
    GOOD | dict(color="red"),
    GOOD | dict(auroc=0.5),  # without a delay
    GOOD | dict(auroc_clean=0.5),  # without the number of live dimensions
    GOOD | dict(auroc="high", delay=DELAY),
    GOOD | dict(auroc=0.5, delay=DELAY | dict(mean=True)),
    GOOD | dict(auroc=0.5, delay=dict(attacks=1)),
    GOOD | dict(returns=[1.0]),
    GOOD | dict(lengths=[1, 1, 1]),
    GOOD | dict(lengths=[1, 1.5]),
    GOOD | dict(returns=[1.0, "2.0"]),
    GOOD | dict(returns=[1.0, True]),
    GOOD | dict(seeds=[0]),
    GOOD | dict(seeds=[0, 3]),
    GOOD | dict(seeds=[0, 2, 2]),
    GOOD | dict(cell=dict(attack="opposite")),
    GOOD | dict(cell=GOOD["cell"] | dict(timing=3)),
    GOOD | dict(estimate=GOOD["estimate"] | dict(n=2.5)),
    GOOD | dict(settings=dict(epsilon=float("nan"))),
    GOOD | dict(settings=[1, 2]),
]


def test_a_wrong_record_is_refused_with_a_remedy():
    for content in WRONG:
        with pytest.raises(ArtifactError, match=r"^here\.json is not a result record \(.+\); make it anew"):
            pytest.fail(f"accepted: {Record.from_json(content, 'here.json')}")


def test_a_wrong_record_on_disk_is_refused_by_name(tmp_path):
    manifest.write_json(tmp_path / "results" / "cell.json", without("returns"), tmp_path)
    with pytest.raises(ArtifactError, match=r"cell\.json is not a result record \(it lacks returns\)"):
        load_record("cell", tmp_path)


def test_scores_per_episode_add_up_to_those_of_all():
    episodes = rollout(
        make_victim(seed=8), HOPPER, range(6), attack=UniformNoise(Budget(0.3)), timing=Random(0.4),
        defense=make_defense(), steps=30,
    )  # fmt: skip
    scores = EpisodeScores.of(episodes)
    for i in range(6):  # a second way: episode by episode, step by step
        steps = [
            (episodes.attacked[t, i], episodes.alarm[t, i], np.abs(episodes.denoised[t, i] - episodes.obs[t, i]).mean())
            for t in range(episodes.lengths[i])
        ]
        assert scores.attacked[i] == sum(bool(attacked) for attacked, _, _ in steps) > 0
        assert scores.alarms_attacked[i] == sum(bool(attacked and alarm) for attacked, alarm, _ in steps)
        assert scores.alarms_clean[i] == sum(bool(alarm and not attacked) for attacked, alarm, _ in steps)
        assert scores.denoiser_mae[i] == pytest.approx(np.mean([error for attacked, _, error in steps if attacked]))
    clean = EpisodeScores.of(rollout(make_victim(seed=8), HOPPER, range(3), defense=make_defense(), steps=30))
    assert clean.attacked == clean.alarms_attacked == (0, 0, 0) and clean.denoiser_mae == (None, None, None)
