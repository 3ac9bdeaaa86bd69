"""The base class of the attacks here: their ball, and the checks at the first call after a reset."""

from collections.abc import Sequence

from torch import Tensor

from detden_lite.core.arguments import check_kind
from detden_lite.core.budget import Budget


def check_budget(budget: Budget, obs_dim: int | None) -> None:
    """Refuse what is no ``Budget``, or one whose scale has another length than the observations, if that is known."""
    check_kind(Budget, budget=budget)
    if obs_dim is not None:
        budget.check_fits(obs_dim)


class BallAttack:
    """An attack within a ball. The contract does not require this base class: it checks what every attack should.

    Args:
        budget: the ball.
        obs_dim: length of the observations that the attack was made for; None if it attacks those of any length.
        maker: the argument that fixed this length, for errors.

    Raises:
        ValueError: if ``budget`` is no ``Budget``, or its scale has another length than the observations.

    Example:
        >>> import torch
        >>> from detden_lite import Budget
        >>> from detden_lite.attacks.base import BallAttack
        >>> class Shift(BallAttack):  # raises every number as far as the ball allows
        ...     def __call__(self, obs, world=None):
        ...         self.check(obs)
        ...         return self.budget.project(obs, obs + 1)
        >>> attack = Shift(Budget(0.25))
        >>> attack.reset([0])
        >>> attack(torch.zeros(1, 3))
        tensor([[0.2500, 0.2500, 0.2500]])
    """

    needs: frozenset[str] = frozenset()
    _begun, _checked = False, False

    def __init__(self, budget: Budget, obs_dim: int | None = None, maker: str = "victim") -> None:
        check_budget(budget, obs_dim)
        self.budget, self.obs_dim, self._maker = budget, obs_dim, maker

    def reset(self, episodes: Sequence[int] | None = None) -> None:
        """Begin new episodes, one seed each; None for offline use on any number of rows."""
        self._begun, self._checked = True, False

    def check(self, obs: Tensor) -> None:
        """Check the observations ``[N, obs_dim]`` of the first call after a reset; later calls cost nothing.

        Raises:
            ValueError: without a reset, or if the observations are no such tensor, not finite or of another task.
        """
        if self._checked:
            return
        if not self._begun:
            raise ValueError(f"{type(self).__name__}: no episode is under way; call reset(episodes) first")
        if not isinstance(obs, Tensor) or obs.ndim != 2:
            raise ValueError(f"obs must be a tensor [N, obs_dim], not {obs!r}")
        if self.obs_dim not in (None, obs.shape[1]):
            raise ValueError(
                f"{self._maker}: it sees {self.obs_dim} numbers, and an observation here has {obs.shape[1]}; "
                f"give the {self._maker} of this task"
            )
        check_budget(self.budget, obs.shape[1])
        if not obs.isfinite().all():
            raise ValueError("obs holds NaN or infinity; check the sensors before the attack")
        self._checked = True
