import numpy as np
import pytest
from builders import ship_victim

from detden_lite.core.files import ArtifactError
from detden_lite.results.online_trainings import load_trainings, robust_from
from detden_lite.results.victim_cards import LearningCurve

COLUMNS = dict(
    end=[100, 200, 300, 400], steps=[100] * 4, episodes=[9, 7, 3, 2], falls=[9, 5, 1, 0], cpu_seconds=[900.0] * 4,
    attacked_steps=[200] * 4, attacked_episodes=[18, 15, 6, 4], attacked_falls=[18, 12, 2, 1],
)  # fmt: skip


def ship(root, algo="atla", **changes):
    """Two trainings, one robust after 200 steps and one after 400; and a card with other changes."""
    curves = [
        dict(seed=0, steps=[100, 200, 300, 400], mean=[1.0] * 4, attacked=[5.0, 95.0, 60.0, 100.0]),
        dict(seed=1, steps=[100, 200, 300, 400], mean=[1.0] * 4, attacked=[5.0, 10.0, 60.0, 100.0]),
    ]
    training = [dict(seed=seed, **COLUMNS) for seed in (0, 1)]
    ship_victim(root, algo=algo, **dict(learning_curves=curves, training=training) | changes)


def test_falls_are_counted_until_a_policy_is_robust_and_from_then_on(tmp_path):
    ship(tmp_path)
    early, late = load_trainings("hopper", "atla", tmp_path)
    assert (early.seed, early.robust_from, late.robust_from) == (0, 200, 400)
    assert (early.falls.before, early.falls.after, early.falls.total) == (14, 1, 15)
    assert (early.attacked_falls.before, early.attacked_falls.after) == (30, 3)
    assert (late.attacked_falls.before, late.attacked_falls.after) == (33, 0)
    assert early.attacked_steps.total == 800 and early.core_hours == 1


def test_a_control_is_never_robust(tmp_path):
    curve = [dict(seed=0, steps=[100, 200, 300, 400], mean=[1.0] * 4)]
    ship(tmp_path, algo="vanilla", learning_curves=curve, training=[dict(seed=0, **COLUMNS)])
    (control,) = load_trainings("hopper", "vanilla", tmp_path)
    assert control.robust_from is None and (control.falls.before, control.falls.after) == (15, 0)


def test_a_row_of_another_kind_tells_nothing(tmp_path):
    ship_victim(tmp_path)
    with pytest.raises(ArtifactError, match="hopper-td3 has no record of its training"):
        load_trainings("hopper", "td3", tmp_path)


def test_a_training_that_only_loses_is_robust_from_its_best_snapshot_on():
    falling = LearningCurve(0, np.array([1, 2, 3]), np.zeros(3), np.array([-3.0, -2.0, -2.5]))
    assert robust_from(falling) == 2
