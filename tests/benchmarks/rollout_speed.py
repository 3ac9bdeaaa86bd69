"""Environment steps a second on one thread: episodes in lockstep against one at a time, with the same networks.

Clean, and under PGD-20 with the defence; then where the time goes. Run by ``make bench``.
"""

import time

import numpy as np
import torch

from detden_lite import artifacts
from detden_lite.attacks import OppositeAttack
from detden_lite.budget import Budget
from detden_lite.rollout import rollout
from detden_lite.simulator import Simulator
from detden_lite.tasks import get_task

torch.set_num_threads(1)
TASK, N = get_task("hopper"), 128
VICTIM = artifacts.load_victim("hopper", "td3")
DEFENSE = artifacts.load_defense("hopper", "td3")
ATTACK = OppositeAttack(VICTIM, Budget(TASK.epsilon), steps=20)


def speed(n: int, **parts) -> float:
    """Steps a second of n episodes in lockstep, whole ones; a single episode is cut short, to end in time."""
    start = time.perf_counter()
    episodes = rollout(VICTIM, TASK, range(n), steps=TASK.horizon if n > 1 else 300, **parts)
    return episodes.lengths.sum() / (time.perf_counter() - start)


def shares() -> dict[str, float]:
    """Seconds of one step of N episodes, by what they are spent on."""
    simulator = Simulator(TASK.env_id, range(N))
    obs = torch.from_numpy(simulator.reset())
    ATTACK.reset(range(N))
    DEFENSE.reset(range(N))
    action = VICTIM(obs).numpy()
    works = dict(physics=lambda: simulator.step(action), attack=lambda: ATTACK(obs), defence=lambda: DEFENSE(obs))
    seconds = {}
    for name, work in works.items():
        times = []
        for _ in range(10):
            start = time.perf_counter()
            work()
            times.append(time.perf_counter() - start)
        seconds[name] = float(np.median(times))
    return seconds


if __name__ == "__main__":
    for title, parts in (("clean", {}), ("PGD-20 + defence", dict(attack=ATTACK, defense=DEFENSE))):
        rounds = [(speed(N, **parts), speed(1, **parts)) for _ in range(2)]  # interleaved
        together, alone = np.median(rounds, axis=0)
        ratio = f"{together / alone:.1f} times"
        print(f"{title:<17} {together:7,.0f} steps/s at N = {N}, {alone:6,.0f} one at a time: {ratio}")
    parts = shares()
    total = sum(parts.values())
    print("one defended step: " + ", ".join(f"{name} {s / total:.0%}" for name, s in parts.items()))
