"""Files of data/, written whole or not at all, with their SHA-256 sums in one manifest."""

import hashlib
import json
import os
import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NoReturn

from filelock import FileLock

from detden_lite.core.files import ArtifactError, replace_files, unwritable

PACKAGED = Path(__file__).resolve().parents[1] / "data"  # the small models in an installed wheel; not in a checkout


def find_data() -> Path:
    """The folder of the shipped files.

    It is the one that the environment variable ``DETDEN_DATA`` names; else data/ of the checkout that this package is
    in; else the part of it that is in the installed package.
    """
    if named := os.environ.get("DETDEN_DATA"):
        return Path(named)
    repository = PACKAGED.parents[1] / "data"
    # Beside an installed package there may be a data/ of another one.
    return repository if (repository / "Snakefile").exists() else PACKAGED


DATA = find_data()

REMEDY = "make it anew as it was made, or restore it (files of data/ with git; data/README.md has their recipe)"


def write_bytes(path: Path, content: bytes, root: Path = DATA) -> None:
    """Write a file of data/ atomically and note its SHA-256 in the manifest of ``root``.

    Args:
        path: inside ``root``.
        content: of the file.
        root: as data/ is laid out.

    Raises:
        ArtifactError: if it cannot be written, or is not inside ``root``; everything is then as it was.
    """
    write_together({Path(path): content}, root)


def write_together(files: Mapping[Path, bytes], root: Path) -> None:
    """Write files that belong together, and note them in the manifest, which is replaced last.

    Several processes may write at once, such as the stages of a recipe that run side by side.

    Raises:
        ArtifactError: if one of them cannot be written, or is not inside ``root``; if the disk is full, everything is
            then as it was.
    """
    sums = {_name(path, root): hashlib.sha256(content).hexdigest() for path, content in files.items()}
    try:
        for path in files:
            path.parent.mkdir(parents=True, exist_ok=True)
        lock = FileLock(root / ".manifest.lock")
        lock.acquire()
    except OSError as error:
        raise unwritable(Path(error.filename or root), error) from None
    try:
        manifest = json.dumps(_manifest(root) | sums, indent=1, sort_keys=True) + "\n"
        replace_files({**files, root / "manifest.json": manifest.encode()})
    finally:
        lock.release()


def read_bytes(path: Path, root: Path = DATA) -> bytes:
    """The content of a file of data/, if it is the one that the manifest promises.

    Raises:
        ArtifactError: if it is missing, not in the manifest, altered, or not inside ``root``.
    """
    path = Path(path)
    expected = promised(path, root)
    if not path.exists():
        raise ArtifactError(f"{path} is missing; {where_else(root) or REMEDY}")
    if expected is None:
        raise ArtifactError(f"{path} is not in {root / 'manifest.json'}; it was not made by a recipe of this project")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ArtifactError(f"{path} could not be read ({error.strerror or error}); {REMEDY}") from None
    if hashlib.sha256(content).hexdigest() != expected:
        raise ArtifactError(f"{path} is truncated or altered (its SHA-256 is not the manifest's); {REMEDY}")
    return content


def promised(path: Path, root: Path = DATA) -> str | None:
    """The SHA-256 that the manifest has of a file, which may be lost by now; None if the manifest does not list it."""
    return _manifest(root).get(_name(path, root))


def is_made(path: Path, root: Path = DATA) -> bool:
    """Whether a file, and the sidecar of a .safetensors file, are there as the manifest has them."""
    try:
        return all(read_bytes(file, root) for file in {Path(path), Path(path).with_suffix(".json")})
    except ArtifactError:
        return False


def write_json(path: Path, content: Mapping[str, Any], root: Path = DATA) -> None:
    """Write a JSON file of data/.

    Raises:
        ArtifactError: as ``write_bytes`` does.
        ValueError: if it holds a number that is not finite.
    """
    write_bytes(path, to_json(content), root)


def read_json(path: Path, root: Path = DATA) -> dict[str, Any]:
    """The content of a JSON file of data/, checked against the manifest.

    Raises:
        ArtifactError: if it is missing, not in the manifest, altered, or no JSON object; JSON has no NaN.

    Example:
        >>> read_json(DATA / "hopper-td3" / "victim.json")["recipe"]["task"]
        'hopper'
    """
    return _object(read_bytes(path, root), path)


def versions() -> dict[str, str]:
    """Versions of the packages that a result depends on."""
    found = {"python": platform.python_version()}
    for package in ("torch", "numpy", "gymnasium", "mujoco", "stable-baselines3", "sbx-rl"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            pass
    return found


def to_json(content: Mapping[str, Any]) -> bytes:
    """The bytes of a JSON file of data/; a ValueError for a number that is not finite.

    Example:
        >>> to_json(dict(mean=1.5))
        b'{\\n "mean": 1.5\\n}\\n'
    """
    return (json.dumps(content, indent=1, allow_nan=False) + "\n").encode()


def _object(content: bytes, path: Path) -> dict[str, Any]:
    def refuse(number: str) -> NoReturn:
        raise ValueError(f"{number} is not a number of JSON")

    try:
        found = json.loads(content, parse_constant=refuse)
    except (ValueError, RecursionError) as error:  # text that is not UTF-8 is a ValueError, too
        raise ArtifactError(f"{path} is not a JSON object ({error}); {REMEDY}") from None
    if not isinstance(found, dict):
        raise ArtifactError(f"{path} is not a JSON object but {type(found).__name__}; {REMEDY}")
    return found


def _manifest(root: Path) -> dict[str, str]:
    path = Path(root) / "manifest.json"
    found = _object(path.read_bytes(), path) if path.exists() else {}
    if not all(isinstance(digest, str) for digest in found.values()):
        raise ArtifactError(f"{path} is truncated or altered (not all of its sums are strings); {REMEDY}")
    return found


def _name(path: Path, root: Path) -> str:
    """The name in the manifest."""
    inside = Path(os.path.relpath(path, root)) if os.path.splitdrive(path)[0] == os.path.splitdrive(root)[0] else None
    if inside is None or ".." in inside.parts:
        raise ArtifactError(f"{path} is not in {root}; give a path inside of it")
    return inside.as_posix()


def where_else(root: Path) -> str | None:
    """Where to find shipped files that this root lacks; None for a root that is not ``DATA``, such as a run's."""
    if Path(root) == PACKAGED:
        hint = "the installed package has the smaller models alone"
    elif Path(root) == DATA and not (DATA / "manifest.json").exists():
        hint = f"{root} has no manifest.json"
    else:
        return None
    return f"{hint}: let the environment variable DETDEN_DATA name the folder data/ of a checkout of the repository"
