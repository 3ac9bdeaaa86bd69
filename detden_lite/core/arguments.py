"""Checks of arguments that many parts share: each names the argument that is wrong."""

from math import inf, nan
from numbers import Integral, Real


def check_whole(least: int, **values: object) -> None:
    """Refuse what is not a whole number of at least ``least``.

    Raises:
        ValueError: names the argument.

    Example:
        >>> check_whole(1, steps=0)
        Traceback (most recent call last):
        ValueError: steps must be a whole number of at least 1, not 0
    """
    for name, value in values.items():
        if not isinstance(value, Integral) or isinstance(value, bool) or value < least:
            raise ValueError(f"{name} must be a whole number of at least {least}, not {value!r}")


def check_positive(**values: object) -> None:
    """Refuse what is not a finite number above 0; a ValueError names the argument."""
    for name, value in values.items():
        if not 0 < _number(value) < inf:
            raise ValueError(f"{name} must be a finite number above 0, not {value!r}")


def check_between(low: float, high: float, **values: object) -> None:
    """Refuse what is not a finite number from ``low`` to ``high``; a ValueError names the argument."""
    for name, value in values.items():
        if not low <= _number(value) <= high or _number(value) == inf:
            limits = f"at least {low}" if high == inf else f"from {low} to {high}"
            raise ValueError(f"{name} must be a finite number {limits}, not {value!r}")


def check_kind(kind: type, **values: object) -> None:
    """Refuse what is of another kind; the ValueError names the argument."""
    for name, value in values.items():
        if not isinstance(value, kind):
            raise ValueError(f"{name} must be a {kind.__name__}, not {value!r}")


def check_number(**values: object) -> None:
    """Refuse what is no number; infinity is one. The ValueError names the argument."""
    for name, value in values.items():
        if not isinstance(value, Real) or value != value:
            raise ValueError(f"{name} must be a number, not {value!r}")


def _number(value: object) -> float:
    return float(value) if isinstance(value, Real) else nan
