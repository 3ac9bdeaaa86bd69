"""Judge a defended policy: the bare policy beside it, without an attack, under controls, and attacked."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from safetensors.torch import load_file

from detden_lite.attacks.threat import Threat
from detden_lite.core.arguments import check_whole
from detden_lite.core.budget import Budget
from detden_lite.core.estimates import Estimate, estimate
from detden_lite.defense.defended import Defended
from detden_lite.recipe.episode_seeds import seeds
from detden_lite.recipe.linear_search import LinearMaps, LinearRecipe
from detden_lite.recipe.search_stages import returns_under, search_maps
from detden_lite.simulation.rollout import rollout
from detden_lite.victims.victim import Victim

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# What is played: a title, the attack's name in the catalogue, and the size of its ball in units of epsilon.
SUITE = (
    ("clean", "none", 1.0),
    ("uniform noise", "uniform", 1.0),
    ("random corner, held", "corner", 1.0),
    ("opposite, half the ball", "opposite", 0.5),
    ("opposite", "opposite", 1.0),
    ("linear adversary", "linear", 1.0),
)
COLUMNS = ("", "bare policy", "defended", "steps with an alarm")


@dataclass(frozen=True)
class JudgedRow:
    """What one attack leaves of the return, without the defence and with it, and how often the alarm is raised."""

    title: str
    bare: Estimate
    defended: Estimate
    alarms: float  # share of the defended policy's steps

    @property
    def cells(self) -> tuple[str, str, str, str]:
        """The row as a table shows it."""
        return self.title, str(self.bare), str(self.defended), f"{self.alarms:.1%}"


@dataclass(frozen=True)
class Judgement:
    """The rows of the standard suite. ``print`` shows a table, Jupyter too, and ``figure`` draws it.

    Args:
        about: the policy, the ball and the episodes, in a line.
        rows: one for each attack of ``SUITE``.

    Example:
        >>> from detden_lite import estimate
        >>> row = JudgedRow("clean", estimate(torch.ones(3)), estimate(torch.ones(3)), alarms=0.05)
        >>> print(Judgement("three episodes", (row,)))
        three episodes
                bare policy   defended   steps with an alarm
        clean      1 [1, 1]   1 [1, 1]                  5.0%
    """

    about: str
    rows: tuple[JudgedRow, ...]

    def __str__(self) -> str:
        lines = [COLUMNS, *(row.cells for row in self.rows)]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        first, *others = widths
        shown = (
            f"{line[0]:<{first}}" + "".join(f"   {cell:>{width}}" for cell, width in zip(line[1:], others, strict=True))
            for line in lines
        )
        return "\n".join([self.about, *shown])

    def _repr_html_(self) -> str:
        from detden_lite.looking.tables import table

        return f"<p>{self.about}</p>{table(COLUMNS, [row.cells for row in self.rows]).data}"

    def figure(self) -> Figure:
        """Mean returns with their 95 % intervals, bare and defended, a row for each attack."""
        from matplotlib.figure import Figure

        from detden_lite.looking.palette import GREEN, VERMILLION

        figure = Figure(figsize=(6.4, 0.8 + 0.45 * len(self.rows)), layout="constrained")
        axes = figure.subplots()
        for shift, name, colour, marker in ((-0.13, "bare", VERMILLION, "s"), (0.13, "defended", GREEN, "o")):
            for i, row in enumerate(self.rows):
                found = getattr(row, name)
                axes.plot([found.low, found.high], [i + shift] * 2, color=colour, linewidth=2)
                axes.plot(found.mean, i + shift, marker, color=colour, label=name if i == 0 else None)
        axes.set(yticks=range(len(self.rows)), yticklabels=[row.title for row in self.rows], xlabel="return")
        axes.set_ylim(len(self.rows) - 0.5, -0.5)
        axes.set_xlim(left=min(0.0, axes.get_xlim()[0]))
        axes.grid(axis="y", visible=False)
        axes.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2, frameon=False)
        return figure


def judge(
    defended: Defended, budget: Budget | None = None, episodes: int = 50, steps: int | None = None,
    search: LinearRecipe | None = None, folder: str | Path | None = None,
) -> Judgement:  # fmt: skip
    """Play the standard suite with the bare policy and with the defended one, in the same episodes.

    No attack knows the defence: this is the least that a defence should stand, and no proof that it stands more. The
    linear adversary is searched for against the bare policy, in episodes that are not reported.

    Args:
        defended: the policy and its defence.
        budget: what the attacker may do; None for a ball of the task's epsilon.
        episodes: how many are reported.
        steps: the longest an episode may be; the task's horizon by default.
        search: sizes of the search for the linear adversary; None for ``LinearRecipe()``, which takes minutes.
        folder: where the search is kept, so that it goes on after a kill; None for a folder that is removed.

    Raises:
        ValueError: if ``defended`` is no ``Defended``, or a number is not in its range.

    Example:
        >>> from detden_lite import Defended, LinearRecipe, get_task, judge, load_defense, load_victim
        >>> policy = Defended(load_victim("hopper", "td3"), get_task("hopper"), load_defense("hopper", "td3", "mixed"))
        >>> tiny = LinearRecipe(generations=1, population=2, elites=1)
        >>> print(judge(policy, episodes=2, steps=2, search=tiny).about)
        Hopper-v5, deterministic policy, epsilon 0.075 (norm inf), 2 episodes
    """
    if not isinstance(defended, Defended):
        raise ValueError(f"defended: give a detden_lite.Defended, as defend() makes, not a {type(defended).__name__}")
    check_whole(1, episodes=episodes, **({} if steps is None else dict(steps=steps)))
    task, victim, defense = defended.task, defended.victim, defended.defense
    ball = Budget(task.epsilon) if budget is None else budget
    with tempfile.TemporaryDirectory() as kept:
        adversary = _search(defended, ball, search or LinearRecipe(), Path(folder or kept), steps)
    rows = []
    for title, name, size in SUITE:
        threat = Threat(replace(ball, epsilon=size * ball.epsilon), adversaries=dict(linear=adversary))
        played = [
            rollout(
                victim, task, seeds("report", episodes), attack=threat.attack(name, victim, task),
                defense=guard, steps=steps,
            )
            for guard in (None, defense)
        ]  # fmt: skip
        bare, guarded = played
        assert guarded.alarm is not None  # there is a defence
        alarms = float(guarded.alarm[guarded.mask].mean())
        rows.append(JudgedRow(title, estimate(bare.returns), estimate(guarded.returns), alarms))
    kind = "deterministic" if victim.action_std is None else "Gaussian"
    about = f"{task.env_id}, {kind} policy, epsilon {ball.epsilon:g} (norm {ball.norm}), {episodes} episodes"
    return Judgement(about, tuple(rows))


def _search(defended: Defended, ball: Budget, recipe: LinearRecipe, folder: Path, steps: int | None) -> Victim:
    """The linear map that leaves the bare policy the smallest return, of those that the search went through."""
    task, victim = defended.task, defended.victim
    about = dict(epsilon=ball.epsilon, norm=str(ball.norm))
    states = [load_file(path) for path in search_maps(recipe, task, victim, ball, folder, steps, about)]
    maps = [torch.cat([state["actor.0.weight"], state["actor.0.bias"][:, None]], 1) for state in states]
    means = [Victim.from_state(recipe.config(task), state) for state in states]
    left = returns_under(LinearMaps(means[0], torch.stack(maps)), victim, task, ball, seeds("selection", 8), steps)
    return means[int(left.argmin())]
