"""The stage that chooses the steps and restarts of the gradient attacks: the fewest that reach what many more reach."""

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from detden_lite.attacks.gradient import GradientAttack
from detden_lite.attacks.threat import Threat
from detden_lite.core.ascent import Objective
from detden_lite.core.tasks import Task
from detden_lite.core.types import Defense
from detden_lite.defense.variants import MAIN
from detden_lite.recipe.episode_seeds import seeds
from detden_lite.recipe.run import Run
from detden_lite.recipe.scales import Scale
from detden_lite.simulation.rollout import rollout
from detden_lite.store import manifest
from detden_lite.victims.victim import Victim

TIE = 0.02  # how much less of an objective than the strongest setting's does not count
OBJECTIVES = ("opposite", "qfunction")

Settings = Sequence[tuple[int, int]]


def settings_around(steps: int, restarts: int) -> Settings:
    """Steps and restarts to compare: one start, the scale's, more of either, and many more of both.

    Example:
        >>> settings_around(20, 5)
        [(20, 1), (20, 5), (20, 10), (50, 5), (100, 10)]
    """
    many = 2 * restarts
    return [(steps, 1), (steps, restarts), (steps, many), (5 * steps // 2, restarts), (5 * steps, many)]


def sample_observations(task: Task, victim: Victim, n: int, episodes: int = 16, steps: int | None = None) -> Tensor:
    """At most n observations ``[n, obs_dim]`` of clean tuning episodes, always the same."""
    clean = rollout(victim, task, seeds("tuning", episodes), steps=steps)
    obs = clean.obs[clean.mask]
    return torch.from_numpy(np.random.default_rng(0).permutation(obs)[:n])


def measure_objectives(task: Task, victim: Victim, threat: Threat, settings: Settings, obs: Tensor) -> list[dict]:
    """How far each setting raises the objectives of the opposite and of the Q-function attack.

    Args:
        task: where the victim acts.
        victim: the policy, with a Q-function.
        threat: the attacker's settings, of which steps and restarts are replaced.
        settings: steps and restarts.
        obs: true observations ``[n, obs_dim]``.

    Returns:
        Ready for JSON: for each setting ``steps``, ``restarts``, the CPU ``seconds`` of both attacks together, and by
        each attack's name the mean rise of its objective above its value at ``obs``, in parts of the largest.

    Example:
        >>> from detden_lite import Budget, Threat, get_task, load_victim
        >>> from detden_lite.recipe.convergence import measure_objectives
        >>> task, victim = get_task("hopper"), load_victim("hopper", "td3")
        >>> obs = 0.1 * torch.ones(1, 11)
        >>> few, many = measure_objectives(task, victim, Threat(Budget(0.075)), [(1, 1), (50, 10)], obs)
        >>> few["opposite"] <= many["opposite"]
        True
    """
    rows: list[dict[str, Any]] = []
    for steps, restarts in settings:
        attacker, start = replace(threat, steps=steps, restarts=restarts), time.process_time()
        found = {name: _perturb(task, victim, attacker, name, obs) for name in OBJECTIVES}
        seconds = time.process_time() - start
        rises = {name: float((at(perturbed) - at(obs)).mean()) for name, (at, perturbed) in found.items()}
        rows.append(dict(steps=steps, restarts=restarts, seconds=seconds, **rises))
    most = {name: max(row[name] for row in rows) for name in OBJECTIVES}
    return [row | {name: row[name] / most[name] if most[name] else 1.0 for name in OBJECTIVES} for row in rows]


def _perturb(task: Task, victim: Victim, threat: Threat, name: str, obs: Tensor) -> tuple[Objective, Tensor]:
    attack = threat.attack(name, victim, task)
    assert isinstance(attack, GradientAttack)
    attack.reset()
    return attack.objective(obs), attack(obs)


def choose(rows: Sequence[dict], restarts: int) -> dict[str, int]:
    """The cheapest setting with at least so many restarts whose objectives are both within 2 % of the largest.

    Example:
        >>> rows = [dict(steps=s, restarts=5, opposite=o, qfunction=1.0) for s, o in ((20, 0.97), (50, 0.985), (99, 1))]
        >>> choose(rows, restarts=5)
        {'steps': 50, 'restarts': 5}
    """
    by_cost = sorted(rows, key=lambda row: row["steps"] * row["restarts"])
    enough = (r for r in by_cost if r["restarts"] >= restarts and min(r[name] for name in OBJECTIVES) >= 1 - TIE)
    chosen = next(enough, by_cost[-1])
    return dict(steps=chosen["steps"], restarts=chosen["restarts"])


def returns_left(
    task: Task, victim: Victim, threat: Threat, settings: Settings, defense: Defense | None = None,
    episodes: int = 16, steps: int | None = None,
) -> dict[str, Any]:  # fmt: skip
    """The mean return that the opposite attack leaves with each setting when it always attacks, on tuning episodes.

    Args:
        task: where the victim acts.
        victim: the policy.
        threat: the attacker's settings, of which steps and restarts are replaced.
        settings: steps and restarts.
        defense: in front of the policy; None for the bare policy.
        episodes: how many.
        steps: the longest an episode may be; the task's horizon by default.

    Returns:
        Ready for JSON: the ``clean`` mean return, those ``left`` in the order of ``settings``, and the ``seeds``.
    """
    chosen = seeds("tuning", episodes)
    attacks = [replace(threat, steps=k, restarts=n).attack("opposite", victim, task) for k, n in settings]
    clean, *left = (
        float(rollout(victim, task, chosen, attack=attack, defense=defense, steps=steps).returns.mean())
        for attack in (None, *attacks)
    )
    return dict(clean=clean, left=left, seeds=[chosen[0], episodes])


def converge(run: Run[Scale], defended: bool = False) -> None:
    """The stage: ``convergence.json`` of a run, with the setting that its attackers use from then on.

    Args:
        run: where.
        defended: measure what is left to the victim with its main defence, in ``convergence-defended.json``.
    """
    path = run.folder / f"convergence{'-defended' * defended}.json"
    if manifest.is_made(path, run.root):
        return
    victim, scale, threat = run.victim(), run.scale, run.untimed_threat
    settings = settings_around(scale.attack_steps, scale.attack_restarts)
    sizes: dict[str, Any] = dict(episodes=min(16, scale.episodes), steps=scale.horizon)
    defense = run.defense(MAIN) if defended else None
    returns = returns_left(run.task, victim, threat, settings, defense, **sizes)
    found: dict[str, Any] = dict(settings=settings, returns=returns)
    if not defended:
        obs = sample_observations(run.task, victim, 1_000, **sizes)
        rows = measure_objectives(run.task, victim, threat, settings, obs)
        found |= dict(rows=rows, observations=len(obs), chosen=choose(rows, scale.attack_restarts))
    manifest.write_json(path, found, run.root)
