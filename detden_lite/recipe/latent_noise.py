"""Is the stochastic barrier real? What the noise of the latents costs an attacker who knows the defence (section 4.4).

The paper explains the failure of its adaptive attacks by the sampling in detector and denoiser. This is measured here
step by step, in the middle of attacked episodes: how much more damage is done by averaging over samples, and to the
same defence without noise; how well a sampled gradient is aligned with the expected one; and the latent's signal to
noise.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from detden_lite.attacks.adaptive import AdaptiveAttack, GradientFreeAttack
from detden_lite.attacks.informed import view_defense
from detden_lite.attacks.opposite import OppositeAttack
from detden_lite.attacks.outcome import Outcome
from detden_lite.core.gradients import value_and_gradient
from detden_lite.core.random_streams import RandomStreams
from detden_lite.core.types import Attack, Episodes, World
from detden_lite.defense.denoiser import Denoiser
from detden_lite.defense.gruvae import GRUVAE
from detden_lite.defense.memory import Recurrent
from detden_lite.defense.pipeline import DetectAndDenoise
from detden_lite.defense.variants import MAIN
from detden_lite.recipe.episode_seeds import seeds
from detden_lite.recipe.run import Run
from detden_lite.recipe.scales import Scale
from detden_lite.simulation.rollout import rollout
from detden_lite.store import manifest

SAMPLES = (1, 2, 4, 8, 16)  # K

FRESH = 256  # samples for the evaluation, none of which an attacker has seen

AT = (10, 40, 160)  # the steps of the episodes that are examined

MEASURED = (MAIN, "standard-prior")  # they differ only in their prior


@dataclass(frozen=True)
class Moment:
    """One step of n attacked and defended episodes.

    Args:
        obs: the true observations, ``[n, obs_dim]``.
        defense: with its memory as it is before that step.
        seeds: of the episodes, n of them.
        action: of the policy one step before, ``[n, action_dim]``; None at the first step.

    Example:
        >>> from detden_lite import OppositeAttack, get_task, load_defense, load_victim, rollout
        >>> from detden_lite.recipe.latent_noise import moment
        >>> victim, defense = load_victim("hopper", "td3"), load_defense("hopper", "td3")
        >>> episodes = rollout(victim, get_task("hopper"), range(2), defense=defense, steps=4)
        >>> moment(episodes, defense, step=3).obs.shape
        torch.Size([2, 11])
    """

    obs: Tensor
    defense: DetectAndDenoise
    seeds: Sequence[int]
    action: Tensor | None

    @property
    def rows(self) -> Tensor:
        """A mask of all n episodes, ``[n]`` bool."""
        return torch.ones(len(self.obs), dtype=torch.bool)


def moment(episodes: Episodes, defense: DetectAndDenoise, step: int) -> Moment:
    """One step of the episodes that lasted until it.

    Args:
        episodes: that ``rollout`` played with this defence.
        defense: a copy of it sees the episodes again up to that step, so that its memory is as it was.
        step: from 0.
    """
    alive = episodes.select(np.flatnonzero(episodes.mask[step]))
    defense = copy.deepcopy(defense)
    defense.reset(alive.seeds.tolist())
    action = None
    for perturbed, sent in zip(alive.perturbed[:step], alive.action, strict=False):
        defense(torch.from_numpy(perturbed), action)
        action = torch.from_numpy(sent)
    return Moment(torch.from_numpy(alive.obs[step]), defense, alive.seeds.tolist(), action)


def silenced(now: Moment) -> Moment:
    """The same moment, with a defence that takes the means of its latents from now on."""
    defense = copy.deepcopy(now.defense)
    for part in defense.parts:
        if isinstance(part, Recurrent):
            part.sample = False
    return Moment(now.obs, defense, now.seeds, now.action)


def deviation(attack: OppositeAttack, now: Moment, perturbed: Tensor) -> Tensor:
    """The deviation of the defended policy's action from pi(o), ``[n]``: root mean square over ``FRESH`` samples.

    Args:
        attack: its objective measures the distance of actions.
        now: the moment.
        perturbed: the input of the defence, ``[n, obs_dim]``.
    """
    view = view_defense(now.defense, now.rows, RandomStreams(1, now.seeds), FRESH, now.action)
    of_action = attack.objective(now.obs).of_action
    return Outcome.of(perturbed, view, attack.victim.mean, of_action).damage.clamp_min(0).sqrt()


def attacked(attack: Attack, now: Moment) -> Tensor:
    """The perturbed observations of an attack at a moment, ``[n, obs_dim]``."""
    attack.reset(now.seeds)
    return attack(now.obs, World(now.rows.numpy(), defense=now.defense, action=now.action))


def alignment(attack: OppositeAttack, now: Moment, perturbed: Tensor, samples: int) -> Tensor:
    """The cosine ``[n]`` between a gradient over K samples and the gradient over ``FRESH`` others.

    Args:
        attack: its objective is the damage, taken through the denoiser.
        now: the moment.
        perturbed: where the gradient is taken, ``[n, obs_dim]``.
        samples: K.
    """
    of_action = attack.objective(now.obs).of_action

    def gradient(seed: int, k: int) -> Tensor:
        view = view_defense(now.defense, now.rows, RandomStreams(seed, now.seeds), k, now.action)

        def damage(seen: Tensor) -> Tensor:
            return Outcome.of(seen, view, attack.victim.mean, of_action).denoised.mean(0)

        return value_and_gradient(damage, perturbed)[1]

    return torch.cosine_similarity(gradient(2, samples), gradient(3, FRESH), dim=-1)


def signal_to_noise(model: GRUVAE, obs: Tensor) -> Tensor:
    """For each latent dimension the variance of mu over all steps divided by the mean of sigma^2, ``[latent_dim]``.

    Args:
        model: of a detector or denoiser.
        obs: sequences ``[N, steps, obs_dim]``, all of them at their full length.
    """
    mean, log_variance, _ = model.encode(obs)
    return mean.flatten(0, 1).var(0) / log_variance.exp().flatten(0, 1).mean(0)


@torch.no_grad()
def measure(
    attack: OppositeAttack, defense: DetectAndDenoise, episodes: Episodes, at: Sequence[int], steps: int
) -> dict[str, Any]:
    """What the latents' noise of one defence costs an attacker, ready for JSON.

    Args:
        attack: one that does not know the defence.
        defense: of two GRU-VAEs.
        episodes: under this attack and with this defence.
        at: the steps to examine.
        steps: of the adaptive attack.

    Returns:
        Deviations of the action, one for each episode and step that is examined: ``clean``, under the ``unaware``
        attack, under the adaptive attack on the same defence without noise (``mean``), under the adaptive attack by K
        (``samples``), and under its cross-check without gradients (``free``). The ``alignment`` by K. And the
        ``latent`` of the denoiser: signal to noise, sorted.

    Raises:
        TypeError: if the denoiser is no GRU-VAE.
    """
    if not isinstance(defense.denoiser, Denoiser):
        raise TypeError(f"defense: its denoiser must be a GRU-VAE, not {defense.denoiser!r}")
    found: dict[str, Any] = dict(clean=[], unaware=[], mean=[], free=[], samples={}, alignment={})
    for now in (moment(episodes, defense, step) for step in at):
        quiet, unaware = silenced(now), attacked(attack, now)
        found["clean"] += deviation(attack, now, now.obs).tolist()
        found["unaware"] += deviation(attack, now, unaware).tolist()
        found["mean"] += deviation(attack, quiet, attacked(AdaptiveAttack(attack, steps, samples=1), quiet)).tolist()
        found["free"] += deviation(attack, now, attacked(GradientFreeAttack(attack, steps=steps), now)).tolist()
        for k in SAMPLES:
            seen = attacked(AdaptiveAttack(attack, steps, samples=k), now)
            found["samples"].setdefault(str(k), []).extend(deviation(attack, now, seen).tolist())
            found["alignment"].setdefault(str(k), []).extend(alignment(attack, now, unaware, k).tolist())
    whole = torch.from_numpy(episodes.obs[:, episodes.mask.all(0)]).swapaxes(0, 1)
    latent = signal_to_noise(defense.denoiser.model, whole).sort().values.tolist()
    return found | dict(latent=latent)


def measure_latent_noise(run: Run[Scale], variants: Sequence[str] = MEASURED, n: int = 32) -> None:
    """The stage: ``barrier.json`` of a run, on tuning episodes.

    Args:
        run: where.
        variants: the defences to measure, keys of ``VARIANTS``.
        n: the number of episodes, unless the scale reports fewer.
    """
    path = run.folder / "barrier.json"
    if manifest.is_made(path, run.root):
        return
    victim, at = run.victim(), [step for step in AT if step < run.scale.horizon]
    chosen, attack, found = seeds("tuning", min(n, run.scale.episodes)), run.opposite(victim), {}
    for name in variants:
        defense = run.defense(name)
        played = rollout(
            victim, run.task, chosen, attack=attack, defense=defense, steps=max(at) + 1,
            progress=f"latent noise of {name}",
        )  # fmt: skip
        found[name] = measure(attack, defense, played, at, run.scale.adaptive["steps"])
    manifest.write_json(path, dict(variants=found, seeds=[chosen[0], len(chosen)], at=at), run.root)
