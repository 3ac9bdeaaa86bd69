"""Two sweeps of one victim: the return at each size of the ball, and the planner of the enchanting attack."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from math import inf, prod
from typing import Any

import numpy as np
from tqdm import tqdm

from detden_lite.attacks.enchanting import EnchantingAttack
from detden_lite.attacks.threat import Threat
from detden_lite.attacks.timing import After
from detden_lite.core.budget import Budget
from detden_lite.core.estimates import estimate
from detden_lite.core.tasks import Task
from detden_lite.core.types import Defense
from detden_lite.recipe.episode_seeds import seeds
from detden_lite.recipe.run import Run
from detden_lite.recipe.scales import Scale
from detden_lite.simulation.planner import CEMPlanner
from detden_lite.simulation.rollout import rollout
from detden_lite.store import manifest
from detden_lite.victims.victim import Victim

CHEAPER = 0.02  # of the clean return: a planner that leaves so much more is as good, if it is cheaper
AFFORDABLE = 60.0  # seconds of CPU that the planning of one episode may take
SIZES = (0.0, 0.1, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0)  # of the ball, in units of the task's epsilon


def over_sizes(
    task: Task,
    victim: Victim,
    threat: Threat,
    episode_seeds: Sequence[int],
    attacks: Sequence[str] = ("uniform", "opposite", "qfunction"),
    sizes: Sequence[float] = SIZES,
    steps: int | None = None,
    defense: Defense | None = None,
) -> dict[str, Any]:
    """Attack always, at several sizes of the ball.

    Args:
        task: where the victim acts.
        victim: the policy.
        threat: the attacker's settings; ``sizes`` multiply the radius of its budget.
        episode_seeds: one an episode; the same for all sizes and attacks.
        attacks: names of attacks that ``threat`` knows.
        sizes: factors of the radius.
        steps: the longest an episode may be; the task's horizon by default.
        defense: in front of the policy; None for the bare policy.

    Returns:
        Ready for JSON: for each attack a row for each size, with the returns of all episodes.

    Example:
        >>> from detden_lite import Budget, Threat, get_task, load_victim, over_sizes
        >>> task, victim = get_task("hopper"), load_victim("hopper", "td3")
        >>> found = over_sizes(task, victim, Threat(Budget(0.075)), [0], ["uniform"], [0, 1], steps=5)
        >>> [row["epsilon"] for row in found["attacks"]["uniform"]]
        [0.0, 0.075]
    """
    found: dict[str, list[dict[str, Any]]] = {attack: [] for attack in attacks}
    with tqdm(total=len(attacks) * len(sizes), desc="sizes of the ball", unit="run") as bar:
        for attack in attacks:
            for size in sizes:
                budget = replace(threat.budget, epsilon=size * threat.budget.epsilon)
                made = replace(threat, budget=budget).attack(attack, victim, task)
                returns = rollout(victim, task, episode_seeds, attack=made, defense=defense, steps=steps).returns
                found[attack].append(dict(epsilon=budget.epsilon, **_of(returns)))
                bar.update()
    return dict(attacks=found, seeds=[int(episode_seeds[0]), len(episode_seeds)])


def over_planners(
    task: Task,
    victim: Victim,
    budget: Budget,
    episode_seeds: Sequence[int],
    planners: Sequence[Mapping[str, int]],
    begin: int = 125,
    steps: int | None = None,
    affordable: float = inf,
) -> dict[str, Any]:
    """The enchanting attack with several planners, on a robot that is already walking, and the choice of one.

    The chosen one is the cheapest of those whose mean return is at most ``CHEAPER`` above the lowest, among those with
    which an episode takes at most ``affordable``. What a planner costs is the number of steps that it simulates.

    Args:
        task: where the victim acts.
        victim: the policy.
        budget: the ball.
        episode_seeds: one an episode; the same for all planners.
        planners: the arguments of each ``CEMPlanner``.
        begin: the first step that is attacked.
        steps: the longest an episode may be; the task's horizon by default.
        affordable: seconds of CPU for the plans of one episode that is attacked from its first step on.

    Returns:
        Ready for JSON: the arguments of the ``chosen`` planner, the mean ``clean_return`` of the same episodes, and a
        row for each planner, with the returns of all episodes, how many steps each lasted under attack, how many plans
        the planner makes in a second of CPU time, and the seconds that it takes for an episode: of those that did not
        end during the sweep, up to the task's horizon. Speed and seconds are 0 if every episode ends before
        it is attacked.

    Example:
        >>> from detden_lite import Budget, get_task, load_victim, over_planners
        >>> task, victim, small = get_task("hopper"), load_victim("hopper", "td3"), dict(population=4, elites=2)
        >>> planners = [small | dict(horizon=horizon, iterations=1) for horizon in (1, 2)]
        >>> over_planners(task, victim, Budget(0.075), [0], planners, begin=2, steps=5)["chosen"] in planners
        True
    """
    clean = float(rollout(victim, task, episode_seeds, steps=steps).returns.mean())
    rows: list[dict[str, Any]] = []
    for settings in tqdm(planners, desc="planners", unit="planner"):
        planner = _Timed(task.env_id, **settings)
        episodes = rollout(
            victim, task, episode_seeds, attack=EnchantingAttack(victim, budget, planner), timing=After(begin),
            steps=steps,
        )  # fmt: skip
        lived = (episodes.attacked & episodes.mask).sum(0)
        each = planner.plans and planner.seconds / planner.plans
        fell = episodes.lengths < (steps or task.horizon)
        costs = dict(plans_per_second=each and 1 / each, seconds=np.where(fell, lived, task.horizon).mean() * each)
        rows.append(dict(settings, **costs, lived=lived.tolist(), **_of(episodes.returns)))
    chosen = planners[_chosen(rows, CHEAPER * abs(clean), affordable)]
    first = int(episode_seeds[0])
    return dict(chosen=dict(chosen), clean_return=clean, rows=rows, begin=begin, seeds=[first, len(episode_seeds)])


def _chosen(rows: Sequence[Mapping[str, Any]], tie: float, affordable: float) -> int:
    """The place of the cheapest row among those within ``tie`` of the lowest return; see ``over_planners``."""
    order = sorted(range(len(rows)), key=lambda i: prod(rows[i][k] for k in ("horizon", "population", "iterations")))
    able = [i for i in order if rows[i]["seconds"] <= affordable] or order[:1]
    means = {i: rows[i]["estimate"]["mean"] for i in able}
    return next(i for i in able if means[i] <= min(means.values()) + tie)


class _Timed(CEMPlanner):
    """A planner that counts its plans and the CPU time that they take."""

    plans, seconds = 0, 0.0

    def plan(self, envs: Sequence, wanted: np.ndarray) -> np.ndarray:
        start = time.process_time()
        first = super().plan(envs, wanted)
        self.plans, self.seconds = self.plans + int(wanted.sum()), self.seconds + time.process_time() - start
        return first


def _of(returns: np.ndarray) -> dict[str, Any]:
    return dict(estimate=asdict(estimate(returns)), returns=returns.tolist())


def epsilon(run: Run[Scale]) -> None:
    """The stage: ``epsilon.json`` of a run, on report episodes."""
    path = run.folder / "epsilon.json"
    if not manifest.is_made(path, run.root):
        episodes = seeds("report", run.scale.episodes)
        found = over_sizes(run.task, run.victim(), run.untimed_threat, episodes, steps=run.scale.horizon)
        manifest.write_json(path, found, run.root)


def planning(run: Run[Scale]) -> None:
    """The stage: ``planning.json`` of a run, with the planner of its enchanting attack, chosen on tuning episodes."""
    path = run.folder / "planning.json"
    if not manifest.is_made(path, run.root):
        begin, episodes = min(125, run.scale.horizon // 2), seeds("tuning", min(8, run.scale.episodes))
        steps = min(begin + run.scale.planned_steps, run.scale.horizon)
        planners = run.scale.planners
        found = over_planners(run.task, run.victim(), run.budget, episodes, planners, begin, steps, AFFORDABLE)
        manifest.write_json(path, found, run.root)
