"""How the robust policies are trained that learn online, against attacks: SA-PPO and ATLA-PPO.

Both are PPO with the settings of ``PPORecipe``, in the task's own ball.
"""

from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING, Any, cast

from detden_lite.core.arguments import check_between, check_positive, check_whole
from detden_lite.core.tasks import Task
from detden_lite.training.adversary_recipe import AdversaryRecipe
from detden_lite.training.recipes import PPORecipe, Worlds

if TYPE_CHECKING:
    from sbx import PPO
    from stable_baselines3.common.vec_env import VecEnv


@dataclass(frozen=True)
class OnlineRecipe(PPORecipe):
    """What both have in common.

    Args:
        normalized: whether the ball's radius is in units of the normaliser's deviations, as Zhang et al. have it, and
            not in the environment's units.
        grown: the share of the training after which a snapshot may be chosen. SA-PPO's ball grows until then.
    """

    normalized: bool = False
    grown: float = 0.75

    def __post_init__(self) -> None:
        super().__post_init__()
        check_between(0, 1, grown=self.grown)
        if not 0 < self.grown < 1:
            raise ValueError(f"grown must be between 0 and 1, not {self.grown!r}")


@dataclass(frozen=True)
class SAPPORecipe(OnlineRecipe):
    """Hyperparameters of SA-PPO; see ``detden_lite.training.sa_ppo``.

    Args:
        weight: of the regularizer.
        ascent: gradient steps of the inner maximum.

    Example:
        >>> from detden_lite import get_task
        >>> SAPPORecipe(weight=0.1).config(get_task("hopper"))["actor"]
        [11, 64, 64, 3]
    """

    weight: float = 0.1
    ascent: int = 10

    def __post_init__(self) -> None:
        super().__post_init__()
        check_between(0, inf, weight=self.weight)
        check_whole(1, ascent=self.ascent)

    @property
    def algorithm(self) -> "type[PPO]":
        """The class of the model."""
        from detden_lite.training.sa_ppo import SAPPO

        return SAPPO

    def start(self, task: Task, worlds: Worlds, seed: int) -> "PPO":
        """A new model, untrained."""
        model: Any = super().start(task, worlds, seed)
        model.weight, model.ascent, model.epsilon, model.normalized = (
            self.weight, self.ascent, task.epsilon, self.normalized
        )  # fmt: skip
        return model

    def begin_segment(self, model: "PPO", worlds: Worlds, done: float) -> None:
        """Begin new episodes, in a larger ball. ``done`` is the completed share of the training."""
        super().begin_segment(model, worlds, done)
        cast(Any, model).share = min(1.0, done / self.grown)


@dataclass(frozen=True)
class ATLARecipe(OnlineRecipe):
    """Hyperparameters of ATLA-PPO; see ``detden_lite.training.atla``.

    The steps are those of the policy. The adversary has as many of their own.

    Args:
        entropy: weight of the policy's entropy bonus.
        adversary_rate: the adversary's learning rate.
        adversary_entropy: weight of the adversary's entropy bonus.

    Example:
        >>> from detden_lite import get_task
        >>> ATLARecipe().adversary.config(get_task("hopper"))["actor"]
        [11, 64, 64, 11]
    """

    entropy: float = 0.0
    adversary_rate: float = 1e-3
    adversary_entropy: float = 0.003

    def __post_init__(self) -> None:
        super().__post_init__()
        check_between(0, inf, entropy=self.entropy, adversary_entropy=self.adversary_entropy)
        check_positive(adversary_rate=self.adversary_rate)

    @property
    def algorithm(self) -> "type[PPO]":
        """The class of the model."""
        from detden_lite.training.atla import ATLA

        return ATLA

    @property
    def adversary(self) -> AdversaryRecipe:
        """The adversary's own hyperparameters; what is not said here is the policy's."""
        return AdversaryRecipe(
            steps=self.steps, segment=self.segment, net=self.net, activation=self.activation,
            learning_rate=self.adversary_rate, envs=self.envs, rollout=self.rollout, batch=self.batch,
            epochs=self.epochs, gamma=self.gamma, gae_lambda=self.gae_lambda, entropy=self.adversary_entropy,
        )  # fmt: skip

    def start(self, task: Task, worlds: Worlds, seed: int) -> "PPO":
        """A new model, untrained, with its adversary."""
        from detden_lite.core.random_streams import derived_seed

        model: Any = super().start(task, self._attacked(worlds), seed)
        model.ent_coef, model.epsilon, model.normalized = self.entropy, task.epsilon, self.normalized
        model.task = task
        model.adversary = self.adversary.start(task, self._arena(model), derived_seed(seed, 1))
        return model

    def begin_segment(self, model: "PPO", worlds: Worlds, done: float) -> None:
        """Begin new episodes of both. ``done`` is the completed share of the training."""
        both: Any = model
        super().begin_segment(model, self._attacked(worlds), done)
        self.adversary.begin_segment(both.adversary, self._arena(both), done)
        both.face_adversary()

    def _attacked(self, worlds: Worlds) -> Worlds:
        from detden_lite.training.atla import AttackedWorlds

        return lambda n: AttackedWorlds(worlds(n))

    def _arena(self, model: Any) -> Worlds:
        from detden_lite.training.adversary_world import AdversaryEnv
        from detden_lite.training.atla import Frozen

        def arena(n: int) -> "VecEnv":
            victim: Any = Frozen(model, deterministic=True)  # it is asked for nothing but actions
            return AdversaryEnv(victim, model.task, model.ball, n)

        return arena
