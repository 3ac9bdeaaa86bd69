"""Stages and loaders of the defences that are assembled from parts: ablations, baselines and ceilings (Q4)."""

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
from detden_lite.defense.thresholds import calibrate, clean_scores, tuned_threshold
from detden_lite.defense.variants import ASSEMBLED, MAIN, VARIANTS
from detden_lite.recipe.episode_seeds import seeds
from detden_lite.recipe.run import Run
from detden_lite.recipe.trajectories import load_trajectories
from detden_lite.simulation.rollout import rollout
from detden_lite.store import manifest, tensors


def fit_baselines(run: Run, seed: int = 0) -> None:
    """Fit the linear models, calibrate their detectors, and train the auto-encoder, on the data of the main defence."""
    linear, autoencoder = run.folder / "baselines.safetensors", run.folder / "autoencoder.safetensors"
    chosen = VARIANTS[MAIN]
    normal = load_trajectories(run, f"normal-{chosen.data}")
    if not manifest.is_made(linear, run.root):
        gaussian, model = Gaussian.fit(normal), LinearModel.fit(normal)
        held_out = load_trajectories(run, "calibration")
        detectors = dict(
            mahalanobis=MahalanobisDetector(gaussian, np.inf), prediction=PredictionDetector(model, np.inf)
        )
        thresholds = {name: calibrate(clean_scores(detector, held_out)) for name, detector in detectors.items()}
        sidecar = dict(data=chosen.data, trajectories=len(normal), thresholds=thresholds, versions=manifest.versions())
        tensors.save_tensors(linear, vars(gaussian) | vars(model), sidecar, run.root)
    if not manifest.is_made(autoencoder, run.root):
        adversarial = [load_trajectories(run, f"{part}-{chosen.data}") for part in chosen.adversarial]
        sizes = dict(hidden=run.scale.defense.hidden, latent=run.scale.defense.latent, residual=True)
        trained = train_autoencoder(normal, [normal, *adversarial], seed, **sizes, epochs=run.scale.memoryless_epochs)
        sidecar = dict(
            data=chosen.data, adversarial=chosen.adversarial, config=trained.config, seed=seed,
            epochs=run.scale.memoryless_epochs, trajectories=len(normal), versions=manifest.versions(),
        )  # fmt: skip
        tensors.save_tensors(autoencoder, trained.state_dict(), sidecar, run.root)


def tune_threshold(run: Run, n: int = 32) -> None:
    """The paper's C_anomaly for the main defence, on tuning episodes: half of the steps attacked, at random.

    The attacks are the two that the denoiser is trained on, so that the threshold has seen no other attack either.
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


def build_defense(run: Run, name: str) -> DetectAndDenoise:
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
    detector, denoiser = main.detector, main.denoiser
    match name:
        case "always":
            return DetectAndDenoise(detector, denoiser, always=True)
        case "projected":
            return DetectAndDenoise(detector, denoiser, budget=run.budget)
        case "detector-only":
            return DetectAndDenoise(detector)
        case "latent-mean":
            detector = Detector(detector.model, detector.threshold, sample=False)
            return DetectAndDenoise(detector, Denoiser(denoiser.model, sample=False))
        case "tuned":
            tuned = manifest.read_json(run.folder / "threshold.json", run.root)["threshold"]
            return DetectAndDenoise(Detector(detector.model, tuned), denoiser)
        case "identity":
            return DetectAndDenoise(detector, Identity())
        case "autoencoder":
            return DetectAndDenoise(detector, _autoencoder(run))
        case "oracle-detector":
            return DetectAndDenoise(OracleDetector(), denoiser)
        case "oracle-denoiser":
            return DetectAndDenoise(detector, OracleDenoiser())
    gaussian, model, thresholds = _linear(run)
    match name:
        case "kalman":
            return DetectAndDenoise(detector, KalmanFilter(model, run.budget))
        case "mahalanobis":
            return DetectAndDenoise(MahalanobisDetector(gaussian, thresholds[name]), denoiser)
        case "prediction":
            return DetectAndDenoise(PredictionDetector(model, thresholds[name]), denoiser)


def _linear(run: Run) -> tuple[Gaussian, LinearModel, dict[str, float]]:
    state, sidecar = tensors.load_tensors(run.folder / "baselines.safetensors", run.root)
    gaussian = Gaussian(state.pop("mean"), state.pop("covariance"))
    return gaussian, LinearModel(**state), sidecar["thresholds"]


def _autoencoder(run: Run) -> DenoisingAutoencoder:
    state, sidecar = tensors.load_tensors(run.folder / "autoencoder.safetensors", run.root)
    model = DenoisingAutoencoder(**sidecar["config"])
    model.load_state_dict(state)
    return model.requires_grad_(False).eval()
