"""What ``make`` refuses, what a failing build leaves behind, and what JupyterLab serves."""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from http.client import HTTPConnection
from pathlib import Path

import pytest
from conftest import ROOT

pytestmark = pytest.mark.skipif(sys.platform == "win32" or not shutil.which("make"), reason="there is no make")

# In the place of jupyter-book, which takes minutes: it writes a page, and then does what the book's source tells it.
BUILDER = f"""#!{sys.executable}
import sys, time
from pathlib import Path
folder = Path(sys.argv[sys.argv.index("--path-output") + 1], "_build", "html")
folder.mkdir(parents=True)
text = Path("book/index.md").read_text()
(folder / "index.html").write_text(text)
if text == "slow":
    Path("begun").touch()
    time.sleep(60)
sys.exit(text == "bad")
"""


def make(folder: Path, *arguments: str, **environment: str) -> subprocess.CompletedProcess:
    return subprocess.run(
        ["make", *arguments], cwd=folder, capture_output=True, text=True, env=os.environ | environment
    )


@pytest.fixture
def checkout(tmp_path) -> Path:
    """The Makefile with what its rules read, and no environment."""
    shutil.copy(ROOT / "Makefile", tmp_path)
    shutil.copytree(ROOT / "data" / "config", tmp_path / "data" / "config")
    (tmp_path / "book").mkdir()
    return tmp_path


@pytest.mark.parametrize("scale", ["huge", "", "lite paper", "../config/lite"])
def test_an_unknown_scale_is_refused_before_anything_is_made(checkout, scale):
    before = sorted(checkout.rglob("*"))
    refused = make(checkout, "data", f"SCALE={scale}")
    assert refused.returncode != 0 and "is unknown; choose one of: lite paper tiny" in refused.stderr
    assert sorted(checkout.rglob("*")) == before


def test_each_scale_has_its_configuration_and_its_folder():
    for scale in ("tiny", "lite", "paper"):
        planned = make(ROOT, "--dry-run", "-o", ".venv/stamp", "data", f"SCALE={scale}").stdout
        assert f"--configfile data/config/{scale}.yaml --directory runs/{scale}" in planned


@pytest.fixture
def book(checkout):
    """A checkout with an environment that has the builder above; its book is built once."""
    binaries = checkout / ".venv" / "bin"
    binaries.mkdir(parents=True)
    (binaries / "python").symlink_to(sys.executable)
    (binaries / "jupyter-book").write_text(BUILDER)
    (binaries / "jupyter-book").chmod(0o755)
    assert build(checkout, "good").returncode == 0
    assert (checkout / "_build" / "html" / "index.html").read_text() == "good"
    return checkout


VENDOR = ("_build/vendor/widgets/embed.js", "_build/vendor/playground/playground.js")
MADE = [part for name in (".venv/stamp", "_build/cache.stamp", *VENDOR) for part in ("-o", name)]


def write(folder: Path, text: str) -> None:
    """A page that is newer than the book, however coarse the clock of the file system is."""
    (folder / "book" / "index.md").write_text(text)
    (folder / "_build" / "html.stamp").unlink(missing_ok=True)


def build(folder: Path, text: str) -> subprocess.CompletedProcess:
    write(folder, text)
    return make(folder, *MADE, "book", "SERVE=0")


def test_a_failing_build_leaves_the_old_book(book):
    assert build(book, "bad").returncode != 0
    assert (book / "_build" / "html" / "index.html").read_text() == "good"
    assert build(book, "better").returncode == 0
    assert (book / "_build" / "html" / "index.html").read_text() == "better"
    assert not (book / "_build" / "old").exists()


def test_an_interrupted_build_leaves_the_old_book(book):
    write(book, "slow")
    quiet = dict(stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
    process = subprocess.Popen(["make", *MADE, "book", "SERVE=0"], cwd=book, **quiet)
    deadline = time.monotonic() + 60
    while process.poll() is None and not (book / "begun").exists():
        assert time.monotonic() < deadline
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGINT)
    assert process.wait() != 0
    assert (book / "_build" / "html" / "index.html").read_text() == "good"
    assert build(book, "better").returncode == 0
    assert (book / "_build" / "html" / "index.html").read_text() == "better"


def test_the_lab_serves_what_the_notebooks_link_to(tmp_path):
    """The server that ``make lab`` starts, without its browser, is asked for a notebook and for a film."""
    options = "LAB=--no-browser --allow-root --ServerApp.port=0 --IdentityProvider.token=secret"
    own = {f"JUPYTER_{kind}_DIR": str(tmp_path / kind) for kind in ("CONFIG", "DATA", "RUNTIME")}  # not the user's
    log, deadline = tmp_path / "log", time.monotonic() + 120
    with log.open("w") as file:
        process = subprocess.Popen(
            ["make", "-o", ".venv/stamp", "lab", options], cwd=ROOT, env=os.environ | own,
            stderr=file, stdout=file, start_new_session=True,
        )  # fmt: skip
    try:
        while not (found := re.search(r"http://127\.0\.0\.1:(\d+)(/lab\S*)\?", log.read_text())):
            assert process.poll() is None and time.monotonic() < deadline, log.read_text()
            time.sleep(0.1)
        assert found[2] == "/lab/tree/notebooks"
        connection = HTTPConnection("127.0.0.1", int(found[1]), timeout=60)
        while connection.sock is None:  # it names its address a moment before it listens
            assert process.poll() is None and time.monotonic() < deadline, log.read_text()
            with suppress(ConnectionRefusedError):
                connection.connect()
            time.sleep(0.1)
        for path in ("notebooks/01-mdp.ipynb", "data/films/hopper-td3-opposite.png", "README.md"):
            connection.request("GET", f"/files/{path}", headers={"Authorization": "token secret"})
            answer = connection.getresponse()
            assert answer.status == 200 and answer.read() == (ROOT / path).read_bytes()
    finally:
        with suppress(ProcessLookupError):  # it has ended by itself
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
