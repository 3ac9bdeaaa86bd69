"""Is the stochastic barrier real? What the noise of the latents costs an attacker who knows the defence (section 4.4).

The paper explains the failure of its adaptive attacks by the sampling in detector and denoiser. So it is measured here
step by step, in the middle of attacked episodes: how much more harm is done by averaging over samples, and to the same
defence without noise; how well a sampled gradient points; and how loud the noise is beside what the latent says.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from detden_lite.attacks.adaptive import AdaptiveAttack, GradientFreeAttack
from detden_lite.attacks.informed import view_defense
from detden_lite.attacks.opposite import OppositeAttack
from detden_lite.attacks.outcome import Outcome
from detden_lite.core.gradients import value_and_gradient
from detden_lite.core.random_streams import RandomStreams
from detden_lite.core.types import Episodes, World
from detden_lite.defense.gruvae import GRUVAE
from detden_lite.defense.pipeline import DetectAndDenoise
from detden_lite.defense.variants import MAIN
from detden_lite.recipe.episode_seeds import seeds
from detden_lite.recipe.run import Run
from detden_lite.simulation.rollout import rollout
from detden_lite.store import manifest

SAMPLES = (1, 2, 4, 8, 16)  # K

FRESH = 256  # samples that judge, none of which an attacker has seen

AT = (10, 40, 160)  # steps of the episodes that are looked at

MEASURED = (MAIN, "standard-prior")  # they differ in their prior alone


@dataclass(frozen=True)
class Moment:
    """One step of n attacked and defended episodes."""

    obs: Tensor  # the true observations, [n, obs_dim]
    defense: DetectAndDenoise  # as it is before that step
    seeds: np.ndarray  # of the episodes, [n]
    action: Tensor | None  # what the policy did one step before, [n, action_dim]

    @property
    def rows(self) -> Tensor:
        """All of them, ``[n]`` bool."""
        return torch.ones(len(self.obs), dtype=torch.bool)


def moment(episodes: Episodes, defense: DetectAndDenoise, step: int) -> Moment:
    """A step of those episodes that got to it, ``rollout`` having played them with this defence."""
    alive = episodes.select(np.flatnonzero(episodes.mask[step]))
    defense = copy.deepcopy(defense)
    defense.reset(alive.seeds)
    action = None
    for perturbed, sent in zip(alive.perturbed[:step], alive.action, strict=False):
        defense(torch.from_numpy(perturbed), action)
        action = torch.from_numpy(sent)
    return Moment(torch.from_numpy(alive.obs[step]), defense, alive.seeds, action)


def silenced(now: Moment) -> Moment:
    """The same moment, and from there on the defence takes the latents' means."""
    defense = copy.deepcopy(now.defense)
    for part in defense.parts:
        part.sample = False
    return Moment(now.obs, defense, now.seeds, now.action)


def deviation(attack: OppositeAttack, now: Moment, perturbed: Tensor) -> Tensor:
    """How far the defended policy's action is from pi(o), ``[n]``: root mean square over ``FRESH`` samples.

    Args:
        attack: whose distance of actions this is.
        now: when.
        perturbed: what the defence is shown, ``[n, obs_dim]``.
    """
    view = view_defense(now.defense, now.rows, RandomStreams(1, now.seeds), FRESH, now.action)
    of_action = attack.objective(now.obs).of_action
    return Outcome.of(perturbed, view, attack.victim.mean, of_action).damage.clamp_min(0).sqrt()


def attacked(attack, now: Moment) -> Tensor:
    """What an attack makes of a moment, ``[n, obs_dim]``."""
    attack.reset(now.seeds)
    return attack(now.obs, World(now.rows.numpy(), defense=now.defense, action=now.action))


def alignment(attack: OppositeAttack, now: Moment, perturbed: Tensor, samples: int) -> Tensor:
    """The cosine ``[n]`` of the gradient in K = ``samples`` samples with that in ``FRESH`` others.

    It is the gradient of the damage through the denoiser, at ``perturbed`` ``[n, obs_dim]``.
    """
    of_action = attack.objective(now.obs).of_action

    def gradient(seed: int, k: int) -> Tensor:
        view = view_defense(now.defense, now.rows, RandomStreams(seed, now.seeds), k, now.action)

        def damage(seen: Tensor) -> Tensor:
            return Outcome.of(seen, view, attack.victim.mean, of_action).denoised.mean(0)

        return value_and_gradient(damage, perturbed)[1]

    return torch.cosine_similarity(gradient(2, samples), gradient(3, FRESH), dim=-1)


def signal_to_noise(model: GRUVAE, obs: Tensor) -> Tensor:
    """Of each latent dimension the variance of mu over all steps, divided by the mean of sigma^2, ``[latent_dim]``.

    Args:
        model: of a detector or denoiser.
        obs: sequences ``[N, steps, obs_dim]``, all of them at their full length.
    """
    mean, log_variance, _ = model.encode(obs)
    return mean.flatten(0, 1).var(0) / log_variance.exp().flatten(0, 1).mean(0)


@torch.no_grad()
def measure(
    attack: OppositeAttack, defense: DetectAndDenoise, episodes: Episodes, at: Sequence[int], steps: int
) -> dict:
    """What the latents' noise of one defence costs an attacker, ready for JSON.

    Args:
        attack: that does not know the defence.
        defense: of two GRU-VAEs.
        episodes: under this attack and with this defence.
        at: the steps to look at.
        steps: of the adaptive attack.

    Returns:
        Deviations of the action, one for each episode and step that is looked at: ``clean``, under the ``unaware``
        attack, under the adaptive attack on the same defence without noise (``mean``), and under the adaptive attack
        by K (``samples``) and its cross-check without gradients (``free``). By K the ``alignment``. And the denoiser's
        ``latent``: signal to noise, sorted.
    """
    found: dict = dict(clean=[], unaware=[], mean=[], free=[], samples={}, alignment={})
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


def measure_latent_noise(run: Run, variants: Sequence[str] = MEASURED, n: int = 32) -> None:
    """The stage: ``barrier.json`` of a run, on tuning episodes."""
    path = run.folder / "barrier.json"
    if manifest.is_made(path, run.root):
        return
    victim, at = run.victim(), [step for step in AT if step < run.scale.horizon]
    chosen, attack, found = seeds("tuning", min(n, run.scale.episodes)), run.opposite(victim), {}
    for name in variants:
        defense = run.defense(name)
        played = rollout(
            victim,
            run.task,
            chosen,
            attack=attack,
            defense=defense,
            steps=max(at) + 1,
            progress=f"latent noise of {name}",
        )
        found[name] = measure(attack, defense, played, at, run.scale.adaptive["steps"])
    manifest.write_json(path, dict(variants=found, seeds=[chosen[0], len(chosen)], at=at), run.root)
