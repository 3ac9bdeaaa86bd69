"""Tensors of data/: safetensors with a JSON sidecar, checked before use."""

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor

from detden_lite.core.files import ArtifactError
from detden_lite.store.manifest import DATA, REMEDY, read_bytes, read_json, to_json, write_together


def digest(state: Mapping[str, Tensor]) -> str:
    """The SHA-256 of the file that ``save_tensors`` would write."""
    return hashlib.sha256(_bytes(state)).hexdigest()


def save_tensors(path: Path, state: Mapping[str, Tensor], sidecar: Mapping[str, Any], root: Path = DATA) -> None:
    """Write ``path`` (.safetensors) and beside it ``sidecar`` as JSON, both in the manifest."""
    path = Path(path)
    write_together({path: _bytes(state), path.with_suffix(".json"): to_json(sidecar)}, root)


def load_tensors(path: Path, root: Path = DATA) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """The tensors and the sidecar of a .safetensors file.

    Raises:
        ArtifactError: if the file fails the manifest, is no safetensors file (a pickle is never opened), or holds NaN.

    Example:
        >>> state, sidecar = load_tensors(DATA / "hopper-td3" / "detector-diverse.safetensors")
        >>> state["obs_mean"].shape, sidecar["threshold"] > 0
        (torch.Size([11]), True)
    """
    path = Path(path)
    if path.suffix != ".safetensors":
        raise ArtifactError(f"{path} is not a .safetensors file; only those are loaded, never pickles")
    try:
        state = load(read_bytes(path, root))
    except SafetensorError as error:
        raise ArtifactError(f"{path} is not in the safetensors format ({error}); {REMEDY}") from None
    if wrong := [name for name, tensor in state.items() if tensor.isnan().any()]:
        raise ArtifactError(f"{path} holds NaN in {', '.join(wrong)}; make it anew with its recipe")
    return state, read_json(path.with_suffix(".json"), root)


def _bytes(state: Mapping[str, Tensor]) -> bytes:
    return save({name: tensor.contiguous() for name, tensor in state.items()})
