"""Training the model of how the robot moves, on D_normal with its actions."""

import math
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from detden_lite.core.arguments import check_positive, check_whole
from detden_lite.core.random_streams import derived_seed
from detden_lite.core.types import Trajectories
from detden_lite.defense.dynamics import Dynamics
from detden_lite.defense.gruvae import LEAST_STD
from detden_lite.training.torch_checkpoint import Parts, resume, save_checkpoint

LEAST_CHANGE = 1e-4  # of an observation in one step, in raw units
SEGMENT = 1_000  # gradient steps between two checkpoints


@dataclass(frozen=True)
class DynamicsRecipe:
    """How the model is trained.

    Contacts make a robot's changes heavy-tailed, so that the loss is the negative log-likelihood of Student's t with 4
    degrees of freedom, whose scale the network predicts. The learning rate falls along half a cosine to zero.

    Args:
        hidden: units of a layer.
        steps: gradient steps.
        batch: transitions of a step.
        learning_rate: of Adam, at the beginning.

    Raises:
        ValueError: for a number that is not above 0.

    Example:
        >>> DynamicsRecipe(steps=100).batch
        1024
    """

    hidden: int = 256
    steps: int = 120_000
    batch: int = 1_024
    learning_rate: float = 2e-3

    def __post_init__(self) -> None:
        check_whole(1, hidden=self.hidden, steps=self.steps, batch=self.batch)
        check_positive(learning_rate=self.learning_rate)


def train_dynamics(
    recipe: DynamicsRecipe, normal: Trajectories, seed: int, state_dim: int | None = None,
    checkpoint: Path | None = None, device: str = "cpu", label: str = "dynamics",
) -> Dynamics:  # fmt: skip
    """Fit f to all transitions of clean episodes.

    Every segment of 1,000 steps seeds torch by (seed, segment), so that a resumed run equals one that never stopped.

    Args:
        recipe: the hyperparameters.
        normal: D_normal, with its actions.
        seed: of initialisation and order.
        state_dim: see ``Dynamics``.
        checkpoint: file to write after every segment and to resume from; None for neither.
        device: where torch computes.
        label: text of the progress bar.

    Returns:
        The trained model, frozen, on the CPU.

    Raises:
        ValueError: if the trajectories have no actions, no transition or numbers that are not finite, or the
            checkpoint is of another recipe or seed.
        ArtifactError: if the checkpoint is damaged.

    Example:
        >>> import numpy as np
        >>> swing = np.sin(np.arange(60, dtype=np.float32)).reshape(4, 5, 3)
        >>> normal = Trajectories(swing, np.array([5, 5, 4, 3]), action=swing[..., :2])
        >>> train_dynamics(DynamicsRecipe(hidden=8, steps=5, batch=4), normal, seed=0).obs_dim
        3
    """
    obs, action, now = _transitions(normal)
    torch.manual_seed(seed)
    model = Dynamics(obs.shape[1], action.shape[1], state_dim, recipe.hidden)
    seen, first = obs[torch.from_numpy(normal.mask).flatten()], torch.from_numpy(normal.obs[:, 0])
    model.set_statistics(seen.mean(0), seen.std(0))
    change = obs[now + 1] - obs[now]
    change[:, model.state_dim :] = obs[now + 1][:, model.state_dim :]
    model.change_std.copy_(change.std(0).clamp(min=LEAST_CHANGE))
    model.change_std[model.state_dim :].clamp_(min=LEAST_STD)
    model.first_mean.copy_(first.mean(0))
    model.first_std.copy_(first.std(0) if len(first) > 1 else first[0].abs() * 0.1)
    del seen, change
    model.to(device)
    optimizer = torch.optim.Adam(model.parameters(), lr=recipe.learning_rate)
    parts: Parts = dict(model=model, optimizer=optimizer)
    identity = dict(asdict(recipe), seed=seed)
    begun = resume(checkpoint, identity, {}, parts) if checkpoint else 0
    segments = math.ceil(recipe.steps / SEGMENT)
    for segment in (bar := tqdm(range(begun, segments), initial=begun, total=segments, desc=label, unit="k steps")):
        torch.manual_seed(derived_seed(seed, segment))
        for step in range(segment * SEGMENT, min((segment + 1) * SEGMENT, recipe.steps)):
            optimizer.param_groups[0]["lr"] = recipe.learning_rate * (1 + math.cos(math.pi * step / recipe.steps)) / 2
            i = now[torch.randint(len(now), (recipe.batch,))]
            loss = surprise(model, obs[i].to(device), action[i].to(device), obs[i + 1].to(device)).mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
        bar.set_postfix(loss=f"{loss.item():.3f}")
        if checkpoint:
            save_checkpoint(checkpoint, identity, segment + 1, parts)
    return model.cpu().requires_grad_(False).eval()


@torch.no_grad()
def one_step_errors(model: Dynamics, clean: Trajectories, most: int = 100_000) -> np.ndarray:
    """How far predictions are from what came, ``[transitions, obs_dim]`` in raw units, of at most so many."""
    obs, action, now = _transitions(clean)
    some = now[:: len(now) // most + 1]
    (state, _), (sensors, _) = model(obs[some, : model.state_dim], action[some])
    return (torch.cat([state, sensors], 1) - obs[some + 1]).abs().numpy()


def surprise(model: Dynamics, obs: Tensor, action: Tensor, following: Tensor) -> Tensor:
    """-log p(o_{t+1} | o_t, a_t) up to a constant, in units of ``model.change_std``, ``[N, obs_dim]``."""
    (state, state_std), (sensors, sensor_std) = model(obs[:, : model.state_dim], action)
    mean, std = torch.cat([state, sensors], -1), torch.cat([state_std, sensor_std], -1)
    return 2.5 * torch.log1p(((following - mean) / std).square() / 4) + (std / model.change_std).log()


def _transitions(normal: Trajectories) -> tuple[Tensor, Tensor, Tensor]:
    """All observations and actions ``[episodes * steps, ...]``, and the positions that another one follows."""
    if normal.action is None:
        raise ValueError("normal: the trajectories have no actions; collect them anew with collect_normal")
    mask = torch.from_numpy(normal.mask)
    follows = torch.nn.functional.pad(mask[:, 1:], (0, 1))
    obs, action = (torch.from_numpy(part).flatten(0, 1) for part in (normal.obs, normal.action))
    now = follows.flatten().nonzero()[:, 0]
    if not len(now):
        raise ValueError("normal: no episode has two steps; collect longer ones")
    if not (torch.isfinite(obs).all() and torch.isfinite(action).all()):
        raise ValueError("normal: an observation or action is NaN or infinite; collect the trajectories anew")
    return obs, action, now
