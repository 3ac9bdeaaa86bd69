import errno
import os
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from detden_lite.core.files import ArtifactError, replace_file, replace_files, replacing, unwritable


@pytest.mark.parametrize(
    ("code", "remedy"),
    [
        (errno.ENOSPC, "; free some space and run again"),
        (errno.EFBIG, "; free some space and run again"),
        (errno.EACCES, "; check the permissions"),
        (errno.EPERM, "; check the permissions"),
        (errno.EROFS, "; check the permissions"),
        (errno.EIO, ")"),
    ],
)
def test_the_remedy_depends_on_the_reason(code, remedy):
    said = str(unwritable(Path("a.json"), OSError(code, os.strerror(code))))
    assert said.startswith(f"a.json could not be written ({os.strerror(code)})")
    assert remedy in said and ("space and run" in said) == ("space and run" in remedy)


def test_a_folder_that_is_not_there_is_named(tmp_path):
    path = tmp_path / "gone" / "a.json"
    with pytest.raises(ArtifactError, match=r"a.json could not be written \(No such file or directory\)$"):
        replace_file(path, b"")
    with pytest.raises(ArtifactError, match="a.json could not be written"), replacing(path) as new:
        Path(new).write_bytes(b"")


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_may_not_be_written_is_not_full(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(ArtifactError, match="check the permissions"):
        replace_file(tmp_path / "a.json", b"")


def test_two_writers_of_one_file_never_meet(tmp_path):
    path, contents = tmp_path / "a.json", [bytes([i]) * 100_000 for i in range(16)]
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda content: replace_file(path, content), contents))
    assert path.read_bytes() in contents
    assert [file.name for file in tmp_path.iterdir()] == ["a.json"]


def test_files_that_belong_together_are_written_all_or_none(tmp_path):
    first, second = tmp_path / "a", tmp_path / "gone" / "b"
    first.write_bytes(b"old")
    with pytest.raises(ArtifactError, match="b could not be written"):
        replace_files({first: b"new", second: b"new"})
    assert first.read_bytes() == b"old" and [file.name for file in tmp_path.iterdir()] == ["a"]


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "film.mp4"
    path.write_bytes(b"old")
    with pytest.raises(KeyError), replacing(path) as new:
        assert Path(new).suffix == ".mp4" and Path(new).parent == tmp_path
        Path(new).write_bytes(b"half")
        raise KeyError
    assert path.read_bytes() == b"old" and [file.name for file in tmp_path.iterdir()] == ["film.mp4"]


def test_the_error_of_another_file_stays_what_it_is(tmp_path):
    with pytest.raises(FileNotFoundError), replacing(tmp_path / "film.mp4"):
        open(tmp_path / "other.txt")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has other permissions")
def test_a_new_file_has_the_permissions_of_any_other(tmp_path):
    (tmp_path / "plain").write_bytes(b"")
    replace_file(tmp_path / "a", b"")
    with replacing(tmp_path / "b.txt") as new:
        Path(new).write_bytes(b"")
    assert len({(tmp_path / name).stat().st_mode for name in ("plain", "a", "b.txt")}) == 1
