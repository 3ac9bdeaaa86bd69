"""Dataclasses from JSON objects, checked by their type hints, and back."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from types import UnionType
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

T = TypeVar("T")


def plain(value: Any) -> Any:
    """A value as ``json.dumps`` wants it: dataclasses as objects, tuples as lists.

    Example:
        >>> from detden_lite import Cell
        >>> plain(dict(cells=(Cell("uniform"),)))
        {'cells': [{'attack': 'uniform', 'timing': 'always', 'defense': 'none'}]}
    """
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, dict):
        return {name: plain(part) for name, part in value.items()}
    return [plain(part) for part in value] if isinstance(value, list | tuple) else value


def typed(kind: type[T], content: object, name: str) -> T:
    """An instance of a dataclass from a JSON object, if each entry is of the type that its field has.

    Args:
        kind: a dataclass. Its fields are numbers, strings, dataclasses, mappings, tuples of these, or one of these or
            None; a field whose default is None may be missing.
        content: what ``json.loads`` gives.
        name: of the object, for the error.

    Raises:
        ValueError: if it is no object, lacks an entry, has one too many or one of another type.

    Example:
        >>> from detden_lite import Cell
        >>> typed(Cell, dict(attack="uniform", timing="always", defense="none"), "cell").attack
        'uniform'
    """
    if not isinstance(content, dict):
        raise ValueError(f"{name} must be an object, not {content!r:.40}")
    hints, optional = get_type_hints(kind), {field.name for field in fields(kind) if field.default is None}  # type: ignore[arg-type]  # kind is a dataclass
    if missing := set(hints) - set(content) - optional:
        raise ValueError(f"{name} lacks {', '.join(sorted(missing))}")
    if extra := set(content) - set(hints):
        raise ValueError(f"{name} has an unknown entry: {', '.join(sorted(extra))}")
    return kind(**{key: _value(hints[key], value, key) for key, value in content.items()})


def _value(hint: Any, value: object, name: str) -> object:
    """``value``, with lists as tuples and objects as dataclasses, if it is of this type; a ValueError otherwise."""
    if get_origin(hint) is UnionType:  # with None
        return None if value is None else _value(get_args(hint)[0], value, name)
    if is_dataclass(hint):
        return typed(hint, value, name)  # type: ignore[arg-type]  # a class, since it is a hint
    if get_origin(hint) is tuple and isinstance(value, list):
        kinds = get_args(hint)
        kinds = kinds[:1] * len(value) if kinds[-1] is ... else kinds
        if len(kinds) == len(value):
            return tuple(_value(kind, part, name) for kind, part in zip(kinds, value, strict=True))
    plain = float | int if hint is float else dict if get_origin(hint) is Mapping else hint
    if isinstance(plain, type | UnionType) and isinstance(value, plain) and not isinstance(value, bool):
        return value
    raise ValueError(f"{name} must be of the type {getattr(hint, '__name__', hint)}, not {value!r:.40}")
