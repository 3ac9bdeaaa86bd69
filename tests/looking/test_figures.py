import matplotlib

matplotlib.use("agg")

import matplotlib.pyplot as plt
import numpy as np
import pytest

from detden_lite.attacks.noise import UniformNoise
from detden_lite.core.budget import Budget
from detden_lite.core.estimates import Estimate
from detden_lite.core.metrics import summarize
from detden_lite.core.tasks import get_task
from detden_lite.looking import figures
from detden_lite.looking.robot import Robot
from detden_lite.simulation.rollout import rollout
from detden_lite.victims.victim import Victim

HOPPER = get_task("hopper")


@pytest.fixture(scope="module")
def robot():
    return Robot.of(HOPPER)


@pytest.fixture(scope="module")
def episodes():
    """Episodes of an untrained victim: they last for some dozen steps, not all equally long."""
    victim = Victim([11, 16, 3], [14, 16, 1])
    return rollout(victim, HOPPER, range(4), attack=UniformNoise(Budget(0.075)), steps=150)


@pytest.fixture
def axes():
    figure, axes = plt.subplots()
    yield axes
    plt.close(figure)


def test_units_follow_the_kind_of_joint(robot):
    found = dict(zip(robot.names, figures.units(robot.names), strict=True))
    assert found["z"] == "m" and found["thigh"] == "rad"
    assert found["velocity_x"] == "m/s" and found["velocity_pitch"] == "rad/s"


def test_the_drawn_body_is_as_high_as_the_robot(robot, axes):
    position = np.array([0, 1.25, 0, 0, 0, 0])  # upright, as the model has it before it moves
    figures.body(axes, robot, position)
    # The torso's capsule ends at 1.45 m with a cap of 0.05 m, the foot's axis is at 0.1 m with a radius of 0.06 m.
    top = max(patch.get_xy()[:, 1].max() for patch in axes.patches)
    low = min(patch.get_xy()[:, 1].min() for patch in axes.patches)
    assert len(axes.patches) == len(robot.geoms)
    assert (low, top) == (pytest.approx(0.04, abs=2e-3), pytest.approx(1.5, abs=2e-3))


def test_a_turned_body_is_turned_in_the_picture(robot, axes):
    figures.body(axes, robot, np.array([0, 1.25, 0, 0, 0, 0]))
    torso = axes.patches[0].get_xy()
    figures.body(axes, robot, np.array([0, 1.25, 0.5, 0, 0, 0]))
    turned = axes.patches[len(robot.geoms)].get_xy()
    assert np.ptp(turned[:, 0]) > 2 * np.ptp(torso[:, 0])


def test_a_strip_leaves_out_steps_after_the_end(robot, episodes, axes):
    length = episodes.lengths[0]
    figures.strip(axes, robot, episodes, 0, [0, length - 1, length])
    floor = 1
    assert len(axes.patches) == floor + 2 * len(robot.geoms)


def test_a_trace_ends_with_its_episode(episodes, axes):
    index = int(episodes.lengths.argmin())
    figures.trace(axes, episodes, index, 0, ["obs", "perturbed"])
    true, perturbed = axes.lines
    assert len(true.get_ydata()) == episodes.lengths[index]
    assert np.abs(true.get_ydata() - perturbed.get_ydata()).max() <= 0.075 + 1e-6


def test_flags_mark_each_stretch_once(axes):
    figures.flags(axes, np.array([1, 1, 0, 0, 1]), "black")
    assert [(patch.get_x(), patch.get_width()) for patch in axes.patches] == [(-0.5, 2), (3.5, 1)]


def test_returns_draw_mean_and_interval_of_every_record(episodes, axes):
    record = dict(summarize(episodes), cell=dict(attack="uniform", timing="always", defense="none"))
    figures.returns(axes, {"noise": record, "again": record}, {"again": 390.0})
    marks = {line.get_marker(): line for line in axes.lines}
    assert [text.get_text() for text in axes.get_yticklabels()] == ["noise", "again"]
    assert marks["o"].get_xdata()[0] == pytest.approx(episodes.returns.mean())
    assert list(marks["D"].get_xdata()) == [390.0] and list(marks["D"].get_ydata()) == [1]


@pytest.mark.parametrize(
    "attack, defense, meaning",
    [("none", "none", "clean"), ("gaussian", "none", "noise"), ("fgsm", "none", "attacked"), ("fgsm", "x", "defended")],
)
def test_a_cell_has_the_colour_of_its_meaning(attack, defense, meaning):
    assert figures.cell_colour(dict(attack=attack, defense=defense)) == figures.PALETTE[meaning]


def test_a_table_has_a_row_for_each_row():
    shown = figures.table(["name", "value"], [["a", 1], ["b", 2]]).data
    assert shown.count("<tr>") == 3 and "<td>2</td>" in shown


def test_an_entry_breaks_only_before_its_interval():
    assert figures.whole(Estimate(3_376, 3_375, 3_376, 0, 0, 0, 100)).split(" ") == [
        "3,376",
        "[3,375,\N{NO-BREAK SPACE}3,376]",
    ]
