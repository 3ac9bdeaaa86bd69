"""One call from a frozen policy to a defended one: the recipe's stages, for whoever brings a policy."""

import re
from dataclasses import asdict, fields, replace
from pathlib import Path

import gymnasium
import numpy as np
import torch
from gymnasium.envs.mujoco import MujocoEnv
from gymnasium.wrappers import OrderEnforcing, PassiveEnvChecker, TimeLimit

from detden_lite.core.budget import Budget
from detden_lite.core.tasks import TASKS, Task
from detden_lite.defense.defended import Defended
from detden_lite.defense.variants import MAIN, VARIANTS
from detden_lite.recipe import defense_stages, evaluation
from detden_lite.recipe.episode_seeds import seeds
from detden_lite.recipe.run import Run
from detden_lite.recipe.scales import DefenseScale, defense_scale
from detden_lite.recipe.sweeps import over_sizes
from detden_lite.results.cells import Cell
from detden_lite.simulation.simulator import make
from detden_lite.store import manifest, models, tensors
from detden_lite.victims.victim import Victim

HARMLESS = (PassiveEnvChecker, OrderEnforcing, TimeLimit)  # gymnasium's own, which change no observation

SIZES = (0.0, 0.25, 0.5, 1.0, 1.5, 2.0)  # of the ball, in units of the one that was defended against


def defend(
    victim,
    env: str | gymnasium.Env,
    budget: Budget,
    scale: str | DefenseScale = "lite",
    folder: str | Path = "defended",
    vecnormalize=None,
    seed: int = 0,
) -> Defended:
    """Make a defence of a frozen policy, or what is missing of it, and the policy behind that defence.

    D_normal is collected with exploration, and attacked offline by the opposite attack, and by the Q-function attack if
    the victim has a critic; the detector and the ``variants.MAIN`` denoiser are trained on it; the threshold is the
    conformal one for false alarms at 5 % of clean steps, or the plain 95 % quantile if there are too few held-out
    episodes to promise anything. All goes into ``folder/<task>-<algorithm>``, laid out as data/ is. Called again after
    a kill it resumes, called again after it finished it loads the result; a file that was altered since is made anew.

    Args:
        victim: a stable-baselines3 (or sbx-rl) TD3 or PPO model, or a ``Victim``.
        env: where it acts: the id of a gymnasium MuJoCo task, or an environment made of nothing but its id.
        budget: what the attacker may do, in raw units of the observations unless it has a ``scale``.
        scale: "tiny" for a try (seconds), "lite" for what the book ships (tens of minutes), "paper" for the paper's
            sizes, or sizes of your own: see ``detden_lite.defense_scale``.
        folder: where everything is kept; it holds one policy for each task and algorithm.
        vecnormalize: the ``VecNormalize`` that a model was trained in, if any.
        seed: of the trainings.

    Raises:
        ValueError: if the policy or the task is of a kind that cannot be defended, they do not fit each other, or the
            folder holds the defence of another victim or one of other, or of unknown, settings.
        ArtifactError: if the disk is full, or the folder's manifest.json is damaged.
    """
    if not isinstance(budget, Budget):
        raise ValueError(f"budget: give a detden_lite.Budget, such as Budget(0.1), not {budget!r}")
    if not isinstance(victim, Victim):
        victim = Victim.from_sb3(victim, vecnormalize)
    task = task_of(env, budget)
    _check_fit(victim, task)
    sizes = scale if isinstance(scale, DefenseScale) else defense_scale(scale, task)
    run = Run(Path(folder), task, "td3" if victim.action_std is None else "ppo", sizes, budget)
    _claim(run, victim, seed)

    data, parts = VARIANTS[MAIN].data, VARIANTS[MAIN].adversarial
    if not len(victim.critics):
        parts = ("adversarial",)  # of the opposite attack alone: the other one needs a critic
    detector, denoiser = (run.folder / f"{name}.safetensors" for name in (f"detector-{data}", f"denoiser-{MAIN}"))
    if not (manifest.is_made(detector, run.root) and manifest.is_made(denoiser, run.root)):
        defense_stages.collect(run, data)
        defense_stages.augment(run, data, parts)
    if not manifest.is_made(detector, run.root):
        defense_stages.train_detector(run, data, seed)
    if not manifest.is_made(denoiser, run.root):
        defense_stages.train_denoiser(run, MAIN, seed, parts)
    return Defended(victim, task, run.defense(MAIN))


def task_of(env: str | gymnasium.Env, budget: Budget) -> Task:
    """The task that an environment is, or the id of one.

    Raises:
        ValueError: if it is none of gymnasium's MuJoCo tasks with vectors as observations and a Box of actions, or was
            made with arguments or wrappers: the episodes are played in worlds made from the id alone.
    """
    try:
        spec = gymnasium.spec(env) if isinstance(env, str) else getattr(env, "spec", None)
        registered = spec and gymnasium.spec(spec.id)
    except gymnasium.error.Error as error:
        raise ValueError(f"env: {error}") from None
    if spec is None:
        raise ValueError("env: it has no spec; register it with gymnasium, and give its id")
    changes = [wrapper.name for wrapper in spec.additional_wrappers]
    changes += [name for name in spec.kwargs if registered.kwargs.get(name) != spec.kwargs[name]]
    if changes:
        raise ValueError(
            f"env: it is {spec.id} with {', '.join(changes)}, which its id does not tell; register arguments under an "
            f"id of their own, move what a wrapper does into a subclass of MujocoEnv and register that, or give "
            f"{spec.id!r} if they change neither observations nor actions"
        )
    world = make(spec.id)
    inner = world
    while isinstance(inner, HARMLESS):
        inner = inner.env
    if inner is not world.unwrapped:
        raise ValueError(
            f"env: what is registered as {spec.id} is wrapped in {type(inner).__name__}, and the episodes are played "
            f"without; move what that does into a subclass of MujocoEnv, and register that"
        )
    for what, space in (("observations", world.observation_space), ("actions", world.action_space)):
        if not isinstance(space, gymnasium.spaces.Box) or len(space.shape) != 1:
            raise ValueError(f"env: the {what} of {spec.id} must be vectors (a Box of one axis), not {space}")
    if not isinstance(world.unwrapped, MujocoEnv):
        raise ValueError(
            f"env: {spec.id} is not derived from gymnasium's MujocoEnv, and nothing else is simulated in lockstep; "
            f"from recorded episodes a defence can be made of its parts: see the book's page Bring your own policy"
        )
    obs_dim, action_dim = world.observation_space.shape[0], world.action_space.shape[0]
    if torch.as_tensor(budget.scale).numel() not in (1, obs_dim):
        raise ValueError(f"budget: its scale must be one number or {obs_dim}, one for each observation of {spec.id}")
    name = re.sub("[^a-z0-9]", "", spec.name.lower())  # of a folder
    paper = {task.env_id: task for task in TASKS.values()}  # which has larger networks for its larger tasks
    task = paper.get(spec.id, Task(name, spec.id, 0.0, obs_dim, action_dim))
    return replace(task, epsilon=budget.epsilon, horizon=spec.max_episode_steps or task.horizon)


def _check_fit(victim: Victim, task: Task) -> None:
    space = make(task.env_id).action_space
    if (victim.obs_dim, victim.action_dim) != (task.obs_dim, task.action_dim):
        raise ValueError(
            f"victim: it maps {victim.obs_dim} observations to {victim.action_dim} actions, "
            f"but {task.env_id} has {task.obs_dim} and {task.action_dim}; give the task that it was trained for"
        )
    low, high = victim.action_low.numpy(), victim.action_high.numpy()
    if not (np.allclose(low, space.low) and np.allclose(high, space.high)):
        raise ValueError(
            f"victim: its actions lie between {low} and {high}, those of {task.env_id} between {space.low} and "
            f"{space.high}; give the task that it was trained for, without a wrapper that changes the actions"
        )


def _claim(run: Run, victim: Victim, seed: int) -> None:
    """Keep the victim and the settings in the run's folder; a ValueError if it is there for others."""
    path, kept, ball, sizes = run.folder / "defend.json", run.folder / "victim.safetensors", run.budget, vars(run.scale)
    settings = dict(
        victim=tensors.digest(victim.state_dict()), env_id=run.task.env_id,
        epsilon=ball.epsilon, norm=str(ball.norm), scale=torch.as_tensor(ball.scale).tolist(),
        sizes={field.name: sizes[field.name] for field in fields(DefenseScale)}, seed=seed,
    )  # fmt: skip
    settings["sizes"]["defense"] = asdict(run.scale.defense)
    told = manifest.read_json(path, run.root) if manifest.is_made(path, run.root) else {}
    known = dict(told)
    if manifest.is_made(kept, run.root):
        known["victim"] = tensors.digest(run.victim().state_dict())
    if other := [name for name in known if settings.get(name) != known[name]]:
        raise ValueError(
            f"folder: {run.folder} holds the defence of another {', '.join(other)}; give another folder, or remove it"
        )
    if not told and any(any(run.folder.glob(made)) for made in ("normal-*", "detector-*", "denoiser-*")):
        raise ValueError(
            f"folder: {run.folder} holds a defence, and no {path.name} that says of which settings; restore that file, "
            f"or give another folder"
        )
    if not manifest.is_made(kept, run.root):
        models.save_victim(run.task.name, run.algo, victim, dict(env_id=run.task.env_id), run.root)
    if not told:
        manifest.write_json(path, settings, run.root)


def defend_victim(run: Run) -> None:
    """Defend a victim of the recipe in this one call, and write down how that went, with the defence and without.

    Records of it clean, under noise and attacked, and ``sizes.json``: noise and attack at several sizes of the ball.
    """
    victim = run.victim()
    defended = defend(victim, run.task.env_id, run.budget, run.scale, run.root)
    defenses, attacks = {"none": None, MAIN: defended.defense}, ("uniform", "opposite")
    cells = [Cell(attack, defense=name) for name in defenses for attack in ("none", *attacks)]
    evaluation.run_cells(run, cells, run.untimed_threat)
    path = run.folder / "sizes.json"
    if not manifest.is_made(path, run.root):
        settings = (run.task, victim, run.untimed_threat, seeds("report", run.scale.episodes), attacks, SIZES)
        found = {
            name: over_sizes(*settings, steps=run.scale.horizon, defense=defense) for name, defense in defenses.items()
        }
        manifest.write_json(path, found, run.root)
