"""The folder of a run: which victim at which scale, and the trajectories that lie in it, in files of a batch each."""

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch

from detden_lite import artifacts, models
from detden_lite.attacks import OppositeAttack, QFunctionAttack
from detden_lite.budget import Budget
from detden_lite.defense import DetectAndDenoise
from detden_lite.defense.augmentation import Trajectories
from detden_lite.scales import DefenseScale, get_scale
from detden_lite.study import Threat
from detden_lite.tasks import Task, get_task
from detden_lite.victims import Victim

SHARD = 128  # trajectories of one file: what a killed run loses at most


@dataclass(frozen=True)
class Variant:
    """A defence as it is trained.

    Args:
        data: the exploration in its D_normal, a key of ``DATASETS``.
        adversarial: the parts of D_adv that its denoiser is trained on, keys of ``ADVERSARIAL``.
        recipe: what its denoiser changes in the scale's ``VAERecipe``.
    """

    data: str
    adversarial: tuple[str, ...] = ("adversarial",)
    recipe: Mapping[str, object] = field(default_factory=dict)


DATASETS = {"plain": (0.0,), "diverse": (0.0, 0.1, 0.2, 0.3)}
ADVERSARIAL = {"adversarial": OppositeAttack, "qfunction": QFunctionAttack}  # which attack made what, offline
MIXED = dict(residual=True, least_share=0.2, least_size=0.5)  # real attackers come and go, and hold back
VARIANTS = {
    "printed": Variant("plain"),
    "diverse": Variant("diverse"),
    "residual": Variant("diverse", recipe=dict(residual=True)),
    "paper": Variant("plain", tuple(ADVERSARIAL)),
    "both": Variant("diverse", tuple(ADVERSARIAL), dict(residual=True)),
    "mixed": Variant("diverse", tuple(ADVERSARIAL), MIXED),
    "regularized": Variant("diverse", tuple(ADVERSARIAL), MIXED | dict(lam=0.1)),
    "standard-prior": Variant("diverse", tuple(ADVERSARIAL), MIXED | dict(prior="standard")),
}
MAIN = "mixed"  # the defence of the tables


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
        known = artifacts.promised(self.folder / "victim.safetensors", self.root)
        if known in (None, artifacts.digest(victim.state_dict())):
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
        tuned = artifacts.read_json(self.folder / "timing.json", self.root)
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


def load_trajectories(run: Run, folder: str) -> Trajectories:
    """All shards of a folder of trajectories: "normal-DATA", "calibration", or "PART-DATA" with a part of D_adv."""
    paths = sorted((run.folder / folder).glob("*.safetensors"))
    if not paths:
        stage = "augment" if folder.startswith(tuple(ADVERSARIAL)) else "collect"
        raise ValueError(f"{run.folder / folder} is empty; run the {stage} stage first")
    shards = [load_shard(run, path) for path in paths]
    return Trajectories(np.concatenate([s.obs for s in shards]), np.concatenate([s.lengths for s in shards]))


def shards(run: Run, folder: str, n: int) -> list[tuple[Path, slice]]:
    """The files of a folder of n trajectories, each with the positions of its own among them."""
    return [(run.folder / folder / f"{i:05d}.safetensors", slice(i, min(i + SHARD, n))) for i in range(0, n, SHARD)]


def save_shard(run: Run, path: Path, shard: Trajectories) -> None:
    """Write one file of trajectories."""
    state = dict(obs=torch.from_numpy(shard.obs), lengths=torch.from_numpy(shard.lengths))
    artifacts.save_tensors(path, state, dict(task=run.task.name, episodes=len(shard)), run.root)


def load_shard(run: Run, path: Path) -> Trajectories:
    """Read one file of trajectories."""
    state, _ = artifacts.load_tensors(path, run.root)
    return Trajectories(state["obs"].numpy(), state["lengths"].numpy())
