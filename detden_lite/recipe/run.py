"""The folder of a run: which victim at which scale."""

import shutil
from dataclasses import dataclass, replace
from pathlib import Path

from detden_lite.attacks.opposite import OppositeAttack
from detden_lite.attacks.qfunction import QFunctionAttack
from detden_lite.attacks.threat import Threat
from detden_lite.core.budget import Budget
from detden_lite.core.tasks import Task, get_task
from detden_lite.defense.pipeline import DetectAndDenoise
from detden_lite.defense.variants import PARTS
from detden_lite.recipe.scales import DefenseScale, get_scale
from detden_lite.store import manifest, models, tensors
from detden_lite.victims.victim import Victim

ADVERSARIAL = dict(zip(PARTS, (OppositeAttack, QFunctionAttack), strict=True))  # which attack makes which part of D_adv


@dataclass(frozen=True)
class Run:
    """A victim's folder of a run at one scale. ``root`` is laid out as data/ is, with a manifest of its own."""

    root: Path
    task: Task
    algo: str
    scale: DefenseScale  # a Scale, for the stages that do more than to make a defence
    ball: Budget | None = None  # None: the paper's, of the task's radius

    @classmethod
    def of(cls, root: Path, task: str, algo: str, scale: str) -> "Run":
        """The run with these names; a ValueError for one that does not exist."""
        found = get_task(task)
        return cls(Path(root), found, algo, get_scale(scale, found, algo))

    @property
    def folder(self) -> Path:
        return self.root / f"{self.task.name}-{self.algo}"

    @property
    def budget(self) -> Budget:
        return self.ball or Budget(self.task.epsilon)

    def forget_others(self, victim: Victim) -> None:
        """If the victim here is, or was, not this one: remove what was made of it, all but the victims' trainings."""
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
        return models.load_victim(self.task.name, self.algo, self.root)

    def defense(self, variant: str) -> DetectAndDenoise:
        return models.load_defense(self.task.name, self.algo, variant, self.root)

    def threat(self) -> Threat:
        """The attacker of the evaluations, with the timing that was tuned and the adversaries that are there."""
        tuned = manifest.read_json(self.folder / "timing.json", self.root)
        row = (self.task.name, self.algo)
        adversaries = {
            kind: models.load_adversary(*row, kind, self.root)
            for kind in models.ADVERSARIES
            if models.adversary_path(*row, kind, self.root).exists()
        }
        return replace(self.untimed_threat, c_vul=tuned["c_vul"], rate=tuned["attack_rate"], adversaries=adversaries)

    @property
    def untimed_threat(self) -> Threat:
        return Threat(self.budget, self.scale.attack_steps, planner=self.scale.planner, adaptive=self.scale.adaptive)

    def opposite(self, victim: Victim) -> OppositeAttack:
        return OppositeAttack(victim, self.budget, steps=self.scale.attack_steps)
