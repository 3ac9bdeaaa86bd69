"""The ceiling: a detector and a denoiser that know the truth. The gap to an oracle is what a real part costs.

No defender knows the truth. So an oracle declares that it ``needs`` it, and ``rollout`` reveals it before each
observation. An oracle that was not told refuses to answer: nothing that runs on a robot can use it by mistake.
"""

from collections.abc import Sequence

from torch import Tensor

from detden_lite.defense.memory import Memoryless


class _Oracle(Memoryless):
    """A part that is told the truth before each step, and uses it up in that step."""

    needs = frozenset({"truth"})
    truth: tuple[Tensor, Tensor] | None

    def reset(self, episodes: Sequence[int]) -> None:
        """Begin new episodes."""
        self.truth = None

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
    """Raises the alarm where there is an attack and nowhere else. Its score is 1 or 0, its reconstruction the truth.

    Example:
        >>> import torch
        >>> oracle, true = OracleDetector(), torch.zeros(2, 3)
        >>> oracle.reset(episodes=[0, 1])
        >>> oracle.reveal(true, torch.tensor([True, False]))  # in an episode rollout does this
        >>> oracle.step(true + 0.1)[1]
        tensor([ True, False])
    """

    threshold = 0.5

    def step(self, obs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The score ``[N]``, the alarm ``[N]`` bool and the reconstruction ``[N, obs_dim]``.

        Raises:
            ValueError: if the truth was not revealed.
        """
        true, attacked = self._use()
        return attacked.to(obs.dtype), attacked.clone(), true.clone()


class OracleDenoiser(_Oracle):
    """Undoes every attack: o from o_hat.

    Example:
        >>> import torch
        >>> oracle, true = OracleDenoiser(), torch.zeros(1, 3)
        >>> oracle.reset(episodes=[0])
        >>> oracle.reveal(true, torch.tensor([True]))
        >>> oracle.step(true + 0.1)
        tensor([[0., 0., 0.]])
    """

    def step(self, obs: Tensor, action: Tensor | None = None) -> Tensor:
        """The true observation ``[N, obs_dim]``; the policy's last ``action`` is not used.

        Raises:
            ValueError: if the truth was not revealed.
        """
        return self._use()[0].clone()
