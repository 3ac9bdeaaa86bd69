from dataclasses import replace

import mujoco
import numpy as np
import pytest
import rerun as rr
from builders import BUDGET, HOPPER, make_defense, make_victim

from detden_lite.attacks.noise import UniformNoise
from detden_lite.attacks.timing import Random
from detden_lite.core.tasks import TASKS
from detden_lite.looking.recordings import record
from detden_lite.looking.robot import Robot
from detden_lite.looking.takes import takes
from detden_lite.simulation.rollout import rollout

NAMES = ("clean", "attacked", "defended")


@pytest.fixture(scope="module")
def episodes():
    """Clean, attacked at half of the steps, and defended; the untrained policy soon falls, the second time sooner."""
    victim, noise = make_victim(), UniformNoise(BUDGET, seed=1)
    run = dict(victim=victim, task=HOPPER, seeds=[0, 1], steps=60)
    half = Random(0.5, seed=2)
    return (
        rollout(**run),
        rollout(**run, attack=noise, timing=half),
        rollout(**run, attack=noise, timing=half, defense=make_defense()),
    )


@pytest.fixture(scope="module")
def path(episodes, tmp_path_factory):
    return record(tmp_path_factory.mktemp("recordings") / "hopper.rrd", HOPPER, *episodes, index=1, threshold=1.5)


def read(path, entity: str, component: str) -> tuple[np.ndarray, list]:
    """The steps and values of one component of one entity; no step where it is static."""
    steps, values = [], []
    for chunk in rr.chunk.RrdReader(path).stream():
        batch = chunk.to_record_batch()
        if chunk.entity_path == entity and component in batch.schema.names:
            values += batch.column(component).to_pylist()
            steps += [] if chunk.is_static else batch.column("step").to_pylist()
    return np.array(steps), values


@pytest.mark.parametrize("kind", range(3))
def test_observations_rewards_and_scores_are_those_of_the_episode(path, episodes, kind):
    name, episode = NAMES[kind], episodes[kind]
    length = episode.lengths[1]
    traces = [episode.obs, episode.perturbed, episode.denoised][: kind + 1]
    wanted = np.stack([trace[:length, 1] for trace in traces], axis=-1)
    steps, found = read(path, f"/{name}/observation", "Scalars:scalars")
    np.testing.assert_array_equal(steps, np.arange(length))
    np.testing.assert_array_equal(np.reshape(found, wanted.shape), wanted)
    reward = episode.reward[:length, 1]
    np.testing.assert_allclose(read(path, f"/{name}/reward", "Scalars:scalars")[1], np.c_[reward, reward.cumsum()])
    score = read(path, f"/{name}/score", "Scalars:scalars")[1]
    assert bool(score) == (name == "defended")
    if score:
        np.testing.assert_array_equal(score, np.c_[episode.score[:length, 1], np.full(length, 1.5)])


@pytest.mark.parametrize("kind", range(3))
@pytest.mark.parametrize("flag", ["attacked", "alarm"])
def test_the_state_changes_give_the_flags_back(path, episodes, kind, flag):
    wanted = getattr(episodes[kind], flag)[: episodes[kind].lengths[1], 1]
    steps, states = read(path, f"/{NAMES[kind]}/{flag}", "StateChange:state")
    position = np.searchsorted(steps, np.arange(len(wanted)), side="right") - 1
    np.testing.assert_array_equal(np.array([state == ["on"] for state in states])[position], wanted)


def test_times_are_in_steps_and_in_seconds(path):
    for chunk in rr.chunk.RrdReader(path).stream():
        if not chunk.is_static:
            batch = chunk.to_record_batch()
            seconds = [time.total_seconds() for time in batch.column("time").to_pylist()]
            np.testing.assert_allclose(seconds, np.array(batch.column("step")) * 0.008, atol=1e-9)


def test_the_recorded_robot_follows_mujoco_and_greys_after_falling(path, episodes):
    robot = Robot.of(HOPPER)
    shot = takes(robot, dict(zip(NAMES, episodes, strict=True)), 1)[0]
    steps, ends = read(path, "/clean/robot", "Capsules3D:translations")
    moving = steps[: len(ends)]  # the steps of the colours come after those of the poses
    assert moving[0] == 0 and moving[-1] == len(shot.positions) - 1
    np.testing.assert_allclose(ends, robot.poses(shot.positions[moving])[0], atol=1e-6)
    colours = read(path, "/clean/robot", "Capsules3D:colors")[1]
    assert shot.fell and len(colours) == 2 and colours[0] != colours[1]
    assert read(path, "/clean/fall", "Points3D:labels")[1] == [[f"fell at step {len(shot)}"]]


@pytest.mark.parametrize("task", TASKS.values(), ids=list(TASKS))
def test_any_task_can_be_recorded(task, tmp_path):
    short = rollout(make_victim(task), task, [5], steps=4)
    path = record(tmp_path / "short.rrd", task, short, short, short, dims=[0, 3])
    robot = Robot.of(task)
    assert len(robot.names) == task.obs_dim
    assert np.shape(read(path, "/clean/robot", "Capsules3D:translations")[1])[1:] == (len(robot.geoms), 3)
    assert np.shape(read(path, "/clean/observation", "Scalars:scalars")[1]) == (len(short.mask), 2)


@pytest.mark.parametrize("task", TASKS.values(), ids=list(TASKS))
def test_every_part_of_a_robot_is_mujocos_capsule(task):
    robot = Robot.of(task)
    kinds = set(robot.model.geom_type[robot.geoms].tolist())
    assert kinds <= {int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_SPHERE)}
    data = mujoco.MjData(robot.model)
    mujoco.mj_forward(robot.model, data)
    ends, turns = robot.poses(data.qpos[None])
    x, y, z, w = turns[0].T
    axis = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=-1)
    np.testing.assert_allclose(ends[0] + axis * robot.lengths[:, None] / 2, data.geom_xpos[robot.geoms], atol=1e-9)


@pytest.mark.parametrize("task", TASKS.values(), ids=list(TASKS))
def test_a_true_observation_describes_the_true_robot(task):
    episodes, robot = rollout(make_victim(task), task, [5], steps=3), Robot.of(task)
    positions = episodes.state[:, 0, : robot.model.nq]
    np.testing.assert_allclose(robot.imagined(positions, episodes.obs[:, 0]), positions, atol=1e-6)


def test_the_same_episodes_give_the_same_recording(path, episodes, tmp_path):
    def stored(path):
        (store,) = rr.chunk.RrdReader(path).recordings()
        return store.recording_id, read(path, "/defended/observation", "Scalars:scalars")[1]

    again = record(tmp_path / "again.rrd", HOPPER, *episodes, index=1, threshold=1.5)
    assert stored(again) == stored(path)
    assert stored(record(tmp_path / "other.rrd", HOPPER, *episodes, index=0))[0] != stored(path)[0]


def test_a_thousand_steps_of_hopper_are_small(tmp_path):
    """The steps are joined from short episodes, since an untrained robot falls early and only the size matters."""
    short = rollout(make_victim(), HOPPER, range(200), attack=UniformNoise(BUDGET, 1), defense=make_defense(), steps=10)
    arrays = {
        name: np.swapaxes(value, 0, 1).reshape(-1, 1, *value.shape[2:])[:1000]
        for name, value in vars(short).items()
        if name != "seeds"
    }
    long = replace(short, seeds=np.array([0]), **arrays | {"mask": np.ones((1000, 1), bool)})
    calm = replace(long, perturbed=long.obs, denoised=long.obs, attacked=np.zeros_like(long.attacked))
    fallen = replace(long, mask=np.arange(1000)[:, None] < 250, denoised=long.perturbed)
    path = record(tmp_path / "long.rrd", HOPPER, calm, fallen, long, threshold=1.0)
    assert path.stat().st_size <= 850_000


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(path="film.mp4"), "ends in .rrd"),
        (dict(index=2), "index: 'clean' has episodes 0 to 1, not 2"),
        (dict(index=-1), "index"),
        (dict(dims=[11]), "dims"),
        (dict(dims=[]), "dims"),
        (dict(frame_rate=0.0), "frame_rate"),
        (dict(task=TASKS["ant"]), "belong together"),
    ],
)
def test_bad_arguments_are_refused_and_nothing_is_written(episodes, tmp_path, change, message):
    arguments = dict(path="hopper.rrd", task=HOPPER, index=0) | change
    arguments["path"] = tmp_path / arguments["path"]
    nominal, attacked, defended = episodes
    with pytest.raises(ValueError, match=message):
        record(nominal=nominal, attacked=attacked, defended=defended, **arguments)
    assert list(tmp_path.iterdir()) == []
