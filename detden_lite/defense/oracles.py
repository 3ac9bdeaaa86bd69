"""The ceiling: a detector and a denoiser that are told the truth. What is missing to them, the defender's part lost.

No defender knows the truth. So an oracle declares that it ``needs`` it, ``rollout`` reveals it before each observation,
and one that was not told refuses to answer: nothing that runs on a robot can use it by mistake.
"""

from collections.abc import Sequence

from torch import Tensor


class _Oracle:
    """What both have: a truth that is used up by one step."""

    needs = frozenset({"truth"})

    def reset(self, episodes: Sequence[int]) -> None:
        """Begin new episodes."""
        self.truth = None

    def restart(self, i: int, episode: int) -> None:
        """Begin a new episode in row i; there is no memory."""

    def reveal(self, true: Tensor, attacked: Tensor) -> None:
        """The true observation ``[N, obs_dim]`` behind the next one, and whether it is attacked, ``[N]`` bool."""
        self.truth = true, attacked

    def _use(self) -> tuple[Tensor, Tensor]:
        if self.truth is None:
            raise ValueError(
                f"{type(self).__name__} was not told the truth of this observation: it is no defence but the ceiling "
                "of one; run it in rollout"
            )
        truth, self.truth = self.truth, None
        return truth


class OracleDetector(_Oracle):
    """Raises the alarm where there is an attack and nowhere else. Its score is 1 or 0, its reconstruction the truth."""

    threshold = 0.5

    def step(self, obs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The score ``[N]``, the alarm ``[N]`` bool and the reconstruction ``[N, obs_dim]``.

        Raises:
            ValueError: if the truth was not revealed.
        """
        true, attacked = self._use()
        return attacked.to(obs.dtype), attacked.clone(), true.clone()


class OracleDenoiser(_Oracle):
    """Undoes every attack: o from o_hat."""

    def step(self, obs: Tensor, action: Tensor | None = None) -> Tensor:
        """The true observation ``[N, obs_dim]``.

        Raises:
            ValueError: if the truth was not revealed.
        """
        return self._use()[0].clone()
