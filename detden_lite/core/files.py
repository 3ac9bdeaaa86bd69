"""Files that are written whole or not at all."""

import errno
import os
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

FULL = (errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC))  # Windows has no quota
FORBIDDEN = (errno.EACCES, errno.EPERM, errno.EROFS)


class ArtifactError(Exception):
    """A file of data/ is missing, altered, or not what it should be; the message says which and what to do."""


def unwritable(path: Path, error: OSError) -> ArtifactError:
    """The error to raise when a file or a folder cannot be written: the remedy depends on the reason.

    Example:
        >>> print(unwritable(Path("a.json"), OSError(errno.ENOSPC, "No space left on device")))
        a.json could not be written (No space left on device); free some space and run again
    """
    remedy = ""
    if error.errno in FULL:
        remedy = "; free some space and run again"
    elif error.errno in FORBIDDEN:
        remedy = "; check the permissions of the file and of its folder"
    return ArtifactError(f"{path} could not be written ({error.strerror or error}){remedy}")


def replace_file(path: Path, content: bytes) -> None:
    """Write a file whole or not at all: after a kill, or on a full disk, the old one is still there.

    Raises:
        ArtifactError: if it cannot be written.
    """
    replace_files({Path(path): content})


def replace_files(files: Mapping[Path, bytes]) -> None:
    """Write files that belong together, all or none: each is written whole before the first takes its place.

    Raises:
        ArtifactError: if one of them cannot be written.
    """
    news = {path: _temporary(path) for path in files}
    try:
        for path, content in files.items():
            news[path].write_bytes(content)
            _sync(news[path])
        for path, new in news.items():
            _take_place(new, path)
    except OSError as error:
        raise unwritable(path, error) from None
    finally:
        for new in news.values():
            new.unlink(missing_ok=True)


@contextmanager
def replacing(path: Path) -> Iterator[str]:
    """The name of a temporary file, with the same suffix, that becomes ``path`` if all goes well.

    Raises:
        ArtifactError: if it cannot be written.
    """
    new = _temporary(path, path.suffix)
    try:
        yield str(new)
        _sync(new)
        _take_place(new, path)
    except OSError as error:
        if error.filename is None or Path(error.filename) in (new, path):
            raise unwritable(path, error) from None
        raise  # another file's error: the body of the ``with`` does more than write
    finally:
        new.unlink(missing_ok=True)


def _temporary(path: Path, suffix: str = "") -> Path:
    """A name of its own beside ``path``: two writers of one file never meet, and a rename stays on one disk."""
    return path.with_name(f"{path.name}.{uuid.uuid4().hex}.new{suffix}")


def _take_place(new: Path, path: Path) -> None:
    os.replace(new, path)
    if os.name != "nt":  # Windows cannot open a folder
        _sync(path.parent)


def _sync(path: Path) -> None:
    """Wait until the disk has it: otherwise a power cut after the rename could leave an empty file."""
    handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
