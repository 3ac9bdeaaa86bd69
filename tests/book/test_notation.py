"""The page about notation: its names are those of the code, and its defences those of the library's list."""

import notation

import detden_lite
from detden_lite.defense import variants


def test_names_in_the_code_exist():
    for _, _, names, _ in notation.SYMBOLS:
        for name in filter(None, names.split(", ")):
            first, *rest = name.split(".")
            found = getattr(detden_lite, first)
            for part in rest:
                kept = set(vars(found)) | set(getattr(found, "__annotations__", {}))
                assert part in kept or part in _set_in_init(found), name


def _set_in_init(kind):
    return kind.__init__.__code__.co_names if hasattr(kind.__init__, "__code__") else ()


def test_every_defence_has_a_row():
    for name in variants.VARIANTS:
        assert f"*{name}*" in notation.trained()
    for name in variants.ASSEMBLED:
        assert f"*{name}*" in notation.assembled()


def test_every_setting_that_differs_is_explained():
    keys = {key for variant in variants.VARIANTS.values() for key in variant.recipe}
    lines = notation.settings().splitlines()
    assert {line.split("`")[1] for line in lines} == keys
    assert all(len(line) > len("- `lam`: weight") for line in lines)
