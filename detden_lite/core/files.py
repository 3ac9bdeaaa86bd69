"""Files that are written whole or not at all."""

import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path


class ArtifactError(Exception):
    """A file of data/ is missing, altered, or not what it should be; the message says which and what to do."""


def unwritable(path: Path, error: OSError) -> ArtifactError:
    """What to raise when the disk refuses a file or a folder."""
    return ArtifactError(f"{path} could not be written ({error.strerror}); free some space and run again")


def replace_file(path: Path, content: bytes) -> None:
    """Write a file whole or not at all: a kill on the way leaves the old one, and so does a full disk.

    Raises:
        ArtifactError: if there is no room for it.
    """
    replace_files({Path(path): content})


def replace_files(files: Mapping[Path, bytes]) -> None:
    """Write files that belong together, all or none: each is written whole before the first takes its place.

    Raises:
        ArtifactError: if there is no room for them.
    """
    news = {path: path.with_name(path.name + ".new") for path in files}
    try:
        for path, content in files.items():
            news[path].write_bytes(content)
        for path, new in news.items():
            os.replace(new, path)
    except OSError as error:
        for new in news.values():
            new.unlink(missing_ok=True)
        raise unwritable(path, error) from None


@contextmanager
def replacing(path: Path) -> Iterator[str]:
    """The name of a temporary file that becomes ``path`` if all goes well."""
    handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=path.suffix)
    os.close(handle)
    try:
        yield temporary
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    finally:
        Path(temporary).unlink(missing_ok=True)
