"""Files that are written whole or not at all."""

import errno
import os
import uuid
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

FULL = (errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC))  # Windows has no quota
FORBIDDEN = (errno.EACCES, errno.EPERM, errno.EROFS)


class ArtifactError(Exception):
    """A file of data/ is missing, altered, or not what it should be; the message says which and what to do.

    Example:
        >>> from detden_lite import load_victim
        >>> try:
        ...     load_victim("hopper", "td3", root=Path("nowhere"))
        ... except ArtifactError as error:
        ...     print(error)
        nowhere/hopper-td3/victim.safetensors is missing
    """


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
    """Write files that belong together: all are written before the first takes its place, and they do so in order.

    If the disk is full, nothing changes. A kill between two of them leaves each whole, the first new and the last old.

    Raises:
        ArtifactError: if one of them cannot be written.
    """
    with ExitStack() as stack:
        # A stack unwinds backwards: the first file takes its place first.
        news = {path: Path(stack.enter_context(replacing(path, ""))) for path in reversed(list(files))}
        for path, content in files.items():
            try:
                news[path].write_bytes(content)
            except OSError as error:
                raise unwritable(path, error) from None


@contextmanager
def replacing(path: Path, suffix: str | None = None) -> Iterator[str]:
    """The name of a temporary file that becomes ``path`` if all goes well.

    Two writers of one file never meet: the name is unique. It is beside ``path``, since a rename stays on one disk.

    Args:
        path: the file to write.
        suffix: of the temporary name; that of ``path`` by default, for writers that go by it.

    Raises:
        ArtifactError: if it cannot be written.
    """
    new = path.with_name(f"{path.name}.{uuid.uuid4().hex}.new{path.suffix if suffix is None else suffix}")
    try:
        yield str(new)
        _sync(new)
        os.replace(new, path)
        with suppress(OSError):  # not every file system, and no Windows, can wait for a folder; the file is in place
            _sync(path.parent)
    except OSError as error:
        if error.filename is None or Path(error.filename) in (new, path):
            raise unwritable(path, error) from None
        raise  # another file's error: the body of the ``with`` does more than write
    finally:
        new.unlink(missing_ok=True)


def _sync(path: Path) -> None:
    """Wait until the disk has it: otherwise a power cut after the rename could leave an empty file."""
    handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
