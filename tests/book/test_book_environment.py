"""environment.lock holds what pyproject.toml asks for, with hashes, and names no host."""

import re
import tomllib

from conftest import ROOT
from packaging.requirements import Requirement

LOCK = (ROOT / "environment.lock").read_text(encoding="utf-8")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
STANZAS = re.findall(r"^([a-z0-9][^=\s]*)==([^\s;]+)(.*(?:\n    --hash=.*)*)", LOCK, re.M)


def test_everything_asked_for_is_locked_in_a_version_that_is_allowed():
    asked = PROJECT["dependencies"] + [line for extra in PROJECT["optional-dependencies"].values() for line in extra]
    locked: dict[str, list[str]] = {}
    for name, version, _ in STANZAS:
        locked.setdefault(name, []).append(version)
    for requirement in map(Requirement, asked):
        if requirement.name != PROJECT["name"]:
            assert locked.get(requirement.name), f"{requirement.name} is not in environment.lock: make lock"
            assert all(requirement.specifier.contains(version) for version in locked[requirement.name]), requirement


def test_every_package_has_hashes_and_the_lock_names_no_host():
    assert len(STANZAS) > 100 and all("--hash=sha256:" in rest for _, _, rest in STANZAS)
    assert not re.search(r"https?://|index-url|find-links", LOCK)


def test_recordings_and_their_viewer_are_of_one_version():
    versions = {name: version for name, version, _ in STANZAS}
    assert versions["rerun-sdk"] == versions["rerun-notebook"]
