"""The adversary's world: its action is the perturbation of what a frozen victim sees (section 3.2.1)."""

from functools import partial

import gymnasium
import numpy as np
import torch
from gymnasium.spaces import Box
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices
from torch import Tensor

from detden_lite.attacks.base import check_budget
from detden_lite.attacks.director import DirectorAttack
from detden_lite.attacks.optimal import History, perturb
from detden_lite.attacks.timing import Always
from detden_lite.core.arguments import check_whole
from detden_lite.core.budget import Budget
from detden_lite.core.tasks import Task
from detden_lite.core.types import Defense, Timing
from detden_lite.simulation.fast_simulator import make_simulator
from detden_lite.simulation.guests import check_guests, check_horizon
from detden_lite.victims.victim import Victim


class AdversaryEnv(VecEnv):
    """N worlds in lockstep, with one call of the victim a step for all of them: a ``VecEnv`` of stable-baselines3.

    The adversary sees the true observation. Its action in [-1, 1]^obs_dim becomes a perturbation in the ball, and its
    reward is the victim's, negated. A director's action is a direction in the space of the victim's actions instead.
    Where the timing says no, the victim sees the truth. A world whose episode has ended begins another one at once,
    with a seed that no other purpose has (``episode_seeds.SEEDS``). Ending at the time limit is a truncation: the
    learner bootstraps from the value function there.

    Args:
        victim: the policy under attack.
        task: the victim's.
        budget: the ball.
        n: how many worlds.
        timing: when to attack; always by default.
        defense: what the victim's observations pass through, if anything; see ``detden_lite.defense``.
        steps: the longest an episode may be; the task's horizon by default.
        history: how many observations the adversary sees, the newest first; see ``OptimalAttack``.
        director: the attack that a director is trained for; None for an adversary who perturbs.

    Raises:
        ValueError: if a number is not in its range, or a part is of another kind or of another task.

    Example:
        >>> from detden_lite import AdversaryEnv, Budget, get_task, load_victim
        >>> env = AdversaryEnv(load_victim("hopper", "td3"), get_task("hopper"), Budget(0.075), n=2)
        >>> env.reset().shape
        (2, 11)
        >>> obs, reward, done, infos = env.step(np.zeros((2, 11)))
        >>> bool((reward < 0).all())  # the victim's rewards, negated
        True
    """

    def __init__(
        self, victim: Victim, task: Task, budget: Budget, n: int, timing: Timing | None = None,
        defense: Defense | None = None, steps: int | None = None, history: int = 1,
        director: DirectorAttack | None = None,
    ) -> None:  # fmt: skip
        check_whole(1, n=n, history=history)
        check_horizon(steps)
        check_guests(None, timing, defense)
        check_budget(budget, task.obs_dim)
        task.check_fits(victim.obs_dim, victim.action_dim)
        self.victim, self.budget, self.timing, self.defense = victim, budget, timing or Always(), defense
        self.simulator, self.horizon = make_simulator(task.env_id, range(n)), steps or task.horizon
        self.history, self.director = History(history), director
        self.follow = director.follow if director else partial(perturb, budget)
        everything = Box(-np.inf, np.inf, (history * task.obs_dim,), np.float32)
        actions = task.action_dim if director else task.obs_dim
        super().__init__(n, everything, Box(-1.0, 1.0, (actions,), np.float32))
        self.seed(0)

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Fix the seeds of all episodes to come."""
        self.generator = np.random.default_rng(seed)
        return [seed] * self.num_envs

    def _fresh_seed(self) -> int:
        return int(self.generator.integers(2**32, 2**63))

    def reset(self) -> np.ndarray:
        """Begin an episode in every world. Returns the true observations ``[N, history * obs_dim]``."""
        self.simulator.seeds = [self._fresh_seed() for _ in range(self.num_envs)]
        for part in (self.timing, self.defense, self.director):
            if part is not None:
                part.reset(self.simulator.seeds)
        self.history.reset()
        self.age = np.zeros(self.num_envs, dtype=int)
        self.obs = self.simulator.reset()
        self.action: Tensor | None = None  # the victim's, one step before
        return self.history.push(torch.from_numpy(self.obs)).numpy()

    def step_async(self, actions: np.ndarray) -> None:
        self.actions = torch.from_numpy(np.asarray(actions, dtype=np.float32))

    @torch.no_grad()
    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict]]:
        """One step of every world.

        Returns:
            True observations ``[N, history * obs_dim]``, of the next episode where one has ended; the victim's rewards,
            negated, ``[N]``; whether the episode has ended ``[N]``; and the infos that stable-baselines3 expects.

        Raises:
            ValueError: if an action of the victim is not finite.
        """
        true = torch.from_numpy(self.obs)
        shown = torch.where(self.timing(true)[:, None], self.follow(true, self.actions), true)
        if self.defense is not None:
            shown = self.defense(shown, self.action).obs
        self.action = action = self.victim(shown)
        if not torch.isfinite(action).all():
            raise ValueError("an action is NaN or infinite: the training of the adversary has diverged")
        obs, reward, ended = self.simulator.step(action.numpy())
        self.age += 1
        done = ended | (self.age >= self.horizon)
        infos: list[dict] = [{} for _ in done]
        seen = self.history.push(torch.from_numpy(obs))
        for i in np.flatnonzero(done):
            infos[i] = {"terminal_observation": seen[i].numpy().copy(), "TimeLimit.truncated": not ended[i]}
            obs[i] = self._begin(int(i), action)
            self.history.restart(int(i), torch.from_numpy(obs[i]))
        self.obs = obs
        return seen.numpy(), -reward, done, infos

    def _begin(self, i: int, action: Tensor) -> np.ndarray:
        """Begin a new episode in one world; the others go on. Its row of ``action`` becomes NaN."""
        seed = self._fresh_seed()
        self.age[i] = 0
        if self.defense is not None:
            self.defense.restart(i, seed)
            action[i] = torch.nan  # there is no action before the first
        return self.simulator.restart(i, seed)

    def close(self) -> None:
        for env in self.simulator.envs:
            env.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list:
        return [getattr(self.simulator.envs[i], attr_name) for i in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: object, indices: VecEnvIndices = None) -> None:
        for i in self._get_indices(indices):
            setattr(self.simulator.envs[i], attr_name, value)

    def env_method(
        self, method_name: str, *method_args: object, indices: VecEnvIndices = None, **method_kwargs: object
    ) -> list:
        envs = [self.simulator.envs[i] for i in self._get_indices(indices)]
        return [getattr(env, method_name)(*method_args, **method_kwargs) for env in envs]

    def env_is_wrapped(self, wrapper_class: type[gymnasium.Wrapper], indices: VecEnvIndices = None) -> list[bool]:
        return [False for _ in self._get_indices(indices)]
