"""The stages that make a defence. Each makes what is missing: running it again resumes it."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace

import numpy as np

from detden_lite.defense import augmentation
from detden_lite.defense.detector import Detector
from detden_lite.defense.dynamics import Dynamics
from detden_lite.defense.gruvae import GRUVAE
from detden_lite.defense.variants import DATASETS, VARIANTS
from detden_lite.recipe import episode_seeds
from detden_lite.recipe.run import ADVERSARIAL, Run
from detden_lite.recipe.scales import DefenseScale
from detden_lite.recipe.trajectories import load_shard, load_trajectories, save_shard, shards
from detden_lite.simulation import collection
from detden_lite.store import manifest, models
from detden_lite.training.dynamics_training import one_step_errors, train_dynamics
from detden_lite.training.gruvae_training import train_gruvae
from detden_lite.training.regularizer import Regularizer
from detden_lite.training.thresholds import calibrate, clean_scores, conformal_threshold

# The rate among clean steps. A missed attack costs more than a false alarm if the denoiser hardly changes clean
# observations: on HalfCheetah's tuning episodes 5 % instead of 1 % raised the return under the optimal attack from
# 3,643 to 5,840, and lowered the clean return by 0.3 %.
FALSE_ALARMS = 0.05


def collect(run: Run[DefenseScale], data: str) -> None:
    """The stage: collect D_normal, and half as many held-out episodes for calibration.

    The held-out episodes are without exploration, as those that the defence will see.

    Args:
        run: where.
        data: the exploration in D_normal, a key of ``DATASETS``.
    """
    victim = run.victim()
    held_out = max(4, run.scale.trajectories // 2)
    wanted = [
        (f"normal-{data}", "normal", run.scale.trajectories, DATASETS[data]),
        ("calibration", "calibration", held_out, DATASETS["plain"]),
    ]
    for folder, purpose, n, exploration in wanted:
        for path, part in shards(run, folder, n):
            if not manifest.is_made(path, run.root):
                shard = collection.collect_normal(
                    victim, run.task, episode_seeds.seeds(purpose, n)[part], exploration.noise,
                    noise_memory=exploration.memory, steps=run.scale.horizon,
                )  # fmt: skip
                save_shard(run, path, shard)


def augment(run: Run[DefenseScale], data: str, parts: Sequence[str] = tuple(ADVERSARIAL)) -> None:
    """The stage: D_adv, every observation of D_normal under the opposite and the Q-function attack, a folder each.

    Args:
        run: where.
        data: the exploration in D_normal, a key of ``DATASETS``.
        parts: of D_adv, keys of ``ADVERSARIAL``.
    """
    victim = run.victim()
    for part in parts:
        attack = ADVERSARIAL[part]
        for index, (path, _) in enumerate(shards(run, f"normal-{data}", run.scale.trajectories)):
            target = path.parent.with_name(f"{part}-{data}") / path.name
            if not manifest.is_made(target, run.root):
                offline = attack(victim, run.budget, steps=run.scale.attack_steps)
                save_shard(run, target, augmentation.augment(load_shard(run, path), offline, seed=index))


def train_detector(run: Run[DefenseScale], data: str, seed: int = 0) -> None:
    """The stage: train the detector on D_normal, and calibrate its threshold on held-out clean episodes.

    The threshold is the conformal one, or the plain quantile if there are too few episodes for a guarantee.

    Args:
        run: where.
        data: the exploration in D_normal, a key of ``DATASETS``.
        seed: of the training.
    """
    normal = load_trajectories(run, f"normal-{data}")
    model = train_gruvae(
        run.scale.defense, [(normal, normal)], seed, run.folder / "checkpoints" / f"detector-{data}.ckpt",
        label=f"detector on {data} data",
    )  # fmt: skip
    calibration = load_trajectories(run, "calibration")
    scores = clean_scores(Detector(model, np.inf), calibration)
    conformal = conformal_threshold(np.split(scores, calibration.lengths.cumsum()[:-1]), FALSE_ALARMS)
    sidecar = dict(
        data=data, recipe=asdict(run.scale.defense), seed=seed, trajectories=len(normal),
        threshold=conformal if np.isfinite(conformal) else calibrate(scores, FALSE_ALARMS),
        conformal=bool(np.isfinite(conformal)), false_alarms=FALSE_ALARMS,
        calibration_quantiles=_quantiles(scores),
    )  # fmt: skip
    models.save_model(run.task.name, run.algo, f"detector-{data}", model, sidecar, run.root)


def fit_denoiser(
    run: Run[DefenseScale],
    variant: str,
    seed: int = 0,
    parts: Sequence[str] = (),
    checkpoint: str = "denoiser",
    after_epoch: Callable[[int, GRUVAE], None] | None = None,
) -> tuple[GRUVAE, dict[str, object]]:
    """Train a variant's denoiser on D_normal and its parts of D_adv, or those given.

    Args:
        run: where.
        variant: a key of ``VARIANTS``.
        seed: of the training.
        parts: of D_adv; those of the variant if empty.
        checkpoint: how the checkpoint's name begins.
        after_epoch: see ``train_gruvae``.

    Returns:
        The model, and the content of its sidecar.
    """
    chosen = VARIANTS[variant]
    parts = tuple(parts) or chosen.adversarial
    normal, *adversarial = (load_trajectories(run, f"{part}-{chosen.data}") for part in ("normal", *parts))
    recipe = replace(run.scale.defense, **chosen.recipe)
    regularizer = Regularizer(run.victim(), run.budget) if recipe.lam else None
    model = train_gruvae(
        recipe, [(normal, normal), *((attacked, normal) for attacked in adversarial)], seed,
        run.folder / "checkpoints" / f"{checkpoint}-{variant}.ckpt", after_epoch, f"{variant} denoiser", regularizer,
    )  # fmt: skip
    return model, dict(
        data=chosen.data, adversarial=parts, recipe=asdict(recipe), seed=seed, trajectories=len(normal),
        regularizer=regularizer and regularizer.settings,
    )  # fmt: skip


def fit_dynamics(run: Run[DefenseScale], variant: str, seed: int = 0) -> tuple[Dynamics, dict[str, object]]:
    """Train the model of a variant that predicts.

    Args:
        run: where.
        variant: a key of ``VARIANTS``.
        seed: of the training.

    Returns:
        The model, and the content of its sidecar, with its errors in held-out clean episodes.
    """
    data, scale = VARIANTS[variant].data, run.scale
    normal = load_trajectories(run, f"normal-{data}")
    model = train_dynamics(
        scale.dynamics, normal, seed, run.task.state_dim, run.folder / "checkpoints" / f"dynamics-{variant}.ckpt",
        label=f"dynamics on {data} data",
    )  # fmt: skip
    error = one_step_errors(model, load_trajectories(run, "calibration"))
    return model, dict(
        data=data, recipe=asdict(scale.dynamics), seed=seed, trajectories=len(normal),
        transitions=int(normal.mask[:, 1:].sum()),
        budget=dict(epsilon=run.budget.epsilon, norm=str(run.budget.norm), scale=np.asarray(run.budget.scale).tolist()),
        error_median=np.median(error, 0).tolist(), error_mean=error.mean(0).tolist(),
    )  # fmt: skip


def train_denoiser(run: Run[DefenseScale], variant: str, seed: int = 0, parts: Sequence[str] = ()) -> None:
    """The stage: train a variant's denoiser and store it. The arguments are those of ``fit_denoiser``."""
    model: GRUVAE | Dynamics
    if VARIANTS[variant].predicts:
        model, sidecar = fit_dynamics(run, variant, seed)
    else:
        model, sidecar = fit_denoiser(run, variant, seed, parts)
    models.save_model(run.task.name, run.algo, f"denoiser-{variant}", model, sidecar, run.root)


def _quantiles(scores: np.ndarray) -> dict[str, float]:
    return {str(q): float(np.quantile(scores, q)) for q in (0.5, 0.9, 0.95, 0.99, 0.999)}
