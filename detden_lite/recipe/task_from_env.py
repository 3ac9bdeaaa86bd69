"""The task that an environment is, for a policy that the recipe does not know; and whether the policy fits it."""

import re
from dataclasses import replace

import gymnasium
import numpy as np
import torch
from gymnasium.envs.mujoco import MujocoEnv
from gymnasium.envs.registration import EnvSpec
from gymnasium.spaces import Box
from gymnasium.wrappers import OrderEnforcing, PassiveEnvChecker, TimeLimit

from detden_lite.core.budget import Budget
from detden_lite.core.tasks import TASKS, Task
from detden_lite.simulation.simulator import make
from detden_lite.victims.victim import Victim

HARMLESS = (PassiveEnvChecker, OrderEnforcing, TimeLimit)  # gymnasium's wrappers that change no observation


def task_of(env: str | gymnasium.Env, budget: Budget) -> Task:
    """The task that an environment is.

    Args:
        env: the id of a gymnasium MuJoCo task, or an environment that was made from its id alone.
        budget: the task's epsilon is its radius.

    Raises:
        ValueError: if it is none of gymnasium's MuJoCo tasks with vectors as observations and a Box of actions, or was
            made with arguments or wrappers: the episodes are played in worlds made from the id alone. Or if the
            budget's scale does not fit the observations.

    Example:
        >>> from detden_lite import Budget, task_of
        >>> task = task_of("InvertedPendulum-v5", Budget(0.05))
        >>> task.name, task.obs_dim, task.action_dim, task.epsilon
        ('invertedpendulum', 4, 1, 0.05)
    """
    spec = _spec(env)
    world = make(spec.id)
    inner = world
    while isinstance(inner, HARMLESS):
        inner = inner.env
    if inner is not world.unwrapped:
        raise ValueError(
            f"env: what is registered as {spec.id} is wrapped in {type(inner).__name__}, and the episodes are played "
            f"without; move what that does into a subclass of MujocoEnv, and register that"
        )
    sizes = []
    for what, space in (("observations", world.observation_space), ("actions", world.action_space)):
        if not isinstance(space, Box) or len(space.shape) != 1:
            raise ValueError(f"env: the {what} of {spec.id} must be vectors (a Box of one axis), not {space}")
        sizes.append(space.shape[0])
    if not isinstance(world.unwrapped, MujocoEnv):
        raise ValueError(
            f"env: {spec.id} is not derived from gymnasium's MujocoEnv, and nothing else is simulated in lockstep; "
            f"from recorded episodes a defence can be made of its parts: see the book's page Bring your own policy"
        )
    obs_dim, action_dim = sizes
    if torch.as_tensor(budget.scale).numel() not in (1, obs_dim):
        raise ValueError(f"budget: its scale must be one number or {obs_dim}, one for each observation of {spec.id}")
    name = re.sub("[^a-z0-9]", "", spec.name.lower())  # of a folder
    paper = {task.env_id: task for task in TASKS.values()}  # which has larger networks for its larger tasks
    task = paper.get(spec.id, Task(name, spec.id, 0.0, obs_dim, action_dim))
    return replace(task, epsilon=budget.epsilon, horizon=spec.max_episode_steps or task.horizon)


def _spec(env: str | gymnasium.Env) -> EnvSpec:
    """What gymnasium's registry says of an environment; a ValueError if the environment is not what its id says."""
    try:
        spec = gymnasium.spec(env) if isinstance(env, str) else getattr(env, "spec", None)
        registered = spec and gymnasium.spec(spec.id)
    except gymnasium.error.Error as error:
        raise ValueError(f"env: {error}") from None
    if spec is None or registered is None:
        raise ValueError("env: it has no spec; register it with gymnasium, and give its id")
    changes = [wrapper.name for wrapper in spec.additional_wrappers]
    changes += [name for name in spec.kwargs if registered.kwargs.get(name) != spec.kwargs[name]]
    if changes:
        raise ValueError(
            f"env: it is {spec.id} with {', '.join(changes)}, which its id does not tell; register arguments under an "
            f"id of their own, move what a wrapper does into a subclass of MujocoEnv and register that, or give "
            f"{spec.id!r} if they change neither observations nor actions"
        )
    return spec


def check_fit(victim: Victim, task: Task) -> None:
    """Whether a policy can act in a task.

    Raises:
        ValueError: if it has another number of observations or actions, or its actions have other bounds.
    """
    space = make(task.env_id).action_space
    task.check_fits(victim.obs_dim, victim.action_dim)
    low, high = victim.action_low.numpy(), victim.action_high.numpy()
    if not (isinstance(space, Box) and np.allclose(low, space.low) and np.allclose(high, space.high)):
        raise ValueError(
            f"victim: its actions lie between {low} and {high}, those of {task.env_id} in {space}; give the task that "
            f"it was trained for, without a wrapper that changes the actions"
        )
