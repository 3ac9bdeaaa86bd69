"""Environment steps a second under PGD-20 with the defence: lockstep against the loop of the paper's released code.

That loop has one environment and calls each network once a step, with autograd for the attack. Networks are of the
paper's sizes, untrained: they stand for what they cost. So that nobody falls and all do the same work, the ball is next
to nothing and the denoiser hands on what it is given. Run by ``make bench``. CPU times on one thread, measured in
turns; two processes against one by the clock on the wall.
"""

from concurrent.futures import ProcessPoolExecutor
from functools import cache
from multiprocessing import get_context
from time import perf_counter, process_time

import gymnasium
import numpy as np
import torch

from detden_lite.attacks.opposite import OppositeAttack, opposite_objective
from detden_lite.core.budget import Budget
from detden_lite.core.tasks import Task, get_task
from detden_lite.defense.denoiser import Denoiser
from detden_lite.defense.detector import Detector
from detden_lite.defense.gruvae import GRUVAE
from detden_lite.defense.pipeline import DetectAndDenoise
from detden_lite.simulation.rollout import rollout
from detden_lite.store import models
from detden_lite.victims.victim import Victim

torch.set_num_threads(1)
N, ROUNDS, PGD, BALL = 128, 3, 20, Budget(1e-6)
STEPS = {"hopper": 100, "halfcheetah": 100, "ant": 50, "humanoid": 40}


@cache
def parts(name: str) -> tuple[Task, Victim, GRUVAE, DetectAndDenoise]:
    """Task, shipped victim, a GRU-VAE that changes nothing, and a defence that always alarms."""
    task, victim = get_task(name), models.load_victim(name, "td3")
    model = GRUVAE(task.obs_dim, task.hidden, task.layers, task.latent, residual=True).requires_grad_(False)
    model.to_output.weight.zero_(), model.to_output.bias.zero_()
    return task, victim, model, DetectAndDenoise(Detector(model, -1.0), Denoiser(model))


def lockstep(name: str, seeds) -> int:
    """Steps of these episodes in the library's loop."""
    task, victim, _, defense = parts(name)
    attack = OppositeAttack(victim, BALL, PGD)
    return int(rollout(victim, task, seeds, attack=attack, defense=defense, steps=STEPS[name]).lengths.sum())


def one_by_one(name: str) -> int:
    """Steps of one episode as the released code has it."""
    task, victim, model, _ = parts(name)
    env, detector_state, denoiser_state = gymnasium.make(task.env_id), None, None
    obs, _ = env.reset(seed=0)
    for step in range(STEPS[name]):  # noqa: B007
        true = torch.tensor(obs[None], dtype=torch.float32)
        objective = opposite_objective(victim, true)
        seen = true + BALL.epsilon * (2 * torch.rand_like(true) - 1)
        for _ in range(PGD):
            seen.requires_grad_()
            objective(seen).sum().backward()
            moved = seen.detach() + 2.5 * BALL.epsilon / PGD * seen.grad.sign()
            seen = torch.clamp(moved, true - BALL.epsilon, true + BALL.epsilon)
        with torch.no_grad():
            detected = model(seen[:, None], torch.randn(1, 1, task.latent), detector_state)
            denoised = model(seen[:, None], torch.randn(1, 1, task.latent), denoiser_state)
            detector_state, denoiser_state = detected.state, denoised.state
            if ((seen - detected.output[:, 0]) / model.obs_std).abs().max() > -1.0:
                seen = denoised.output[:, 0]
            action = victim(seen)[0].numpy()
        obs, _, terminated, _, _ = env.step(action)
        if terminated:
            break
    return step + 1


def against_the_loop(name: str) -> str:
    """The ratio of both, in one process."""
    rounds = []
    for _ in range(ROUNDS):
        speeds = []
        for work in (lambda: lockstep(name, range(N)), lambda: one_by_one(name)):
            start = process_time()
            steps = work()
            speeds.append(steps / (process_time() - start))
        rounds.append(speeds)
    (together, alone), ratio = np.median(rounds, axis=0), np.median([a / b for a, b in rounds])
    return f"{together:8,.0f} steps/s at N = {N},{alone:6,.0f} one by one: {ratio:.1f} times as fast"


def two_processes(name: str, pool: ProcessPoolExecutor) -> str:
    """The same episodes by one worker, and shared by two."""
    ratios = []
    for _ in range(ROUNDS):
        times = []
        for parts_of_them in ([range(N)], [range(N // 2), range(N // 2, N)]):
            start = perf_counter()
            list(pool.map(lockstep, [name] * len(parts_of_them), parts_of_them))
            times.append(perf_counter() - start)
        ratios.append(times[0] / times[1])
    return f"; with two processes {np.median(ratios):.2f} times more"


if __name__ == "__main__":
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        for name in STEPS:
            list(pool.map(lockstep, [name, name], [range(8), range(8)]))  # both workers load what they need
            print(f"{name:<12}{against_the_loop(name)}{two_processes(name, pool)}", flush=True)
