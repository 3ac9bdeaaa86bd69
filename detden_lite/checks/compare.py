"""Compare a student's result with the right one, and name the misunderstanding that explains the difference."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike


def array(call: str, got: object) -> np.ndarray:
    """The result of ``call`` as an array; an AssertionError if it is nothing, or no numbers.

    Example:
        >>> array("f(2)", None)
        Traceback (most recent call last):
        AssertionError: f(2) gives None: does the function end with `return`?
    """
    assert got is not None, f"{call} gives None: does the function end with `return`?"
    assert got is not NotImplemented and got is not Ellipsis, f"{call} gives {got!r}: write the missing lines first"
    got = got.detach().cpu() if hasattr(got, "detach") else got
    try:
        return np.asarray(got, dtype=float)
    except (TypeError, ValueError):
        raise AssertionError(f"{call} gives a {type(got).__name__}, not an array of numbers") from None


def compare(
    call: str, got: object, expected: ArrayLike, mistakes: Mapping[str, ArrayLike] | None = None, atol: float = 1e-5
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
