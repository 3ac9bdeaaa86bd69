"""An attacker who knows the defence: what they see of it at one step, with gradients (section 4.4).

They know the networks, the networks' memory and the threshold, but not the noise of the latents. So they take K samples
of their own, and maximise the mean over them (expectation over transformation, Athalye et al., 2018).
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from detden_lite.attacks.base import BallAttack
from detden_lite.attacks.gradient import GradientAttack
from detden_lite.core.arguments import check_kind
from detden_lite.core.random_streams import RandomStreams, derived_seed
from detden_lite.core.types import World
from detden_lite.defense.gruvae import sample
from detden_lite.defense.memory import Recurrent
from detden_lite.defense.pipeline import DetectAndDenoise
from detden_lite.defense.predict_correct import PredictCorrect, Surprise


@dataclass(frozen=True)
class View:
    """A defence at one step, for n rows and K latent samples. To evaluate it does not change the defence's memory.

    Args:
        reconstruct: det(.), from perturbed observations ``[n, obs_dim]`` to reconstructions ``[K, n, obs_dim]``.
        denoise: den(.), likewise.
        scale: units of the detector's score, a number or ``[obs_dim]``.
        threshold: C_anomaly; an alarm is a score above it.

    Example:
        >>> from detden_lite import View
        >>> view = View(lambda seen: 0 * seen[None], lambda seen: seen[None], scale=0.5, threshold=1.0)
        >>> view.deviation(torch.tensor([[1.0, -0.25]]))  # of a detector that always reconstructs zeros
        tensor([[[2.0000, 0.5000]]])
    """

    reconstruct: Callable[[Tensor], Tensor]
    denoise: Callable[[Tensor], Tensor]
    scale: Tensor | float
    threshold: float

    def deviation(self, perturbed: Tensor) -> Tensor:
        """|o_hat - det(o_hat)| in units of ``scale``, ``[K, n, obs_dim]``: its largest over obs_dim is the score."""
        return ((perturbed - self.reconstruct(perturbed)) / self.scale).abs()


@dataclass(frozen=True)
class PredictedView(View):
    """The view of a denoiser that predicts, and that gives its own odds of a perturbation.

    Args:
        log_odds: from perturbed observations ``[n, obs_dim]`` to ``[n]``; above ``threshold`` is an alarm.
    """

    log_odds: Callable[[Tensor], Tensor]

    def deviation(self, perturbed: Tensor) -> Tensor:
        """The odds as the only number of a deviation, ``[1, n, 1]``."""
        return self.log_odds(perturbed)[None, :, None]


Views = Callable[[int], View]  # the view of a defence in so many latent samples, new ones at every call


def one_step(part: Recurrent, rows: Tensor, noise: Tensor | None) -> Callable[[Tensor], Tensor]:
    """The output of a ``Detector`` or ``Denoiser`` at its next step, as a function of what it is shown.

    Args:
        part: the detector or denoiser, whose memory stays as it is.
        rows: the episodes to look at, ``[N]`` bool, n of them.
        noise: of the latent, standard normal ``[K, n, latent_dim]``; None for the latent's mean, which makes K 1.

    Returns:
        A function from ``[n, obs_dim]`` to ``[K, n, obs_dim]``, with a gradient.
    """
    model, samples = part.model, 1 if noise is None else len(noise)
    encoder_state = decoder_state = None
    if part.state is not None:
        encoder_state = part.state[0][:, rows].contiguous()
        decoder_state = part.state[1][:, rows].repeat(1, samples, 1)

    def step(obs: Tensor) -> Tensor:
        mean, log_variance, _ = model.encode(obs[:, None], encoder_state)
        z = sample(mean[:, 0], log_variance[:, 0], noise).reshape(samples * len(obs), 1, -1)
        output, _ = model.decode(z, obs.repeat(samples, 1)[:, None], decoder_state)
        return output.reshape(samples, *obs.shape)

    return step


def view_defense(
    defense: DetectAndDenoise, rows: Tensor, streams: RandomStreams, samples: int, action: Tensor | None = None
) -> View:
    """The view of a defence of two GRU-VAEs, or of one that predicts, which has no latents: K is 1.

    Args:
        defense: with its memory as it is before this observation.
        rows: the attacked ones of its N episodes, ``[N]`` bool, n of them.
        streams: the attacker's, of n rows.
        samples: K, latent samples of each row.
        action: what the policy did one step before, ``[n, action_dim]``; a GRU-VAE does not use it.

    Raises:
        ValueError: if the defence has other parts.

    Example:
        >>> from detden_lite import RandomStreams, load_defense, view_defense
        >>> defense, obs = load_defense("hopper", "td3"), torch.zeros(2, 11)
        >>> defense.reset([0, 1])
        >>> view = view_defense(defense, torch.tensor([True, True]), RandomStreams(0, [0, 1]), samples=4)
        >>> view.denoise(obs).shape
        torch.Size([4, 2, 11])
    """

    if isinstance(defense.denoiser, PredictCorrect) and isinstance(defense.detector, Surprise):
        return _view_predicted(defense, rows, action)
    n, budget, through, units = int(rows.sum()), defense.budget, [], []
    for part in defense.parts:
        if not isinstance(part, Recurrent):
            raise ValueError(f"defense: its {type(part).__name__} is no GRU-VAE; give the attack a view of your own")
        noise = None
        if part.sample:
            noise = streams.normal(n * samples, part.model.latent_dim).reshape(n, samples, -1).transpose(0, 1)
        through.append(one_step(part, rows, noise))
        units.append(part.model.obs_std)
    reconstruct, denoise = through[0], through[-1]  # without a denoiser they are the same
    return View(
        reconstruct,
        denoise if budget is None else lambda obs: budget.project(obs, denoise(obs)),
        units[0],
        -torch.inf if defense.always else defense.detector.threshold,  # what is always denoised is always alarming
    )


def _view_predicted(defense: DetectAndDenoise, rows: Tensor, action: Tensor | None) -> View:
    assert isinstance(defense.denoiser, PredictCorrect)
    part = defense.denoiser.select(rows)
    prediction = part.predict(action)
    odds = defense.detector.threshold / (1 - defense.detector.threshold)
    return PredictedView(
        lambda obs: prediction.obs[None],
        lambda obs: part.correct(obs, prediction).denoised[None],
        1.0,
        -torch.inf if defense.always else math.log(odds),
        lambda obs: torch.logit(part.correct(obs, prediction).perturbed, eps=1e-15).float(),
    )


class InformedAttack(BallAttack, ABC):
    """An attack that knows policy and defence.

    Args:
        attack: the attack that does not know the defence; its objective is the damage here too.
        seed: of the attacker's random numbers.
        view: how to see a defence, with the arguments of ``view_defense``.

    Raises:
        ValueError: if ``attack`` is no gradient attack.
    """

    def __init__(self, attack: GradientAttack, seed: int = 0, view: Callable[..., View] = view_defense) -> None:
        check_kind(GradientAttack, attack=attack)
        super().__init__(attack.budget, attack.victim.obs_dim)
        self.attack, self.seed, self.view = attack, seed, view
        self.needs = attack.needs | {"defense"}
        self.policy = attack.victim.straight_through if attack.clips else attack.victim.mean

    @property
    @abstractmethod
    def settings(self) -> dict[str, float | str]:
        """Its settings, for a result record."""

    @abstractmethod
    def perturb(self, obs: Tensor, wanted: Tensor, world: World, views: Views, streams: RandomStreams) -> Tensor:
        """The perturbed observations ``[N, obs_dim]``.

        Args:
            obs: true observations ``[N, obs_dim]``.
            wanted: the rows whose perturbed observation will be used, ``[N]`` bool, n > 0 of them.
            world: what ``rollout`` hands to the attack.
            views: gives views of the defence for the n rows.
            streams: of the n rows.
        """

    def reset(self, episodes: Sequence[int] | None = None) -> None:
        """Begin new episodes, one seed each; None for offline use on any number of rows."""
        super().reset(episodes)
        self.attack.reset(episodes)
        self.episodes, self.step = None if episodes is None else np.asarray(episodes), 0

    @torch.no_grad()
    def __call__(self, obs: Tensor, world: World | None = None) -> Tensor:
        """Perturbed observations ``[N, obs_dim]``; rows that the world does not want come back as they are.

        Raises:
            ValueError: if there is no defence; and as ``check``.
        """
        self.check(obs)
        if world is None or world.defense is None:
            raise ValueError("world: it has no defense to adapt to; give one, or use the attack without adaptation")
        defense = world.defense
        # Every step has streams of its own, so that the random numbers of one step, and the rows that it perturbs,
        # change nothing in another.
        seed, self.step = derived_seed(self.seed, self.step), self.step + 1
        wanted = torch.from_numpy(world.wanted)
        if not wanted.any():
            return self.attack(obs, world)  # only so that its random numbers and its plans go on
        streams = RandomStreams(seed, None if self.episodes is None else self.episodes[world.wanted])
        action = None if world.action is None else world.action[wanted]
        return self.perturb(obs, wanted, world, lambda k: self.view(defense, wanted, streams, k, action), streams)
