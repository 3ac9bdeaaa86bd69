"""N episodes in lockstep, attacked and defended: the loop in which everything meets (figure 2 of the paper)."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from detden_lite.attacks.timing import Always
from detden_lite.draws import Draws
from detden_lite.fast_simulator import make_simulator
from detden_lite.simulator import Simulator
from detden_lite.tasks import Task
from detden_lite.victims import Victim


@dataclass(frozen=True)
class Episodes:
    """What happened in N episodes. Arrays are ``[steps, N, ...]``; what is not ``mask`` came after an episode's end."""

    seeds: np.ndarray  # [N]
    mask: np.ndarray  # the episode was still going when this step began, bool
    state: np.ndarray  # qpos and qvel before the action, [steps, N, nq + nv] float32
    obs: np.ndarray  # the true observation o
    perturbed: np.ndarray  # what the attacker made of it; o itself where not attacked
    denoised: np.ndarray  # what the denoiser made of that; the perturbed observation without a defence
    shown: np.ndarray  # what the policy saw
    action: np.ndarray  # what it did, [steps, N, action_dim]
    reward: np.ndarray  # [steps, N] float64
    attacked: np.ndarray  # 1_vul, bool
    alarm: np.ndarray  # 1_anomaly, bool
    score: np.ndarray  # the detector's score; 0 without a defence

    @property
    def returns(self) -> np.ndarray:
        """Undiscounted return of each episode, ``[N]``."""
        return (self.reward * self.mask).sum(0)

    @property
    def lengths(self) -> np.ndarray:
        """Steps of each episode, ``[N]``."""
        return self.mask.sum(0)

    def select(self, index: Sequence[int]) -> "Episodes":
        """The episodes at these positions."""
        index = np.asarray(index)
        return Episodes(self.seeds[index], *(getattr(self, f.name)[:, index] for f in fields(self)[1:]))


@dataclass(frozen=True)
class World:
    """What an attack may see beside the observation, according to its ``needs``; what it does not need is None."""

    wanted: np.ndarray  # whose perturbed observation will be used, [N] bool; the others' may be anything
    simulator: Simulator | None = None
    defense: Any = None  # a copy, with the defence's memory as it is before this observation


@torch.no_grad()
def rollout(
    victim: Victim,
    task: Task,
    seeds: Sequence[int],
    *,
    attack=None,
    timing=None,
    defense=None,
    action_noise: float | np.ndarray = 0.0,
    steps: int | None = None,
    progress: str | None = None,
) -> Episodes:
    """Run one episode for each seed, with one call of each network a step for all of them.

    Args:
        victim: the policy.
        task: where it acts.
        seeds: one an episode; they fix the start, and every random number of attack and defence in that episode.
        attack: see ``detden_lite.attacks``; None for clean episodes.
        timing: when to attack; always by default.
        defense: see ``detden_lite.defense``; None for a bare policy. Only one that ``needs`` the truth, an oracle, is
            told it.
        action_noise: standard deviation of Gaussian noise on the actions, in units of half their range; a number, one
            for each episode ``[N]``, or one for each of their actions ``[N, action_dim]``.
        steps: the longest an episode may be; the task's horizon by default.
        progress: text of a progress bar, None for no bar.

    Raises:
        ValueError: if the victim is of another task, or an action is not finite.
    """
    if (victim.obs_dim, victim.action_dim) != (task.obs_dim, task.action_dim):
        raise ValueError(
            f"victim: it maps {victim.obs_dim} observations to {victim.action_dim} actions, "
            f"but {task.env_id} has {task.obs_dim} and {task.action_dim}; give the victim of this task"
        )
    simulator = make_simulator(task.env_id, seeds)
    n = len(seeds)
    timing = timing or Always()
    for part in (attack, timing, defense):
        if part is not None:
            part.reset(simulator.seeds)
    needs = attack.needs if attack is not None else frozenset()
    exploration = Draws(1, simulator.seeds)
    noise_size = torch.as_tensor(action_noise, dtype=torch.float32)
    noise_size = noise_size if noise_size.ndim == 2 else noise_size.reshape(-1, 1)
    half_range = (victim.action_high - victim.action_low) / 2

    nothing = torch.zeros(n, dtype=torch.bool)
    no_score = torch.zeros(n)
    history: dict[str, list] = {f.name: [] for f in fields(Episodes)[1:]}
    obs = simulator.reset()
    for _ in tqdm(range(steps or task.horizon), desc=progress, disable=progress is None, unit="step", leave=False):
        true = torch.from_numpy(obs)
        row = dict(mask=simulator.alive.copy(), state=simulator.state().astype(np.float32), obs=obs)
        attacked, perturbed = nothing, true
        if attack is not None:
            attacked = timing(true)
            world = World(
                attacked.numpy() & simulator.alive,
                simulator if "simulator" in needs else None,
                copy.deepcopy(defense) if "defense" in needs else None,
            )
            perturbed = torch.where(attacked[:, None], attack(true, world), true)
        shown, alarm, score, denoised = perturbed, nothing, no_score, perturbed
        if defense is not None:
            if "truth" in getattr(defense, "needs", ()):
                defense.reveal(true, attacked)
            verdict = defense(perturbed)
            shown, alarm, score, denoised = verdict.obs, verdict.alarm, verdict.score, verdict.denoised
        action = victim(shown)
        if noise_size.any():
            noisy = action + noise_size * half_range * exploration.normal(*action.shape)
            action = noisy.clamp(victim.action_low, victim.action_high)
        if not torch.isfinite(action).all():  # MuJoCo itself would only write a warning and go on
            raise ValueError("an action is NaN or infinite: look for the first such number in what the policy saw")
        obs, reward, _ = simulator.step(action.numpy())
        tensors = dict(
            perturbed=perturbed, denoised=denoised, shown=shown, action=action,
            attacked=attacked, alarm=alarm, score=score,
        )  # fmt: skip
        row |= {name: tensor.numpy() for name, tensor in tensors.items()} | dict(reward=reward)
        for name, value in row.items():
            history[name].append(value)
        if not simulator.alive.any():
            break
    return Episodes(seeds=np.array(simulator.seeds), **{name: np.stack(rows) for name, rows in history.items()})
