"""The folder of a run: which victim at which scale."""

import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

from detden_lite.attacks.opposite import OppositeAttack
from detden_lite.attacks.qfunction import QFunctionAttack
from detden_lite.attacks.threat import Threat
from detden_lite.core.budget import Budget
from detden_lite.core.tasks import Task, get_task
from detden_lite.core.types import Attack
from detden_lite.defense.pipeline import DetectAndDenoise
from detden_lite.defense.variants import PARTS
from detden_lite.recipe.scales import DefenseScale, Scale, get_scale
from detden_lite.results.adversary_cards import load_adversary_cards
from detden_lite.store import manifest, models, tensors
from detden_lite.victims.victim import Victim

# Which attack makes which part of D_adv.
ADVERSARIAL: dict[str, Callable[..., Attack]] = dict(zip(PARTS, (OppositeAttack, QFunctionAttack), strict=True))

Sizes = TypeVar("Sizes", bound=DefenseScale, covariant=True)


@dataclass(frozen=True)
class Run(Generic[Sizes]):
    """A victim's folder of a run at one scale.

    ``root`` is laid out as data/ is, with a manifest of its own. A ``Run[DefenseScale]`` has the sizes of a defence; a
    ``Run[Scale]`` has those of the whole recipe.

    Args:
        root: of the run.
        task: where the victim acts.
        algo: the victim's algorithm.
        scale: how large everything is.
        ball: what the attacker may do; None for the paper's ball, of the task's radius.

    Example:
        >>> from detden_lite import Run
        >>> run = Run.of("runs/tiny", "hopper", "td3", "tiny")
        >>> run.folder.as_posix(), run.budget.epsilon, run.scale.episodes
        ('runs/tiny/hopper-td3', 0.075, 4)
    """

    root: Path
    task: Task
    algo: str
    scale: Sizes
    ball: Budget | None = None

    @staticmethod
    def of(root: str | Path, task: str, algo: str, scale: str) -> "Run[Scale]":
        """The run with these names.

        Raises:
            ValueError: for a name that does not exist; it lists those that do.
        """
        found = get_task(task)
        return Run(Path(root), found, algo, get_scale(scale, found, algo))

    @property
    def folder(self) -> Path:
        """Where everything of the victim is."""
        return self.root / f"{self.task.name}-{self.algo}"

    @property
    def budget(self) -> Budget:
        """What the attacker may do."""
        return self.ball or Budget(self.task.epsilon)

    def forget_others(self, victim: Victim) -> None:
        """If the run's victim is, or was, another one: remove everything made of it except the trainings."""
        known = manifest.promised(self.folder / "victim.safetensors", self.root)
        if known in (None, tensors.digest(victim.state_dict())):
            return
        for path in (self.root / "results").glob(f"{self.folder.name}.*"):
            path.unlink()
        for path in [*self.folder.glob("*"), *(self.folder / "checkpoints").glob("*")]:
            if path.is_file():
                path.unlink()
            elif path.name != "checkpoints" and not path.name.startswith("victim-"):
                shutil.rmtree(path)

    def victim(self) -> Victim:
        """The chosen victim."""
        return models.load_victim(self.task.name, self.algo, self.root)

    def defense(self, variant: str) -> DetectAndDenoise:
        """A trained defence, a key of ``VARIANTS``."""
        return models.load_defense(self.task.name, self.algo, variant, self.root)

    def threat(self: "Run[Scale]") -> Threat:
        """The attacker of the evaluations, with the tuned timings, and the planner and adversaries that are there."""
        tuned = manifest.read_json(self.folder / "timing.json", self.root)
        row = (self.task.name, self.algo)
        cards = load_adversary_cards(*row, self.root)
        third = tuned.get("third", {})  # which older files lack
        return replace(
            self.untimed_threat, c_vul=tuned["c_vul"], rate=tuned["attack_rate"], c_third=third.get("c_vul"),
            rate_third=third.get("attack_rate"), planner=self._planner(),
            adversaries={kind: models.load_adversary(*row, kind, self.root) for kind in cards},
            learned={kind: card.budget for kind, card in cards.items()},
        )  # fmt: skip

    def _planner(self: "Run[Scale]") -> Mapping[str, int]:
        """The arguments of the planner that the stage planning chose; the scale's where it has not run."""
        path = self.folder / "planning.json"
        found = manifest.read_json(path, self.root) if path.exists() else {}
        return found.get("chosen", self.scale.planner)

    @property
    def untimed_threat(self: "Run[Scale]") -> Threat:
        """The attacker before the timing is tuned and adversaries are trained.

        Steps and restarts are those that ``convergence.json`` chose, or the scale's if it is not there.
        """
        path, scale = self.folder / "convergence.json", self.scale
        search: dict[str, Any] = dict(steps=scale.attack_steps, restarts=scale.attack_restarts)
        if path.exists():
            search = manifest.read_json(path, self.root)["chosen"]
        return Threat(self.budget, planner=scale.planner, adaptive=scale.adaptive, **search)

    def opposite(self, victim: Victim) -> OppositeAttack:
        """The opposite attack with the scale's steps."""
        return OppositeAttack(victim, self.budget, steps=self.scale.attack_steps)
