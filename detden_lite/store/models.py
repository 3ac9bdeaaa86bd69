"""The models in data/, by victim: the victim itself, its adversaries, its detectors and denoisers."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from torch import Tensor

from detden_lite.core.budget import Budget
from detden_lite.core.files import ArtifactError
from detden_lite.defense.denoiser import Denoiser
from detden_lite.defense.detector import Detector
from detden_lite.defense.dynamics import Dynamics
from detden_lite.defense.gruvae import GRUVAE
from detden_lite.defense.pipeline import DetectAndDenoise
from detden_lite.defense.predict_correct import PredictCorrect, Surprise
from detden_lite.defense.variants import VARIANTS
from detden_lite.store.manifest import DATA, promised, versions, where_else
from detden_lite.store.tensors import load_tensors, save_tensors
from detden_lite.victims.victim import Victim

M = TypeVar("M")


def save_victim(task: str, algo: str, victim: Victim, sidecar: Mapping[str, Any], root: Path = DATA) -> None:
    """Ship a victim as ``<task>-<algo>/victim``."""
    sidecar = dict(sidecar, config=victim.config, versions=versions())
    save_tensors(root / f"{task}-{algo}" / "victim.safetensors", victim.state_dict(), sidecar, root)


def load_victim(task: str, algo: str, root: Path = DATA) -> Victim:
    """A shipped victim, with its learned Q-function if it has one.

    Args:
        task: "hopper".
        algo: "td3".
        root: as data/ is laid out.

    Raises:
        ArtifactError: if there is no such victim, and the error lists those that there are; or if it is damaged.

    Example:
        >>> victim = load_victim("hopper", "td3")
        >>> victim.obs_dim, victim.action_dim
        (11, 3)
    """
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


def save_model(
    task: str, algo: str, name: str, model: GRUVAE | Dynamics, sidecar: Mapping[str, Any], root: Path = DATA
) -> None:
    """Ship a network of a defence as ``<task>-<algo>/<name>``."""
    sidecar = dict(sidecar, config=model.config, versions=versions())
    save_tensors(root / f"{task}-{algo}" / f"{name}.safetensors", model.state_dict(), sidecar, root)


def load_model(task: str, algo: str, name: str, root: Path = DATA) -> tuple[GRUVAE, dict[str, Any]]:
    """A shipped GRU-VAE and its sidecar.

    Args:
        task: of its victim ("hopper").
        algo: that victim's algorithm ("td3").
        name: "detector-diverse", "denoiser-mixed".
        root: as data/ is laid out.

    Raises:
        ArtifactError: if there is no such model, and the error lists those that there are; or if it is damaged.

    Example:
        >>> model, sidecar = load_model("hopper", "td3", "denoiser-mixed")
        >>> model.obs_dim, sidecar["data"]
        (11, 'diverse')
    """
    return _build(
        lambda card, state: GRUVAE.from_state(card["config"], state),
        root / f"{task}-{algo}" / f"{name}.safetensors", root,
    )  # fmt: skip


def load_defense(task: str, algo: str, variant: str = "mixed", root: Path = DATA) -> DetectAndDenoise:
    """A shipped defence of a victim: a variant's denoiser with the detector of the same data and its threshold.

    Args:
        task: of the victim ("hopper").
        algo: the victim's algorithm ("td3").
        variant: a key of ``detden_lite.defense.variants.VARIANTS``.
        root: as data/ is laid out.

    Raises:
        ArtifactError: if there is no such defence, and the error lists those that there are; or if it is damaged.

    Example:
        >>> import torch
        >>> defense = load_defense("hopper", "td3")
        >>> defense.reset([0])
        >>> bool(defense(torch.full((1, 11), 9.0)).alarm)
        True
    """
    if variant in VARIANTS and VARIANTS[variant].predicts:
        return _load_predicting(task, algo, f"denoiser-{variant}", root)
    denoiser, sidecar = load_model(task, algo, f"denoiser-{variant}", root)
    if not isinstance(data := sidecar.get("data"), str):
        raise _wrong_card(task, algo, f"denoiser-{variant}", f"data is {data!r} instead of the name of a dataset", root)
    detector, calibration = load_model(task, algo, f"detector-{data}", root)
    threshold = calibration.get("threshold")
    if isinstance(threshold, bool) or not isinstance(threshold, int | float) or not abs(threshold) < float("inf"):
        raise _wrong_card(task, algo, f"detector-{data}", f"threshold is {threshold!r:.40} instead of a number", root)
    return DetectAndDenoise(Detector(detector, threshold), Denoiser(denoiser))


def _load_predicting(task: str, algo: str, name: str, root: Path) -> DetectAndDenoise:
    def filter(card: Mapping[str, Any], state: Mapping[str, Tensor]) -> PredictCorrect:
        ball = card["budget"]
        budget = Budget(float(ball["epsilon"]), float(ball["norm"]), ball["scale"])
        return PredictCorrect(Dynamics.from_state(card["config"], state), budget)

    found, _ = _build(filter, root / f"{task}-{algo}" / f"{name}.safetensors", root)
    return DetectAndDenoise(Surprise(found), found)


def _wrong_card(task: str, algo: str, name: str, problem: str, root: Path) -> ArtifactError:
    return ArtifactError(f"{root / f'{task}-{algo}' / name}.json is damaged: {problem}; make the model anew")


# By kind, the file: learned by reinforcement, a linear map, a held offset, a director; and on the defended victim.
ADVERSARIES = {
    "optimal": "adversary",
    "linear": "adversary-linear",
    "offset": "adversary-offset",
    "director": "director",
    "adaptive-optimal": "adversary-adaptive",
    "adaptive-offset": "adversary-adaptive-offset",
    "adaptive-director": "director-adaptive",
}


def adversary_path(task: str, algo: str, kind: str, root: Path = DATA) -> Path:
    """Where the adversary of this kind, a key of ``ADVERSARIES``, is."""
    if kind not in ADVERSARIES:
        raise ValueError(f"kind must be one of {', '.join(ADVERSARIES)}, not {kind!r}")
    return root / f"{task}-{algo}" / f"{ADVERSARIES[kind]}.safetensors"


def save_adversary(
    task: str, algo: str, kind: str, adversary: Victim, sidecar: Mapping[str, Any], root: Path = DATA
) -> None:
    """Ship an adversary of a victim; see ``adversary_path`` for the kinds."""
    sidecar = dict(sidecar, config=adversary.config, versions=versions())
    save_tensors(adversary_path(task, algo, kind, root), adversary.state_dict(), sidecar, root)


def load_adversary(task: str, algo: str, kind: str = "optimal", root: Path = DATA) -> Victim:
    """A shipped adversary, for ``OptimalAttack``: its actions are perturbations in units of the ball's radius.

    A "director" is for ``DirectorAttack``: its actions are directions of the victim's.

    Args:
        task: of the victim that it learned to harm ("hopper").
        algo: that victim's algorithm ("td3").
        kind: a key of ``ADVERSARIES``.
        root: as data/ is laid out.

    Raises:
        ArtifactError: if it is missing or damaged.
        ValueError: if the kind is unknown.

    Example:
        >>> adversary = load_adversary("hopper", "td3")
        >>> adversary.obs_dim, adversary.action_dim
        (11, 11)
    """
    director = kind.endswith("director")

    def adversary(card: Mapping[str, Any], state: Mapping[str, Tensor]) -> Victim:
        found = Victim.from_state(card["config"], state)
        if not director and found.obs_dim % found.action_dim:  # it sees one observation, or several
            raise ValueError(f"it maps {found.obs_dim} observations to {found.action_dim} perturbations")
        return found

    return _build(adversary, adversary_path(task, algo, kind, root), root)[0]


def _build(make: Callable[[dict[str, Any], dict[str, Tensor]], M], path: Path, root: Path) -> tuple[M, dict[str, Any]]:
    if not path.exists() and promised(path, root) is None:
        raise _unknown(path, root)
    state, sidecar = load_tensors(path, root)
    try:
        return make(sidecar, state), sidecar
    except (AttributeError, IndexError, KeyError, RuntimeError, TypeError, ValueError) as error:
        problem = " ".join(f"{type(error).__name__}: {error}".split())  # torch's have several lines
        raise ArtifactError(f"{path} does not fit its sidecar ({problem}); make both anew with their recipe") from None


def _unknown(path: Path, root: Path) -> ArtifactError:
    """The error for a model that was never there: it lists the models that are."""
    if not path.parent.is_dir():
        known = sorted(victim.parent.name for victim in root.glob("*/victim.safetensors"))
    else:
        known = sorted(model.stem for model in path.parent.glob("*.safetensors"))
        kind = path.stem.partition("-")[0] + "-"
        known = [name for name in known if name.startswith(kind)] or known
    there = f"there are: {', '.join(known)}" if known else None
    return ArtifactError("; ".join(filter(None, (f"{path} is missing", there, where_else(root)))))
