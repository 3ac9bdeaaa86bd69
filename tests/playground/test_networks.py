"""Networks, attacks and defence in the page compute what the library computes."""

import copy
from itertools import product

import numpy as np
import pytest
import torch

from detden_lite import Budget, get_task, load_defense, load_victim
from detden_lite.attacks.opposite import opposite_objective
from detden_lite.attacks.optimal import OptimalAttack
from detden_lite.attacks.qfunction import q_objective
from detden_lite.core.gradients import value_and_gradient
from detden_lite.simulation.rollout import rollout
from detden_lite.store.models import load_adversary

VICTIMS = [f"{task}-{algo}" for task in ("hopper", "walker2d", "halfcheetah") for algo in ("td3", "ppo")]


@pytest.fixture(params=VICTIMS)
def named(request):
    return request.param


@pytest.fixture
def victim(named):
    return load_victim(*named.split("-"))


@pytest.fixture
def obs(named, victim):
    """Observations around those of an episode, as far away as an attacker could ever move them."""
    random, task = np.random.default_rng(0), get_task(named.split("-")[0])
    seen = rollout(victim, task, [3], steps=40).obs[:, 0]
    return torch.from_numpy(seen + random.uniform(-3, 3, seen.shape).astype(np.float32) * np.float32(task.epsilon))


@pytest.fixture
def precise(victim):
    """The victim in double precision, as the page computes: torch's own rounding is left out of the comparison."""
    return copy.deepcopy(victim).double()


def close(found: list, wanted: torch.Tensor) -> bool:
    """Equal up to 1e-5 of the largest number in each row."""
    wanted = wanted.reshape(len(wanted), -1).double().numpy()
    size = np.maximum(1, np.abs(wanted).max(-1, keepdims=True))
    return bool((np.abs(np.array(found).reshape(wanted.shape) - wanted) <= 1e-5 * size).all())


def test_policy_critics_and_value_are_those_of_torch(ask, named, precise, obs):
    victim, obs = precise, obs.double()
    action = victim(obs.flip(0))
    (rows,) = ask(named, dict(ask="networks", obs=obs.tolist(), action=action.tolist()))
    for name, wanted in dict(act=victim(obs), qs=victim.qs(obs, action).T, value=victim.value(obs)).items():
        assert close([row[name] for row in rows], wanted), name


def test_objectives_and_their_gradients_are_those_of_autograd(ask, named, precise, obs):
    victim, obs = precise, obs.double()
    (rows,) = ask(named, dict(ask="networks", obs=obs.tolist(), action=victim(obs).tolist()))
    for name, objective in dict(opposite=opposite_objective, badness=q_objective).items():
        value, gradient = value_and_gradient(objective(victim, obs.roll(-1, 0)), obs)
        found = np.array([row[name] for row in rows])
        assert close(found[:, 0], value)
        assert close(found[:, 1:], gradient)


def test_learned_adversaries_perturb_as_the_library_lets_them(ask, named, obs):
    task, algo = named.split("-")
    (found,) = ask(named, dict(ask="adversaries", obs=obs.tolist()))
    assert {"linear", "optimal"} <= set(found)
    for kind, rows in found.items():
        attack = OptimalAttack(load_adversary(task, algo, kind), Budget(get_task(task).epsilon))
        attack.reset()
        assert close(rows, attack(obs))


def test_the_defence_judges_a_whole_sequence_as_the_library_does(ask, named, obs):
    defense = load_defense(*named.split("-"))
    defense.reset([0])
    noise = [[part.streams.normal(1, part.model.latent_dim)[0].tolist() for _ in obs] for part in defense.parts]
    (rows,) = ask(named, dict(ask="defense", obs=obs.tolist(), noise=noise))
    defense.reset([0])  # its random numbers begin again
    verdicts = [defense(row[None]) for row in obs]
    assert close([row["score"] for row in rows], torch.stack([verdict.score for verdict in verdicts]))
    assert close([row["denoised"] for row in rows], torch.cat([verdict.denoised for verdict in verdicts]))
    assert close([row["shown"] for row in rows], torch.cat([verdict.obs for verdict in verdicts]))
    assert [row["alarm"] for row in rows] == [verdict.alarm.item() for verdict in verdicts]


def test_an_attack_stays_in_its_ball_and_is_repeated_by_its_seed(ask):
    chance = dict.fromkeys(("uniform", "corner", "fgsm", "opposite", "qfunction"), True)
    cases = list(product(chance | dict.fromkeys(("hand", "linear", "optimal"), False), (0.0, 0.075, 0.3)))
    obs = torch.randn(5, 11, generator=torch.Generator().manual_seed(0))
    about = dict(ask="attack", obs=obs.tolist(), steps=5, offset=[2.0, -0.5])
    questions = [about | dict(name=name, epsilon=epsilon, seed=seed) for name, epsilon in cases for seed in (1, 1, 2)]
    answers = iter(ask("hopper-td3", *questions))
    for (name, epsilon), first, again, other in zip(cases, answers, answers, answers, strict=True):
        assert first == again
        assert Budget(epsilon).contains(obs, torch.tensor(first), atol=1e-6).all()
        assert (torch.tensor(first) != obs).any() == (epsilon > 0)
        assert (first != other) == (epsilon > 0 and name in chance)


def test_more_steps_move_the_action_further_than_one_and_one_further_than_noise(ask):
    victim, obs = load_victim("hopper", "td3"), rollout(load_victim("hopper", "td3"), get_task("hopper"), [0], steps=60)
    true = torch.from_numpy(obs.obs[:, 0])
    attacks = dict(uniform=1, fgsm=1, opposite=20)
    questions = [
        dict(ask="attack", name=name, obs=true.tolist(), steps=steps, epsilon=0.075, seed=0)
        for name, steps in attacks.items()
    ]
    moved = opposite_objective(victim, true)
    noise, one, twenty = (moved(torch.tensor(rows)).mean() for rows in ask("hopper-td3", *questions))
    assert noise < one < twenty
