"""Compare a student's result with the right one, and name the misunderstanding that explains the difference."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike


def array(call: str, got: Any) -> np.ndarray:
    """The result of ``call`` as an array; an AssertionError if it is nothing, or no numbers.

    Example:
        >>> array("f(2)", None)
        Traceback (most recent call last):
        AssertionError: f(2) gives None: does the function end with `return`?
    """
    assert got is not None, f"{call} gives None: does the function end with `return`?"
    assert got is not NotImplemented and got is not Ellipsis, f"{call} gives {got!r}: write the missing lines first"
    assert not (hasattr(got, "values") and hasattr(got, "indices") and isinstance(got, tuple)), (
        f"{call} gives both values and indices: torch's x.max(-1) does. Take its values, or x.amax(-1)"
    )
    got = got.detach().cpu() if hasattr(got, "detach") else got
    got = [array(call, part) for part in got] if isinstance(got, list | tuple) else got
    try:
        return np.asarray(got, dtype=float)
    except (TypeError, ValueError):
        raise AssertionError(f"{call} gives a {type(got).__name__}, not an array of numbers") from None


def parts(call: str, got: Any, *names: str) -> list:
    """The several things that ``call`` gives: a tuple, a list or an array of as many entries.

    Example:
        >>> parts("f()", 3, "low", "high")
        Traceback (most recent call last):
        AssertionError: f() gives one int; it should give two things: low and high
    """
    wanted = f"{('two', 'three', 'four', 'five')[len(names) - 2]} things: {', '.join(names[:-1])} and {names[-1]}"
    assert got is not None, f"{call} gives None: does the function end with `return`? It should give {wanted}"
    several = isinstance(got, list | tuple) or getattr(got, "ndim", 0) > 0
    assert several, f"{call} gives one {type(got).__name__}; it should give {wanted}"
    assert len(got) == len(names), f"{call} gives {len(got)} things; it should give {wanted}"
    return list(got)


def compare(
    call: str, got: Any, expected: ArrayLike, mistakes: Mapping[str, ArrayLike] | None = None, atol: float = 1e-5
) -> None:
    """Raise an AssertionError that says where ``got`` differs from ``expected``, and the likely misunderstanding.

    Args:
        call: the call that gave the result, as the message shows it.
        got: the student's result: numbers, a NumPy array or a tensor.
        expected: the right one.
        mistakes: the results of well-known misunderstandings, each under the hint that corrects it.
        atol: how much numbers may differ.

    Example:
        >>> compare("double(3)", 9, 6, {"That is the square": 9})
        Traceback (most recent call last):
        AssertionError: double(3) is 9; it should be 6. That is the square
    """
    got, expected = array(call, got), np.asarray(expected, dtype=float)
    if got.shape != expected.shape:
        raise AssertionError(
            f"{call} has the shape {got.shape}; it should have {expected.shape}{_of_shape(got, expected)}"
        )
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


def _of_shape(got: np.ndarray, expected: np.ndarray) -> str:
    if got.ndim > expected.ndim and got.squeeze().shape == expected.shape:
        return ". An axis of size 1 is left over: drop keepdim, or squeeze it"
    if got.ndim == 2 and got.T.shape == expected.shape:
        return ". Its two axes are swapped"
    if got.ndim > expected.ndim:
        return ". An axis is left over: over which one should the function sum or average?"
    return ". An axis is missing: the function sums or averages over too many" if got.ndim < expected.ndim else ""
