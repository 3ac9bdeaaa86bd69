"""Offline PGD-20 in samples a second: ours in float32 and bfloat16, the peers, and the machine's own limit; then the
planner against a loop over one environment; then what five restarts in one batch cost, against one start, and the peers
with as many restarts. Run by ``make bench``; the peers are asked if they are installed:

    uv pip install --python .venv torchattacks foolbox adversarial-robustness-toolbox

One thread and CPU times; what is compared is measured in turns. The planner alone has two threads and wall-clock time.
"""

from collections.abc import Callable
from importlib.util import find_spec
from time import perf_counter, process_time

import gymnasium
import numpy as np
import torch
from torch import Tensor, nn

from detden_lite.attacks.opposite import OppositeAttack, opposite_objective
from detden_lite.core.ascent import Best, ascend
from detden_lite.core.budget import Budget
from detden_lite.core.random_streams import RandomStreams
from detden_lite.core.tasks import TASKS, get_task
from detden_lite.simulation.planner import CEMPlanner
from detden_lite.simulation.rollout import rollout
from detden_lite.store.models import load_victim
from detden_lite.victims.victim import Victim

torch.set_num_threads(1)
STEPS, ROUNDS, ROWS, BATCH, HIDDEN = 20, 5, 100_000, 2_048, 256
EPSILON, SPAN = 0.1, 20.0  # radius of the ball; observations lie within half the span of 0


def peak(size: int = 1_024) -> float:
    """The most multiply-adds a second, times two, that float32 matrix products of some shapes reach."""
    best = 0.0
    for rows in (BATCH, 4 * BATCH):
        a, b, out = torch.randn(rows, size), torch.randn(size, size), torch.empty(rows, size)
        for _ in range(8):
            start = process_time()
            for _ in range(5):
                torch.mm(a, b, out=out)
            best = max(best, 5 * 2 * rows * size * size / (process_time() - start))
    return best


def products(victim: Victim) -> int:
    """Floating-point operations of one sample's matrix products: PGD's steps there and back, and the last value."""
    weights = sum(layer.weight.numel() for layer in victim.actor if isinstance(layer, nn.Linear))
    return 2 * weights * (2 * STEPS + 2)  # the true observation's action, and the value of the last point


class Shim(nn.Module):
    """The policy as a classifier of images, as the peers want it: its output is the action."""

    def __init__(self, victim: Victim):
        super().__init__()
        self.victim = victim

    def forward(self, x: Tensor) -> Tensor:
        return self.victim.mean(x.reshape(len(x), -1))


def ours(victim: Victim, dtype: torch.dtype) -> Callable[[Tensor], Tensor]:
    attack = OppositeAttack(victim, Budget(EPSILON), STEPS, dtype=dtype)
    attack.reset([0])
    return attack


def by_torchattacks(victim: Victim, epsilon: float = EPSILON) -> Callable[[Tensor], Tensor]:
    import torchattacks

    class SquaredDistance(nn.Module):
        """What its PGD gets where it asks for a cross-entropy."""

        def forward(self, output, action):
            return (output - action).square().sum()

    class Image(Shim):
        """Its images lie in [0, 1]."""

        def forward(self, x):
            return super().forward((x - 0.5) * SPAN)

    attack = torchattacks.PGD(Image(victim), epsilon / SPAN, 2.5 * epsilon / STEPS / SPAN, STEPS)

    def run(obs: Tensor) -> Tensor:
        cross_entropy, nn.CrossEntropyLoss = nn.CrossEntropyLoss, SquaredDistance
        try:
            return (attack.forward(obs / SPAN + 0.5, victim.mean(obs)) - 0.5) * SPAN
        finally:
            nn.CrossEntropyLoss = cross_entropy

    return run


def by_foolbox(victim: Victim, epsilon: float = EPSILON) -> Callable[[Tensor], Tensor]:
    import eagerpy
    import foolbox

    class PGD(foolbox.attacks.LinfProjectedGradientDescentAttack):
        def get_loss_fn(self, model, labels):
            return lambda x: (model(x) - labels).square().sum()

    model = foolbox.PyTorchModel(Shim(victim), bounds=(-1e3, 1e3), device="cpu")
    attack = PGD(abs_stepsize=2.5 * epsilon / STEPS, steps=STEPS)

    def run(obs: Tensor) -> Tensor:
        # The criterion must hold actions where foolbox expects classes; ``run`` itself does not mind.
        criterion = foolbox.criteria.Misclassification(eagerpy.astensor(victim.mean(obs)))
        return attack.run(model, obs, criterion, epsilon=epsilon)

    return run


def by_art(victim: Victim, epsilon: float = EPSILON) -> Callable[[Tensor], Tensor]:
    from art.attacks.evasion import ProjectedGradientDescentPyTorch
    from art.estimators.classification import PyTorchClassifier

    class SquaredDistance(nn.Module):
        reduction = "sum"

        def forward(self, output, action):
            return (output - action).square().sum()

    classifier = PyTorchClassifier(
        Shim(victim), SquaredDistance(), (victim.obs_dim,), nb_classes=victim.action_dim, device_type="cpu"
    )
    classifier.reduce_labels = lambda y: y
    attack = ProjectedGradientDescentPyTorch(
        classifier, eps=epsilon, eps_step=2.5 * epsilon / STEPS, max_iter=STEPS, num_random_init=1, batch_size=BATCH,
        verbose=False,
    )  # fmt: skip
    return lambda obs: torch.from_numpy(attack.generate(obs.numpy(), victim.mean(obs).numpy()))


PEERS = dict(torchattacks=by_torchattacks, foolbox=by_foolbox, art=by_art)


def offline(obs_dim: int, action_dim: int, limit: float) -> None:
    """Samples a second of everyone, on [ROWS, obs_dim]."""
    torch.manual_seed(0)
    victim = Victim([obs_dim, HIDDEN, HIDDEN, action_dim])
    obs = torch.randn(ROWS, obs_dim)
    makers = {"float32": lambda v: ours(v, torch.float32)}
    if torch.cpu._is_amx_tile_supported():
        makers["bfloat16"] = lambda v: ours(v, torch.bfloat16)
    makers |= {name: make for name, make in PEERS.items() if find_spec(name)}
    absent = [name for name in PEERS if not find_spec(name)]
    attacks = {name: make(victim) for name, make in makers.items()}
    # The peers get batches of the size at which they are fastest here, and a part of the rows, which suffices.
    share = dict.fromkeys(attacks, ROWS // 5)
    objective = {name: np.nan for name in attacks}
    speeds: dict[str, list[float]] = {name: [] for name in attacks}
    for _ in range(ROUNDS):
        for name, attack in attacks.items():
            some = obs[: share[name]]
            start = process_time()
            found = torch.cat([attack(part) for part in some.split(BATCH)])
            speeds[name].append(len(some) / (process_time() - start))
            assert Budget(EPSILON).contains(some, found, 1e-4).all(), name
            objective[name] = float(opposite_objective(victim, some)(found).mean())
    speed = {name: float(np.median(values)) for name, values in speeds.items()}
    print(
        f"\nPGD-{STEPS} on rows of [{ROWS:,} x {obs_dim}], {HIDDEN} x {HIDDEN}, {action_dim} actions; {ROUNDS} rounds"
    )
    for name, samples in speed.items():
        reached = f"{samples * products(victim) / limit:.0%} of the sgemm peak" if name == "float32" else ""
        ratio = "" if name == "float32" else f"{samples / speed['float32']:.2f} x our float32"
        print(f"  {name:<13}{samples:10,.0f} samples/s  mean l_op {objective[name]:.4f}  {reached}{ratio}")
    rivals = [speed[name] for name in speed if name in PEERS]
    if rivals:
        print(f"  ours is {speed['float32'] / max(rivals):.2f} times as fast as the fastest of the others")
    if "bfloat16" not in makers:
        print("  bfloat16: this processor has no AMX, without which it is slower than float32")
    if absent:
        print(f"  not installed: {', '.join(absent)} (see the head of this file)")


def restarts(several: int = 5) -> None:
    """What restarts cost on shipped victims, and what the peers reach who begin anew, at the same steps and starts."""
    print(f"\nPGD-{STEPS} with {several} starts")
    for task, algo, n in (
        ("hopper", "td3", 32),
        ("hopper", "td3", 128),
        ("humanoid", "ppo", 32),
        ("humanoid", "ppo", 128),
    ):
        victim, budget = load_victim(task, algo), Budget(get_task(task).epsilon)
        clean = rollout(victim, get_task(task), range(4), steps=200)
        obs = torch.from_numpy(np.random.default_rng(0).permutation(clean.obs[clean.mask])[:n])
        attacks = {count: OppositeAttack(victim, budget, STEPS, count) for count in (1, several)}
        spent: dict[int, list[float]] = {count: [] for count in attacks}
        for _ in range(4 * ROUNDS):
            for count, attack in attacks.items():
                attack.reset()
                start = process_time()
                attack(obs)
                spent[count].append(process_time() - start)
        one, all_of_them = (float(np.median(spent[count])) for count in attacks)
        print(f"  {task}-{algo}, {n:3} rows: {1e3 * one:.1f} ms once, {all_of_them / one:.2f} times that in one batch")


def against_peers(starts: int = 5) -> None:
    """The objective that each reaches on Hopper-TD3 with equal steps, and its best of as many starts."""
    victim, task = load_victim("hopper", "td3"), get_task("hopper")
    clean = rollout(victim, task, range(4))
    obs = torch.from_numpy(np.random.default_rng(0).permutation(clean.obs[clean.mask])[:BATCH])
    objective = opposite_objective(victim, obs)
    print(f"\nHopper-TD3, {len(obs):,} rows, {STEPS} steps x {starts} starts")

    def told(name: str, found: Tensor, seconds: float) -> None:
        inside = Budget(task.epsilon).contains(obs, found, 1e-4).all()
        print(
            f"  {name:<13}{len(obs) / seconds:8,.0f} samples/s  mean l_op {objective(found).mean():.4f}"
            + " LEFT THE BALL" * (not inside)
        )

    attack = OppositeAttack(victim, Budget(task.epsilon), STEPS, starts)
    attack.reset()
    start = process_time()
    found = attack(obs)
    told("ours", found, process_time() - start)
    start = process_time()
    textbook = ascend(
        attack.objective(obs), obs, attack.budget, RandomStreams(0), STEPS, 2.5 * task.epsilon / STEPS, starts
    )
    told("ours, 2.5/T", textbook, process_time() - start)
    for name, make in PEERS.items():
        if not find_spec(name):
            print(f"  {name} is not installed; the head of this file says how to install it")
            continue
        torch.manual_seed(0)
        peer, best = make(victim, task.epsilon), Best(obs)
        start = process_time()
        for _ in range(starts):
            found = peer(obs)
            best.meet(found, objective(found))
        told(name, best.point, process_time() - start)


def loop(env: gymnasium.Env, horizon: int, population: int, iterations: int, seed: int = 0) -> int:
    """What a plan costs without ``mujoco.rollout``: set the state, step, for every candidate. Steps done."""
    random, steps = np.random.default_rng(seed), 0
    start = env.data.qpos.copy(), env.data.qvel.copy()
    for _ in range(iterations * population):
        env.set_state(*start)
        for _ in range(horizon):
            env.step(random.uniform(env.action_space.low, env.action_space.high))
            steps += 1
    env.set_state(*start)
    return steps


def planner() -> None:
    """Plans a second with two threads against the plain loop in one, by the clock on the wall."""
    sizes = dict(horizon=15, population=64, iterations=4)
    print("\nthe planner, population 64, horizon 15, 4 iterations, two threads, against set_state + env.step")
    for task in TASKS.values():
        worlds = [gymnasium.make(task.env_id).unwrapped for _ in range(2)]
        for seed, env in enumerate(worlds):
            env.reset(seed=seed)
        cem = CEMPlanner(task.env_id, threads=2, **sizes)
        cem.reset(range(2))
        ratios, plans = [], []
        for _ in range(3):
            start = perf_counter()
            for _ in range(3):
                cem.plan(worlds, np.ones(2, dtype=bool))
            plans.append(6 / (perf_counter() - start))
            start = perf_counter()
            loop(worlds[0], **sizes)
            ratios.append(plans[-1] * (perf_counter() - start))
        print(f"  {task.name:<12}{np.median(plans):6.1f} plans/s, {np.median(ratios):.1f} times the loop")


if __name__ == "__main__":
    limit = peak()
    print(f"sgemm peak on one thread: {limit / 1e9:.0f} GFLOP/s")
    offline(11, 3, limit)
    offline(348, 17, limit)
    planner()
    restarts()
    against_peers()
