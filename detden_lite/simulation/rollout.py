"""N episodes in lockstep, attacked and defended: the loop of figure 2 of the paper."""

import copy
from collections.abc import Sequence
from dataclasses import fields

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from detden_lite.core.arguments import check_between, check_kind
from detden_lite.core.random_streams import RandomStreams
from detden_lite.core.tasks import Task
from detden_lite.core.types import Attack, Defense, Episodes, Timing, World
from detden_lite.simulation import guests
from detden_lite.simulation.fast_simulator import make_simulator
from detden_lite.victims.victim import Victim


@torch.no_grad()
def rollout(
    victim: Victim,
    task: Task,
    seeds: Sequence[int],
    *,
    attack: Attack | None = None,
    timing: Timing | None = None,
    defense: Defense | None = None,
    action_noise: float | np.ndarray | Tensor = 0.0,
    noise_rate: float = 1.0,
    noise_memory: float | np.ndarray | Tensor = 0.0,
    steps: int | None = None,
    progress: str | None = None,
) -> Episodes:
    """Run one episode for each seed, with one call of each network a step for all of them.

    Args:
        victim: the policy.
        task: where it acts.
        seeds: one an episode; they fix the start, and every random number of attack and defence in that episode.
        attack: see ``detden_lite.attacks``; None for clean episodes.
        timing: when to attack; None for always.
        defense: see ``detden_lite.defense``; None for a bare policy. Only one that ``needs`` the truth, an oracle, is
            told it.
        action_noise: standard deviation of Gaussian noise on the actions, in units of half their range; a number, one
            for each episode ``[N]``, or one for each of their actions ``[N, action_dim]``.
        noise_rate: the share of steps that have this noise, drawn for each episode and step.
        noise_memory: for how many steps the noise is correlated: its correlation falls to 1/e over them. A number, or
            one for each episode; 0 for white noise.
        steps: the longest an episode may be; the task's horizon by default.
        progress: text of a progress bar, None for no bar.

    Returns:
        The episodes, step by step; see ``Episodes``.

    Raises:
        ValueError: if the victim is of another task; if a seed, the noise, its rate or the steps are invalid; if
            attack, timing or defence break their contract (``detden_lite.core.types``) before or at the first step; or
            if an action is not finite.

    Example:
        >>> from detden_lite import Budget, OppositeAttack, get_task, load_victim, rollout
        >>> victim, task = load_victim("hopper", "td3"), get_task("hopper")
        >>> attack = OppositeAttack(victim, Budget(task.epsilon))
        >>> rollout(victim, task, range(2), attack=attack, steps=5).returns.shape
        (2,)
    """
    check_kind(Victim, victim=victim)
    check_kind(Task, task=task)
    task.check_fits(victim.obs_dim, victim.action_dim)
    guests.check_seeds(seeds)
    guests.check_horizon(steps)
    guests.check_guests(attack, timing, defense)
    check_between(0, 1, noise_rate=noise_rate)
    noise_size = guests.check_noise(action_noise, len(seeds), task.action_dim)
    kept = torch.exp(-1 / guests.check_noise(noise_memory, len(seeds), 1, "noise_memory"))  # exp(-1 / 0) is 0
    renewed = (1 - kept.square()).sqrt()  # so that correlated noise is as large as white noise
    simulator = make_simulator(task.env_id, seeds)
    n = len(seeds)
    for guest in (attack, timing, defense):
        if guest is not None:
            guest.reset(simulator.seeds)
    needs = attack.needs if attack is not None else frozenset()
    reveal = getattr(defense, "reveal") if "truth" in getattr(defense, "needs", ()) else None  # noqa: B009 an oracle's
    exploration, coloured = RandomStreams(1, simulator.seeds), None
    half_range = (victim.action_high - victim.action_low) / 2

    unchecked = attack is not None
    nothing, everyone = torch.zeros(n, dtype=torch.bool), torch.ones(n, dtype=torch.bool)
    no_score = torch.zeros(n)
    history: dict[str, list] = {f.name: [] for f in fields(Episodes)[1:]}
    obs, action = simulator.reset(), None
    for step in tqdm(range(steps or task.horizon), desc=progress, disable=progress is None, unit="step", leave=False):
        true = torch.from_numpy(obs)
        row = dict(mask=simulator.alive.copy(), state=simulator.state().astype(np.float32), obs=obs)
        attacked, perturbed = nothing, true
        if attack is not None:
            attacked = everyone if timing is None else timing(true)
            if step == 0:
                guests.check_timing(attacked, n)
            world = World(
                attacked.numpy() & simulator.alive,
                simulator if "simulator" in needs else None,
                copy.deepcopy(defense) if "defense" in needs else None,
                action,
            )
            found = attack(true, world)
            if unchecked:  # until there is a row that it attacks, nothing says whether it stays in its ball
                guests.check_perturbed(attack, found, true, attacked)
                unchecked = not attacked.any()
            perturbed = torch.where(attacked[:, None], found, true)
        shown, alarm, score, denoised = perturbed, nothing, no_score, perturbed
        if defense is not None:
            if reveal is not None:
                reveal(true, attacked)
            verdict = defense(perturbed, action)
            if step == 0:
                guests.check_verdict(verdict, perturbed)
            shown, alarm, score, denoised = verdict.obs, verdict.alarm, verdict.score, verdict.denoised
        action = victim(shown)
        if noise_size.any():
            white = exploration.normal(*action.shape)
            coloured = white if coloured is None else kept * coloured + renewed * white
            noise = noise_size * half_range * coloured
            if noise_rate < 1:
                noise *= exploration.uniform(n, 1) < noise_rate
            action = (action + noise).clamp(victim.action_low, victim.action_high)
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
