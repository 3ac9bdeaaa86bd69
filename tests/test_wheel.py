"""The wheel: built, installed into a fresh environment, and used outside the repository."""

import json
import os
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest
from conftest import ROOT

MODELS = [(task, "td3") for task in ("hopper", "walker2d", "halfcheetah")]
MODELS += [(task, "ppo") for task in ("hopper", "walker2d", "halfcheetah", "swimmer")]

IMPORT = """
import detden_lite
from detden_lite import DATA, Budget, DetectAndDenoise, defend, load_defense, load_victim, rollout
print(detden_lite.__file__, DATA, sep="\\n")
"""

USE = (
    IMPORT
    + f"""
from detden_lite import Threat, get_task, victim_cards

for task, algo in {MODELS}:
    victim, defense = load_victim(task, algo), load_defense(task, algo)
    threat = Threat(Budget(get_task(task).epsilon), steps=2)
    attack = threat.attack("opposite", victim, get_task(task))
    episodes = rollout(victim, get_task(task), [0, 1], attack=attack, defense=defense, steps=3)
    assert episodes.attacked.all() and episodes.mask.all()
    assert victim_cards.load_card(task, algo).algo == algo
assert len(victim_cards.load_cards()) == 6
"""
)


LACKING = """
from detden_lite import ArtifactError, load_record

for load, *arguments in (
    (load_victim, "ant", "td3"), (load_defense, "hopper", "td3", "paper"), (load_record, "hopper-td3.none.always.none")
):
    try:
        load(*arguments)
    except ArtifactError as error:
        print(error)
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> Path:
    """The interpreter of a fresh environment that has the wheel, and finds its dependencies in this one."""
    folder = tmp_path_factory.mktemp("wheel")
    uv = [sys.executable, "-m", "uv", "--offline", "--quiet"]
    build = ["build", "--no-build-isolation", "--python", sys.executable, "--out-dir", folder]
    subprocess.run([*uv, *build, ROOT], check=True)
    subprocess.run([*uv, "venv", "--python", sys.executable, folder / "venv"], check=True)
    python = folder / "venv" / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    (wheel,) = folder.glob("*.whl")
    subprocess.run([*uv, "pip", "install", "--python", python, "--no-deps", wheel], check=True)
    found = subprocess.run(
        [python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"],
        capture_output=True,
        text=True,
        check=True,
    )
    # After the fresh environment's own packages; the .pth file of this environment's editable checkout is not read.
    Path(found.stdout.strip(), "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return python


def use(python: Path, program: str, folder: Path, **variables: str) -> subprocess.CompletedProcess:
    """Run a program with the installed package, outside the repository."""
    environment = {name: value for name, value in os.environ.items() if name not in ("DETDEN_DATA", "PYTHONPATH")}
    command = [str(python), "-c", program]
    return subprocess.run(command, cwd=folder, env=environment | variables, capture_output=True, text=True)


def test_the_packaged_victims_and_defences_work(installed, tmp_path):
    found = use(installed, USE, tmp_path)
    assert found.returncode == 0, found.stderr
    module, data = map(Path, found.stdout.splitlines()[:2])
    assert module.is_relative_to(installed.parents[1]) and data == module.parent / "data"


EXTRAS = ("stable_baselines3", "sbx", "jax", "flax", "matplotlib", "ipywidgets", "IPython", "rerun", "imageio_ffmpeg")

WITHOUT_EXTRAS = f"""
import sys

class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {EXTRAS}:
            raise ImportError(f"{{name}} is no dependency of the library's core")

sys.meta_path.insert(0, Blocked())
"""


def test_the_packaged_models_need_no_optional_dependency(installed, tmp_path):
    found = use(installed, WITHOUT_EXTRAS + USE, tmp_path)
    assert found.returncode == 0, found.stderr


def test_the_packaged_files_are_those_of_the_repository(installed, tmp_path):
    found = use(installed, "from detden_lite.store.manifest import DATA; print(DATA)", tmp_path)
    data = Path(found.stdout.strip())
    packaged, shipped = (json.loads((root / "manifest.json").read_text()) for root in (data, ROOT / "data"))
    assert packaged and packaged.items() <= shipped.items()
    files = {path.relative_to(data).as_posix() for path in data.rglob("*") if path.is_file()}
    assert files == set(packaged) | {"manifest.json"}
    assert sum((data / name).stat().st_size for name in files) < 10e6


def test_what_the_wheel_lacks_is_asked_for_by_name(installed, tmp_path):
    found = use(installed, IMPORT + LACKING, tmp_path)
    assert found.returncode == 0, found.stderr
    victim, defense, record = found.stdout.splitlines()[2:]
    assert "there are: halfcheetah-ppo, halfcheetah-td3, hopper-ppo" in victim
    assert "there are: denoiser-mixed;" in defense
    for error in (victim, defense, record):
        assert "is missing; " in error and "let the environment variable DETDEN_DATA name the folder data/" in error


def test_a_named_folder_goes_before_the_packaged_one(installed, tmp_path):
    found = use(installed, f"{IMPORT}load_defense('hopper', 'td3', 'paper')", tmp_path, DETDEN_DATA=str(ROOT / "data"))
    assert found.returncode == 0, found.stderr
    assert found.stdout.splitlines()[1] == str(ROOT / "data")


def test_a_named_folder_without_data_is_refused_with_a_remedy(installed, tmp_path):
    found = use(installed, f"{IMPORT}load_victim('hopper', 'td3')", tmp_path, DETDEN_DATA=str(tmp_path))
    assert "ArtifactError" in found.stderr and "let the environment variable DETDEN_DATA name" in found.stderr


def test_the_console_script_is_installed(installed, tmp_path):
    script = installed.with_name("detden.exe" if os.name == "nt" else "detden")
    found = subprocess.run([script, "--version"], capture_output=True, text=True, cwd=tmp_path)
    assert found.returncode == 0 and found.stdout.startswith("detden "), found.stderr
