"""The checkpoint of a training: arrays and whole numbers, never a pickle, with a SHA-256 that is checked before use.

``checkpoint/model-<segments>.npz`` has the networks with their optimizers' state, the random keys, the replay buffer
(TD3), the statistics of the normaliser, the counters and the last returns. ``checkpoint/segments.json`` says which such
file holds, and its SHA-256. It is replaced last and at once, so that a kill at any time leaves a whole checkpoint.
"""

import hashlib
import json
import zipfile
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from detden_lite.core.files import ArtifactError, replace_file, replacing

if TYPE_CHECKING:
    from sbx import PPO, TD3

STATES = ("actor_state", "qf_state", "vf_state")  # of a policy of sbx-rl: parameters and optimizers
BUFFER = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
ADVERSARY = "adversary."  # before the names of the arrays of an adversary who learns with the model
COUNTERS = ("num_timesteps", "_n_updates", "_episode_num")


def save(model: "TD3 | PPO", checkpoint: Path, segments: int) -> None:
    """Replace the checkpoint by one of a model that has been trained for so many segments.

    Raises:
        ArtifactError: if it cannot be written; the one before is then as it was.
    """
    checkpoint.mkdir(exist_ok=True)
    record, path = checkpoint / "segments.json", checkpoint / f"model-{segments}.npz"
    if not record.exists():  # from here on a model without a record is damage, and no first checkpoint under way
        replace_file(record, json.dumps(dict(segments=0, first=path.name)).encode())
    with replacing(path) as new:
        np.savez(new, segments=np.array(segments), **_arrays(model))  # type: ignore[arg-type] # none is "allow_pickle"
        digest = _sha256(Path(new))
    replace_file(record, json.dumps(dict(segments=segments, sha256={path.name: digest})).encode())
    for other in {*checkpoint.iterdir()} - {record, path}:
        other.unlink()


def load(model: "TD3 | PPO", checkpoint: Path) -> int:
    """Put a checkpoint's state into a new model of the same recipe; the number of segments that it was trained for.

    A first checkpoint that was never finished is removed, and the number is 0.

    Raises:
        ArtifactError: if the checkpoint is damaged, of an earlier version, or of another model; nothing in it is run.
    """
    record = checkpoint / "segments.json"
    remedy = f"restore it, or remove {checkpoint} to train anew"
    if not any(checkpoint.glob("model-*.npz")) and not record.exists():
        return 0
    try:
        said = json.loads(record.read_text())
        segments = said["segments"]
        models = [*checkpoint.glob("model-*.npz")]  # whole, or a temporary file of one that was being written
        unfinished = segments == 0 and all(path.name.startswith(said["first"]) for path in models)
        path = checkpoint / f"model-{segments}.npz"
        expected = None if unfinished else said["sha256"][path.name]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise ArtifactError(f"{record} is missing, damaged, or of an earlier version; {remedy}") from None
    if unfinished:
        for path in (*models, record):  # the record last: a kill between them leaves one that says so again
            path.unlink()
        return 0
    try:
        found = _sha256(path)
    except OSError as error:
        raise ArtifactError(f"{path} cannot be read ({error.strerror}); {remedy}") from None
    if found != expected:
        raise ArtifactError(f"{path} is truncated or altered (its SHA-256 is not that of {record.name}); {remedy}")
    try:
        with np.load(path, allow_pickle=False) as arrays:
            if arrays["segments"] != segments:
                raise ValueError(f"it was written after segment {arrays['segments']}")
            _restore(model, arrays)
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise ArtifactError(f"{path} does not fit this recipe ({error}); {remedy}") from None
    return segments


def _places(model: "TD3 | PPO") -> dict[str, tuple[object, str]]:
    """Owner and attribute of each array, apart from networks, transitions and returns."""
    owners = dict(policy=(model.policy, ("key", "noise_key")), model=(model, COUNTERS))
    if buffer := getattr(model, "replay_buffer", None):
        owners["buffer"] = (buffer, ("pos", "full"))
    if (normalizer := model.get_vec_normalize_env()) is not None:
        owners |= {name: (getattr(normalizer, name), ("mean", "var", "count")) for name in ("obs_rms", "ret_rms")}
    return {f"{name}.{part}": (owner, part) for name, (owner, parts) in owners.items() for part in parts}


def _arrays(model: "TD3 | PPO") -> dict[str, np.ndarray]:
    import jax

    found = {name: np.asarray(getattr(*place)) for name, place in _places(model).items()}
    for name in STATES:
        leaves = jax.tree_util.tree_leaves(getattr(model.policy, name, None))
        found |= {f"{name}.{i}": np.asarray(leaf) for i, leaf in enumerate(leaves)}
    if buffer := getattr(model, "replay_buffer", None):
        found |= {name: getattr(buffer, name)[: buffer.size()] for name in BUFFER}
    found["episodes"] = np.array([[e["r"], e["l"], e["t"]] for e in model.ep_info_buffer or ()]).reshape(-1, 3)
    if adversary := getattr(model, "adversary", None):
        found |= {f"{ADVERSARY}{name}": array for name, array in _arrays(adversary).items()}
    return found


def _restore(model: "TD3 | PPO", arrays: Mapping[str, np.ndarray]) -> None:
    import jax

    for name, (owner, part) in _places(model).items():
        setattr(owner, part, arrays[name][()])
    for name in (name for name in STATES if hasattr(model.policy, name)):
        leaves, tree = jax.tree_util.tree_flatten(getattr(model.policy, name))
        found = [jax.numpy.asarray(arrays[f"{name}.{i}"]) for i in range(len(leaves))]
        if [leaf.shape for leaf in found] != [np.shape(leaf) for leaf in leaves]:
            raise ValueError(f"{name} has other sizes")
        setattr(model.policy, name, jax.tree_util.tree_unflatten(tree, found))
    if buffer := getattr(model, "replay_buffer", None):
        for name in BUFFER:
            getattr(buffer, name)[: buffer.size()] = arrays[name]
    episodes = [dict(r=r, l=length, t=t) for r, length, t in arrays["episodes"].tolist()]
    model.ep_info_buffer, model.ep_success_buffer = (deque(e, maxlen=model._stats_window_size) for e in (episodes, ()))
    if adversary := getattr(model, "adversary", None):
        own = {name.removeprefix(ADVERSARY): name for name in arrays if name.startswith(ADVERSARY)}
        _restore(adversary, {name: arrays[whole] for name, whole in own.items()})


def _sha256(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
