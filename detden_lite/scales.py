"""How large everything is: ``tiny`` for tests, ``lite`` for what is shipped, ``paper`` for the paper's own sizes."""

from dataclasses import dataclass, replace

from detden_lite.defense.training import VAERecipe
from detden_lite.qfunction import QRecipe
from detden_lite.tasks import Task
from detden_lite.victim_recipes import PPORecipe, TD3Recipe

ALGORITHMS = ("td3", "ppo")
SCALES = ("tiny", "lite", "paper")

# What the shipped victims are trained with; the paper says nothing of its victims' training.
_PPO = PPORecipe(envs=32, rollout=64, batch=128)
VICTIMS = {
    ("hopper", "td3"): TD3Recipe(steps=500_000),
    ("walker2d", "td3"): TD3Recipe(steps=500_000),
    ("halfcheetah", "td3"): TD3Recipe(steps=540_000),
    ("ant", "td3"): TD3Recipe(steps=700_000),
    ("humanoid", "td3"): TD3Recipe(steps=1_000_000, learning_rate=3e-4),
    ("hopper", "ppo"): _PPO,
    ("walker2d", "ppo"): _PPO,
    ("halfcheetah", "ppo"): replace(_PPO, log_std=-0.7),
    ("ant", "ppo"): replace(_PPO, steps=3_072_000, log_std=-0.5),
    ("humanoid", "ppo"): PPORecipe(
        steps=8_192_000, net=256, activation="relu", learning_rate=1e-4, envs=32, rollout=64, batch=256, epochs=5,
        gamma=0.95, gae_lambda=0.9, clip=0.3, log_std=-2.0,
    ),
}  # fmt: skip
TINY_VICTIMS = {
    "td3": TD3Recipe(steps=1_000, segment=500, net=32, batch=32, buffer=1_000, learning_starts=200),
    "ppo": PPORecipe(steps=1_024, segment=512, net=32, envs=4, rollout=64, epochs=2),
}

# Of the enchanting attack, in the sweep of what planning costs: how far it looks, and how hard it searches.
PLANNERS = tuple(
    dict(horizon=horizon, population=population, iterations=iterations)
    for horizon, population, iterations in (
        (1, 64, 4), (2, 64, 4), (5, 64, 4), (15, 64, 4), (30, 64, 4), (15, 4, 1), (15, 16, 2), (15, 256, 4),
    )
)  # fmt: skip
TINY_PLANNERS = (dict(horizon=2, population=4, iterations=1), dict(horizon=5, population=4, iterations=1))


@dataclass(frozen=True)
class Scale:
    """Sizes of one run of the whole pipeline."""

    victim: TD3Recipe | PPORecipe
    critic: QRecipe
    defense: VAERecipe
    trajectories: int
    horizon: int
    episodes: int  # of each reported cell
    attack_steps: int  # PGD steps
    planners: tuple[dict[str, int], ...]


def get_scale(name: str, task: Task, algo: str = "td3") -> Scale:
    """The scale called ``name`` for a victim; a ValueError that lists the names otherwise."""
    if algo not in ALGORITHMS:
        raise ValueError(f"unknown algorithm {algo!r}; choose one of: {', '.join(ALGORITHMS)}")
    if name not in SCALES:
        raise ValueError(f"unknown scale {name!r}; choose one of: {', '.join(SCALES)}")
    if name == "tiny":
        return Scale(
            victim=TINY_VICTIMS[algo],
            critic=QRecipe(episodes=16, net=32, epochs=3, batch=64),
            defense=VAERecipe(hidden=16, layers=1, latent=8, epochs=2, batch=4, chunk=25),
            trajectories=8,
            horizon=50,
            episodes=4,
            attack_steps=3,
            planners=TINY_PLANNERS,
        )
    sizes = dict(hidden=task.hidden, layers=task.layers, latent=task.latent, learning_rate=task.learning_rate)
    return Scale(
        victim=VICTIMS[task.name, algo],
        critic=QRecipe(),
        defense=VAERecipe(**sizes, epochs=30 if name == "lite" else task.epochs, batch=task.batch),
        trajectories=1_000 if name == "lite" else task.trajectories,
        horizon=task.horizon,
        episodes=100,
        attack_steps=20,
        planners=PLANNERS,
    )
