import json
import os
import pickle
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import torch
from builders import make_gruvae, make_victim, normal
from conftest import ROOT

from detden_lite.core.files import ArtifactError
from detden_lite.core.networks import mlp
from detden_lite.store import manifest, models, tensors
from detden_lite.victims.victim import Victim


@pytest.fixture
def root(tmp_path):
    """A data folder with a victim, a defence and a record."""
    models.save_victim("hopper", "td3", make_victim(seed=3), dict(step=7), tmp_path)
    models.save_model("hopper", "td3", "detector-diverse", make_gruvae(), dict(threshold=1.5), tmp_path)
    denoiser = make_gruvae(residual=True)
    models.save_model("hopper", "td3", "denoiser-residual", denoiser, dict(data="diverse"), tmp_path)
    manifest.write_json(tmp_path / "results" / "cell.json", dict(mean=1.5), tmp_path)
    return tmp_path


def read_cell(root) -> dict:
    return manifest.read_json(root / "results" / "cell.json", root)


def test_loading_gives_what_was_saved(root):
    obs = normal(5, 11)
    victim = models.load_victim("hopper", "td3", root)
    assert torch.equal(victim(obs), make_victim(seed=3)(obs)) and torch.equal(
        victim.value(obs), make_victim(seed=3).value(obs)
    )
    model, sidecar = models.load_model("hopper", "td3", "denoiser-residual", root)
    assert torch.equal(model(obs[None]).output, make_gruvae(residual=True)(obs[None]).output)
    assert sidecar["data"] == "diverse" and sidecar["versions"]["torch"].startswith(torch.__version__.split("+")[0])
    defense = models.load_defense("hopper", "td3", "residual", root)
    assert defense.detector.threshold == 1.5 and defense.denoiser.model.config["residual"]
    assert read_cell(root) == dict(mean=1.5)


@pytest.mark.parametrize("gaussian", [False, True])
def test_both_kinds_of_victims_go_to_disk_and_back(tmp_path, gaussian):
    victim, obs = make_victim(gaussian=gaussian), normal(5, 11)
    models.save_victim("hopper", "any", victim, {}, tmp_path)
    again = models.load_victim("hopper", "any", tmp_path)
    assert torch.equal(again(obs), victim(obs)) and (again.action_std is None) == (not gaussian)


def truncate(path):
    path.write_bytes(path.read_bytes()[:-10])


def alter(path):
    content = bytearray(path.read_bytes())
    content[-10] ^= 1
    path.write_bytes(content)


class Bomb:
    def __reduce__(self):
        return os._exit, (1,)  # what a pickle may do to whoever opens it


def replace_by_pickle(path):
    path.write_bytes(pickle.dumps(Bomb()))


@pytest.mark.parametrize("harm", [truncate, alter, replace_by_pickle, os.remove])
@pytest.mark.parametrize("name", ["victim.safetensors", "victim.json"])
def test_a_harmed_file_is_refused_by_name(root, harm, name):
    harm(root / "hopper-td3" / name)
    with pytest.raises(ArtifactError, match=name):
        models.load_victim("hopper", "td3", root)


@pytest.mark.parametrize("harm", [truncate, alter, os.remove])
def test_a_harmed_record_is_refused_by_name(root, harm):
    harm(root / "results" / "cell.json")
    with pytest.raises(ArtifactError, match="cell.json"):
        read_cell(root)


@pytest.mark.parametrize("harm", [truncate, os.remove])
def test_without_a_whole_manifest_nothing_is_trusted(root, harm):
    harm(root / "manifest.json")
    with pytest.raises(ArtifactError, match="manifest.json"):
        models.load_victim("hopper", "td3", root)


def test_a_pickle_in_the_manifest_is_not_opened(root):
    manifest.write_bytes(root / "hopper-td3" / "victim.safetensors", pickle.dumps(Bomb()), root)
    with pytest.raises(ArtifactError, match="victim.safetensors.*safetensors format"):
        models.load_victim("hopper", "td3", root)
    manifest.write_bytes(root / "victim.pkl", pickle.dumps(Bomb()), root)
    with pytest.raises(ArtifactError, match="victim.pkl.*never pickles"):
        tensors.load_tensors(root / "victim.pkl", root)


def test_a_file_that_the_manifest_lacks_is_refused(root):
    (root / "results" / "foreign.json").write_text("{}")
    with pytest.raises(ArtifactError, match="foreign.json is not in .*manifest.json"):
        manifest.read_json(root / "results" / "foreign.json", root)


def test_weights_that_do_not_fit_their_sidecar_are_refused(root):
    folder = root / "hopper-td3"
    for broken in (dict(config=dict(actor=[11, 9, 3])), dict(config=dict(color="red")), {}):
        manifest.write_json(folder / "victim.json", broken, root)
        with pytest.raises(ArtifactError, match="victim.safetensors does not fit its sidecar"):
            models.load_victim("hopper", "td3", root)


def test_numbers_that_json_does_not_know_are_refused(root):
    with pytest.raises(ValueError):
        manifest.write_json(root / "results" / "cell.json", dict(mean=float("nan")), root)
    assert read_cell(root) == dict(mean=1.5)


def test_a_file_is_made_if_its_sidecar_is_too(root):
    victim, record = root / "hopper-td3" / "victim.safetensors", root / "results" / "cell.json"
    assert manifest.is_made(victim, root) and manifest.is_made(record, root)
    victim.with_suffix(".json").unlink()
    truncate(record)
    assert not manifest.is_made(victim, root) and not manifest.is_made(record, root)
    assert not manifest.is_made(root / "results" / "other.json", root)


CRITIC = [14, 8, 1]


@pytest.fixture
def ppo(tmp_path) -> Victim:
    """A shipped PPO victim with a critic that was learned and shipped afterwards, and the victim as it was."""
    victim = make_victim(gaussian=True)
    models.save_victim("hopper", "ppo", victim, {}, tmp_path)
    tensors.save_tensors(tmp_path / "hopper-ppo" / "critic.safetensors", critic().state_dict(), CARD, tmp_path)
    return victim


CARD = dict(critic=CRITIC, activation="relu")


def critic():
    torch.manual_seed(4)
    return mlp(CRITIC)


def test_a_learned_critic_comes_with_its_victim(tmp_path, ppo):
    loaded, obs, action = models.load_victim("hopper", "ppo", tmp_path), normal(6, 11), normal(6, 3, seed=1)
    assert torch.equal(loaded.q(obs, action), critic()(loaded.critic_input(obs, action)).squeeze(-1))
    for name in ("forward", "mean", "value"):  # V is the value network's still
        assert torch.equal(getattr(loaded, name)(obs), getattr(ppo, name)(obs))
    (gradient,) = torch.autograd.grad(loaded.q(obs, action.requires_grad_()).sum(), action)
    assert (gradient != 0).any(-1).all()
    (tmp_path / "hopper-ppo" / "critic.safetensors").unlink()
    with pytest.raises(ValueError, match="no Q-function"):  # the recipe learns it again
        models.load_victim("hopper", "ppo", tmp_path).q(obs, action)


@pytest.mark.parametrize("harm", [truncate, alter, replace_by_pickle])
@pytest.mark.parametrize("name", ["critic.safetensors", "critic.json"])
def test_a_harmed_critic_is_refused_by_name(tmp_path, ppo, harm, name):
    harm(tmp_path / "hopper-ppo" / name)
    with pytest.raises(ArtifactError, match=name):
        models.load_victim("hopper", "ppo", tmp_path)


@pytest.mark.parametrize(
    "card",
    [{}, dict(CARD, critic=[14, 9, 1]), dict(CARD, critic=[11, 8, 1]), dict(CARD, activation="elu")],
)
def test_a_critic_that_does_not_fit_is_refused(tmp_path, ppo, card):
    manifest.write_json(tmp_path / "hopper-ppo" / "critic.json", card, tmp_path)
    with pytest.raises(ArtifactError, match="critic.safetensors does not fit its sidecar"):
        models.load_victim("hopper", "ppo", tmp_path)


def test_weights_whose_sidecar_cannot_be_written_are_not_replaced(root):
    path = root / "hopper-td3" / "victim.safetensors"
    before = everything(root)
    with pytest.raises(ValueError):
        tensors.save_tensors(path, make_victim(seed=9).state_dict(), dict(mean=float("nan")), root)
    assert everything(root) == before


def everything(root) -> dict[str, bytes]:
    return {path.relative_to(root).as_posix(): path.read_bytes() for path in root.rglob("*") if path.is_file()}


FULL_DISK = """
import json, pathlib, resource, signal, sys
import torch
from detden_lite.store import manifest, tensors, models
from detden_lite.core import files
from detden_lite.core.types import Trajectories
from detden_lite.training.gruvae_training import VAERecipe, train_gruvae

root, large = pathlib.Path(sys.argv[1]), "x" * 10_000
waves = Trajectories(torch.rand(8, 20, 3).numpy(), torch.full((8,), 20).numpy())

def train(after_epoch=None):
    train_gruvae(VAERecipe(epochs=2, batch=4), [(waves, waves)], 0, root / "model.ckpt", after_epoch)

def interrupt(*_):
    raise KeyboardInterrupt

try:
    train(interrupt)
except KeyboardInterrupt:
    kept = (root / "model.ckpt").read_bytes()
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)

def try_with(quota, write, *arguments):
    resource.setrlimit(resource.RLIMIT_FSIZE, (quota, resource.RLIM_INFINITY))
    try:
        write(*arguments)
    except files.ArtifactError as error:
        print(error)
    else:
        print("written")

cell, victim = root / "results" / "cell.json", root / "hopper-td3" / "victim.safetensors"
size = (root / "manifest.json").stat().st_size
try_with(1_000, manifest.write_bytes, cell, large.encode(), root)
try_with(1_000, manifest.write_json, root / "results" / "new.json", dict(more=large), root)
try_with(1_000, tensors.save_tensors, victim, dict(weight=torch.zeros(5_000)), dict(step=8), root)
try_with(1_000, tensors.save_tensors, victim, dict(weight=torch.zeros(5)), dict(more=large), root)
try_with(size, manifest.write_json, root / "results" / "more.json", dict(mean=2.5), root)
try_with(1_000, train)
assert (root / "model.ckpt").read_bytes() == kept
try_with(resource.RLIM_INFINITY, train)  # it goes on from there
assert (root / "model.ckpt").read_bytes() != kept
(root / "model.ckpt").unlink()
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such quota")
def test_a_full_disk_leaves_every_file_as_it_was(root):
    """A quota of this many bytes a file. In the fifth case there is room for the file, but not for the manifest."""
    before = everything(root)
    found = subprocess.run([sys.executable, "-c", FULL_DISK, str(root)], capture_output=True, text=True, check=True)
    lines = found.stdout.splitlines()
    names = ["cell.json", "new.json", "victim.safetensors", "victim.json", "manifest.json", "model.ckpt"]
    assert lines.pop() == "written"
    for line, name in zip(lines, names, strict=True):
        assert re.search(rf"{name} could not be written \(.+\); free some space and run again$", line)
    assert everything(root) == before  # and so nothing by the name of .new
    assert manifest.is_made(root / "hopper-td3" / "victim.safetensors", root)


KILLED_WRITE = """
import os, pathlib, re, signal, sys
from detden_lite.store import manifest

root, name = pathlib.Path(sys.argv[1]), sys.argv[2]
write_whole = pathlib.Path.write_bytes

def write(self, content):
    if not re.fullmatch(name, self.name):
        return write_whole(self, content)
    with open(self, "wb") as file:
        file.write(content[: len(content) // 2])
        file.flush()
        os.kill(os.getpid(), signal.SIGKILL)

pathlib.Path.write_bytes = write
manifest.write_json(root / "results" / "cell.json", dict(mean=2.5, more="x" * 1000), root)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")
@pytest.mark.parametrize("name", [r"cell\.json\..+\.new", r"cell\.json"])
def test_a_kill_while_writing_leaves_the_old_file(root, name):
    """The process dies with half of the new content written; to the file itself it never writes."""
    status = subprocess.run([sys.executable, "-c", KILLED_WRITE, str(root), name]).returncode
    assert (status, read_cell(root)["mean"]) == ((-9, 1.5) if name.endswith("new") else (0, 2.5))
    manifest.write_json(root / "results" / "cell.json", dict(mean=3.5), root)
    assert read_cell(root) == dict(mean=3.5)


KILLED_REPLACEMENT = """
import os, pathlib, signal, sys
from detden_lite.store import manifest

replace = os.replace

def replace_and_die(source, target):
    replace(source, target)
    os.kill(os.getpid(), signal.SIGKILL)

os.replace = replace_and_die
root = pathlib.Path(sys.argv[1])
manifest.write_together({root / "new.json": b"{}", root / "other.json": b"{}"}, root)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")
def test_the_manifest_promises_only_files_in_their_place(root):
    """A process that dies between two replacements has replaced the first file, and the manifest would be the last."""
    before = (root / "manifest.json").read_bytes()
    assert subprocess.run([sys.executable, "-c", KILLED_REPLACEMENT, str(root)]).returncode == -9
    assert (root / "manifest.json").read_bytes() == before
    assert (root / "new.json").exists() and not (root / "other.json").exists()


def test_the_manifest_lists_the_files_of_parallel_writers(tmp_path):
    def write(i):
        manifest.write_json(tmp_path / f"{i}.json", dict(i=i), tmp_path)

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(write, range(100)))
    assert set(json.loads((tmp_path / "manifest.json").read_text())) == {f"{i}.json" for i in range(100)}


@pytest.mark.parametrize("kind", ["optimal", "linear"])
def test_an_adversary_goes_to_disk_and_back(tmp_path, kind):
    adversary, obs = Victim([11, 8, 11] if kind == "optimal" else [11, 11], gaussian=True), normal(5, 11)
    models.save_adversary("hopper", "td3", kind, adversary, dict(step=7), tmp_path)
    assert torch.equal(models.load_adversary("hopper", "td3", kind, tmp_path)(obs), adversary(obs))
    other = "linear" if kind == "optimal" else "optimal"
    with pytest.raises(ArtifactError, match="adversary.*is missing"):
        models.load_adversary("hopper", "td3", other, tmp_path)


def test_a_model_that_is_no_adversary_is_refused(tmp_path):
    models.save_adversary("hopper", "td3", "optimal", make_victim(), {}, tmp_path)
    with pytest.raises(ArtifactError, match="adversary.safetensors does not fit .*11 observations to 3 perturbations"):
        models.load_adversary("hopper", "td3", "optimal", tmp_path)
    with pytest.raises(ValueError, match="kind must be one of optimal, linear, offset, director, .*, not 'best'"):
        models.load_adversary("hopper", "td3", "best", tmp_path)


@pytest.mark.parametrize(
    "content",
    [b"", b"[]", b"null", b'"text"', b"{", b"\xff\xfe{}", b'{"a": 3}', b'{"a": null}', b'{"a": {}}', b"[" * 100_000],
    ids=range(10),
)
def test_a_damaged_manifest_is_refused_by_name(root, content):
    (root / "manifest.json").write_bytes(content)
    for use in (
        lambda: models.load_victim("hopper", "td3", root),
        lambda: read_cell(root),
        lambda: manifest.write_json(root / "new.json", {}, root),
    ):
        with pytest.raises(ArtifactError, match=r"manifest\.json is .*restore it"):
            use()
    assert not (root / "new.json").exists()


@pytest.mark.parametrize(
    "content",
    [b"", b"[]", b"null", b"3", b"{", b"\xff{}", b'{"a": NaN}', b'{"a": [-Infinity]}', b"[" * 100_000],
    ids=range(9),
)
def test_a_file_without_a_json_object_is_refused(root, content):
    manifest.write_bytes(root / "results" / "cell.json", content, root)
    with pytest.raises(ArtifactError, match=r"cell\.json is not a JSON object.*restore it"):
        read_cell(root)


def test_a_path_outside_the_root_is_refused(root, tmp_path_factory):
    other = tmp_path_factory.mktemp("other") / "cell.json"
    for path in (other, root / ".." / "cell.json", root / "results" / ".." / ".." / "cell.json"):
        with pytest.raises(ArtifactError, match=r"cell\.json is not in .+; give a path inside"):
            manifest.write_json(path, {}, root)
        path.write_text("{}")
        for use in (manifest.read_json, manifest.read_bytes, manifest.promised):
            with pytest.raises(ArtifactError, match=r"cell\.json is not in .+; give a path inside"):
                use(path, root)
        path.unlink()
    with pytest.raises(ArtifactError, match="give a path inside"):
        models.load_victim("../hopper", "td3", root)


def test_relative_and_absolute_paths_mean_the_same_file(root, monkeypatch):
    monkeypatch.chdir(root)
    assert manifest.read_json(Path("results/cell.json"), root) == dict(mean=1.5)
    assert manifest.read_json(root / "results" / "cell.json", Path(".")) == dict(mean=1.5)


def test_a_folder_in_the_place_of_a_file_is_refused(root):
    (root / "results" / "cell.json").unlink()
    (root / "results" / "cell.json").mkdir()
    with pytest.raises(ArtifactError, match=r"cell\.json could not be read"):
        read_cell(root)


WRONG_CARDS = [
    dict(threshold=True), dict(threshold=None), dict(threshold="high"), dict(threshold=[1.5]),
    {}, dict(data="diverse"),
]  # fmt: skip


@pytest.mark.parametrize("change", WRONG_CARDS, ids=str)
def test_a_detector_without_a_proper_threshold_is_refused(root, change):
    path = root / "hopper-td3" / "detector-diverse.json"
    card = {name: value for name, value in manifest.read_json(path, root).items() if name != "threshold"}
    manifest.write_json(path, card | change, root)
    with pytest.raises(ArtifactError, match=r"detector-diverse\.json .*threshold.*make .* anew"):
        models.load_defense("hopper", "td3", "residual", root)


@pytest.mark.parametrize("threshold", [b"NaN", b"Infinity", b"1e999"])
def test_a_threshold_that_is_not_finite_is_refused(root, threshold):
    path = root / "hopper-td3" / "detector-diverse.json"
    manifest.write_bytes(path, path.read_bytes().replace(b"1.5", threshold), root)
    with pytest.raises(ArtifactError, match=r"detector-diverse\.json .*anew"):
        models.load_defense("hopper", "td3", "residual", root)


@pytest.mark.parametrize("data", [None, 3, ["diverse"], "../../x"])
def test_a_denoiser_must_name_the_data_of_its_detector(root, data):
    path = root / "hopper-td3" / "denoiser-residual.json"
    card = {name: value for name, value in manifest.read_json(path, root).items() if name != "data"}
    for changed in (card, card | dict(data=data)):
        manifest.write_json(path, changed, root)
        with pytest.raises(
            ArtifactError, match=r"denoiser-residual\.json .*data.*anew|detector-.* is missing|give a path"
        ):
            models.load_defense("hopper", "td3", "residual", root)


def cut(tensor):
    return tensor[..., :-1].clone()


@pytest.mark.parametrize("harm", [cut, lambda tensor: tensor.fill_(float("nan"))], ids=["shape", "nan"])
@pytest.mark.parametrize("name", ["victim", "detector-diverse", "denoiser-residual"])
def test_weights_of_a_wrong_shape_or_nan_are_refused(root, harm, name):
    path = root / "hopper-td3" / f"{name}.safetensors"
    state, card = tensors.load_tensors(path, root)
    weight = next(name for name, tensor in state.items() if tensor.ndim == 2)
    tensors.save_tensors(path, state | {weight: harm(state[weight])}, card, root)
    with pytest.raises(ArtifactError, match=rf"{name}\.safetensors .*make .* anew"):
        models.load_victim("hopper", "td3", root)
        models.load_defense("hopper", "td3", "residual", root)


@pytest.mark.parametrize(
    "config", [None, [], 3, "text", {}, dict(actor="text"), dict(actor=[]), dict(actor=[11, "8", 3])]
)
def test_a_sidecar_with_a_wrong_configuration_is_refused(root, config):
    path = root / "hopper-td3" / "victim.json"
    manifest.write_json(path, manifest.read_json(path, root) | dict(config=config), root)
    with pytest.raises(ArtifactError, match=r"victim\.safetensors does not fit its sidecar .*make both anew"):
        models.load_victim("hopper", "td3", root)


def test_an_unknown_model_is_refused_with_those_there(root):
    for use, known in (
        (lambda: models.load_victim("hoper", "td3", root), "hopper-td3"),
        (lambda: models.load_victim("hopper", "sac", root), "hopper-td3"),
        (lambda: models.load_model("hopper", "td3", "detector-best", root), "detector-diverse"),
        (lambda: models.load_model("hopper", "td3", "best", root), "denoiser-residual, detector-diverse, victim"),
        (lambda: models.load_defense("hopper", "td3", "best", root), "denoiser-residual"),
        (lambda: models.load_adversary("hopper", "td3", "linear", root), "denoiser-residual, detector-diverse, victim"),
    ):
        with pytest.raises(ArtifactError, match=rf"is missing; there are: {known}$"):
            use()


FIND = "from detden_lite.store.manifest import DATA; print(DATA)"
LOAD = "from detden_lite import load_record, load_victim; load_{}"


def python(program: str, data: str | None) -> subprocess.CompletedProcess:
    """Run a program with this DETDEN_DATA, or without one."""
    environment = {name: value for name, value in os.environ.items() if name != "DETDEN_DATA"}
    environment |= {} if data is None else dict(DETDEN_DATA=data)
    return subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True)


def test_the_data_folder_is_the_named_one_or_the_repositorys(tmp_path):
    for named, expected in ((str(tmp_path), tmp_path), ("", ROOT / "data"), (None, ROOT / "data")):
        assert Path(python(FIND, named).stdout.strip()) == expected


@pytest.mark.parametrize("what", ["victim('hopper', 'td3')", "record('hopper-td3.none.always.none')"])
def test_a_data_folder_without_data_names_the_variable_to_set(tmp_path, what):
    error = python(LOAD.format(what), str(tmp_path)).stderr
    assert re.search(r"ArtifactError: .+ is missing; .+: let the environment variable DETDEN_DATA name", error), error
