"""Files of data/, written whole or not at all, with their SHA-256 sums in one manifest."""

import hashlib
import json
import os
import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from filelock import FileLock

from detden_lite.core.files import ArtifactError, replace_files

DATA = Path(os.environ.get("DETDEN_DATA", Path(__file__).resolve().parents[2] / "data"))

REMEDY = "make it anew as it was made, or restore it (what is in data/ with git; data/README.md has its recipe)"


def write_bytes(path: Path, content: bytes, root: Path = DATA) -> None:
    """Write a file of data/ atomically and note its SHA-256 in the manifest of ``root``.

    Raises:
        ArtifactError: if there is no room for it; everything is then as it was.
    """
    write_together({Path(path): content}, root)


def write_together(files: Mapping[Path, bytes], root: Path) -> None:
    """Several processes may write at once: the stages of a recipe run side by side."""
    for path in files:
        path.parent.mkdir(parents=True, exist_ok=True)
    with FileLock(root / ".manifest.lock"):
        sums = {
            path.relative_to(root).as_posix(): hashlib.sha256(content).hexdigest() for path, content in files.items()
        }
        manifest = json.dumps(_manifest(root) | sums, indent=1, sort_keys=True) + "\n"
        replace_files({**files, root / "manifest.json": manifest.encode()})


def read_bytes(path: Path, root: Path = DATA) -> bytes:
    """The content of a file of data/, if it is the one that the manifest promises.

    Raises:
        ArtifactError: if it is missing, not in the manifest, or altered.
    """
    path = Path(path)
    if not path.exists():
        raise ArtifactError(f"{path} is missing; {REMEDY}")
    content = path.read_bytes()
    expected = promised(path, root)
    if expected is None:
        raise ArtifactError(f"{path} is not in {root / 'manifest.json'}; it was not made by a recipe of this project")
    if hashlib.sha256(content).hexdigest() != expected:
        raise ArtifactError(f"{path} is truncated or altered (its SHA-256 is not the manifest's); {REMEDY}")
    return content


def promised(path: Path, root: Path = DATA) -> str | None:
    """The SHA-256 that the manifest has of a file, which may be lost by now; None if it knows none."""
    return _manifest(root).get(Path(path).relative_to(root).as_posix())


def is_made(path: Path, root: Path = DATA) -> bool:
    """Whether a file, and the sidecar of a .safetensors file, are there as the manifest has them."""
    try:
        return all(read_bytes(file, root) for file in {Path(path), Path(path).with_suffix(".json")})
    except ArtifactError:
        return False


def write_json(path: Path, content: Mapping, root: Path = DATA) -> None:
    """Write a JSON file of data/; numbers that are not finite are refused."""
    write_bytes(path, to_json(content), root)


def read_json(path: Path, root: Path = DATA) -> dict:
    """The content of a JSON file of data/, checked against the manifest."""
    return json.loads(read_bytes(path, root))


def versions() -> dict[str, str]:
    """Versions of what a result depends on."""
    found = {"python": platform.python_version()}
    for package in ("torch", "numpy", "gymnasium", "mujoco", "stable-baselines3", "sbx-rl"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            pass
    return found


def _manifest(root: Path) -> dict[str, str]:
    path = root / "manifest.json"
    try:
        return json.loads(path.read_text()) if path.exists() else {}
    except json.JSONDecodeError as error:
        raise ArtifactError(f"{path} is truncated or altered ({error}); {REMEDY}") from None


def to_json(content: Mapping) -> bytes:
    return (json.dumps(content, indent=1, allow_nan=False) + "\n").encode()
