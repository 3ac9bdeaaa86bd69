"""How an adversary is trained: PPO in the world of ``detden_lite.training.adversary_world``."""

from dataclasses import dataclass, replace
from math import inf
from typing import TYPE_CHECKING, Any

from detden_lite.core.arguments import check_between, check_whole
from detden_lite.core.tasks import Task
from detden_lite.training.recipes import PPORecipe, Worlds

if TYPE_CHECKING:
    from sbx import PPO


@dataclass(frozen=True)
class AdversaryRecipe(PPORecipe):
    """Hyperparameters of PPO for an adversary, who sees the true observation and perturbs it.

    Args:
        entropy: weight of the entropy bonus.
        timing: when they may attack: "always" or "vulnerable".
        history: how many observations they see: the last ones.
        warm: whether they begin as a copy of the linear adversary.
        director: whether they choose a direction of the action instead of a perturbation; see ``DirectorAttack``.

    Example:
        >>> from detden_lite import get_task
        >>> AdversaryRecipe(history=3).config(get_task("hopper"))["actor"]
        [33, 64, 64, 11]
    """

    steps: int = 1_024_000
    segment: int = 102_400
    learning_rate: float = 1e-3
    envs: int = 32
    rollout: int = 64
    batch: int = 128
    entropy: float = 0.003
    timing: str = "always"
    history: int = 1
    warm: bool = False
    director: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        check_between(0, inf, entropy=self.entropy)
        check_whole(1, history=self.history)
        if self.timing not in ("always", "vulnerable"):
            raise ValueError(f"timing must be always or vulnerable, not {self.timing!r}")
        if self.director and (self.warm or self.history > 1):
            raise ValueError("director: it sees one observation, and no linear map can be its beginning")

    def config(self, task: Task) -> dict[str, Any]:
        """The arguments of the ``Victim`` that the adversary is: its actions are perturbations, or directions."""
        actions = task.action_dim if self.director else task.obs_dim
        return super().config(replace(task, obs_dim=self.history * task.obs_dim, action_dim=actions))

    def start(self, task: Task, worlds: Worlds, seed: int) -> "PPO":
        """A new model, untrained."""
        model = super().start(task, worlds, seed)
        model.ent_coef = self.entropy
        return model
