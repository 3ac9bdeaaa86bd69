"""The film of all attacks and their recordings; a GL driver renders them in a separate process."""

import json

import imageio_ffmpeg
from builders import make_gruvae, run_with_gl, ship_victim
from PIL import Image

from detden_lite.defense.variants import MAIN
from detden_lite.looking import renderer
from detden_lite.recipe import publish
from detden_lite.recipe.run import Run
from detden_lite.store import manifest, models
from detden_lite.victims.victim import Victim

SCRIPT = """
import sys
from detden_lite.recipe.cli import main
main(["gallery", "--root", sys.argv[1], "--attacks", "opposite", "qfunction", "optimal"])
"""


def test_all_attacks_are_filmed_together_and_recorded_singly(tmp_path):
    root = tmp_path / "run"
    ship_victim(root)
    models.save_model("hopper", "td3", "detector-diverse", make_gruvae(), dict(threshold=1.0), root)
    models.save_model("hopper", "td3", f"denoiser-{MAIN}", make_gruvae(), dict(data="diverse"), root)
    manifest.write_json(root / "hopper-td3" / "timing.json", dict(c_vul=0.0, attack_rate=0.5), root)
    curve = dict(recipe=dict(steps=2), steps=[2], mean=[1.0])
    card = dict(recipe=curve["recipe"], selection_mean=1.0, clean_mean=2.0, learning_curves=[curve])
    models.save_adversary("hopper", "td3", "optimal", Victim([11, 11]), card, root)
    run_with_gl(SCRIPT, root)

    about = next(imageio_ffmpeg.read_frames(root / "films" / "hopper-td3-attacks.mp4"))
    assert about["codec"] == "h264" and about["size"] == (4 * 220, 220 + renderer.CAPTION)
    assert about["duration"] <= 0.9, "at most 50 steps of 8 ms, half as fast"
    assert Image.open(root / "films" / "hopper-td3-attacks.png").size == about["size"]
    assert Image.open(root / "films" / "hopper-td3-qfunction.png").size == (900, 300 + renderer.CAPTION)
    assert {path.stem for path in (root / "recordings").iterdir()} == {"hopper-td3-qfunction", "hopper-td3-optimal"}

    publish.publish(Run.of(root, "hopper", "td3", "tiny"), tmp_path / "data")
    found = json.loads((tmp_path / "data" / "manifest.json").read_text())
    assert {"films/hopper-td3-attacks.mp4", "recordings/hopper-td3-qfunction.rrd"} <= set(found)


def test_an_episode_under_a_stealthy_attack_is_recorded(tmp_path):
    ship_victim(tmp_path)
    models.save_model("hopper", "td3", "detector-diverse", make_gruvae(), dict(threshold=1.0), tmp_path)
    models.save_model("hopper", "td3", f"denoiser-{MAIN}", make_gruvae(), dict(data="diverse"), tmp_path)
    manifest.write_json(tmp_path / "hopper-td3" / "timing.json", dict(c_vul=0.0, attack_rate=0.5), tmp_path)
    command = 'main(["slip", "--root", sys.argv[1]])'
    run_with_gl(f"import sys\nfrom detden_lite.recipe.cli import main\n{command}", tmp_path)
    assert Image.open(tmp_path / "films" / "hopper-td3-stealthy.png").size == (900, 300 + renderer.CAPTION)
    assert (tmp_path / "recordings" / "hopper-td3-stealthy.rrd").stat().st_size > 10_000
