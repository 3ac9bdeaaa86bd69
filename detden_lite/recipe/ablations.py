"""Ablations, baselines and ceilings (research question Q4): two stages that make their parts, and how to assemble them.

``detden_lite.defense.variants`` lists them; each name there has its maker in ``_MAKERS`` here.
"""

from collections.abc import Callable

import numpy as np

from detden_lite.attacks.opposite import OppositeAttack
from detden_lite.attacks.qfunction import QFunctionAttack
from detden_lite.attacks.timing import Random
from detden_lite.defense.autoencoder import DenoisingAutoencoder, train_autoencoder
from detden_lite.defense.baselines import Identity, KalmanFilter, MahalanobisDetector, PredictionDetector
from detden_lite.defense.denoiser import Denoiser
from detden_lite.defense.detector import Detector
from detden_lite.defense.linear_models import Gaussian, LinearModel
from detden_lite.defense.oracles import OracleDenoiser, OracleDetector
from detden_lite.defense.pipeline import DetectAndDenoise
from detden_lite.defense.variants import ASSEMBLED, MAIN, VARIANTS
from detden_lite.recipe.episode_seeds import seeds
from detden_lite.recipe.run import Run
from detden_lite.recipe.scales import DefenseScale, Scale
from detden_lite.recipe.trajectories import load_trajectories
from detden_lite.simulation.rollout import rollout
from detden_lite.store import manifest, tensors
from detden_lite.training.thresholds import calibrate, clean_scores, tuned_threshold


def fit_baselines(run: Run[Scale], seed: int = 0) -> None:
    """The stage: fit the linear models, calibrate their detectors and train the auto-encoder.

    All use the data of the main defence. What is made already is left as it is.

    Args:
        run: where.
        seed: of the auto-encoder's training.

    Raises:
        ValueError: if the trajectories are not collected and attacked yet.
    """
    linear, autoencoder = run.folder / "baselines.safetensors", run.folder / "autoencoder.safetensors"
    chosen = VARIANTS[MAIN]
    normal = load_trajectories(run, f"normal-{chosen.data}")
    if not manifest.is_made(linear, run.root):
        gaussian, model = Gaussian.fit(normal), LinearModel.fit(normal)
        held_out = load_trajectories(run, "calibration")
        detectors: dict[str, MahalanobisDetector | PredictionDetector] = dict(
            mahalanobis=MahalanobisDetector(gaussian, np.inf), prediction=PredictionDetector(model, np.inf)
        )
        thresholds = {name: calibrate(clean_scores(detector, held_out)) for name, detector in detectors.items()}
        sidecar = dict(data=chosen.data, trajectories=len(normal), thresholds=thresholds, versions=manifest.versions())
        tensors.save_tensors(linear, vars(gaussian) | vars(model), sidecar, run.root)
    if not manifest.is_made(autoencoder, run.root):
        adversarial = [load_trajectories(run, f"{part}-{chosen.data}") for part in chosen.adversarial]
        trained = train_autoencoder(
            normal, [normal, *adversarial], seed, run.scale.defense.hidden, run.scale.defense.latent, residual=True,
            epochs=run.scale.memoryless_epochs,
        )  # fmt: skip
        sidecar = dict(
            data=chosen.data, adversarial=chosen.adversarial, config=trained.config, seed=seed,
            epochs=run.scale.memoryless_epochs, trajectories=len(normal), versions=manifest.versions(),
        )  # fmt: skip
        tensors.save_tensors(autoencoder, trained.state_dict(), sidecar, run.root)


def tune_threshold(run: Run[Scale], n: int = 32) -> None:
    """The stage: the paper's C_anomaly for the main defence, on tuning episodes.

    A random half of the steps is attacked, by the two attacks that the denoiser is trained on: the threshold has seen
    no other attack either.

    Args:
        run: where.
        n: the number of episodes, unless the scale reports fewer.
    """
    path = run.folder / "threshold.json"
    if manifest.is_made(path, run.root):
        return
    victim, defense, n = run.victim(), run.defense(MAIN), min(n, run.scale.episodes)
    scores, attacked = [], []
    for attack in (OppositeAttack, QFunctionAttack):
        episodes = rollout(
            victim, run.task, seeds("tuning", n), attack=attack(victim, run.budget, run.scale.attack_steps),
            timing=Random(0.5), defense=defense, steps=run.scale.horizon,
        )  # fmt: skip
        scores.append(episodes.score[episodes.mask])
        attacked.append(episodes.attacked[episodes.mask])
    threshold = tuned_threshold(np.concatenate(scores), np.concatenate(attacked))
    manifest.write_json(path, dict(threshold=threshold, seeds=[seeds("tuning", n)[0], n]), run.root)


def build_defense(run: Run[DefenseScale], name: str) -> DetectAndDenoise:
    """A defence of the tables: a trained one, a key of ``VARIANTS``, or one assembled around the main one.

    Args:
        run: where its parts are.
        name: a key of ``VARIANTS`` or of ``ASSEMBLED``.

    Raises:
        ValueError: for another name.
        ArtifactError: if a part is missing or altered.
    """
    if name in VARIANTS:
        return run.defense(name)
    if name not in ASSEMBLED:
        raise ValueError(f"defense must be one of {', '.join((*VARIANTS, *ASSEMBLED))}, not {name!r}")
    main = run.defense(MAIN)
    if not isinstance(main.detector, Detector) or not isinstance(main.denoiser, Denoiser):
        raise TypeError(f"{MAIN}: the main defence must have a GRU-VAE as detector and another as denoiser")
    return _MAKERS[name](run, main.detector, main.denoiser)


def _tuned(run: Run[DefenseScale]) -> float:
    """The paper's threshold, from ``tune_threshold``."""
    return manifest.read_json(run.folder / "threshold.json", run.root)["threshold"]


def _autoencoder(run: Run[DefenseScale]) -> DenoisingAutoencoder:
    state, sidecar = tensors.load_tensors(run.folder / "autoencoder.safetensors", run.root)
    model = DenoisingAutoencoder(**sidecar["config"])
    model.load_state_dict(state)
    return model.requires_grad_(False).eval()


def _linear_models(run: Run[DefenseScale]) -> tuple[Gaussian, LinearModel, dict[str, float]]:
    """Both linear models, and the thresholds of the detectors that use them."""
    state, sidecar = tensors.load_tensors(run.folder / "baselines.safetensors", run.root)
    gaussian = Gaussian(state.pop("mean"), state.pop("covariance"))
    return gaussian, LinearModel(**state), sidecar["thresholds"]


def _mahalanobis(run: Run[DefenseScale]) -> MahalanobisDetector:
    gaussian, _, thresholds = _linear_models(run)
    return MahalanobisDetector(gaussian, thresholds["mahalanobis"])


def _prediction(run: Run[DefenseScale]) -> PredictionDetector:
    _, model, thresholds = _linear_models(run)
    return PredictionDetector(model, thresholds["prediction"])


# How each name of ``ASSEMBLED`` is made from the detector and the denoiser of the main defence.
_MAKERS: dict[str, Callable[[Run[DefenseScale], Detector, Denoiser], DetectAndDenoise]] = {
    "always": lambda run, det, den: DetectAndDenoise(det, den, always=True),
    "detector-only": lambda run, det, den: DetectAndDenoise(det),
    "latent-mean": lambda run, det, den: DetectAndDenoise(
        Detector(det.model, det.threshold, sample=False), Denoiser(den.model, sample=False)
    ),
    "projected": lambda run, det, den: DetectAndDenoise(det, den, budget=run.budget),
    "tuned": lambda run, det, den: DetectAndDenoise(Detector(det.model, _tuned(run)), den),
    "identity": lambda run, det, den: DetectAndDenoise(det, Identity()),
    "kalman": lambda run, det, den: DetectAndDenoise(det, KalmanFilter(_linear_models(run)[1], run.budget)),
    "autoencoder": lambda run, det, den: DetectAndDenoise(det, _autoencoder(run)),
    "mahalanobis": lambda run, det, den: DetectAndDenoise(_mahalanobis(run), den),
    "prediction": lambda run, det, den: DetectAndDenoise(_prediction(run), den),
    "oracle-detector": lambda run, det, den: DetectAndDenoise(OracleDetector(), den),
    "oracle-denoiser": lambda run, det, den: DetectAndDenoise(det, OracleDenoiser()),
}
