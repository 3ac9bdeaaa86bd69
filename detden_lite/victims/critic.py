"""Learning the Q-function that a PPO agent lacks, from clean episodes of its own (section 2.2 of the paper)."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn
from tqdm import tqdm

from detden_lite.core.arguments import check_between, check_positive, check_whole
from detden_lite.core.networks import mlp
from detden_lite.core.tasks import Task
from detden_lite.core.types import Episodes
from detden_lite.victims.victim import Victim


@dataclass(frozen=True)
class QRecipe:
    """How Q is learned: single explored steps, and regression on what came of them until the next one.

    ``noise`` is as large as what attacks do to actions: Q is right about no others. ``gamma`` is below the 0.99 of a
    training: what one action does in the next twenty steps can be learned, and what it does in the next hundred hardly.

    Example:
        >>> from detden_lite import get_task
        >>> QRecipe(net=64).sizes(get_task("hopper"))
        [14, 64, 64, 1]
    """

    episodes: int = 256
    noise: float = 0.8  # of an explored action, a standard deviation, in units of half the action range
    noise_rate: float = 0.1  # the share of explored steps
    weight: float = 5.0  # of an explored step in the loss, where another has 1
    net: int = 256
    epochs: int = 12
    batch: int = 512
    learning_rate: float = 2e-3  # falls to zero along half a cosine
    gamma: float = 0.95
    judged: int = 64  # episodes in which the effects of actions are measured

    def __post_init__(self) -> None:
        check_whole(1, episodes=self.episodes, net=self.net, epochs=self.epochs, batch=self.batch, judged=self.judged)
        check_positive(noise=self.noise, noise_rate=self.noise_rate, weight=self.weight)
        check_positive(learning_rate=self.learning_rate)
        check_between(0, 1, gamma=self.gamma, noise_rate=self.noise_rate)

    def sizes(self, task: Task) -> list[int]:
        """Layer sizes of the network, for ``mlp`` and ``Victim.with_critic``."""
        return [task.obs_dim + task.action_dim, self.net, self.net, 1]


def learn_q(
    victim: Victim, task: Task, recipe: QRecipe, episodes: Episodes, horizon: int | None = None, seed: int = 0
) -> nn.Sequential:
    """Learn Q(o, a) of a policy without noise, from clean episodes with an explored step now and then.

    Args:
        victim: the policy.
        task: where it acts.
        recipe: the hyperparameters.
        episodes: ``rollout(..., action_noise=recipe.noise, noise_rate=recipe.noise_rate)``.
        horizon: the step at which these episodes were cut off; the task's by default.
        seed: of initialisation and order.

    Returns:
        The network, for ``Victim.with_critic``.

    Raises:
        ValueError: if gamma is 1, or no step of the episodes was explored.
    """
    if recipe.gamma == 1:
        raise ValueError("gamma must be below 1 to learn Q, whose scale is 1 / (1 - gamma)")
    mask = episodes.mask
    obs, action = torch.from_numpy(episodes.obs[mask]), torch.from_numpy(episodes.action[mask])
    own = victim(obs)
    far = ((action - own).abs() > 1e-4 * (victim.action_high - victim.action_low)).any(-1)
    if not far.any():
        raise ValueError("episodes: no action was explored; roll them out with the recipe's noise and noise_rate")
    explored = np.zeros_like(mask)
    explored[mask] = far.numpy()
    cut_off = episodes.lengths == (horizon or task.horizon)
    scale = float(np.abs(episodes.reward[mask]).mean()) / (1 - recipe.gamma)

    torch.manual_seed(seed)
    net = mlp(recipe.sizes(task))
    inputs, quiet = victim.critic_input(obs, action), victim.critic_input(obs, own)
    weights = torch.where(far, recipe.weight, 1.0)
    weights /= weights.mean()
    optimizer = torch.optim.Adam(net.parameters(), lr=recipe.learning_rate)
    batches = -(-len(inputs) // recipe.batch)
    falling = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, recipe.epochs * batches)
    value = np.zeros_like(episodes.reward)
    with tqdm(range(recipe.epochs), desc=f"Q-function of {task.name}", unit="epoch") as bar:
        for _ in bar:
            value[mask] = _evaluate(net, quiet).numpy()
            found = explored_returns(episodes.reward / scale, value, explored, mask, cut_off, recipe.gamma)
            targets = torch.from_numpy(found[mask].astype(np.float32))
            total = 0.0
            for rows in torch.randperm(len(inputs)).split(recipe.batch):
                loss = ((net(inputs[rows]).squeeze(-1) - targets[rows]).square() * weights[rows]).mean()
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()
                falling.step()
                total += loss.item()
            bar.set_postfix(loss=f"{total / batches:.4f}")
    with torch.no_grad():
        for parameter in net[-1].parameters():
            parameter.mul_(scale)
    return net.requires_grad_(False)


def explored_returns(
    reward: np.ndarray, value: np.ndarray, explored: np.ndarray, mask: np.ndarray, cut_off: np.ndarray, gamma: float
) -> np.ndarray:
    """Targets of Q, ``[steps, N]``: the discounted return up to the next explored step, and V(o) = Q(o, pi(o)) there.

    So the policy has done all that a target contains, except for the action whose target it is. After a fall the
    return is 0. An episode that was cut off is continued with its last value.

    Args:
        reward: ``[steps, N]``.
        value: V of each observation, ``[steps, N]``.
        explored: the action was another than the policy's, ``[steps, N]``.
        mask: the episode was still going, ``[steps, N]``.
        cut_off: the episode would have gone on, ``[N]``.
        gamma: the discount factor.
    """
    targets = np.zeros_like(reward)
    following = np.where(cut_off, value[-1], 0.0)
    for t in reversed(range(len(reward))):
        targets[t] = mask[t] * (reward[t] + gamma * following)
        following = mask[t] * np.where(explored[t], value[t], targets[t])
    return targets


@torch.no_grad()
def _evaluate(net: nn.Module, inputs: Tensor) -> Tensor:
    return torch.cat([net(rows).squeeze(-1) for rows in inputs.split(4_096)])
