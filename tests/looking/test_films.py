"""Films and stills. A GL driver renders them in a separate process: MUJOCO_GL is read when Python starts."""

import os
import pickle
import subprocess
import sys
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from builders import BUDGET, HOPPER, make_defense, make_victim, run_with_gl
from PIL import Image

from detden_lite.attacks.noise import UniformNoise
from detden_lite.looking import films, renderer, takes
from detden_lite.simulation.rollout import rollout

SCRIPT = """
import pickle, sys
from pathlib import Path
from detden_lite.looking import films
folder = Path(sys.argv[1])
task, episodes = pickle.loads((folder / "episodes").read_bytes())
films.still(folder / "still.png", task, episodes, seconds=0.0, width=120)
films.still(folder / "after.png", task, episodes, seconds=9.0, width=120)
films.filmstrip(folder / "strip.png", task, episodes, seconds=[0.0, 0.1], width=120)
films.film(folder / "film.mp4", task, episodes, seconds=0.2, fps=25, width=120)
films.film(folder / "slow.mp4", task, episodes, seconds=0.4, fps=25, width=120, speed=0.5)
"""


@pytest.fixture(scope="module")
def kinds():
    victim, noise = make_victim(), UniformNoise(BUDGET, seed=1)
    return {
        "clean": rollout(victim, HOPPER, [3], steps=60),
        "attacked": rollout(victim, HOPPER, [3], attack=noise, steps=10),
        "defended": rollout(victim, HOPPER, [3], attack=noise, defense=make_defense(), steps=60),
    }


@pytest.fixture(scope="module")
def folder(kinds, tmp_path_factory) -> Path:
    """A folder with a film and stills that were just made."""
    folder = tmp_path_factory.mktemp("films")
    (folder / "episodes").write_bytes(pickle.dumps((HOPPER, kinds)))
    run_with_gl(SCRIPT, folder)
    return folder


def test_the_film_is_what_browsers_play(folder):
    reader = imageio_ffmpeg.read_frames(folder / "film.mp4")
    about = next(reader)
    frames = list(reader)
    assert (about["codec"], about["fps"], about["size"]) == ("h264", 25.0, (360, 120 + renderer.CAPTION))
    assert about["pix_fmt"].startswith("yuv420p")
    assert len(frames) == 5
    assert frames[0] != frames[-1]
    boxes = (folder / "film.mp4").read_bytes()
    assert boxes.index(b"moov") < boxes.index(b"mdat"), "a browser must find the index before the pictures"
    assert len(boxes) < 40_000


def test_half_the_speed_doubles_the_frames(folder):
    fast, slow = (list(imageio_ffmpeg.read_frames(folder / name))[1:] for name in ("film.mp4", "slow.mp4"))
    assert len(slow) == 2 * len(fast)
    for frame, twice in zip(fast, slow[::2], strict=True):
        one, other = (np.frombuffer(picture, np.uint8).astype(int) for picture in (frame, twice))
        assert np.abs(one - other).mean() < 3  # except for the codec's losses


def test_a_still_shows_each_robot_in_its_colour(folder):
    picture = np.asarray(Image.open(folder / "still.png").convert("RGB")).astype(int)
    assert picture.shape == (120 + renderer.CAPTION, 360, 3)
    for position, colour in enumerate(takes.TAKE_COLOURS[:3]):
        robot = picture[:120, 120 * position : 120 * (position + 1)]
        direction = np.array(colour) / np.linalg.norm(colour)
        bright = robot[np.linalg.norm(robot, axis=-1) > 120]
        alike = (bright @ direction) / np.linalg.norm(bright, axis=-1) > 0.98
        assert alike.sum() > 50


def test_a_robot_whose_episode_ended_early_is_grey(folder):
    before, after = (
        np.asarray(Image.open(folder / name).convert("RGB")).astype(int) for name in ("still.png", "after.png")
    )
    fallen = slice(120, 240)
    assert (np.ptp(before[:120, fallen], axis=-1) > 60).sum() > 50
    assert (np.ptp(after[:120, fallen], axis=-1) > 60).sum() == 0


def test_a_filmstrip_has_kinds_as_rows_and_times_as_columns(folder):
    picture = Image.open(folder / "strip.png")
    assert picture.size == (2 * 120, 3 * (120 + renderer.CAPTION))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda path, kinds: films.film(path / "film.avi", HOPPER, kinds), "must end in .mp4"),
        (lambda path, kinds: films.film(path / "film.mp4", HOPPER, kinds, fps=0), "fps"),
        (lambda path, kinds: films.film(path / "film.mp4", HOPPER, kinds, speed=0), "speed"),
        (lambda path, kinds: films.film(path / "film.mp4", HOPPER, kinds, width=121), "width"),
        (lambda path, kinds: films.film(path / "film.mp4", HOPPER, {}), "at least one kind"),
        (lambda path, kinds: films.film(path / "film.mp4", HOPPER, kinds, index=1), "index"),
        (lambda path, kinds: films.filmstrip(path / "strip.png", HOPPER, kinds, seconds=[]), "seconds is empty"),
        (lambda path, kinds: films.still(path / "still.png", HOPPER, kinds, seconds=-1.0), "seconds"),
    ],
)
def test_bad_arguments_are_refused_before_anything_is_rendered(tmp_path, kinds, make, message):
    with pytest.raises(ValueError, match=message):
        make(tmp_path, kinds)
    assert list(tmp_path.iterdir()) == []


def test_without_a_driver_the_error_says_what_to_install(tmp_path, kinds):
    (tmp_path / "episodes").write_bytes(pickle.dumps((HOPPER, kinds)))
    environment = os.environ | {"MUJOCO_GL": "disable"}
    done = subprocess.run([sys.executable, "-c", SCRIPT, tmp_path], env=environment, capture_output=True, text=True)
    assert done.returncode != 0
    assert "RuntimeError: MuJoCo cannot render" in done.stderr and "MUJOCO_GL=egl" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["episodes"]
