"""The checks of ``rollout``'s guests, the attack, the timing and the defence, before and at the first step.

They are made once: a guest that keeps its contract at the first step is trusted with the others.
"""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from detden_lite.core.arguments import check_whole
from detden_lite.core.budget import Budget
from detden_lite.core.types import KNOWLEDGE, Verdict


def check_guests(attack: object, timing: object, defense: object) -> None:
    """Check that guests have the methods of their contracts in ``detden_lite.core.types``; None is no guest.

    Raises:
        ValueError: names the argument and what it lacks.
    """
    for name, guest, methods in (
        ("attack", attack, ("needs", "reset", "__call__")),
        ("timing", timing, ("reset", "__call__")),
        ("defense", defense, ("reset", "__call__") + ("reveal",) * ("truth" in getattr(defense, "needs", ()))),
    ):
        if isinstance(guest, type):
            raise ValueError(f"{name}: {guest.__name__} is a class; give an object made of it")
        if guest is not None and (lacks := [m for m in methods if not hasattr(guest, m)]):
            article = "an attack such as OppositeAttack(victim, budget)" if name == "attack" else f"a {name} object"
            raise ValueError(f"{name}: {guest!r} has no {' and no '.join(lacks)}; give {article}")
    if unknown := sorted(set(getattr(attack, "needs", ())) - set(KNOWLEDGE)):
        raise ValueError(f"attack: it needs {', '.join(unknown)}; an attack can need {', '.join(KNOWLEDGE)}")
    if "defense" in getattr(attack, "needs", ()) and defense is None:
        raise ValueError("attack: it needs a defense to adapt to; give one, or the attack that does not know it")


def check_seeds(seeds: Sequence[int]) -> None:
    """Check that there is at least one seed, and that each is a whole number of at least 0."""
    if not hasattr(seeds, "__len__"):
        raise ValueError(f"seeds: give a sequence with one seed for each episode, such as range(8), not {seeds!r}")
    if not len(seeds):
        raise ValueError("seeds is empty: give one seed for each episode")
    for seed in seeds:
        check_whole(0, **{"each of seeds": seed})


def check_horizon(steps: int | None, name: str = "steps") -> None:
    """Check that a number of steps is None or at least 1."""
    if steps is not None:
        check_whole(1, **{name: steps})


def check_noise(noise: float | np.ndarray | Tensor, n: int, action_dim: int, name: str = "action_noise") -> Tensor:
    """A number of the exploration noise as ``[1 or N, 1 or action_dim]``; it must be finite and at least 0."""
    try:
        found = torch.as_tensor(noise, dtype=torch.float32)
    except (TypeError, ValueError, RuntimeError):
        raise ValueError(f"{name} must be a number or an array of numbers, not {noise!r}") from None
    if not (found.isfinite() & (found >= 0)).all():
        raise ValueError(f"{name} must be finite and at least 0 everywhere, not {noise}")
    found = found if found.ndim == 2 else found.reshape(-1, 1)
    if found.shape[0] not in (1, n) or found.shape[1] not in (1, action_dim):
        shapes = f"[{n}]" if action_dim == 1 else f"[{n}] or [{n}, {action_dim}]"
        raise ValueError(f"{name} must be one number, {shapes}, not {list(found.shape)}")
    return found


def check_timing(attacked: Tensor, n: int) -> None:
    """Check 1_vul at the first step: ``[N]`` bool."""
    _check("timing", "it says when to attack with", attacked, (n,), torch.bool)


def check_perturbed(attack: object, perturbed: Tensor, true: Tensor, wanted: Tensor) -> None:
    """Check an attack's answer: shape, numbers, and its own budget on the rows that are attacked."""
    _check("attack", "it gives", perturbed, tuple(true.shape), torch.float32)
    rows = perturbed[wanted]
    if not rows.isfinite().all():
        raise ValueError("attack: it gives NaN or infinity")
    budget = getattr(attack, "budget", None)
    if budget is None or not len(rows):
        return
    if not isinstance(budget, Budget):
        raise ValueError(f"attack: its budget must be a Budget, not {budget!r}")
    size, true = budget.size(true[wanted], rows), true[wanted]
    rounding = 4e-7 * ((true.abs() + rows.abs()) / budget.scale).sum(-1) + 1e-5 * budget.epsilon + 1e-6
    if (size > budget.epsilon + rounding).any():
        raise ValueError(
            f"attack: {type(attack).__name__} leaves its ball: {size.max():.4g} from the truth, with epsilon = "
            f"{budget.epsilon}; project what it gives with budget.project"
        )


def check_verdict(verdict: Verdict, shown: Tensor) -> None:
    """Check a defence's answer at the first step."""
    if not isinstance(verdict, Verdict):
        raise ValueError(f"defense: it gives {type(verdict).__name__}, and must give a detden_lite.Verdict")
    n, shape = len(shown), tuple(shown.shape)
    _check("defense", "verdict.obs is", verdict.obs, shape, torch.float32)
    _check("defense", "verdict.denoised is", verdict.denoised, shape, torch.float32)
    _check("defense", "verdict.alarm is", verdict.alarm, (n,), torch.bool)
    _check("defense", "verdict.score is", verdict.score, (n,), torch.float32)


def _check(name: str, what: str, value: object, shape: tuple[int, ...], dtype: torch.dtype) -> None:
    if not isinstance(value, Tensor):
        raise ValueError(f"{name}: {what} {type(value).__name__}, and must be a tensor {list(shape)} {dtype}")
    if tuple(value.shape) != shape or value.dtype != dtype:
        raise ValueError(f"{name}: {what} {list(value.shape)} {value.dtype}, and must be {list(shape)} {dtype}")
