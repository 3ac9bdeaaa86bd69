"""Attacks that know the defence, on toys whose worst point is known and on small real defences."""

import copy
from collections.abc import Callable
from dataclasses import dataclass
from math import inf

import numpy as np
import pytest
import torch
from builders import (
    BUDGET,
    HOPPER,
    FixedPlan,
    Quadratic,
    cases,
    excess,
    make_defense,
    make_gruvae,
    make_victim,
    normal,
    steady,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from detden_lite.attacks.adaptive import AdaptiveAttack, CoupledAttack, GradientFreeAttack, Outcome, StealthyAttack
from detden_lite.attacks.enchanting import EnchantingAttack
from detden_lite.attacks.informed import View, one_step, view_defense
from detden_lite.attacks.opposite import OppositeAttack
from detden_lite.attacks.printed import PrintedAttack
from detden_lite.attacks.qfunction import QFunctionAttack
from detden_lite.core.budget import Budget
from detden_lite.core.gradients import value_and_gradient
from detden_lite.core.random_streams import RandomStreams
from detden_lite.core.types import World
from detden_lite.defense.baselines import Identity
from detden_lite.defense.denoiser import Denoiser
from detden_lite.defense.detector import Detector
from detden_lite.defense.dynamics import Dynamics
from detden_lite.defense.pipeline import DetectAndDenoise
from detden_lite.defense.predict_correct import PredictCorrect, Surprise
from detden_lite.simulation.rollout import rollout
from detden_lite.simulation.simulator import Simulator
from detden_lite.victims.victim import Victim

EPSILON = 0.1
SEARCH = dict(steps=80, restarts=6, samples=1, fresh=1)  # on a toy whose worst point is to be found
SMALL = dict(steps=3, restarts=1, samples=2, fresh=3)


@dataclass(frozen=True)
class Toy:
    """Alarms outside a box around a prediction ``[N, obs_dim]``; ``den`` maps o_hat and noise ``[K, n, obs_dim]``."""

    prediction: Tensor
    radius: float
    den: Callable[[Tensor, Tensor], Tensor] = lambda seen, noise: torch.zeros_like(noise)
    follows: float = 0.0  # how far the reconstruction follows what is seen
    true: Tensor | float = 0.0  # from where on


def see(toy: Toy, rows: Tensor, streams: RandomStreams, samples: int, action: Tensor | None = None) -> View:
    """How the toy is seen."""
    prediction = toy.prediction[rows]
    n, dim = prediction.shape
    noise = streams.normal(n * samples, dim).reshape(n, samples, dim).transpose(0, 1)

    def reconstruct(seen: Tensor) -> Tensor:
        return (prediction + toy.follows * (seen - toy.true)).expand_as(noise)

    return View(reconstruct, lambda seen: toy.den(seen, noise), 1.0, toy.radius)


def strike(attack, obs: Tensor, defense, wanted=None, episodes=None) -> Tensor:
    """One step of an attack on a defence that has just been reset, or has a memory."""
    attack.reset(range(len(obs)) if episodes is None else episodes)
    wanted = np.ones(len(obs), dtype=bool) if wanted is None else np.array(wanted)
    return attack(obs, World(wanted, defense=defense))


def linear_victim(dim: int = 6) -> tuple[Victim, Tensor]:
    """A policy with one action, w.o + b, and w."""
    torch.manual_seed(0)
    victim = Victim([dim, 1], gaussian=True)
    return victim, victim.actor[0].weight[0]


def warm_defense(obs_dim: int = 11, n: int = 4, steps: int = 3, **parts) -> DetectAndDenoise:
    """A real defence that has seen some steps of n episodes."""
    whole = make_defense(obs_dim)
    defense = DetectAndDenoise(**(dict(detector=whole.detector, denoiser=whole.denoiser) | parts))
    defense.reset(range(n))
    for obs in normal(steps, n, obs_dim, seed=5):
        defense(obs)
    return defense


def in_effect(toy: Toy, seen: Tensor) -> Tensor:
    """The observation that the defended policy acts on, for a toy without noise."""
    alarm = (seen - toy.prediction).abs().amax(-1) > toy.radius
    return torch.where(alarm[:, None], toy.den(seen, torch.zeros(1, *seen.shape))[0], seen)


# The view of a defence


@pytest.mark.parametrize("steps", [0, 3])
@pytest.mark.parametrize("layers", [1, 2])
def test_the_view_predicts_the_next_step_of_the_defence(steps, layers):
    parts = dict(
        detector=Detector(make_gruvae(layers=layers), 2.0), denoiser=Denoiser(make_gruvae(seed=1, residual=True))
    )
    defense, obs = warm_defense(steps=steps, **parts), normal(4, 11)
    noises = [copy.deepcopy(part.streams).normal(4, 4)[None] for part in defense.parts]
    everyone = torch.ones(4, dtype=torch.bool)
    reconstruct, denoise = (one_step(*pair) for pair in zip(defense.parts, [everyone] * 2, noises, strict=True))
    view = View(reconstruct, denoise, defense.detector.model.obs_std, defense.detector.threshold)
    score = view.deviation(obs).amax(-1)[0]
    some = torch.tensor([True, False, True, True])
    alone = one_step(defense.denoiser, some, noises[1][:, some])(obs[some])[0]
    verdict = defense(obs)
    assert torch.allclose(score, verdict.score, atol=1e-5)
    assert torch.equal(score > view.threshold, verdict.alarm)
    assert torch.allclose(denoise(obs)[0], verdict.denoised, atol=1e-5)
    assert torch.allclose(alone, verdict.denoised[some], atol=1e-5)


@pytest.mark.parametrize("change", ["nothing", "always", "projected", "detector-only"])
def test_the_view_of_an_ablation_is_exact_without_noise(change):
    """Of a defence without noise what is seen is exactly what it does."""
    changes = dict(always=dict(always=True), projected=dict(budget=BUDGET)) | {"detector-only": dict(denoiser=None)}
    parts = dict(
        detector=Detector(make_gruvae(), 1.5, sample=False), denoiser=Denoiser(make_gruvae(seed=1), sample=False)
    )
    defense, obs = warm_defense(**parts | changes.get(change, {})), normal(4, 11)
    view = view_defense(defense, torch.ones(4, dtype=torch.bool), RandomStreams(0), 5)
    alarm = view.deviation(obs).amax(-1)[0] > view.threshold
    denoised = view.denoise(obs)[0]
    verdict = defense(obs)
    assert torch.allclose(torch.where(alarm[:, None], denoised, obs), verdict.obs, atol=1e-5)
    assert torch.allclose(denoised, verdict.denoised, atol=1e-5)


def predicting_defense(steps: int = 3) -> tuple[DetectAndDenoise, Tensor, Tensor]:
    """A defence that predicts, with an untrained model, after some steps; its next observation and last action."""
    torch.manual_seed(0)
    model = Dynamics(obs_dim=11, action_dim=3, state_dim=9, hidden=8).requires_grad_(False)
    denoiser = PredictCorrect(model, BUDGET)
    defense = DetectAndDenoise(Surprise(denoiser), denoiser)
    defense.reset(range(4))
    for t in range(steps):
        defense(normal(4, 11, seed=t), normal(4, 3, seed=t) if t else None)
    return defense, normal(4, 11, seed=9), normal(4, 3, seed=9)


def test_the_view_of_a_defence_that_predicts_is_exact():
    defense, obs, action = predicting_defense()
    some = torch.tensor([True, False, True, True])
    view = view_defense(defense, some, RandomStreams(0), 5, action[some])
    shown = defense.denoiser.predict(action).obs + BUDGET.epsilon * torch.linspace(-0.001, 0.9, 4)[:, None]
    score, denoised = view.deviation(shown[some]).amax(-1)[0], view.denoise(shown[some])[0]
    verdict = defense(shown, action)
    assert torch.equal(score > view.threshold, verdict.alarm[some])
    assert torch.allclose(denoised, verdict.denoised[some], atol=1e-5)


def test_an_attack_on_a_defence_that_predicts_leaves_its_memory():
    defense, obs, action = predicting_defense()
    attack = AdaptiveAttack(OppositeAttack(make_victim(), BUDGET), steps=2, samples=1, fresh=1)
    attack.reset(range(4))
    before = copy.deepcopy(defense)
    found = attack(obs, World(np.ones(4, bool), defense=defense, action=action))
    assert BUDGET.contains(obs, found).all() and not torch.equal(found, obs)
    assert torch.equal(before(obs, action).denoised, defense(obs, action).denoised)


def test_the_attackers_samples_have_the_same_distribution():
    defense, obs, rows = warm_defense(), normal(4, 11), torch.ones(4, dtype=torch.bool)
    view = view_defense(defense, rows, RandomStreams(0), 4_000)
    assert not torch.allclose(
        view.reconstruct(obs), view_defense(defense, rows, RandomStreams(1), 4_000).reconstruct(obs)
    )
    verdicts = [copy.deepcopy(defense) for _ in range(200)]
    for i, copied in enumerate(verdicts):
        copied.denoiser.streams = RandomStreams(i)
    denoised = torch.stack([copied(obs).denoised for copied in verdicts])
    assert torch.allclose(view.denoise(obs).mean(0), denoised.mean(0), atol=0.1)
    assert torch.allclose(view.denoise(obs).std(0), denoised.std(0), rtol=0.4, atol=0.02)


def test_the_gradient_of_the_mean_varies_less():
    """The variance falls as 1 / K: to a sixteenth here, up to sampling error."""
    victim, obs, defense = make_victim(), normal(4, 11), warm_defense()
    rows, streams = torch.ones(4, dtype=torch.bool), RandomStreams(0)
    objective = OppositeAttack(victim, BUDGET).objective(obs + 1)

    def spread(samples: int) -> float:
        def damage(seen: Tensor) -> Tensor:
            return Outcome.of(
                seen, view_defense(defense, rows, streams, samples), victim.mean, objective.of_action
            ).denoised.mean(0)

        def gradient() -> Tensor:
            return value_and_gradient(damage, obs)[1]

        return float(torch.stack([gradient() for _ in range(60)]).var(0).mean())

    assert 1 / 32 < spread(16) / spread(1) < 1 / 8


def test_a_defence_without_networks_is_refused():
    attack = AdaptiveAttack(OppositeAttack(make_victim(), BUDGET), **SMALL)
    with pytest.raises(ValueError, match="defense: its Identity is no GRU-VAE; give the attack a view of your own"):
        strike(attack, normal(4, 11), warm_defense(denoiser=Identity()))
    with pytest.raises(ValueError, match="no defense to adapt to"):
        strike(attack, normal(4, 11), None)


# The attack as it should be


def a_box(radius: float, kept: float) -> tuple[Victim, Tensor, Toy, Tensor]:
    """A box around o, a denoiser that keeps a share of the perturbation, and how far the action can be moved."""
    victim, weight = linear_victim()
    obs = normal(20, 6)
    prediction = obs + 0.04 * normal(20, 6, seed=1).tanh()
    toy = Toy(prediction, radius, lambda seen, noise: (obs + kept * (seen - obs)).expand_as(noise))
    low = (prediction - radius - obs).clamp(min=-EPSILON)
    high = (prediction + radius - obs).clamp(max=EPSILON)
    ends = [torch.where(sign * weight > 0, high, low) @ weight for sign in (1, -1)]
    quiet, loud = torch.stack(ends).abs().amax(0), kept * EPSILON * weight.abs().sum()
    return victim, obs, toy, quiet.maximum(loud)


def moved(victim: Victim, obs: Tensor, toy: Toy, seen: Tensor) -> Tensor:
    """How far the defended policy's one action is from the clean one."""
    return (victim.mean(in_effect(toy, seen)) - victim.mean(obs)).abs()[:, 0]


@pytest.mark.parametrize("radius, kept", [(0.06, 0.8), (0.08, 0.3)])
def test_the_worst_point_is_found_through_detector_or_denoiser(radius, kept):
    victim, obs, toy, most = a_box(radius, kept)
    found = strike(AdaptiveAttack(OppositeAttack(victim, Budget(EPSILON)), **SEARCH, view=see), obs, toy)
    assert torch.allclose(moved(victim, obs, toy, found), most, rtol=1e-3)
    silent = (found - toy.prediction).abs().amax(-1) <= radius
    assert silent.any() and (kept < 0.5 or not silent.all())


def test_the_stealthy_attack_finds_the_worst_undetected_point():
    victim, obs, toy, _ = a_box(0.06, 0.8)  # where more is to be had through the denoiser
    *_, most = a_box(0.06, 0.0)  # the same box, and nothing is to be had there
    found = strike(StealthyAttack(OppositeAttack(victim, Budget(EPSILON)), **SEARCH, view=see), obs, toy)
    assert ((found - toy.prediction).abs().amax(-1) <= toy.radius).all()
    assert torch.allclose(moved(victim, obs, toy, found), most, rtol=1e-3)


def test_it_is_never_weaker_than_the_unaware_attack():
    for radius, kept in ((-1.0, 0.5), (0.06, 0.8), (0.09, 0.0), (inf, 0.0)):
        victim, obs, toy, _ = a_box(radius, kept)
        plain = OppositeAttack(victim, Budget(EPSILON), steps=20)
        unaware = strike(plain, obs, None)
        found = strike(AdaptiveAttack(plain, **SMALL, view=see), obs, toy)
        assert (moved(victim, obs, toy, found) >= moved(victim, obs, toy, unaware)).all()


def test_a_denoiser_without_gradient_stops_only_the_printed_attacks():
    """Its output is always the truth, so that only undetected perturbations do damage."""
    victim, obs, toy, most = a_box(0.06, 0.0)
    plain = OppositeAttack(victim, Budget(EPSILON), steps=80)
    for form in ("text", "appendix"):
        printed = moved(victim, obs, toy, strike(PrintedAttack(plain, form, view=see), obs, toy))
        assert printed.mean() < 0.2 * most.mean()
    found = strike(AdaptiveAttack(plain, **SEARCH, view=see), obs, toy)
    assert torch.allclose(moved(victim, obs, toy, found), most, rtol=1e-3)


def test_noise_stops_only_the_printed_attack():
    """The policy always acts on a noisy denoised observation; only the mean tells which direction does damage."""
    victim, obs = Quadratic(), normal(40, 6)
    toy = Toy(obs, -1.0, lambda seen, noise: seen + 2 * noise)
    plain = QFunctionAttack(victim, Budget(EPSILON), steps=20)
    away = victim(obs)[:, 0] - obs[:, 0]
    reach = EPSILON * victim.actor[0].weight.abs().sum()
    clear = away.abs() > reach  # elsewhere both ends of the reachable interval are far from the best action

    def share_found(attack) -> float:
        far = (victim(strike(attack, obs, toy))[:, 0] - obs[:, 0]).abs()
        return float((far > away.abs() + 0.99 * reach)[clear].float().mean())

    assert share_found(PrintedAttack(plain, view=see)) < 0.5
    assert share_found(AdaptiveAttack(plain, steps=20, samples=64, fresh=64, view=see)) > 0.9


def test_the_gradient_free_search_reveals_masked_gradients():
    """A denoiser that rounds, and inverts every other perturbation: no gradient, and the plain attack does not help."""
    victim, weight = linear_victim()
    obs, turn = normal(20, 6), torch.tensor([1.0, -1.0] * 3)
    step = EPSILON / 2
    toy = Toy(obs, -1.0, lambda seen, noise: (obs + turn * step * ((seen - obs) / step).round()).expand_as(noise))
    plain, most = OppositeAttack(victim, Budget(EPSILON)), EPSILON * weight.abs().sum()
    gradient = strike(AdaptiveAttack(plain, steps=10, restarts=1, samples=1, fresh=1, view=see), obs, toy)
    free = strike(GradientFreeAttack(plain, restarts=1, samples=1, fresh=1, view=see), obs, toy)
    assert moved(victim, obs, toy, gradient).mean() < 0.8 * most
    assert moved(victim, obs, toy, free).mean() > 0.95 * most


def test_the_gradient_free_search_comes_near_the_worst_point():
    victim, obs, toy, most = a_box(0.08, 0.3)
    found = strike(GradientFreeAttack(OppositeAttack(victim, Budget(EPSILON)), samples=1, fresh=1, view=see), obs, toy)
    assert (moved(victim, obs, toy, found) / most).mean() > 0.85


def test_damage_is_defined_by_the_given_attack():
    """The enchanting attack's is the distance to the planner's action: here 0, which a point in the box reaches."""
    victim, weight = linear_victim()
    victim.action_low.fill_(-1), victim.action_high.fill_(1)
    obs = normal(20, 6)
    obs = obs - ((victim.mean(obs) - 0.02) @ weight[None]) / weight.square().sum()
    assert torch.allclose(victim.mean(obs), torch.tensor(0.02), atol=1e-5)
    toy = Toy(obs, 0.05, lambda seen, noise: obs.expand_as(noise))
    plain = EnchantingAttack(victim, Budget(EPSILON), FixedPlan("Hopper-v5", 0.0))
    attack = AdaptiveAttack(plain, samples=1, fresh=1, view=see)
    assert attack.needs == {"policy", "simulator", "defense"}
    attack.reset(range(20))
    found = attack(obs, World(np.ones(20, dtype=bool), Simulator("Hopper-v5", range(20)), toy))
    assert torch.allclose(victim.mean(in_effect(toy, found)), torch.zeros(()), atol=1e-3)


# Invariants of all of them


def made(kind: str, plain, view=view_defense):
    """A small attack of each kind."""
    match kind:
        case "text" | "appendix":
            return PrintedAttack(plain, kind, view=view)
        case "adaptive":
            return AdaptiveAttack(plain, **SMALL, view=view)
        case "gradient-free":
            return GradientFreeAttack(plain, population=4, elites=2, **SMALL | dict(steps=2), view=view)
        case "stealthy":
            return StealthyAttack(plain, **SMALL, view=view)
        case "coupled":
            return CoupledAttack(plain, 0.5, **SMALL, view=view)


KINDS = ["text", "appendix", "adaptive", "gradient-free", "stealthy", "coupled"]


@settings(steady, max_examples=25)
@given(cases(), st.sampled_from(KINDS), st.booleans(), st.sampled_from([-inf, 0.0, 1.0, inf]))
def test_nothing_leaves_the_ball(case, kind, gaussian, radius):
    budget, obs, far = case
    if kind == "coupled" and budget.norm != inf:
        return
    torch.manual_seed(0)
    victim = Victim([obs.shape[1], 8, 2], gaussian=gaussian)
    toy = Toy(far, radius, lambda seen, noise: seen + noise)
    found = strike(made(kind, OppositeAttack(victim, budget, steps=3), see), obs, toy)
    assert excess(budget, obs, found) <= 0


@pytest.mark.parametrize("kind", KINDS)
def test_an_episodes_attack_depends_on_its_own_seed_alone(kind):
    obs, victim = normal(3, 11), make_victim()

    def run(rows, episodes, seed=0):
        attack = made(kind, OppositeAttack(victim, BUDGET, steps=3))
        attack.seed = seed
        defense = make_defense()
        defense.reset(episodes)
        return strike(attack, rows, defense, episodes=episodes)

    together = run(obs, [4, 5, 6])
    assert torch.allclose(run(obs[1:2], [5])[0], together[1], atol=1e-5)
    assert torch.equal(run(obs, [4, 5, 6]), together)
    assert not torch.equal(run(obs, [7, 8, 9]), together)


@pytest.mark.parametrize("kind", KINDS)
def test_only_wanted_rows_are_perturbed_independently_of_the_others(kind):
    obs, defense, attack = normal(4, 11), warm_defense(), made(kind, QFunctionAttack(make_victim(), BUDGET, steps=3))
    world = lambda *wanted: World(np.array(wanted), defense=defense)  # noqa: E731
    attack.reset(range(4))
    attack(obs, world(False, True, True, False))
    whole = attack(obs, world(True, True, True, True))
    attack.reset(range(4))
    nothing = attack(obs, world(False, False, False, False))
    some = attack(obs, world(True, False, True, False))
    assert torch.equal(nothing, obs) and torch.equal(some[1::2], obs[1::2])
    if kind != "coupled":  # which goes on from where it was
        assert torch.allclose(some[::2], whole[::2], atol=1e-5)
    assert (some[::2] != obs[::2]).any()


@pytest.mark.parametrize("kind", KINDS)
def test_the_memory_and_noise_of_the_defence_are_unchanged(kind):
    defense, obs = warm_defense(), normal(4, 11)
    before = copy.deepcopy(defense)
    strike(made(kind, OppositeAttack(make_victim(), BUDGET, steps=3)), obs, defense)
    found, expected = defense(obs), before(obs)
    assert all(torch.equal(getattr(found, name), getattr(expected, name)) for name in vars(expected))


@pytest.mark.parametrize("kind", KINDS)
def test_episodes_in_lockstep_equal_episodes_alone(kind):
    """An episode does not depend on the others beside it."""
    victim = make_victim(seed=8)

    def run(seeds):
        attack = made(kind, OppositeAttack(victim, BUDGET, steps=3))
        return rollout(victim, HOPPER, seeds, attack=attack, defense=make_defense(), steps=4)

    three, one = run([1, 2, 3]), run([2])
    assert BUDGET.contains(torch.from_numpy(three.obs), torch.from_numpy(three.perturbed)).all()
    assert (three.perturbed != three.obs).any(-1).all()
    assert np.allclose(three.perturbed[:, 1:2], one.perturbed, atol=1e-3)


def test_arguments_out_of_range_are_refused():
    plain = OppositeAttack(make_victim(), Budget(0.1, 2))
    for kind, wrong, message in (
        (AdaptiveAttack, dict(samples=0), "samples must be a whole number of at least 1, not 0"),
        (GradientFreeAttack, dict(elites=1), "elites must be a whole number of at least 2"),
        (CoupledAttack, dict(), "budget: a coupled attack needs the norm inf, not 2"),
        (CoupledAttack, dict(pace=-0.1), "pace must be a finite number above 0"),
        (PrintedAttack, dict(form="book"), "form must be one of text, appendix, not 'book'"),
    ):
        with pytest.raises(ValueError, match=message):
            kind(plain, **wrong)


# The attack that drifts


@pytest.mark.parametrize("pace", [0.05, 0.5])
def test_a_coupled_perturbation_keeps_its_pace(pace):
    defense, scale = warm_defense(), torch.linspace(0.5, 2, 11)
    budget = Budget(EPSILON, scale=scale)
    attack = CoupledAttack(OppositeAttack(make_victim(), budget, steps=3), pace, **SMALL)
    attack.reset(range(4))
    last, longest = torch.zeros(4, 11), 0.0
    for obs in normal(6, 4, 11):
        perturbation = attack(obs, World(np.ones(4, dtype=bool), defense=defense)) - obs
        change = ((perturbation - last) / scale).abs()
        assert change.max() <= pace * EPSILON + 1e-6 and (perturbation / scale).abs().max() <= EPSILON + 1e-6
        last, longest = perturbation, max(longest, float((perturbation / scale).abs().max()))
    assert longest > min(EPSILON, 4 * pace * EPSILON)  # the pace alone does not keep it near zero


def test_an_unwanted_step_starts_the_drift_again():
    attack, obs = CoupledAttack(OppositeAttack(make_victim(), BUDGET, steps=3), 0.5, **SMALL), normal(4, 11)
    defense = warm_defense()
    attack.reset(range(4))
    for _ in range(3):
        attack(obs, World(np.ones(4, dtype=bool), defense=defense))
    attack(obs, World(np.array([True, False, True, False]), defense=defense))
    size = BUDGET.size(obs, attack(obs, World(np.ones(4, dtype=bool), defense=defense)))
    assert (size[1::2] <= 0.5 * BUDGET.epsilon + 1e-6).all() and (size[::2] > 0.5 * BUDGET.epsilon + 1e-6).any()


def test_a_pace_of_two_is_no_condition():
    defense, plain = warm_defense(), OppositeAttack(make_victim(), BUDGET, steps=3)
    free, coupled = AdaptiveAttack(plain, **SMALL), CoupledAttack(copy.copy(plain), 2.0, **SMALL)
    free.reset(range(4)), coupled.reset(range(4))
    for obs in normal(3, 4, 11):
        world = World(np.ones(4, dtype=bool), defense=defense)
        assert torch.allclose(free(obs, world), coupled(obs, world), atol=1e-6)


# The attacks as printed


@pytest.mark.parametrize("error, raised", [(0.0, 0.5), (3 * EPSILON, -0.5)])
def test_the_two_printed_forms_move_the_score_apart(error, raised):
    """det(o_hat) = o + error + (o_hat - o) / 2, the error in one component.

    To raise ||det(o_hat) - o|| is to go away from o, or, if the error is larger than the ball, to go after it: towards
    the reconstruction, so that the score falls as with the other form.
    """
    victim, obs = make_victim(), normal(16, 11)
    prediction = obs + error * (torch.arange(11) == 0)
    toy = Toy(prediction, inf, lambda seen, noise: obs.expand_as(noise), follows=0.5, true=obs)
    plain = OppositeAttack(victim, Budget(EPSILON), steps=100)
    view = see(toy, torch.ones(16, dtype=torch.bool), RandomStreams(0), 1)

    def score(seen: Tensor) -> Tensor:
        return view.deviation(seen).amax(-1)[0]

    text, appendix = (strike(PrintedAttack(plain, form, view=see), obs, toy) for form in ("text", "appendix"))
    assert torch.allclose(score(appendix), score(obs) + raised * EPSILON, atol=1e-3)
    low = score(obs) if error else 0.8 * score(appendix)
    assert (score(text) < low).all()


def test_without_l_det_the_two_forms_are_equal():
    defense, obs, plain = warm_defense(), normal(4, 11), OppositeAttack(make_victim(), BUDGET, steps=3)
    text, appendix = (strike(PrintedAttack(plain, form, weight=0), obs, defense) for form in ("text", "appendix"))
    assert torch.equal(text, appendix)


def test_the_printed_opposite_attack_leaves_the_denoised_action():
    """A denoiser that adds 5 leaves both ends equally far; seen from pi(o), one of them would be farther."""
    victim, weight = linear_victim()
    obs = normal(40, 6)
    toy = Toy(obs, inf, lambda seen, noise: (seen + 5).expand_as(noise))
    found = strike(PrintedAttack(OppositeAttack(victim, Budget(EPSILON), steps=40), weight=0, view=see), obs, toy)
    away = (found - obs) @ weight
    assert torch.allclose(away.abs(), EPSILON * weight.abs().sum(), rtol=1e-3)
    assert (away > 0).any() and (away < 0).any()


@pytest.mark.parametrize("weight, leaves", [(0.5, True), (2.0, False)])
def test_lengths_are_weighed_against_l_det_without_a_square(weight, leaves):
    """|a'(o) d| against weight |d|, of a policy whose slope is 1 at o: only the larger of the two counts."""
    victim = Victim([1, 1])
    victim.actor[0].weight.fill_(1), victim.actor[0].bias.fill_(0)
    obs = torch.zeros(8, 1)
    toy = Toy(obs, inf, lambda seen, noise: seen.expand_as(noise))
    plain = OppositeAttack(victim, Budget(EPSILON), steps=40)
    found = strike(PrintedAttack(plain, weight=weight, view=see), obs, toy).abs()
    assert (found > 0.99 * EPSILON).all() if leaves else (found < 0.1 * EPSILON).all()
