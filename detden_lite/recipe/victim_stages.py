"""The stages that train and choose a victim, and learn the Q-function that a PPO victim lacks.

Each makes what is missing: running it again resumes it.
"""

from collections.abc import Callable
from dataclasses import asdict

import numpy as np

from detden_lite.core import estimates
from detden_lite.core.tasks import ONLINE
from detden_lite.core.types import Attack
from detden_lite.recipe import episode_seeds, selection
from detden_lite.recipe.critic_fit import judge_q
from detden_lite.recipe.run import Run
from detden_lite.recipe.scales import Scale
from detden_lite.simulation.rollout import rollout
from detden_lite.store import manifest, models, tensors
from detden_lite.training import worlds
from detden_lite.training.online_recipes import OnlineRecipe
from detden_lite.training.progress import columns, load_progress
from detden_lite.victims import critic
from detden_lite.victims.victim import Victim


def train_victim(run: Run[Scale], seed: int) -> None:
    """The stage: train one seed; its snapshots are stored in the run's checkpoints."""
    worlds.train_victim(run.task, run.scale.victim, seed, run.folder / "checkpoints" / f"victim-{seed}")


def select_victim(run: Run[Scale]) -> None:
    """The stage: choose among all snapshots of all seeds, and store the chosen one with its evaluation.

    Screening takes 5 episodes; see ``selection.choose``. A policy that was trained to be robust is chosen by the mean
    of its returns without an attack and under the opposite attack, any other by those without. The chosen one is
    evaluated once on the report's episodes. If another victim was stored before, everything that was made of that one
    is removed.

    Raises:
        ValueError: if there is no snapshot.
    """
    folders = sorted((run.folder / "checkpoints").glob("victim-*"))
    if not any(any((folder / "snapshots").glob("*.safetensors")) for folder in folders):
        raise ValueError(f"{run.folder / 'checkpoints'} holds no snapshot of a victim; run the victim stage first")
    episodes = dict(screening=5, selection=run.scale.episodes, report=run.scale.episodes)

    attacks: dict[str, Callable[[Victim], Attack | None]] = dict(mean=lambda victim: None)
    if isinstance(run.scale.victim, OnlineRecipe):
        attacks["attacked"] = run.opposite
    screened: dict[str, list[float]] = {name: [] for name in attacks}  # in the order of the curves

    def returns(victim: Victim, purpose: str, attack: Attack | None = None) -> np.ndarray:
        seeds = episode_seeds.seeds(purpose, episodes[purpose])
        return rollout(victim, run.task, seeds, attack=attack, steps=run.scale.horizon).returns

    def measure(victim: Victim, purpose: str) -> float:
        found = {name: float(returns(victim, purpose, attack(victim)).mean()) for name, attack in attacks.items()}
        if purpose == "screening":
            for name in found:
                screened[name].append(found[name])
        return float(np.mean([*found.values()]))

    chosen = selection.choose(run.task, dict.fromkeys(folders, type(run.scale.victim)), measure)
    reported = returns(chosen.policy, "report")
    sidecar = dict(
        task=run.task.name,
        env_id=run.task.env_id,
        algo=run.algo,
        trained_with="sbx-rl",
        recipe=chosen.recipe,
        step=chosen.step,
        selection_mean=chosen.selection,
        returns=reported.tolist(),
        estimate=asdict(estimates.estimate(reported)),
        learning_curves=[
            dict(seed=curve["recipe"]["seed"], steps=curve["steps"])
            | {name: [screened[name].pop(0) for _ in curve["steps"]] for name in screened}
            for curve in chosen.curves
        ],
    )
    if run.algo in ONLINE:
        told = [(selection.read_recipe(folder)["seed"], load_progress(folder)) for folder in folders]
        sidecar["training"] = [dict(seed=seed, **columns(progress)) for seed, progress in told]
    run.forget_others(chosen.policy)
    models.save_victim(run.task.name, run.algo, chosen.policy, sidecar, run.root)


def learn_q(run: Run[Scale], seed: int = 0) -> None:
    """The stage: learn the Q-function of a PPO victim from clean episodes.

    Args:
        run: where.
        seed: of the training.

    Raises:
        ValueError: for a TD3 victim, which has critics.
    """
    if run.algo == "td3":
        raise ValueError("a TD3 victim has critics of its own; the qfunction stage is for PPO")
    recipe, victim, horizon = run.scale.critic, run.victim(), run.scale.horizon
    seeds = episode_seeds.seeds("critic", recipe.episodes + recipe.judged)
    episodes = rollout(
        victim, run.task, seeds[: recipe.episodes], action_noise=recipe.noise, noise_rate=recipe.noise_rate,
        steps=horizon, progress=f"clean episodes of {run.task.name}",
    )  # fmt: skip
    net = critic.learn_q(victim, run.task, recipe, episodes, horizon, seed)
    able = victim.with_critic(recipe.sizes(run.task), net.state_dict())
    fit = judge_q(able, run.task, seeds[recipe.episodes :], run.budget, recipe.gamma, horizon)
    sidecar = dict(
        critic=recipe.sizes(run.task), activation="relu", recipe=asdict(recipe), seed=seed, fit=asdict(fit),
        versions=manifest.versions(),
    )  # fmt: skip
    tensors.save_tensors(run.folder / "critic.safetensors", net.state_dict(), sidecar, run.root)
