"""A denoiser that predicts: where the robot must be by its last estimate and action, corrected by what is shown.

A Kalman filter takes the noise of a measurement for Gaussian. An attacker's is not: it may be anything in the ball, and
may stay the same for a whole episode. So there are two explanations of an observation, weighed by Bayes' rule. Nobody
attacks, and it is exact. Or it is perturbed, and of each number all that is known is that the truth lies in the ball
around it, and perhaps that the perturbation is that of the step before. No attack is needed to train this.
"""

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from detden_lite.core.arguments import check_positive
from detden_lite.core.budget import Budget
from detden_lite.defense.bounded_noise import DOF, Moments, condition, log_student, truncated_moments
from detden_lite.defense.dynamics import Dynamics

EXACT = 1e-3  # standard deviation of an observation that is not perturbed, in balls
FLOOR = 3e-3  # the least that f's argument is varied by, in balls
MODEL_ERROR = 2e-3  # added to the standard deviation that f gives, in balls
SURPRISE = 3.0  # standard deviations between a prediction and the ball from which on the prediction is trusted less
MEMORY = 0.1  # how fast it is learned in an episode whether perturbations stay
HELD = (0.02, 0.98)  # the range of that probability


@dataclass(frozen=True)
class Prediction:
    """What is known of the next observation of N episodes before it is seen: everything in float64 and raw units.

    Covariances are in balls, of the state x_t and of the one before.
    """

    mean: Tensor  # of the state, [N, state_dim]
    covariance: Tensor  # [N, state_dim, state_dim]
    cross: Tensor  # of x_t with x_{t-1}
    past: Tensor  # the covariance of x_{t-1}
    sensors: Moments  # mean and standard deviation of the other numbers, [N, obs_dim - state_dim] each
    delta: Tensor  # the perturbation of the step before, in balls, [N, state_dim]
    held: Tensor  # the probability that it stays, [N]

    @property
    def obs(self) -> Tensor:
        """The mean of the whole observation, ``[N, obs_dim]`` float32."""
        return torch.cat([self.mean, self.sensors[0]], 1).float()


@dataclass(frozen=True)
class Correction:
    """What an observation of N episodes made of a prediction."""

    denoised: Tensor  # [N, obs_dim] float32, in the ball around what was shown
    perturbed: Tensor  # the probability of a perturbation, [N]
    estimate: Tensor  # of the state, [N, state_dim]
    covariance: Tensor  # of the state, in balls
    delta: Tensor  # the perturbation of the state, in balls
    held: Tensor  # the probability that a perturbation stays, [N]


class PredictCorrect:
    """A filter over the robot's state, for a learned model of its motion and a perturbation that is bounded.

    Its memory is the estimate of the state e with its covariance P, in balls, and the last perturbation. A step
    predicts both by sigma points of f, and conditions them on the observation (``detden_lite.defense.bounded_noise``).

    Args:
        dynamics: f, trained on D_normal.
        budget: the ball in which the attacker keeps; the answer lies in it.

    Attributes:
        perturbed: the probability that the last observation was perturbed, ``[N]``.
        prediction: what was known of it before.

    Raises:
        ValueError: if the ball has no radius, or its scale is for observations of another size.

    Example:
        >>> filter = PredictCorrect(Dynamics(obs_dim=3, action_dim=2, hidden=8), Budget(0.1))
        >>> filter.reset(episodes=[0, 1])
        >>> obs = torch.zeros(2, 3)
        >>> filter.step(obs).shape, filter.step(obs, torch.zeros(2, 2)).shape
        (torch.Size([2, 3]), torch.Size([2, 3]))
    """

    perturbed: Tensor
    prediction: Prediction

    def __init__(self, dynamics: Dynamics, budget: Budget):
        check_positive(**{"budget.epsilon": budget.epsilon})
        budget.check_fits(dynamics.obs_dim)
        self.dynamics, self.budget = dynamics, budget
        self.obs_dim, self.state_dim = dynamics.obs_dim, dynamics.state_dim
        ball = torch.as_tensor(budget.epsilon * budget.scale, dtype=torch.float64).expand(self.obs_dim)
        self.ball, self.sensor_ball = ball.tensor_split([self.state_dim])
        self.identity = torch.eye(self.state_dim, dtype=torch.float64)
        self.rows = torch.cat(  # of x_t and x_{t-1}: by how much the perturbation changed, and where the state is
            [torch.cat([self.identity, -self.identity], 1), torch.cat([self.identity, 0 * self.identity], 1)]
        )

    def reset(self, episodes: Sequence[int]) -> None:
        """Begin new episodes."""
        n, d = len(episodes), self.state_dim
        self.first = torch.ones(n, dtype=torch.bool)
        self.estimate = torch.zeros(n, d, dtype=torch.float64)
        self.covariance = self.identity.repeat(n, 1, 1)
        self.delta = torch.zeros(n, d, dtype=torch.float64)  # the last perturbation
        self.held = torch.full((n,), 0.5, dtype=torch.float64)  # the probability that a perturbation stays
        self.perturbed = torch.full((n,), 0.5, dtype=torch.float64)

    def restart(self, i: int, episode: int) -> None:
        """Begin a new episode in row i; the others go on."""
        self.first[i], self.held[i] = True, 0.5

    def step(self, obs: Tensor, action: Tensor | None = None) -> Tensor:
        """The estimate of the true observation ``[N, obs_dim]``, in the ball around the shown one.

        Args:
            obs: the observations as the policy would see them, ``[N, obs_dim]``.
            action: what the policy did one step before, ``[N, action_dim]``; may be None at an episode's first step.

        Raises:
            ValueError: if the action is missing in the middle of an episode.
        """
        self.prediction = self.predict(action)
        found = self.correct(obs, self.prediction)
        self.estimate, self.covariance, self.delta = found.estimate, found.covariance, found.delta
        self.held, self.perturbed = found.held, found.perturbed
        self.first = torch.zeros_like(self.first)
        return found.denoised

    def select(self, rows: Tensor) -> "PredictCorrect":
        """A filter of these rows alone, ``[N]`` bool, with their memories as they are."""
        part = copy.copy(self)
        for name in ("first", "estimate", "covariance", "delta", "held", "perturbed"):
            setattr(part, name, getattr(self, name)[rows])
        return part

    def correct(self, obs: Tensor, prediction: Prediction) -> Correction:
        """Weigh both explanations of an observation ``[N, obs_dim]``; the memory stays as it is."""
        shown, sensors = obs.double().tensor_split([self.state_dim], 1)
        x = (prediction.mean - shown) / self.ball  # the state, as seen from the observation: minus the perturbation
        (a, cov_a, exact), (b, cov_b, held) = self._clean(x, prediction.covariance), self._attacked(x, prediction)
        a, b, perturbed = a.clamp(-1, 1), b.clamp(-1, 1), torch.sigmoid(_log_anywhere(x, prediction.covariance) - exact)
        apart, w = b - a, perturbed[:, None]
        x = a + w * apart
        spread = (w * (1 - w))[..., None] * apart[:, :, None] * apart[:, None]
        covariance = cov_a + w[..., None] * (cov_b - cov_a) + spread
        mean, std = prediction.sensors  # each alone: the part of its prediction that lies in the ball
        inside, _ = truncated_moments((mean - sensors) / self.sensor_ball, (std / self.sensor_ball).square())
        moved = torch.cat([self.ball * x, w * inside * self.sensor_ball], 1).float()
        symmetric = 0.5 * (covariance + covariance.mT)
        return Correction(self.budget.project(obs, obs + moved), perturbed, shown + self.ball * x, symmetric, -x, held)

    def predict(self, action: Tensor | None) -> Prediction:
        """What the next observation should be after this ``action``; the memory stays as it is."""
        if action is None:
            if not self.first.all():
                raise ValueError("action: this denoiser predicts from it; give what was done one step before")
            action = torch.zeros(len(self.first), self.dynamics.config["action_dim"])
        d, begins = self.state_dim, self.first[:, None]
        action = torch.where(begins, 0.0, action)
        past = self.covariance + FLOOR**2 * self.identity
        root = torch.linalg.cholesky(past).mT
        points = self.estimate[:, None] + torch.cat([torch.zeros_like(root[:, :1]), root, -root], 1) * self.ball
        actions = action[:, None].expand(-1, 2 * d + 1, -1)
        moved, std = (part.double() for part in self.dynamics.next_state(points.float(), actions))
        change = (moved[:, 1:] - moved[:, :1]) / self.ball
        noise = torch.diag_embed((std[:, 0] / self.ball + MODEL_ERROR).square())
        cross = 0.5 * (change[:, :d] - change[:, d:]).mT @ root
        start, spread = self.dynamics.first_mean.double(), self.dynamics.first_std.double()
        at_start = torch.diag((spread[:d] / self.ball).square() + EXACT**2)
        sensors, sensor_std = (part.double() for part in self.dynamics.sensors(self.estimate.float(), action))
        return Prediction(
            torch.where(begins, start[:d], moved[:, 0]),
            torch.where(begins[..., None], at_start, 0.5 * change.mT @ change + noise),
            torch.where(begins[..., None], 0.0, cross),
            torch.where(begins[..., None], 1e4 * self.identity, past),  # nothing is known of a state before the first
            (torch.where(begins, start[d:], sensors), torch.where(begins, spread[d:], sensor_std)),
            self.delta,
            self.held,
        )

    def _clean(self, x: Tensor, covariance: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The state if the observation is exact: a Kalman filter's update.

        Returns:
            Its mean and covariance, and the log density of the observation.
        """
        root = torch.linalg.cholesky(covariance + EXACT**2 * self.identity)
        gain = torch.linalg.solve_triangular(root, covariance, upper=False)
        innovation = torch.linalg.solve_triangular(root, -x[..., None], upper=False)
        whitened = innovation[..., 0]
        density = log_student(whitened, torch.ones_like(whitened)) - root.diagonal(dim1=1, dim2=2).log()
        return x + (gain.mT @ innovation)[..., 0], covariance - gain.mT @ gain, density.sum(1)

    def _attacked(self, x: Tensor, prediction: Prediction) -> tuple[Tensor, Tensor, Tensor]:
        """The state if each number is perturbed: by what it was perturbed before, or by anything in the ball.

        Returns:
            Its mean and covariance, and the probability that perturbations stay.
        """
        d, covariance, cross, past = self.state_dim, prediction.covariance, prediction.cross, prediction.past
        outside = (x.abs() - 1).clamp(min=0) / covariance.diagonal(dim1=1, dim2=2).sqrt()
        doubt = (outside.amax(1) / SURPRISE).clamp(min=1).square()[:, None, None]
        joint = torch.cat([torch.cat([covariance, cross], 2), torch.cat([cross.mT, past], 2)], 1) * doubt
        found: list[Tensor] = []

        def tilted(cavity: Moments) -> Moments:
            (change, here), (change_var, here_var) = (part.tensor_split([d], 1) for part in cavity)
            box = truncated_moments(here, here_var)
            scale = (2 * here_var).sqrt()
            mass = 0.5 * (torch.erf((1 - here) / scale) + torch.erf((1 + here) / scale))
            free = mass.clamp(min=1e-6).log() - math.log(2) + (1 - prediction.held).log()[:, None]
            same = log_student(change, change_var + EXACT**2) + prediction.held.log()[:, None]
            w = torch.sigmoid(same - free)
            found[:] = w, change_var
            variance = (1 - w) * change_var + w * EXACT**2 + w * (1 - w) * change.square()
            return torch.cat([(1 - w) * change, box[0]], 1), torch.cat([variance, box[1]], 1)

        mean, joint = condition(torch.cat([x, -prediction.delta], 1), joint, self.rows, tilted)
        telling = (0.5 / (0.5 + found[1].sqrt())).square()  # a number that is hardly known tells nothing
        share = (found[0] * telling).sum(1) / telling.sum(1)
        held = (1 - MEMORY) * prediction.held + MEMORY * share
        return mean[:, :d], joint[:, :d, :d], held.clamp(*HELD)


def _log_anywhere(x: Tensor, covariance: Tensor) -> Tensor:
    """Log density of an observation that may be anywhere in the ball around the state, ``[N]``."""
    outside = (x.abs() - 1).clamp(min=0) / covariance.diagonal(dim1=1, dim2=2).sqrt()
    return (-math.log(2) - 0.5 * (DOF + 1) * torch.log1p(outside.square() / DOF)).sum(1)


class Surprise:
    """The filter's own detector: raises the alarm where a perturbation is the likelier explanation.

    Args:
        filter: runs before it, as the denoiser of the same defence.
        threshold: of the probability.

    Example:
        >>> filter = PredictCorrect(Dynamics(obs_dim=3, action_dim=2, hidden=8), Budget(0.1))
        >>> filter.reset([0])
        >>> _ = filter.step(torch.full((1, 3), 50.0))
        >>> Surprise(filter).step(torch.full((1, 3), 50.0))[1]
        tensor([True])
    """

    def __init__(self, filter: PredictCorrect, threshold: float = 0.5):
        self.filter, self.threshold, self.obs_dim = filter, threshold, filter.obs_dim

    def reset(self, episodes: Sequence[int]) -> None:
        """Begin new episodes; the memory is the filter's."""

    def restart(self, i: int, episode: int) -> None:
        """Begin a new episode in row i; the memory is the filter's."""

    def step(self, obs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The probability of a perturbation ``[N]``, the alarm ``[N]`` and what was predicted ``[N, obs_dim]``."""
        score = self.filter.perturbed.float()
        return score, score > self.threshold, self.filter.prediction.obs
