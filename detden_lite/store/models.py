"""The models in data/, by victim: the victim itself, its adversaries, its detectors and denoisers."""

from collections.abc import Callable, Mapping
from pathlib import Path

import torch

from detden_lite.core.files import ArtifactError
from detden_lite.defense.denoiser import Denoiser
from detden_lite.defense.detector import Detector
from detden_lite.defense.gruvae import GRUVAE
from detden_lite.defense.pipeline import DetectAndDenoise
from detden_lite.store.manifest import DATA, versions
from detden_lite.store.tensors import load_tensors, save_tensors
from detden_lite.victims.victim import Victim


def save_victim(task: str, algo: str, victim: Victim, sidecar: Mapping, root: Path = DATA) -> None:
    """Ship a victim as ``<task>-<algo>/victim``."""
    sidecar = dict(sidecar, config=victim.config, versions=versions())
    save_tensors(root / f"{task}-{algo}" / "victim.safetensors", victim.state_dict(), sidecar, root)


def load_victim(task: str, algo: str, root: Path = DATA) -> Victim:
    """The shipped victim of a task ("hopper") and an algorithm ("td3"), with its learned Q-function if it has one."""
    folder = root / f"{task}-{algo}"
    victim, _ = _build(
        lambda card, state: Victim.from_state(card["config"], state), folder / "victim.safetensors", root
    )
    if not (folder / "critic.safetensors").exists():
        return victim
    with_critic, _ = _build(
        lambda card, state: victim.with_critic(card["critic"], state, card["activation"]),
        folder / "critic.safetensors", root,
    )  # fmt: skip
    return with_critic


def save_model(task: str, algo: str, name: str, model: GRUVAE, sidecar: Mapping, root: Path = DATA) -> None:
    """Ship a GRU-VAE as ``<task>-<algo>/<name>``."""
    sidecar = dict(sidecar, config=model.config, versions=versions())
    save_tensors(root / f"{task}-{algo}" / f"{name}.safetensors", model.state_dict(), sidecar, root)


def load_model(task: str, algo: str, name: str, root: Path = DATA) -> tuple[GRUVAE, dict]:
    """A shipped GRU-VAE ("detector-diverse", "denoiser-residual") and its sidecar."""
    return _build(
        lambda card, state: GRUVAE.from_state(card["config"], state),
        root / f"{task}-{algo}" / f"{name}.safetensors", root,
    )  # fmt: skip


def load_defense(task: str, algo: str, variant: str = "mixed", root: Path = DATA) -> DetectAndDenoise:
    """A shipped defence of a victim: a variant's denoiser with the detector of the same data and its threshold."""
    denoiser, sidecar = load_model(task, algo, f"denoiser-{variant}", root)
    detector, calibration = load_model(task, algo, f"detector-{sidecar['data']}", root)
    return DetectAndDenoise(Detector(detector, calibration["threshold"]), Denoiser(denoiser))


# By kind: learned by reinforcement on the bare victim, a linear map, and learned on the victim with its defence.
ADVERSARIES = {"optimal": "adversary", "linear": "adversary-linear", "adaptive-optimal": "adversary-adaptive"}


def adversary_path(task: str, algo: str, kind: str, root: Path = DATA) -> Path:
    """Where the adversary of this kind, a key of ``ADVERSARIES``, is."""
    if kind not in ADVERSARIES:
        raise ValueError(f"kind must be one of {', '.join(ADVERSARIES)}, not {kind!r}")
    return root / f"{task}-{algo}" / f"{ADVERSARIES[kind]}.safetensors"


def save_adversary(task: str, algo: str, kind: str, adversary: Victim, sidecar: Mapping, root: Path = DATA) -> None:
    """Ship an adversary of a victim; see ``adversary_path`` for the kinds."""
    sidecar = dict(sidecar, config=adversary.config, versions=versions())
    save_tensors(adversary_path(task, algo, kind, root), adversary.state_dict(), sidecar, root)


def load_adversary(task: str, algo: str, kind: str = "optimal", root: Path = DATA) -> Victim:
    """A shipped adversary, for ``OptimalAttack``: its actions are perturbations in units of the ball's radius.

    Args:
        task: of the victim that it learned to harm ("hopper").
        algo: that victim's algorithm ("td3").
        kind: a key of ``ADVERSARIES``.
        root: as data/ is laid out.
    """
    adversary, _ = _build(_adversary, adversary_path(task, algo, kind, root), root)
    return adversary


def _adversary(card: dict, state: dict) -> Victim:
    adversary = Victim.from_state(card["config"], state)
    if adversary.obs_dim != adversary.action_dim:
        raise ValueError(f"it maps {adversary.obs_dim} observations to {adversary.action_dim} perturbations")
    return adversary


def _build(make: Callable[[dict, dict], torch.nn.Module], path: Path, root: Path) -> tuple[torch.nn.Module, dict]:
    state, sidecar = load_tensors(path, root)
    try:
        return make(sidecar, state), sidecar
    except (KeyError, RuntimeError, TypeError, ValueError) as error:
        raise ArtifactError(f"{path} does not fit its sidecar ({error}); make both anew with their recipe") from None
