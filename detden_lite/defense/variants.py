"""The list of defences: how each is trained, and which are assembled from parts."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

PARTS = ("adversarial", "qfunction")  # of D_adv: attacked offline by the opposite and by the Q-function attack


@dataclass(frozen=True)
class Variant:
    """A defence as it is trained.

    Args:
        data: the exploration in its D_normal, a key of ``DATASETS``.
        adversarial: the parts of D_adv that its denoiser is trained on, among ``PARTS``.
        recipe: the settings of its denoiser that differ from the scale's ``VAERecipe``.
        predicts: whether it is no GRU-VAE but a ``PredictCorrect``, which needs no D_adv.

    Example:
        >>> VARIANTS[MAIN].recipe["residual"]
        True
    """

    data: str
    adversarial: tuple[str, ...] = ("adversarial",)
    recipe: Mapping[str, Any] = field(default_factory=dict)
    predicts: bool = False


@dataclass(frozen=True)
class Exploration:
    """The exploration noise in a D_normal; the episodes take turns. See ``collect_normal``."""

    noise: tuple[float, ...]
    memory: tuple[float, ...] = (0.0,)


DATASETS = {
    "plain": Exploration((0.0,)),
    "diverse": Exploration((0.0, 0.1, 0.2, 0.3)),
    "coloured": Exploration((0.0, 0.1, 0.2, 0.3), (0.0, 2.0, 10.0, 50.0)),
}

MIXED = dict(residual=True, least_share=0.2, least_size=0.5)  # real attackers come and go, and hold back

VARIANTS = {
    "printed": Variant("plain"),
    "diverse": Variant("diverse"),
    "residual": Variant("diverse", recipe=dict(residual=True)),
    "paper": Variant("plain", PARTS),
    "both": Variant("diverse", PARTS, dict(residual=True)),
    "mixed": Variant("diverse", PARTS, MIXED),
    "regularized": Variant("diverse", PARTS, MIXED | dict(lam=0.1)),
    "standard-prior": Variant("diverse", PARTS, MIXED | dict(prior="standard")),
    "predict": Variant("coloured", (), predicts=True),
}

MAIN = "mixed"  # the defence of the tables

ABLATIONS = {  # changes of the main defence, one each
    "always": "denoises at every step, whatever the detector says",
    "detector-only": "shows the detector's own reconstruction: there is no denoiser",
    "latent-mean": "takes the latent's mean instead of a sample",
    "projected": "projects what is denoised into B(o_hat), which takes knowing epsilon",
    "tuned": "the paper's threshold, tuned on attacked episodes",
}

BASELINES = {  # replacements of one of its networks
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

EXPLAINING = ("always", "projected", *CEILINGS)  # these show which part of a defence falls short

ASSEMBLED = ABLATIONS | BASELINES | CEILINGS
