"""``defend``: a policy that the recipe does not know, defended in one call; its refusals, and a second call."""

import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch
from builders import make_victim, normal
from gymnasium.envs.mujoco.inverted_pendulum_v5 import InvertedPendulumEnv
from stable_baselines3 import PPO, TD3
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecNormalize

import detden_lite
from detden_lite.core.budget import Budget
from detden_lite.core.tasks import SWIMMER
from detden_lite.defense.variants import MAIN
from detden_lite.recipe.cli import main
from detden_lite.recipe.run import Run
from detden_lite.recipe.scales import defense_scale
from detden_lite.recipe.task_from_env import task_of
from detden_lite.recipe.trajectories import load_trajectories, save_shard
from detden_lite.results import records
from detden_lite.store import manifest, models, tensors
from detden_lite.victims.victim import Victim

BUDGET = Budget(0.05)
NET = dict(net_arch=[16, 12])


@pytest.fixture(scope="module")
def ppo():
    """A PPO with its normaliser after a few steps."""
    env = VecNormalize(make_vec_env("InvertedPendulum-v5", n_envs=2, seed=0))
    model = PPO("MlpPolicy", env, policy_kwargs=dict(NET), n_steps=64, batch_size=64, seed=0)
    return model.learn(256), env


@pytest.fixture(scope="module")
def defended(ppo, tmp_path_factory):
    folder = tmp_path_factory.mktemp("own")
    return detden_lite.defend(ppo[0], "InvertedPendulum-v5", BUDGET, "tiny", folder, ppo[1]), folder


def contents(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*.*") if path.is_file()}


def again(folder, ppo, **changes):
    settings = dict(env="InvertedPendulum-v5", budget=BUDGET, scale="tiny", folder=folder, vecnormalize=ppo[1])
    return detden_lite.defend(**{"victim": ppo[0], **settings, **changes})


def scores(defense, obs) -> np.ndarray:
    """Scores and denoised observations of ten steps of three episodes."""
    defense.reset(range(3))
    verdicts = [defense(step) for step in obs]
    return torch.stack([torch.cat([v.score[:, None], v.denoised], 1) for v in verdicts]).numpy()


def test_a_defended_ppo_is_stored_in_its_folder(defended, ppo):
    found, folder = defended
    victim = models.load_victim("invertedpendulum", "ppo", folder)
    obs = normal(10, 3, 4)
    assert torch.equal(victim(obs[0]), found.victim(obs[0]))
    seen = ppo[1].normalize_obs(obs[0].numpy())
    assert np.allclose(found.victim(obs[0]), ppo[0].predict(seen, deterministic=True)[0], atol=1e-5)
    loaded = models.load_defense("invertedpendulum", "ppo", MAIN, folder)
    assert loaded.detector.threshold == found.defense.detector.threshold
    assert not loaded.ablations and loaded.denoiser.model.config["residual"]
    assert np.array_equal(scores(loaded, obs), scores(found.defense, obs))


def test_a_second_call_loads_the_same_defence(defended, ppo):
    found, folder = defended
    before, obs = contents(folder), normal(10, 3, 4)
    times = {path: path.stat().st_mtime_ns for path in folder.rglob("*.safetensors")}
    second = again(folder, ppo, victim=found.victim, vecnormalize=None, env=gymnasium.make("InvertedPendulum-v5"))
    assert contents(folder) == before
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*.safetensors")} == times
    assert np.array_equal(scores(second.defense, obs), scores(found.defense, obs))


@pytest.mark.parametrize("lost", ["detector-diverse.json", f"denoiser-{MAIN}.safetensors", "normal-diverse"])
def test_a_lost_file_is_made_again_the_same(defended, ppo, tmp_path, lost):
    found, folder = defended
    copy, obs = shutil.copytree(folder, tmp_path / "copy"), normal(10, 3, 4)
    path = copy / "invertedpendulum-ppo" / lost
    if path.is_dir():  # and what was made of it
        shutil.rmtree(copy / "invertedpendulum-ppo" / "checkpoints")
        shutil.rmtree(path)
        (path.parent / "detector-diverse.safetensors").unlink()
    else:
        path.unlink()
    assert np.array_equal(scores(again(copy, ppo).defense, obs), scores(found.defense, obs))
    kept = {name: content for name, content in contents(folder).items() if "checkpoints" not in name}
    assert {name: content for name, content in contents(copy).items() if "checkpoints" not in name} == kept


def test_the_denoiser_of_a_td3_is_trained_on_both_attacks(tmp_path):
    model = TD3("MlpPolicy", "InvertedPendulum-v5", policy_kwargs=dict(NET), seed=0, buffer_size=10)
    found = detden_lite.defend(model, model.get_env().envs[0].unwrapped.spec.id, BUDGET, "tiny", tmp_path)
    folder = tmp_path / "invertedpendulum-td3"
    card = manifest.read_json(folder / f"denoiser-{MAIN}.json", tmp_path)
    assert card["adversarial"] == ["adversarial", "qfunction"] and len(found.victim.critics) == 2
    clean, *attacked = (
        tensors.load_tensors(folder / name / "00000.safetensors", tmp_path)[0]
        for name in ("normal-diverse", "adversarial-diverse", "qfunction-diverse")
    )
    for part in attacked:
        assert 0 < (part["obs"] - clean["obs"]).abs().max() <= BUDGET.epsilon + 1e-6
        assert torch.equal(part["lengths"], clean["lengths"])
    assert not torch.equal(*(part["obs"] for part in attacked))


def test_the_attacks_use_the_given_ball(ppo, tmp_path):
    scale = torch.tensor([1.0, 0.5, 2.0, 4.0])
    again(tmp_path, ppo, budget=Budget(0.1, 2, scale))
    folder = tmp_path / "invertedpendulum-ppo"
    true, seen = (
        tensors.load_tensors(folder / f"{part}-diverse" / "00000.safetensors", tmp_path)[0]["obs"]
        for part in ("normal", "adversarial")
    )
    size = torch.linalg.vector_norm((seen - true) / scale, dim=-1)
    assert 0.09 < size.max() <= 0.1 + 1e-6


def test_enough_episodes_give_the_conformal_threshold(defended, ppo, tmp_path):
    found, folder = defended
    few = manifest.read_json(folder / "invertedpendulum-ppo" / "detector-diverse.json", folder)
    assert not few["conformal"] and np.isfinite(few["threshold"])
    copy = shutil.copytree(folder, tmp_path / "copy")
    run = Run(copy, found.task, "ppo", defense_scale("tiny", found.task))
    enough = load_trajectories(run, "calibration").select(np.resize(np.arange(4), 100))
    save_shard(run, run.folder / "calibration" / "00000.safetensors", enough)
    (run.folder / "detector-diverse.safetensors").unlink()
    again(copy, ppo)
    card = manifest.read_json(run.folder / "detector-diverse.json", copy)
    assert card["conformal"] and card["threshold"] >= card["calibration_quantiles"]["0.95"]


def test_a_folder_of_another_victim_or_settings_is_refused(defended, ppo):
    found, folder = defended
    before = contents(folder)
    other = Victim.from_state(found.victim.config, found.victim.state_dict())
    other.actor[0].weight.add_(0.5)
    tiny = defense_scale("tiny", task_of("InvertedPendulum-v5", BUDGET))
    for changes, named in (
        (dict(victim=other), "victim"),
        (dict(budget=Budget(0.06)), "epsilon"),
        (dict(budget=Budget(0.05, norm=2), seed=1), "norm, seed"),
        (dict(scale=replace(tiny, trajectories=9)), "sizes"),
    ):
        with pytest.raises(ValueError, match=rf"folder: .*-ppo holds the defence of another {named};"):
            again(folder, ppo, **changes)
    assert contents(folder) == before


def test_a_defence_of_unknown_settings_is_refused(defended, ppo, tmp_path):
    copy = shutil.copytree(defended[1], tmp_path / "copy")
    (copy / "invertedpendulum-ppo" / "defend.json").unlink()
    before = contents(copy)
    with pytest.raises(ValueError, match=r"holds a defence, and no defend.json that says of which settings; restore"):
        again(copy, ppo, budget=Budget(0.5))
    assert contents(copy) == before


def test_a_wrapper_hidden_behind_an_id_is_refused():
    """The episodes are played without the wrapper: the defence would be made for other observations."""

    def scaled(**kwargs):
        world = InvertedPendulumEnv(**kwargs)
        return gymnasium.wrappers.TransformObservation(world, lambda obs: 100 * obs, world.observation_space)

    gymnasium.register("ScaledPendulum-v0", entry_point=scaled)
    with pytest.raises(ValueError, match="is wrapped in TransformObservation, and the .*; move"):
        task_of("ScaledPendulum-v0", BUDGET)


class Odd(gymnasium.Env):
    """An environment that is not registered."""


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (dict(budget=0.05), "budget: give a .*Budget"),
        (dict(budget=Budget(0.1, scale=torch.ones(3))), "budget: its scale must be one number or 4"),
        (dict(scale="huge"), "unknown scale 'huge'; choose one of: tiny"),
        (dict(scale=None), "unknown scale None"),
        (dict(seed=1.5), "seed: it must be a whole number of at least 0, not 1.5"),
        (dict(seed=-1), "seed: it must be a whole number"),
        (dict(seed=True), "seed: it must be a whole number"),
        (dict(victim="ppo.zip"), "model: str is none of"),
        (dict(env="Nowhere-v5"), "env: .*Nowhere"),
        (dict(env=Odd()), "env: it has no spec"),
        (dict(env="CartPole-v1"), "env: the actions of CartPole-v1 must be vectors"),
        (dict(env="Pendulum-v1"), "env: Pendulum-v1 is not derived .*; from recorded episodes"),
        (dict(env="Swimmer-v5"), "victim: it maps 4 observations to 1 actions, but Swimmer-v5 has 8 and 2"),
        (dict(env=gymnasium.make("InvertedPendulum-v5", reset_noise_scale=0.2)), "with reset_noise_scale, which"),
        (dict(env=Monitor(gymnasium.make("InvertedPendulum-v5"))), "with Monitor, which its id does not tell"),
        (dict(vecnormalize=None), "vecnormalize: this PPO saw normalised observations"),
    ],
)
def test_bad_arguments_are_refused_before_anything_is_written(ppo, tmp_path, changes, message):
    with pytest.raises(ValueError, match=message):
        again(tmp_path, ppo, **changes)
    assert not list(tmp_path.iterdir())


def test_a_folder_that_is_a_file_is_refused(ppo, tmp_path):
    file = tmp_path / "mine"
    file.write_text("in the way")
    for folder in (file, file / "inside"):
        with pytest.raises(ValueError, match="folder: .*mine is a file; give a folder"):
            again(folder, ppo)
    with pytest.raises(ValueError, match="folder: give a path, not None"):
        again(None, ppo)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "invertedpendulum-ppo").write_text("in the way")
    with pytest.raises(ValueError, match="invertedpendulum-ppo is a file"):
        again(tmp_path / "run", ppo)
    assert {path.name for path in tmp_path.rglob("*")} == {"mine", "run", "invertedpendulum-ppo"}


@pytest.mark.parametrize("name", ["trajectories", "horizon", "attack_steps"])
@pytest.mark.parametrize("number", [0, -1, 1.5, True, None])
def test_sizes_that_are_no_counts_are_refused(name, number):
    tiny = defense_scale("tiny", task_of("InvertedPendulum-v5", BUDGET))
    with pytest.raises(ValueError, match=f"{name} must be a whole number of at least 1, not {number}"):
        replace(tiny, **{name: number})
    with pytest.raises(ValueError, match="defense must be a detden_lite.VAERecipe"):
        replace(tiny, defense=None)


def test_a_policy_whose_actions_have_other_bounds_is_refused(ppo, tmp_path):
    victim = Victim.from_sb3(*ppo)
    victim.action_high.fill_(1.0)
    with pytest.raises(
        ValueError, match=r"its actions lie between \[-3.\] and \[1.\], those of InvertedPendulum-v5 in"
    ):
        again(tmp_path, ppo, victim=victim)


def test_a_task_has_the_papers_sizes_and_the_environments_limit():
    ant = task_of("Ant-v5", Budget(0.2))
    assert (ant.name, ant.epsilon, ant.hidden) == ("ant", 0.2, 256)
    assert task_of(gymnasium.make("Swimmer-v5", max_episode_steps=70), BUDGET).horizon == 70


def test_importing_is_lazy_and_defending_needs_no_trainer():
    script = "import sys, detden_lite; assert 'torch' not in sys.modules; detden_lite.defend; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout.split()
    assert "detden_lite.recipe.defend" in loaded and not {"stable_baselines3", "sbx", "jax", "matplotlib"} & set(loaded)
    with pytest.raises(AttributeError, match="defense_of"):
        detden_lite.defense_of  # noqa: B018


def test_the_defend_stage_stores_its_records_and_sweep_once(tmp_path):
    models.save_victim("swimmer", "ppo", make_victim(SWIMMER, gaussian=True), {}, tmp_path)
    stage = ["defend", "--task", "swimmer", "--algo", "ppo", "--scale", "tiny", "--root", str(tmp_path)]
    main(stage)
    made = {path.stem for path in (tmp_path / "results").glob("*.json")}
    assert made == {f"swimmer-ppo.{a}.always.{d}" for a in ("none", "uniform", "opposite") for d in ("none", MAIN)}
    sweep = manifest.read_json(tmp_path / "swimmer-ppo" / "sizes.json", tmp_path)
    for name, found in sweep.items():
        for attack, rows in found["attacks"].items():
            (at_full,) = [row["returns"] for row in rows if row["epsilon"] == SWIMMER.epsilon]
            told = records.load_record(f"swimmer-ppo.{attack}.always.{name}", tmp_path)
            assert at_full == told["returns"] and len(at_full) == 4
    before = contents(tmp_path)
    main(stage)
    assert contents(tmp_path) == before
