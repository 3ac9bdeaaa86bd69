"""Learning the Q-function that a PPO agent lacks, from clean episodes of its own (section 2.2 of the paper)."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor, nn
from tqdm import tqdm

from detden_lite.core.arguments import check_between, check_positive, check_whole
from detden_lite.core.networks import mlp
from detden_lite.core.tasks import Task
from detden_lite.core.types import Episodes
from detden_lite.victims.victim import Victim

SETTLED = 300  # steps: later rewards have a weight of less than 0.99 ** 300 = 0.05 in a discounted return


@dataclass(frozen=True)
class QRecipe:
    """How Q is learned: regression on TD(lambda) targets, which are made anew from Q itself before every epoch.

    Example:
        >>> from detden_lite import get_task
        >>> QRecipe(net=64).sizes(get_task("hopper"))
        [14, 64, 64, 1]
    """

    episodes: int = 256
    net: int = 256
    epochs: int = 30
    batch: int = 1_024
    learning_rate: float = 1e-3  # falls to zero along half a cosine
    gamma: float = 0.99
    lam: float = 0.9

    def __post_init__(self) -> None:
        check_whole(2, episodes=self.episodes)  # one to learn from and one to hold out
        check_whole(1, net=self.net, epochs=self.epochs, batch=self.batch)
        check_positive(learning_rate=self.learning_rate)
        check_between(0, 1, gamma=self.gamma, lam=self.lam)

    def sizes(self, task: Task) -> list[int]:
        """Layer sizes of the network, for ``mlp`` and ``Victim.with_critic``."""
        return [task.obs_dim + task.action_dim, self.net, self.net, 1]


@dataclass(frozen=True)
class Fit:
    """How well Q predicts the discounted returns of held-out episodes.

    ``explained_variance`` is 1 for a perfect prediction and 0 for a constant. ``action_correlation`` is that of
    Q(o, a) - Q(o, pi(o)) with what a step of exploration gained or cost: above 0, Q knows which actions are worse.

    Example:
        >>> Fit(explained_variance=0.9, action_correlation=0.4, steps=1_000, episodes=8).action_correlation > 0.1
        True
    """

    explained_variance: float
    action_correlation: float
    steps: int
    episodes: int


def policy_noise(victim: Victim) -> np.ndarray:
    """The spread of a Gaussian policy's actions as exploration noise for ``rollout``, ``[1, action_dim]``.

    Raises:
        ValueError: if the policy is deterministic.
    """
    if victim.action_std is None:
        raise ValueError("victim: its policy is deterministic and does not explore; TD3 has critics of its own")
    return (2 * victim.action_std / (victim.action_high - victim.action_low)).reshape(1, -1).numpy()


def learn_q(
    victim: Victim, task: Task, recipe: QRecipe, episodes: Episodes, horizon: int | None = None, seed: int = 0
) -> tuple[nn.Sequential, Fit]:
    """Learn Q(o, a) of a Gaussian policy from clean on-policy episodes; one in eight is held out for the fit.

    Args:
        victim: a Gaussian policy.
        task: where it acts.
        recipe: the hyperparameters.
        episodes: clean ones with the noise of ``policy_noise``: without the spread of the policy's own samples,
            a ~ N(pi(o), Sigma), Q could not know what an action does.
        horizon: the step at which these episodes were cut off; the task's by default.
        seed: of initialisation and order.

    Returns:
        The network, for ``Victim.with_critic``, and its fit.

    Raises:
        ValueError: if the victim's policy is deterministic, or there are fewer than two episodes.
    """
    policy_noise(victim)  # refuses a deterministic policy
    if recipe.gamma == 1:
        raise ValueError("gamma must be below 1 to learn Q, whose scale is 1 / (1 - gamma)")
    if len(episodes.seeds) < 2:
        raise ValueError("episodes: at least two are needed, one to learn from and one to hold out")
    horizon = horizon or task.horizon
    held_out = np.arange(len(episodes.seeds)) % 8 == 1
    learned, kept = episodes.select(np.flatnonzero(~held_out)), episodes.select(np.flatnonzero(held_out))

    torch.manual_seed(seed)
    net = mlp(recipe.sizes(task))
    inputs, mask = _inputs(victim, learned), torch.from_numpy(learned.mask)
    known = inputs[mask]
    scale = float(np.abs(learned.reward[learned.mask]).mean()) / (1 - recipe.gamma)
    optimizer = torch.optim.Adam(net.parameters(), lr=recipe.learning_rate)
    batches = -(-len(known) // recipe.batch)
    falling = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, recipe.epochs * batches)
    with tqdm(range(recipe.epochs), desc=f"Q-function of {task.name}", unit="epoch") as bar:
        for _ in bar:
            q = _evaluate(net, inputs).numpy()
            returns = lambda_returns(learned.reward / scale, q, learned.mask, horizon, recipe)
            targets = torch.from_numpy(returns.astype(np.float32))[mask]
            total = 0.0
            for rows in torch.randperm(len(known)).split(recipe.batch):
                loss = (net(known[rows]).squeeze(-1) - targets[rows]).square().mean()
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()
                falling.step()
                total += loss.item()
            bar.set_postfix(loss=f"{total / batches:.4f}")
    with torch.no_grad():
        for parameter in net[-1].parameters():
            parameter.mul_(scale)
    return net.requires_grad_(False), fit(net, victim, kept, horizon, recipe)


def lambda_returns(reward: np.ndarray, q: np.ndarray, mask: np.ndarray, horizon: int, recipe: QRecipe) -> np.ndarray:
    """TD(lambda) targets of Q, ``[steps, N]``: G_t = r_t + gamma ((1 - lambda) Q_{t+1} + lambda G_{t+1}).

    After a fall the return is 0. An episode that was cut off at the horizon is continued with its last Q.

    Args:
        reward: ``[steps, N]``.
        q: Q of the observation and action of each step, ``[steps, N]``.
        mask: the episode was still going, ``[steps, N]``.
        horizon: the step at which episodes are cut off.
        recipe: gamma and lambda.
    """
    targets = np.zeros_like(reward)
    cut_off = mask.sum(0) == horizon
    following = bootstrap = np.where(cut_off, q[-1], 0.0)
    for t in reversed(range(len(reward))):
        targets[t] = reward[t] + recipe.gamma * ((1 - recipe.lam) * bootstrap + recipe.lam * following)
        targets[t] *= mask[t]
        following, bootstrap = np.where(mask[t], targets[t], 0.0), np.where(mask[t], q[t], 0.0)
    return targets


def fit(net: nn.Module, victim: Victim, episodes: Episodes, horizon: int, recipe: QRecipe) -> Fit:
    """Compare Q with the discounted returns that followed, where they are known: not shortly before the cut-off.

    After the cut-off the last Q replaces the rest, which has little weight. Without it all returns would depend on the
    time that is left, which an observation does not show.
    """
    q, quiet = (_evaluate(net, _inputs(victim, episodes, explored)).numpy() for explored in (True, False))
    returns = lambda_returns(episodes.reward, q, episodes.mask, horizon, replace(recipe, lam=1.0))
    ends_in_a_fall = episodes.lengths < horizon
    left = horizon - np.arange(len(returns))[:, None]
    usable = episodes.mask & (ends_in_a_fall | (left > min(SETTLED, horizon // 2)))
    q, quiet, found = q[usable], quiet[usable], returns[usable]
    predicted, gained = q - quiet, found - quiet
    varied = predicted.std() > 0 and gained.std() > 0
    return Fit(
        explained_variance=float(1 - np.var(found - q) / np.var(found)) if np.var(found) > 0 else 0.0,
        action_correlation=float(np.corrcoef(predicted, gained)[0, 1]) if varied else 0.0,
        steps=int(usable.sum()),
        episodes=len(episodes.seeds),
    )


def _inputs(victim: Victim, episodes: Episodes, explored: bool = True) -> Tensor:
    obs = torch.from_numpy(episodes.obs)
    action = torch.from_numpy(episodes.action) if explored else victim(obs)
    return victim.critic_input(obs, action)


@torch.no_grad()
def _evaluate(net: nn.Module, inputs: Tensor) -> Tensor:
    return torch.stack([net(row).squeeze(-1) for row in inputs])
