"""How a student's result differs from what is right, in words that help."""

from collections.abc import Mapping
from typing import Any

import numpy as np


def array(call: str, got: Any) -> np.ndarray:
    """What ``call`` gave as an array; an AssertionError if it gave nothing, or no numbers."""
    assert got is not None, f"{call} gives None: does the function end with `return`?"
    assert got is not NotImplemented and got is not Ellipsis, f"{call} gives {got!r}: write the missing lines first"
    got = got.detach().cpu() if hasattr(got, "detach") else got
    try:
        return np.asarray(got, dtype=float)
    except (TypeError, ValueError):
        raise AssertionError(f"{call} gives a {type(got).__name__}, not an array of numbers") from None


def compare(call: str, got: Any, expected: Any, mistakes: Mapping[str, Any] | None = None, atol: float = 1e-5) -> None:
    """Raise an AssertionError that says where ``got`` differs from ``expected``, and what may lie behind it.

    Args:
        call: the call that gave it, as the message shows it.
        got: the student's result: numbers, a NumPy array or a tensor.
        expected: the right one.
        mistakes: what well-known misunderstandings give, each under the hint that leads out of it.
        atol: how much numbers may differ.
    """
    got, expected = array(call, got), np.asarray(expected, dtype=float)
    assert got.shape == expected.shape, f"{call} has the shape {got.shape}; it should have {expected.shape}"
    wrong = ~np.isclose(got, expected, rtol=1e-5, atol=atol)
    if not wrong.any():
        return
    place = tuple(int(i) for i in np.argwhere(wrong)[0])
    at = f" at {list(place)}" if place else ""
    message = f"{call}{at} is {got[place]:.6g}; it should be {expected[place]:.6g}"
    for hint, mistaken in (mistakes or {}).items():
        mistaken = np.asarray(mistaken, dtype=float)
        if mistaken.shape == got.shape and np.allclose(got, mistaken, rtol=1e-5, atol=atol):
            message += f". {hint}"
            break
    raise AssertionError(message)
