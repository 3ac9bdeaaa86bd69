"""The rooms of the library: who imports whom, what an import loads, and the public face."""

import importlib
import re
import subprocess
import sys
from collections import Counter

import pytest
from conftest import ROOT

import detden_lite

PACKAGE = ROOT / "detden_lite"

READ_RECORDS = """
from detden_lite.core.tasks import ALGORITHMS, TASKS
from detden_lite.results import adaptive_attacks, bare_victims, defended_victims, records, table, victim_cards
from detden_lite.store.manifest import DATA

assert table.collect_records(DATA)
assert all(records.load_record(path.stem) for path in (DATA / "results").glob("*.json"))
assert victim_cards.load_cards()
for task in TASKS:
    for algo in ALGORITHMS:
        bare_victims.load_bare(task, algo)
        defended_victims.load_defended(task, algo)
        adaptive_attacks.load_adaptive(task, algo)
"""


def loaded_by(program: str) -> set[str]:
    """The top-level packages that a fresh interpreter has loaded after this program."""
    program += "\nimport sys; print(*sorted({name.partition('.')[0] for name in sys.modules}))"
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=ROOT)
    assert found.returncode == 0, found.stderr
    return set(found.stdout.splitlines()[-1].split())


def test_the_defense_loads_no_simulator():
    """All of its modules in one interpreter: what none of them loads together, none loads alone."""
    modules = [f"detden_lite.defense.{path.stem}" for path in (PACKAGE / "defense").glob("*.py")]
    assert len(modules) > 5
    assert not loaded_by(f"import {', '.join(modules)}") & {"mujoco", "gymnasium"}


def test_reading_records_loads_neither_torch_nor_simulator():
    assert not loaded_by(READ_RECORDS) & {"torch", "mujoco", "gymnasium"}


def test_importing_the_package_loads_no_library():
    assert not loaded_by("import detden_lite") & {"torch", "numpy", "mujoco", "gymnasium", "matplotlib"}


def test_every_public_name_is_importable_and_listed():
    listed = set(dir(detden_lite))
    for name in detden_lite.__all__:
        assert getattr(detden_lite, name) is not None
        assert name in listed
    assert len(detden_lite.__all__) == len(set(detden_lite.__all__))


def test_an_unknown_public_name_raises_attribute_error():
    with pytest.raises(AttributeError, match="'detden_lite' has no attribute 'Bugdet'"):
        detden_lite.Bugdet  # noqa: B018
    with pytest.raises(ImportError, match="Bugdet"):
        exec("from detden_lite import Bugdet")


def test_rooms_import_only_from_those_below():
    command = [sys.executable, "-c", "from importlinter.cli import lint_imports_command; lint_imports_command()"]
    found = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert found.returncode == 0, found.stdout


def test_every_module_lives_in_a_room():
    assert {path.name for path in PACKAGE.glob("*.py")} == {"__init__.py", "__main__.py"}
    assert (PACKAGE / "py.typed").exists()
    assert all((path.parent / "__init__.py").exists() for path in PACKAGE.glob("*/*.py"))


def test_no_two_modules_share_a_name():
    """Those of ``checks`` are named after what they check."""
    modules = [path.stem for path in PACKAGE.glob("*/*.py") if path.parent.name != "checks" and path.stem[0] != "_"]
    assert [name for name, n in Counter(modules).items() if n > 1] == []


def test_every_module_and_room_says_what_it_is_for():
    for path in PACKAGE.rglob("*.py"):
        if path.name != "__main__.py":
            name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
            assert importlib.import_module(name).__doc__, name


def test_the_types_of_the_public_face_are_those_that_it_loads():
    """``__init__.pyi`` is what type checkers read: it names what ``__init__.py`` offers, from the same modules."""
    stub = (PACKAGE / "__init__.pyi").read_text("utf-8")
    named = re.findall(r"^from detden_lite\.([\w.]+) import (\w+) as \2$", stub, re.M)
    assert sorted(named) == sorted(
        [(module, name) for module, names in detden_lite._FACE.items() for name in names.split()]
        + [tuple(module.rsplit(".", 1)) for module in detden_lite._MODULES]
    )


@pytest.mark.slow
def test_a_type_checker_knows_the_public_face(tmp_path):
    script = tmp_path / "user.py"
    script.write_text(
        "from detden_lite import Budget, catalogue\nb: Budget = Budget(0.1)\nn: int = len(catalogue.FOUR)\n"
    )
    command = [sys.executable, "-m", "mypy", "--config-file=", "--cache-dir", tmp_path / "cache", script]
    checked = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert checked.returncode == 0, checked.stdout
