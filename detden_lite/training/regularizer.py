"""The robustness regularizer: pi(den(.)) should do the same, attacked or not (section 3.1.2).

The paper optimises L_den + R, which cannot be right: its L_den is an ELBO, to be maximised, and R is to be small. Here
-L_den + lambda R is minimised; see ``detden_lite.training.gruvae_training`` for the units.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from detden_lite.core.arguments import check_whole
from detden_lite.core.budget import Budget
from detden_lite.core.distances import euclidean, mahalanobis
from detden_lite.core.gradients import value_and_gradient
from detden_lite.core.random_streams import RandomStreams
from detden_lite.defense.gruvae import GRUVAE, State
from detden_lite.victims.victim import Victim


@dataclass(frozen=True)
class Regularizer:
    """R of a victim whose parameters stay as they are: only the denoiser's are trained.

    The inner attack is the opposite attack on pi o den by projected gradient ascent on R itself. The denoiser
    remembers, so that single observations are not attacked one by one: all observations of a sequence are perturbed
    jointly, each in its own ball, to make the mean of R over the sequence large. So a perturbation is also chosen for
    its effect on later actions through the memory, and the whole sequence costs one call a gradient step. The latent
    noise is held fixed and is the same for both actions: R measures the perturbation, not the sampling.

    Args:
        victim: pi. A Gaussian policy's mean is compared before it is clipped, as in the opposite attack.
        budget: the ball.
        steps: gradient steps of the inner attack, from a random start.
        reference: the action to compare the attacked one with: "denoised" for pi(den(o)), as the paper has it; "true"
            for pi(o), which no denoiser can approach by ignoring its input.

    Raises:
        ValueError: for fewer than one step or another reference.

    Example:
        >>> from detden_lite import Regularizer, load_model, load_victim
        >>> victim, denoiser = load_victim("hopper", "td3"), load_model("hopper", "td3", "denoiser-mixed")[0]
        >>> obs = torch.zeros(2, 10, 11)  # two sequences of ten steps
        >>> r = Regularizer(victim, Budget(0.075))(denoiser, obs, mask=torch.ones(2, 10))
        >>> bool(r > 0)
        True
    """

    victim: Victim
    budget: Budget
    steps: int = 3
    reference: str = "denoised"

    def __post_init__(self) -> None:
        check_whole(1, steps=self.steps)
        if self.reference not in ("denoised", "true"):
            raise ValueError(f'reference must be "denoised" or "true", not {self.reference!r}')

    @property
    def settings(self) -> dict[str, object]:
        """All but the victim, ready for JSON."""
        budget = dict(vars(self.budget), norm=str(self.budget.norm), scale=torch.as_tensor(self.budget.scale).tolist())
        return dict(budget, steps=self.steps, reference=self.reference)

    def distance(self, action: Tensor, reference: Tensor) -> Tensor:
        """R of each observation: R_ppo for a Gaussian policy, R_td3 for a deterministic one."""
        std = self.victim.action_std
        return euclidean(action, reference) if std is None else mahalanobis(action, reference, std)

    def action(self, model: GRUVAE, obs: Tensor, noise: Tensor | None = None, state: State | None = None) -> Tensor:
        """pi(den(o)) ``[N, steps, action_dim]`` of sequences; see ``GRUVAE.forward`` for the arguments."""
        return self.victim.mean(model(obs, noise, state).output)

    def attack(
        self, model: GRUVAE, obs: Tensor, reference: Tensor, mask: Tensor, noise: Tensor | None = None,
        state: State | None = None,
    ) -> Tensor:  # fmt: skip
        """A_B(o) on pi o den: sequences ``[N, steps, obs_dim]``, each observation in the ball of its own.

        Args:
            model: den.
            obs: true observations ``[N, steps, obs_dim]``.
            reference: actions to get away from, ``[N, steps, action_dim]``.
            mask: 1 or True for steps that are not padding, ``[N, steps]``.
            noise: of the latent, ``[N, steps, latent_dim]``; None takes its mean.
            state: the denoiser's memory at the first observation; None at an episode's beginning.
        """
        streams = RandomStreams(int(torch.randint(2**31, ())))
        project, step_size = self.budget.projection(obs), self.budget.epsilon * min(1.0, 2.5 / self.steps)
        perturbed = project(self.budget.sample(obs.flatten(0, 1), streams).view_as(obs))
        for _ in range(self.steps):
            _, gradient = value_and_gradient(
                lambda seen: self.distance(self.action(model, seen, noise, state), reference) * mask, perturbed
            )
            perturbed = project(perturbed + step_size * self.budget.steepest(gradient))
        return perturbed

    def __call__(
        self, model: GRUVAE, obs: Tensor, mask: Tensor, noise: Tensor | None = None, state: State | None = None
    ) -> Tensor:
        """The mean of R over all observations but padding, which is to be small; see ``attack`` for the arguments."""
        reference = self.action(model, obs, noise, state) if self.reference == "denoised" else self.victim.mean(obs)
        perturbed = self.attack(model, obs, reference.detach(), mask, noise, state)
        distance = self.distance(self.action(model, perturbed, noise, state), reference)
        return (distance * mask).sum() / mask.sum().clamp_min(1)
