"""The defences of the tables that are assembled from parts: ablations of the paper's, baselines, and ceilings (Q4)."""

import numpy as np

from detden_lite import artifacts
from detden_lite.attacks import OppositeAttack, QFunctionAttack, Random
from detden_lite.defense import Denoiser, DetectAndDenoise, Detector
from detden_lite.defense.autoencoder import DenoisingAutoencoder, train_autoencoder
from detden_lite.defense.baselines import Identity, KalmanFilter, MahalanobisDetector, PredictionDetector
from detden_lite.defense.detector import calibrate, clean_scores, tuned_threshold
from detden_lite.defense.linear import Gaussian, LinearModel
from detden_lite.defense.oracles import OracleDenoiser, OracleDetector
from detden_lite.rollout import rollout
from detden_lite.runs import MAIN, VARIANTS, Run, load_trajectories
from detden_lite.study import seeds

ABLATIONS = {  # of the main defence: what each changes in it
    "always": "denoises at every step, whatever the detector says",
    "detector-only": "shows the detector's own reconstruction: there is no denoiser",
    "latent-mean": "takes the latent's mean instead of a sample",
    "projected": "projects what is denoised into B(o_hat), which takes knowing epsilon",
    "tuned": "the paper's threshold, tuned on attacked episodes",
}
BASELINES = {  # what replaces one of its networks
    "identity": "a denoiser that does nothing",
    "kalman": "a Kalman filter as denoiser",
    "autoencoder": "a denoising auto-encoder without memory as denoiser",
    "mahalanobis": "a Gaussian of all observations as detector",
    "prediction": "a linear one-step prediction as detector",
}
CEILINGS = {
    "oracle-detector": "a detector that knows the truth",
    "oracle-denoiser": "a denoiser that knows the truth",
}
EXPLAINING = ("always", "projected", *CEILINGS)  # what tells which part of a defence falls short
ASSEMBLED = ABLATIONS | BASELINES | CEILINGS


def fit_baselines(run: Run, seed: int = 0) -> None:
    """Fit the linear models, calibrate their detectors, and train the auto-encoder, on the data of the main defence."""
    linear, autoencoder = run.folder / "baselines.safetensors", run.folder / "autoencoder.safetensors"
    chosen = VARIANTS[MAIN]
    normal = load_trajectories(run, f"normal-{chosen.data}")
    if not artifacts.is_made(linear, run.root):
        gaussian, model = Gaussian.fit(normal), LinearModel.fit(normal)
        held_out = load_trajectories(run, "calibration")
        detectors = dict(
            mahalanobis=MahalanobisDetector(gaussian, np.inf), prediction=PredictionDetector(model, np.inf)
        )
        thresholds = {name: calibrate(clean_scores(detector, held_out)) for name, detector in detectors.items()}
        sidecar = dict(data=chosen.data, trajectories=len(normal), thresholds=thresholds, versions=artifacts.versions())
        artifacts.save_tensors(linear, vars(gaussian) | vars(model), sidecar, run.root)
    if not artifacts.is_made(autoencoder, run.root):
        adversarial = [load_trajectories(run, f"{part}-{chosen.data}") for part in chosen.adversarial]
        sizes = dict(hidden=run.scale.defense.hidden, latent=run.scale.defense.latent, residual=True)
        trained = train_autoencoder(normal, [normal, *adversarial], seed, **sizes, epochs=run.scale.memoryless_epochs)
        sidecar = dict(
            data=chosen.data, adversarial=chosen.adversarial, config=trained.config, seed=seed,
            epochs=run.scale.memoryless_epochs, trajectories=len(normal), versions=artifacts.versions(),
        )  # fmt: skip
        artifacts.save_tensors(autoencoder, trained.state_dict(), sidecar, run.root)


def tune_threshold(run: Run, n: int = 32) -> None:
    """The paper's C_anomaly for the main defence, on tuning episodes: half of the steps attacked, at random.

    The attacks are the two that the denoiser is trained on, so that the threshold has seen no other attack either.
    """
    path = run.folder / "threshold.json"
    if artifacts.is_made(path, run.root):
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
    artifacts.write_json(path, dict(threshold=threshold, seeds=[seeds("tuning", n)[0], n]), run.root)


def load(run: Run, name: str) -> DetectAndDenoise:
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
            tuned = artifacts.read_json(run.folder / "threshold.json", run.root)["threshold"]
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
    state, sidecar = artifacts.load_tensors(run.folder / "baselines.safetensors", run.root)
    gaussian = Gaussian(state.pop("mean"), state.pop("covariance"))
    return gaussian, LinearModel(**state), sidecar["thresholds"]


def _autoencoder(run: Run) -> DenoisingAutoencoder:
    state, sidecar = artifacts.load_tensors(run.folder / "autoencoder.safetensors", run.root)
    model = DenoisingAutoencoder(**sidecar["config"])
    model.load_state_dict(state)
    return model.requires_grad_(False).eval()
