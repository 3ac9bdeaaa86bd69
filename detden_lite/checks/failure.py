"""What a student sees when a check does not pass: one message, and no traceback through the check's own code."""

import inspect
import linecache
import re
import textwrap
import traceback
from collections.abc import Callable, Sequence
from functools import wraps
from typing import Any

import numpy as np


class CheckFailed(AssertionError):
    """A result is wrong, or the student's function failed: an error like any other, which Jupyter shows in words.

    Example:
        >>> CheckFailed("f(2) is 5; it should be 4.")._render_traceback_()
        ['Not right yet.', 'f(2) is 5; it should be 4.']
    """

    headline = "Not right yet."

    def _render_traceback_(self) -> list[str]:
        """What IPython prints instead of a traceback."""
        return [self.headline, *textwrap.wrap(str(self), 88, break_long_words=False)]


class NotWritten(CheckFailed, NotImplementedError):
    """The exercise is still as it was handed out."""

    headline = "Not written yet."


_ADVICE = {  # what the words of an error mean for who writes an exercise
    r"missing \d+ required|takes \d+ positional|unexpected keyword": (
        "Keep the first line of the function, with its arguments, as it was given"
    ),
    r"does not require grad": (
        "Autograd follows only tensors that require a gradient; detach(), no_grad() and .data cut it off. Begin with "
        "detach().requires_grad_() where an argument has none"
    ),
    r"numpy\(\) on .*requires grad": "A tensor with a gradient cannot become an array: stay with torch's functions",
    r"in-place operation|leaf Variable": "Do not change an argument in place: make a new tensor, or work on a clone()",
    r"[Bb]oolean value of|truth value of": (
        "`if`, `and`, `or`, `not`, `min()` and `max()` want a single True or False: take torch.where or np.where, "
        "&, |, ~, and the minimum along an axis"
    ),
    r"[Qq]uantile.*(range|must be)|q values must": (
        "A quantile takes a share between 0 and 1. Is the argument a share, or is it the threshold itself?"
    ),
    r"cannot be multiplied|size mismatch|must match|broadcast|mismatch in its core|shape": (
        "The shapes do not fit together: `@` needs the same size in the middle, other operations equal sizes or a size "
        "of 1. x[:, None] adds an axis, x.T swaps two"
    ),
    r"has no attribute '(clamp|norm|square|detach|clone|amax|sigmoid|exp|sign)'": (
        "That is a function of torch; the argument is a NumPy array, or a number"
    ),
    r"has no attribute": "Look at what the docstring says the argument is: a tensor, an array, a function or a number",
    r"[Ee]xpected Tensor|must be Tensor|expected np|not 'numpy|unsupported operand|Concatenation operation": (
        "Two kinds of things meet that do not go together, as a tensor and an array or a function and a number"
    ),
    r"not callable": "Something is called that is no function",
    r"is not defined|referenced before|not associated with a value": (
        "A name is used that neither the function nor an earlier cell defines"
    ),
    r"out of (bounds|range)|too many indices": "An index goes beyond the array: compare it with the shapes",
}


def explained(check: Callable[[Any], None]) -> Callable[[Any], None]:
    """A check whose every failure is a `CheckFailed`, also where the student's function or its result raises an error.

    Args:
        check: takes the student's function; its parameter is called as the function is in the chapter.

    Example:
        >>> @explained
        ... def check_half(half):
        ...     assert half(3.0) == 1.5, "half(3) should be 1.5"
        >>> check_half(lambda x: x / y)
        Traceback (most recent call last):
        detden_lite.checks.failure.CheckFailed: half raises a NameError: name 'y' is not defined. A name is used that \
neither the function nor an earlier cell defines. It was given x = 3.
    """
    name = next(iter(inspect.signature(check).parameters))

    @wraps(check)
    def run(function: Any) -> None:
        if not callable(function):
            raise CheckFailed(f"Give {check.__name__} the function {name} itself, not {_say(function)}.")
        results: list[object] = []
        try:
            check(_guard(function, name, results))
        except CheckFailed:
            raise
        except AssertionError as error:
            raise CheckFailed(f"{str(error).rstrip('.')}.") from None
        except Exception as error:
            given = _say(results[-1]) if results else "nothing"
            raise CheckFailed(
                f"{name} gives {given}, which the check cannot use ({_words(error)}). Compare it with the docstring of "
                f"{name}: what should it give?"
            ) from error

    return run


def _guard(function: Callable, name: str, results: list[object]) -> Callable:
    """The student's function; what it raises becomes a `CheckFailed`, and so it is with a function that it returns."""

    def guarded(*arguments: object) -> object:
        before = [(i, _plain(value).copy()) for i, value in enumerate(arguments) if hasattr(value, "shape")]
        try:
            result = function(*arguments)
        except CheckFailed:
            raise
        except NotImplementedError as error:
            raise NotWritten(
                f"{str(error) or name}. Replace the line `raise NotImplementedError(...)` by your code, and run that "
                "cell before this one."
            ) from None
        except Exception as error:
            if isinstance(error, AssertionError) and _raised_by_a_check(error):
                raise CheckFailed(f"{str(error).rstrip('.')}.") from None
            raise CheckFailed(_explain(error, function, name, arguments)) from error
        for i, kept in before:
            if not np.array_equal(kept, _plain(arguments[i])):
                raise CheckFailed(
                    f"{name} changes its argument {_names(function, arguments)[i]} itself, which others still need: "
                    "make a new array, or work on a copy (.clone() of a tensor, .copy() of an array)."
                )
        results.append(result)
        return _guard(result, f"the function that {name} gives", results) if callable(result) else result

    return guarded


def _raised_by_a_check(error: BaseException) -> bool:
    """Whether a policy, a world or the like, which the check made, refused what it was given."""
    name = ""
    for frame, _ in traceback.walk_tb(error.__traceback__):
        name = frame.f_globals.get("__name__", "")
    return name.startswith("detden_lite.checks")


def _explain(error: Exception, function: Callable, name: str, arguments: Sequence[object]) -> str:
    place = ""
    code = getattr(inspect.unwrap(function), "__code__", None)
    for frame, number in traceback.walk_tb(error.__traceback__):
        if code and frame.f_code.co_filename == code.co_filename:
            line = linecache.getline(code.co_filename, number).strip()
            place = f" at `{line}`" if line and function.__name__ != "<lambda>" else ""
    words = _words(error)
    advice = next((f" {advice}." for pattern, advice in _ADVICE.items() if re.search(pattern, words)), "")
    pairs = zip(_names(function, arguments), arguments, strict=True)
    given = ", ".join(f"{key} = {_say(value)}" for key, value in pairs)
    given = f" It was given {given}." if arguments else ""
    return f"{name} raises {_article(type(error).__name__)}{place}: {words.rstrip('.')}.{advice}{given}"


def _plain(value: Any) -> Any:
    return np.asarray(value.detach() if hasattr(value, "detach") else value)


def _names(function: Callable, arguments: Sequence[object]) -> list[str]:
    """What the function calls its arguments; their numbers, if it does not take so many."""
    try:
        return list(inspect.signature(function).bind(*arguments).arguments)
    except (TypeError, ValueError):
        return [f"argument {i + 1}" for i in range(len(arguments))]


def _words(error: BaseException) -> str:
    """The first line of what an error says; torch adds advice for its own developers below."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]


def _article(noun: str) -> str:
    return f"{'an' if noun[0].lower() in 'aeiou' else 'a'} {noun}"


def _say(value: object) -> str:
    """A value in a few words: a number itself, an array by its shape, anything else by its kind."""
    if isinstance(value, str | bool | None):
        return repr(value)
    if isinstance(value, int | float | np.number):
        return f"{value:g}"
    if hasattr(value, "shape"):
        kind = "an array" if isinstance(value, np.ndarray) else "a tensor"
        return f"{kind} {list(value.shape)}"
    return "a function" if inspect.isroutine(value) else _article(type(value).__name__)
