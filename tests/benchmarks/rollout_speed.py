"""Environment steps a second on one thread: clean episodes in lockstep against one at a time, with the same policy.

Then where the time of an attacked and defended step goes and what bounds it; then, for four tasks, clean episodes as a
share of bare physics, with gymnasium's own loop and with the fast simulator. Attacked and defended episodes have a
benchmark of their own, ``defended_speed.py``. Run by ``make bench``. All times are CPU times, so that other programs on
the machine disturb less; what is compared is measured in turns.
"""

from collections.abc import Callable
from time import process_time

import gymnasium
import mujoco
import numpy as np
import torch

from detden_lite.attacks.opposite import OppositeAttack
from detden_lite.core.budget import Budget
from detden_lite.core.tasks import Task, get_task
from detden_lite.core.types import Episodes
from detden_lite.simulation import rollout as rollout_module
from detden_lite.simulation.fast_simulator import make_simulator
from detden_lite.simulation.rollout import rollout
from detden_lite.simulation.simulator import Simulator
from detden_lite.store import models

torch.set_num_threads(1)
TASK, STEPS, N = get_task("hopper"), 200, 128
VICTIM = models.load_victim("hopper", "td3")
DEFENSE = models.load_defense("hopper", "td3")
ATTACK = OppositeAttack(VICTIM, Budget(TASK.epsilon), steps=20)
ROUNDS = 3


def lockstep() -> float:
    """Steps a second of N episodes with one call of the policy a step."""
    start = process_time()
    episodes = rollout(VICTIM, TASK, range(N), steps=STEPS)
    return episodes.lengths.sum() / (process_time() - start)


@torch.no_grad()
def one_at_a_time() -> float:
    """Steps a second of one episode, in the loop that everybody writes first."""
    env = gymnasium.make(TASK.env_id)
    start = process_time()
    obs, _ = env.reset(seed=0)
    for step in range(STEPS):  # noqa: B007
        seen = torch.tensor(obs[None], dtype=torch.float32)
        obs, _, terminated, _, _ = env.step(VICTIM(seen)[0].numpy())
        if terminated:
            break
    return (step + 1) / (process_time() - start)


def median(work: Callable[[], object], repetitions: int = 15) -> float:
    """Seconds of one call."""
    times = []
    for _ in range(repetitions):
        start = process_time()
        work()
        times.append(process_time() - start)
    return float(np.median(times))


def where_the_time_goes() -> None:
    """One step of N attacked and defended episodes, and the least that its two large parts can take."""
    simulator = make_simulator(TASK.env_id, range(N))
    obs = torch.from_numpy(simulator.reset())
    for part in (ATTACK, DEFENSE):
        part.reset(range(N))
    action = VICTIM(obs).numpy()
    worlds = [(env.model, env.data, env.frame_skip) for env in simulator.envs]
    weights = [layer.weight for layer in VICTIM.actor if isinstance(layer, torch.nn.Linear)]
    hidden = [torch.randn(N, weight.shape[1]) for weight in weights]
    errors = [torch.randn(N, weight.shape[0]) for weight in weights]

    def bare_physics() -> None:
        for model, data, frame_skip in worlds:
            mujoco.mj_step(model, data, nstep=frame_skip)

    def bare_products() -> None:
        """The matrix products of one gradient step, there and back."""
        for h, e, weight in zip(hidden, errors, weights, strict=True):
            h @ weight.T, e @ weight  # noqa: B018

    attack, defense = median(lambda: ATTACK(obs)), median(lambda: DEFENSE(obs))
    physics = median(lambda: simulator.step(action))
    simulator.reset()
    bounds = dict(physics=median(bare_physics), attack=ATTACK.steps * median(bare_products, 100))
    total = physics + attack + defense
    print(f"a step of {N}: physics {physics / total:.0%}, attack {attack / total:.0%}, defence {defense / total:.0%}")
    print(
        f"bounds: MuJoCo alone takes {bounds['physics'] / physics:.0%} of the physics, and the actor's matrix products "
        f"{bounds['attack'] / attack:.0%} of the attack; with nothing else, {N / sum(bounds.values()):,.0f} steps/s"
    )


def replay(task: Task, episodes: Episodes) -> float:
    """Steps a second of MuJoCo alone, in the same worlds with the same actions."""
    simulator = make_simulator(task.env_id, episodes.seeds)
    simulator.reset()
    worlds = [(env.model, env.data, env.data.ctrl, env.frame_skip) for env in simulator.envs]
    start = process_time()
    for actions, mask in zip(episodes.action, episodes.mask.tolist(), strict=True):
        for (model, data, control, frame_skip), action, alive in zip(worlds, actions, mask, strict=True):
            if alive:
                control[:] = action
                mujoco.mj_step(model, data, frame_skip)
    return episodes.mask.sum() / (process_time() - start)


def share_of_physics(name: str, steps: int) -> None:
    """Clean episodes with either simulator against MuJoCo alone."""
    task, victim = get_task(name), models.load_victim(name, "td3")
    rounds = []
    for _ in range(ROUNDS):
        speeds = []
        for kind in (Simulator, make_simulator):
            rollout_module.make_simulator = kind
            start = process_time()
            episodes = rollout(victim, task, range(N), steps=steps)
            speeds.append(episodes.mask.sum() / (process_time() - start))
        rounds.append((*speeds, replay(task, episodes)))
    before, after, bare = np.median(rounds, axis=0)
    shares = np.median(np.array(rounds)[:, :2] / np.array(rounds)[:, 2:], axis=0)
    print(
        f"{name:<12}{bare:8,.0f} steps/s of MuJoCo alone; clean episodes {before:,.0f} ({shares[0]:.0%}) with "
        f"gymnasium's loop, {after:,.0f} ({shares[1]:.0%}) with the fast simulator"
    )


if __name__ == "__main__":
    rounds = np.array([(lockstep(), one_at_a_time()) for _ in range(ROUNDS)])
    together, alone = np.median(rounds, axis=0)
    ratio = np.median(rounds[:, 0] / rounds[:, 1])
    print(f"clean: {together:,.0f} steps/s at N = {N}, {alone:,.0f} one at a time: {ratio:.1f} times as fast")
    where_the_time_goes()
    for name, steps in (("hopper", 300), ("halfcheetah", 300), ("ant", 100), ("humanoid", 100)):
        share_of_physics(name, steps)
