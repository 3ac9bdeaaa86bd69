"""The five tasks and the paper's numbers for them (tables 1, 2 and 5), and one that is not the paper's."""

from dataclasses import dataclass

ALGORITHMS = ("td3", "ppo")
# Not the paper's: trained to be robust, in the attacker's ball or a normalised one, and their control.
ONLINE = dict(
    vanilla="PPO, control", sappo="SA-PPO", atla="ATLA-PPO", zsappo="SA-PPO, normalised ball",
    zatla="ATLA-PPO, normalised ball",
)  # fmt: skip
SCALES = ("tiny", "lite", "paper")  # of a run of the recipe; ``detden_lite.recipe.scales`` has their sizes


@dataclass(frozen=True)
class Task:
    """One control task, its attack budget and the paper's hyperparameters for it.

    ``obs_dim`` is what gymnasium's v5 shows; ``paper_obs_dim`` is what the paper had. They differ where v5 drops
    observations that never change (Ant, Humanoid). ``state_dim`` says how many of its first numbers are positions and
    velocities; None for all. A task of your own needs the first five numbers.

    Example:
        >>> task = Task("reacher", "Reacher-v5", epsilon=0.05, obs_dim=10, action_dim=2, horizon=50)
        >>> task.env_id, task.hidden
        ('Reacher-v5', 64)
    """

    name: str
    env_id: str
    epsilon: float  # table 1, radius of the l-infinity ball in raw observation units
    obs_dim: int
    action_dim: int
    paper_obs_dim: int | None = None
    hidden: int = 64  # table 5, GRU hidden size of encoder and decoder
    layers: int = 1  # table 5, GRU layers
    latent: int = 64  # table 5, "embedding size"
    batch: int = 128  # table 5
    epochs: int = 50  # table 5
    trajectories: int = 10_000  # appendix C.1
    horizon: int = 1_000
    learning_rate: float = 1e-3  # table 5
    state_dim: int | None = None

    def check_fits(self, obs_dim: int, action_dim: int) -> None:
        """Check that a victim with so many observations and actions can act in this task; a ValueError if not."""
        if (obs_dim, action_dim) != (self.obs_dim, self.action_dim):
            raise ValueError(
                f"victim: it maps {obs_dim} observations to {action_dim} actions, "
                f"but {self.env_id} has {self.obs_dim} and {self.action_dim}; give the victim of this task"
            )


TASKS = {
    task.name: task
    for task in (
        Task("hopper", "Hopper-v5", 0.075, 11, 3, 11, 64, 1, 64, 128, 50, 10_000),
        Task("walker2d", "Walker2d-v5", 0.1, 17, 6, 17, 64, 1, 64, 128, 50, 10_000),
        Task("halfcheetah", "HalfCheetah-v5", 0.15, 17, 6, 17, 64, 1, 64, 128, 50, 10_000),
        Task("ant", "Ant-v5", 0.15, 105, 8, 111, 256, 1, 64, 256, 100, 20_000, state_dim=27),
        Task("humanoid", "Humanoid-v5", 0.15, 348, 17, 376, 256, 2, 128, 1_024, 200, 20_000, state_dim=45),
    )
}

SWIMMER = Task("swimmer", "Swimmer-v5", epsilon=0.5, obs_dim=8, action_dim=2)  # the book defends it in one call

OTHERS = (SWIMMER,)  # the tasks that are not the paper's
_BY_NAME = TASKS | {task.name: task for task in OTHERS}

TASK_NAMES = tuple(_BY_NAME)


def get_task(name: str) -> Task:
    """The task called ``name``; a ValueError that lists the names otherwise."""
    try:
        return _BY_NAME[name]
    except KeyError:
        raise ValueError(f"unknown task {name!r}; choose one of: {', '.join(TASK_NAMES)}") from None
