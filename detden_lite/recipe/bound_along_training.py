"""Does a better denoiser tighten the bound? Both sides of appendix A along the training of a denoiser."""

import numpy as np
import torch
from torch import Tensor

from detden_lite.core import metrics
from detden_lite.core.distances import mahalanobis
from detden_lite.core.random_streams import RandomStreams
from detden_lite.core.types import Attack, Defense, Detector, Episodes
from detden_lite.defense.denoiser import Denoiser
from detden_lite.defense.gruvae import GRUVAE
from detden_lite.defense.pipeline import DetectAndDenoise
from detden_lite.recipe import defense_stages
from detden_lite.recipe.episode_seeds import seeds
from detden_lite.recipe.run import Run
from detden_lite.recipe.scales import DefenseScale, Scale
from detden_lite.simulation.rollout import rollout
from detden_lite.store import manifest
from detden_lite.theory import bound
from detden_lite.theory.worst_error import worst_errors
from detden_lite.victims.victim import Victim

NOISE = 0.2  # on a TD3 victim's actions, in units of half their range; without noise the total variation is 0 or 1

GAMMA = 0.99

STEPS = 150  # of an episode in the loop
ATTACKED = (4, 60)  # episodes and steps along which the denoiser is attacked


def discounted(episodes: Episodes, gamma: float = GAMMA) -> np.ndarray:
    """The discounted return of each episode, ``[N]``: the value of its start, cut off where the episode ends.

    Example:
        >>> from detden_lite import get_task, load_victim, rollout
        >>> from detden_lite.recipe.bound_along_training import discounted
        >>> episodes = rollout(load_victim("hopper", "td3"), get_task("hopper"), range(2), steps=3)
        >>> bool((discounted(episodes, 1.0).round(4) == episodes.returns.round(4)).all())
        True
    """
    weights = gamma ** np.arange(len(episodes.reward))[:, None]
    return (weights * episodes.reward * episodes.mask).sum(0)


def noise_of(victim: Victim) -> Tensor:
    """The standard deviation of the actions in the bound, ``[action_dim]``: PPO's own, or ``NOISE`` for TD3."""
    half = (victim.action_high - victim.action_low) / 2
    return NOISE * half if victim.action_std is None else victim.action_std


def total_variations(victim: Victim, episodes: Episodes) -> Tensor:
    """The exact total variation between the actions for the true and the shown observation of each step, ``[n]``."""
    true, shown = (torch.from_numpy(x[episodes.mask]) for x in (episodes.obs, episodes.shown))
    squared = mahalanobis(victim.mean(true), victim.mean(shown), std=noise_of(victim))
    return bound.total_variation(squared.sqrt())


def play(
    run: Run[DefenseScale], victim: Victim, n: int, attack: Attack | None = None, defense: Defense | None = None
) -> Episodes:
    """n tuning episodes with noise on the actions."""
    half = (victim.action_high - victim.action_low) / 2
    noise = (noise_of(victim) / half).expand(n, -1).numpy()
    steps = min(STEPS, run.scale.horizon)
    return rollout(
        victim, run.task, seeds("tuning", n), attack=attack, defense=defense, action_noise=noise, steps=steps
    )


@torch.no_grad()
def both_sides(
    run: Run[DefenseScale], model: GRUVAE, detector: Detector, clean: Episodes
) -> dict[str, float | list[float]]:
    """The right side and the left side of theorem 1 for one denoiser, ready for JSON.

    Args:
        run: with the victim.
        model: of the denoiser, which is used at every step.
        detector: beside it; its alarms have no effect.
        clean: unattacked episodes from ``play``.

    Returns:
        ``error``, the largest error that an attack on the denoiser finds, and its ``median`` over the steps. For the
        loop under the opposite attack the denoiser's ``mae``, the median ``tv``, and the value ``lost`` in each
        episode.
    """
    victim, (n, steps) = run.victim(), ATTACKED
    recorded = torch.from_numpy(clean.obs[:steps, :n]).swapaxes(0, 1)
    errors = worst_errors(model, recorded, run.budget, RandomStreams(0)).T[clean.mask[:steps, :n]]
    defense = DetectAndDenoise(detector, Denoiser(model), always=True)
    played = play(run, victim, len(clean.seeds), run.opposite(victim), defense)
    return dict(
        error=errors.max().item(),
        median=errors.median().item(),
        mae=metrics.mean_absolute_error(played),
        tv=total_variations(victim, played).median().item(),
        lost=(discounted(clean) - discounted(played)).tolist(),
    )


def measure_along_training(run: Run[Scale], variant: str = "residual", n: int = 32) -> None:
    """The stage: ``curve.json``, both sides after each epoch of a variant's training, which is repeated for this.

    Args:
        run: where.
        variant: a key of ``VARIANTS``.
        n: the number of episodes, unless the scale reports fewer.
    """
    path = run.folder / "curve.json"
    if manifest.is_made(path, run.root):
        return
    detector, n = run.defense(variant).detector, min(n, run.scale.episodes)
    clean, measured = play(run, run.victim(), n), run.folder / "checkpoints" / f"curve-{variant}"

    def after_epoch(epoch: int, model: GRUVAE) -> None:
        if not manifest.is_made(file := measured / f"{epoch}.json", run.root):
            manifest.write_json(file, both_sides(run, model, detector, clean), run.root)

    defense_stages.fit_denoiser(run, variant, checkpoint="curve", after_epoch=after_epoch)
    epochs = [manifest.read_json(measured / f"{e}.json", run.root) for e in range(run.scale.defense.epochs)]
    settings = dict(noise=NOISE, gamma=GAMMA, steps=STEPS, seeds=[seeds("tuning", n)[0], n])
    manifest.write_json(path, dict(variant=variant, epochs=epochs, **settings), run.root)
