"""One call from a frozen policy to a defended one: the recipe's stages, for any policy."""

from __future__ import annotations

from dataclasses import asdict, fields
from pathlib import Path
from types import EllipsisType
from typing import TYPE_CHECKING

import gymnasium
import torch

from detden_lite.core.arguments import check_whole
from detden_lite.core.budget import Budget
from detden_lite.defense.defended import Defended
from detden_lite.defense.variants import MAIN, VARIANTS
from detden_lite.recipe import defense_stages, evaluation
from detden_lite.recipe.episode_seeds import seeds
from detden_lite.recipe.run import Run
from detden_lite.recipe.scales import DefenseScale, Scale, defense_scale
from detden_lite.recipe.sweeps import over_sizes
from detden_lite.recipe.task_from_env import check_fit, task_of
from detden_lite.results.cells import Cell
from detden_lite.store import manifest, models, tensors
from detden_lite.victims.victim import Victim

if TYPE_CHECKING:  # defending a ``Victim`` needs no trainer
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.vec_env import VecNormalize

SIZES = (0.0, 0.25, 0.5, 1.0, 1.5, 2.0)  # of the ball, in units of the one that was defended against


def defend(
    victim: Victim | BaseAlgorithm,
    env: str | gymnasium.Env,
    budget: Budget,
    scale: str | DefenseScale = "lite",
    folder: str | Path = "defended",
    vecnormalize: VecNormalize | None | EllipsisType = ...,
    seed: int = 0,
) -> Defended:
    """Make a defence of a frozen policy, and put the policy behind it.

    D_normal is collected with exploration. It is attacked offline by the opposite attack, and by the Q-function attack
    if the victim has a critic. The detector and the ``variants.MAIN`` denoiser are trained on it. The threshold is the
    conformal one for false alarms at 5 % of clean steps, or the plain 95 % quantile if there are too few held-out
    episodes for a guarantee. Everything goes into ``folder/<task>-<algorithm>``, laid out as data/ is. Called again
    after a kill it resumes; called again after it finished it loads the result; an altered file is made anew.

    Args:
        victim: a stable-baselines3 (or sbx-rl) TD3 or PPO model, or a ``Victim``.
        env: where it acts: the id of a gymnasium MuJoCo task, or an environment made of nothing but its id.
        budget: what the attacker may do, in raw units of the observations unless it has a ``scale``.
        scale: "tiny" for a try (seconds), "lite" for what the book ships (tens of minutes), "paper" for the paper's
            sizes, or sizes of your own: see ``detden_lite.defense_scale``.
        folder: where everything is stored; it holds one policy for each task and algorithm.
        vecnormalize: the ``VecNormalize`` that a model was trained in; None, said explicitly, if it was trained without
            one and was loaded without its environment.
        seed: of the trainings.

    Raises:
        ValueError: for an argument that is not valid; if policy or task cannot be defended or do not fit each other;
            if the folder holds the defence of another victim, or of other or unknown settings. Nothing is then written.
        ArtifactError: if the disk is full, or the folder's manifest.json is damaged.

    Example:
        Seconds at this scale; "lite" takes tens of minutes::

            from detden_lite import Budget, defend, load_victim

            defended = defend(load_victim("hopper", "td3"), "Hopper-v5", Budget(0.075), "tiny", "runs/mine")
            actions, _ = defended.predict(observations)
    """
    if not isinstance(budget, Budget):
        raise ValueError(f"budget: give a detden_lite.Budget, such as Budget(0.1), not {budget!r}")
    check_whole(0, **{"seed: it": seed})
    seed, root = int(seed), _folder(folder)
    if not isinstance(victim, Victim):
        victim = Victim.from_sb3(victim, vecnormalize)
    task = task_of(env, budget)
    check_fit(victim, task)
    sizes = scale if isinstance(scale, DefenseScale) else defense_scale(scale, task)
    run = Run(root, task, "td3" if victim.action_std is None else "ppo", sizes, budget)
    _folder(run.folder)
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


def _folder(folder: str | Path) -> Path:
    """A folder that exists, or that can be made."""
    if not isinstance(folder, str | Path):
        raise ValueError(f"folder: give a path, not {folder!r}")
    nearest = next(path for path in (Path(folder), *Path(folder).absolute().parents) if path.exists())
    if not nearest.is_dir():
        raise ValueError(f"folder: {nearest} is a file; give a folder")
    return Path(folder)


def _claim(run: Run[DefenseScale], victim: Victim, seed: int) -> None:
    """Write the victim and the settings into the run's folder; a ValueError if it belongs to others."""
    path, weights, ball = run.folder / "defend.json", run.folder / "victim.safetensors", run.budget
    own = [field.name for field in fields(DefenseScale) if field.name != "dynamics"]  # it makes no model that predicts
    sizes = {name: getattr(run.scale, name) for name in own}
    settings = dict(
        victim=tensors.digest(victim.state_dict()), env_id=run.task.env_id,
        epsilon=ball.epsilon, norm=str(ball.norm), scale=torch.as_tensor(ball.scale).tolist(),
        sizes=sizes | dict(defense=asdict(run.scale.defense)), seed=seed,
    )  # fmt: skip
    told = manifest.read_json(path, run.root) if manifest.is_made(path, run.root) else {}
    known = dict(told)
    if manifest.is_made(weights, run.root):
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
    if not manifest.is_made(weights, run.root):
        models.save_victim(run.task.name, run.algo, victim, dict(env_id=run.task.env_id), run.root)
    if not told:
        manifest.write_json(path, settings, run.root)


def defend_victim(run: Run[Scale]) -> None:
    """The stage: defend a victim of the recipe by ``defend``, and evaluate it with the defence and without.

    It writes records of clean episodes, under noise and attacked, and ``sizes.json``: noise and attack at several sizes
    of the ball.
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
