"""How large everything is: ``tiny`` for tests, ``lite`` for what is shipped, ``paper`` for the paper's own sizes."""

from dataclasses import dataclass

from detden_lite.defense.training import VAERecipe
from detden_lite.tasks import Task
from detden_lite.victim_training import TD3Recipe


@dataclass(frozen=True)
class Scale:
    """Sizes of one run of the whole pipeline."""

    victim: TD3Recipe
    defense: VAERecipe
    trajectories: int
    horizon: int
    episodes: int  # of each reported cell
    attack_steps: int  # PGD steps


def get_scale(name: str, task: Task) -> Scale:
    """The scale called ``name`` for this task; a ValueError that lists the names otherwise."""
    sizes = dict(hidden=task.hidden, layers=task.layers, latent=task.latent, learning_rate=task.learning_rate)
    if name == "tiny":
        return Scale(
            victim=TD3Recipe(steps=1_000, segment=500, net=32, batch=32, buffer=1_000, learning_starts=200),
            defense=VAERecipe(hidden=16, layers=1, latent=8, epochs=2, batch=4, chunk=25),
            trajectories=8,
            horizon=50,
            episodes=4,
            attack_steps=3,
        )
    if name == "lite":
        return Scale(
            victim=TD3Recipe(),
            defense=VAERecipe(**sizes, epochs=30, batch=task.batch),
            trajectories=1_000,
            horizon=task.horizon,
            episodes=100,
            attack_steps=20,
        )
    if name == "paper":
        return Scale(
            victim=TD3Recipe(),
            defense=VAERecipe(**sizes, epochs=task.epochs, batch=task.batch),
            trajectories=task.trajectories,
            horizon=task.horizon,
            episodes=100,
            attack_steps=20,
        )
    raise ValueError(f"unknown scale {name!r}; choose one of: tiny, lite, paper")
