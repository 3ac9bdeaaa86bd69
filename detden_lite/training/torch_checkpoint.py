"""The checkpoint of a training: after a kill it goes on from the last finished epoch."""

import io
import json
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import nn

from detden_lite.core.files import ArtifactError, replace_file

Parts = Mapping[str, nn.Module | torch.optim.Optimizer]


def save_checkpoint(path: Path, identity: Mapping[str, object], epochs: int, parts: Parts) -> None:
    """Write a checkpoint whole or not at all.

    Args:
        path: the file; its folder is made.
        identity: the training's settings, ready for JSON.
        epochs: how many are finished.
        parts: whose states are kept, by name.
    """
    states = {name: part.state_dict() for name, part in parts.items()}
    torch.save(dict(identity=json.dumps(identity), epochs=epochs, **states), file := io.BytesIO())
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_file(path, file.getvalue())


def resume(path: Path, identity: Mapping[str, object], defaults: Mapping[str, object], parts: Parts) -> int:
    """Load a checkpoint into ``parts``, and say how many epochs are finished; 0 without a file.

    Nothing in the file is executed. A setting that it does not mention did not exist when it was written, and had the
    value that is now the default.

    Args:
        path: from ``save_checkpoint``.
        identity: the training's settings, which must be those of the checkpoint.
        defaults: of the settings.
        parts: take the states of the checkpoint.

    Raises:
        ArtifactError: if the file is damaged, or not such a checkpoint.
        ValueError: if the checkpoint is of other settings.
    """
    if not path.exists():
        return 0
    content = path.read_bytes()
    try:
        saved = torch.load(io.BytesIO(content), weights_only=True)
        if {**defaults, **json.loads(saved["identity"])} == json.loads(json.dumps(identity)):
            for name, part in parts.items():
                part.load_state_dict(saved[name])
            return int(saved["epochs"])
    except Exception as error:  # torch, pickle and zipfile raise almost anything
        raise ArtifactError(f"{path} is damaged, or no checkpoint of this training; remove it to start anew") from error
    raise ValueError(
        f"{path} is a checkpoint of another recipe ({saved['identity']}); remove it or choose another file"
    )
