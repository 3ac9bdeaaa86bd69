"""Senseless arguments and observations are refused by errors that name them; sound ones cost one check an episode."""

from math import inf, nan

import gymnasium
import numpy as np
import pytest
import torch
from builders import BUDGET, HOPPER, make_defense, make_victim, normal
from gymnasium.error import ResetNeeded

from detden_lite.attacks.adaptive import AdaptiveAttack, CoupledAttack, GradientFreeAttack, StealthyAttack
from detden_lite.attacks.attacked_observations import AttackedObservations
from detden_lite.attacks.enchanting import EnchantingAttack
from detden_lite.attacks.noise import GaussianNoise, UniformNoise
from detden_lite.attacks.opposite import OppositeAttack
from detden_lite.attacks.optimal import OptimalAttack
from detden_lite.attacks.printed import PrintedAttack
from detden_lite.attacks.qfunction import QFunctionAttack
from detden_lite.attacks.threat import Threat
from detden_lite.attacks.timing import After, Random, Vulnerable
from detden_lite.core.budget import Budget
from detden_lite.core.tasks import get_task
from detden_lite.core.types import World
from detden_lite.recipe.linear_search import LinearMaps
from detden_lite.training.adversary_world import AdversaryEnv
from detden_lite.victims.victim import Victim

VICTIM, WALKER = make_victim(), make_victim(get_task("walker2d"))
PLAIN = OppositeAttack(VICTIM, BUDGET)
GRADIENT = (OppositeAttack, QFunctionAttack)
INFORMED = (AdaptiveAttack, GradientFreeAttack, StealthyAttack, CoupledAttack, PrintedAttack)
WIDE = Budget(0.1, scale=[1.0] * 17)
HALF = Victim([11, 5], gaussian=True)
NO_NUMBERS = (0, -1, 1.5, nan, "many")


def make_adversary(obs_dim: int = 11) -> Victim:
    return Victim([obs_dim, obs_dim], gaussian=True)


def make_world(**changes) -> AdversaryEnv:
    return AdversaryEnv(**dict(victim=VICTIM, task=HOPPER, budget=BUDGET, n=1) | changes)


SENSELESS = [  # what to make, and the argument that the error must name
    *((lambda t=t: Vulnerable(VICTIM, t), "threshold") for t in (nan, "low", None)),
    *((lambda s=s: After(s), "step") for s in (-1, 1.5, nan, None)),
    *((lambda r=r: Random(r), "rate") for r in (-0.1, 1.1, nan, "often")),
    *(
        (lambda k=kind, a=argument, v=value: k(VICTIM, BUDGET, **{a: v}), argument)
        for kind in GRADIENT
        for argument in ("steps", "restarts")
        for value in NO_NUMBERS
    ),
    *(
        (lambda k=kind, a=argument, v=value: k(PLAIN, **{a: v}), argument)
        for kind in (AdaptiveAttack, StealthyAttack, CoupledAttack, GradientFreeAttack)
        for argument in ("steps", "restarts", "samples", "fresh")
        for value in NO_NUMBERS
    ),
    *((lambda v=v: GradientFreeAttack(PLAIN, elites=v), "elites") for v in (1, 2.5, 33)),
    *((lambda v=v: GradientFreeAttack(PLAIN, population=v), "population") for v in (1, 32.5)),
    *((lambda v=v: CoupledAttack(PLAIN, v), "pace") for v in (0, -1, nan, inf)),
    *((lambda v=v: PrintedAttack(PLAIN, weight=v), "weight") for v in (nan, inf)),
    *((lambda k=kind, b=b: k(VICTIM, b), "budget") for kind in GRADIENT for b in (0.1, None, "0.1")),
    *((lambda k=kind, b=b: k(b), "budget") for kind in (UniformNoise, GaussianNoise, Threat) for b in (0.1, None)),
    *((lambda k=kind: k("td3", BUDGET), "victim") for kind in GRADIENT),
    *((lambda k=kind: k(VICTIM, WIDE), "scale") for kind in GRADIENT),
    *((lambda k=kind, a=a: k(a), "attack") for kind in INFORMED for a in ("opposite", UniformNoise(BUDGET))),
    (lambda: EnchantingAttack(VICTIM, BUDGET, None).reset(None), "episodes"),
    (lambda: OptimalAttack(make_adversary(), 0.1), "budget"),
    (lambda: OptimalAttack(make_adversary(), WIDE), "scale"),
    (lambda: OptimalAttack(HALF, BUDGET), "adversary"),
    *((lambda n=n: make_world(n=n), "n must") for n in NO_NUMBERS),
    *((lambda s=s: make_world(steps=s), "steps") for s in (0, -1, 1.5)),
    (lambda: make_world(budget=0.1), "budget"),
    (lambda: make_world(budget=WIDE), "scale"),
    (lambda: make_world(victim=WALKER), "victim"),
    (lambda: make_world(timing="always"), "timing"),
    (lambda: make_world(defense="mixed"), "defense"),
    *(
        (lambda a=argument, v=value: Threat(BUDGET, **{a: v}), argument)
        for argument, value in (
            *(("steps", value) for value in NO_NUMBERS),
            *(("restarts", value) for value in NO_NUMBERS),
            *(("rate", value) for value in (-0.1, 1.5, nan)),
            *(("rate_third", value) for value in (-0.1, 1.5, nan)),
            ("c_vul", nan),
            ("c_third", nan),
        )
    ),
    (lambda: Threat(BUDGET).attack("tickle", VICTIM, HOPPER), "attack"),
    (lambda: Threat(BUDGET).timing("never", VICTIM), "timing"),
    *((lambda a=a: AttackedObservations(gymnasium.make("Hopper-v5"), a), "attack") for a in ("opposite", 1)),
    (lambda: AttackedObservations(gymnasium.make("Hopper-v5"), PLAIN, "always"), "timing"),
    *((lambda e=e: AttackedObservations(gymnasium.make(e), PLAIN), "env") for e in ("Walker2d-v5", "Blackjack-v1")),
]


@pytest.mark.parametrize(("make", "argument"), SENSELESS)
def test_a_senseless_argument_is_named_at_construction(make, argument):
    with pytest.raises(ValueError, match=argument):
        make()


def attacks() -> list:
    """One of every kind."""
    informed = [kind(OppositeAttack(VICTIM, BUDGET, steps=1)) for kind in INFORMED]
    small = dict(steps=1, samples=1, fresh=1)
    informed[:4] = [kind(OppositeAttack(VICTIM, BUDGET, steps=1), **small) for kind in INFORMED[:4]]
    gradient = [kind(VICTIM, BUDGET, steps=1) for kind in GRADIENT]
    return [UniformNoise(BUDGET), GaussianNoise(BUDGET), OptimalAttack(make_adversary(), BUDGET), *gradient, *informed]


ATTACKS = pytest.mark.parametrize("attack", attacks(), ids=lambda attack: type(attack).__name__)


def make_world_of(obs: torch.Tensor) -> World:
    defense = make_defense()
    defense.reset(range(len(obs)))
    return World(np.ones(len(obs), dtype=bool), defense=defense)


@ATTACKS
def test_a_call_before_reset_is_refused(attack):
    with pytest.raises(ValueError, match=rf"{type(attack).__name__}: no episode is under way; call reset\(episodes\)"):
        attack(normal(2, 11), make_world_of(normal(2, 11)))


@ATTACKS
@pytest.mark.parametrize("wrong", [nan, inf, -inf])
def test_observations_that_are_not_finite_are_refused(attack, wrong):
    obs = normal(2, 11)
    obs[1, 3] = wrong
    attack.reset(range(2))
    with pytest.raises(ValueError, match="obs holds NaN or infinity"):
        attack(obs, make_world_of(obs))


@ATTACKS
def test_observations_of_another_task_are_refused(attack):
    if attack.obs_dim is None:
        pytest.skip("noise is for observations of any length")
    attack.reset(range(2))
    with pytest.raises(ValueError, match="(victim|adversary): it sees 11 numbers, and an observation here has 17"):
        attack(normal(2, 17), make_world_of(normal(2, 11)))


@ATTACKS
@pytest.mark.parametrize("obs", [normal(11), normal(2, 1, 11), normal(2, 11).numpy(), "left", None])
def test_observations_of_another_shape_are_refused(attack, obs):
    attack.reset(range(2))
    with pytest.raises(ValueError, match=r"obs must be a tensor \[N, obs_dim\]"):
        attack(obs, make_world_of(normal(2, 11)))


@pytest.mark.parametrize("kind", [UniformNoise, GaussianNoise])
def test_noise_refuses_a_scale_of_another_length(kind):
    attack = kind(WIDE)
    attack.reset(range(2))
    with pytest.raises(ValueError, match="scale"):
        attack(normal(2, 11))


def test_linear_maps_of_another_task_are_refused():
    attack = OptimalAttack(LinearMaps(make_adversary(17), torch.zeros(2, 17, 18)), BUDGET)
    attack.reset(range(2))
    with pytest.raises(ValueError, match="adversary: it sees 17 numbers"):
        attack(normal(2, 11))


def test_an_adversary_with_too_few_outputs_is_refused():
    attack = OptimalAttack(lambda obs: obs[:, :5], BUDGET)
    attack.reset(range(2))
    with pytest.raises(ValueError, match="adversary: it perturbs 5 numbers of 11"):
        attack(normal(2, 11))


def test_the_check_is_repeated_after_every_reset():
    attack = OppositeAttack(VICTIM, BUDGET, steps=1)
    for _ in range(2):
        attack.reset(range(2))
        attack(normal(2, 11))
        attack.reset(range(2))
        with pytest.raises(ValueError, match="NaN"):
            attack(normal(2, 11) * nan)


def test_a_planner_needs_a_simulator():
    attack = EnchantingAttack(VICTIM, BUDGET, None)
    with pytest.raises(ValueError, match="world: it has no simulator to plan in"):
        attack.objective(normal(2, 11), World(np.ones(2, dtype=bool)))


@pytest.mark.parametrize(("unwrap", "error"), [(False, ResetNeeded), (True, ValueError)])
def test_an_attacked_environment_must_be_reset_first(unwrap, error):
    env = gymnasium.make("Hopper-v5")
    attacked = AttackedObservations(env.unwrapped if unwrap else env, OppositeAttack(VICTIM, BUDGET))
    with pytest.raises(error, match="reset"):
        attacked.step(np.zeros(3))
