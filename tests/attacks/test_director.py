import pytest
import torch
from builders import BUDGET, HOPPER, make_victim, normal
from hypothesis import given
from hypothesis import strategies as st

from detden_lite.attacks.director import DirectorAttack
from detden_lite.simulation.rollout import rollout
from detden_lite.victims.victim import Victim


@given(st.integers(0, 1_000))
def test_a_linear_policy_goes_as_far_along_the_direction_as_the_ball_allows(seed):
    """The corner of the ball that is best for a linear function of the observation is known."""
    torch.manual_seed(seed)
    victim, obs, direction = Victim([6, 3], gaussian=True), torch.randn(4, 6), torch.randn(4, 3)
    weight = victim.actor[0].weight
    weight.mul_(1e-3)  # so that no action is clipped
    attack = DirectorAttack(None, victim, BUDGET)
    attack.reset(None)
    gained = ((victim.mean(attack.follow(obs, direction)) - victim.mean(obs)) * direction).sum(-1)
    best = BUDGET.epsilon * (direction @ weight).abs().sum(-1)
    assert torch.allclose(gained, best, rtol=1e-3, atol=1e-8)


def test_the_attack_follows_its_director():
    victim, obs = make_victim(), normal(5, 11)
    attack = DirectorAttack(lambda seen: seen[:, :3].sign(), victim, BUDGET)
    attack.reset(range(5))
    assert torch.equal(attack(obs), attack.follow(obs, obs[:, :3].sign()))
    assert BUDGET.contains(obs, attack(obs)).all()
    left, right = (attack.follow(obs, torch.tensor([[side, 0.0, 0.0]]).expand(5, -1)) for side in (-1.0, 1.0))
    assert (victim(left)[:, 0] <= victim(obs)[:, 0]).all() and (victim(obs)[:, 0] <= victim(right)[:, 0]).all()


class EveryOther:
    """A timing: at every second step."""

    def reset(self, episodes):
        self.step = 0

    def __call__(self, obs):
        self.step += 1
        return torch.full((len(obs),), self.step % 2 == 0)


def test_rollout_plays_it_and_attacks_only_when_it_is_time():
    director = Victim([11, 8, 3], gaussian=True)
    attack = DirectorAttack(director, make_victim(), BUDGET, steps=2)
    episodes = rollout(make_victim(), HOPPER, range(2), attack=attack, timing=EveryOther(), steps=6)
    moved = (episodes.perturbed != episodes.obs).any(-1)
    assert moved[1::2].all() and not moved[::2].any()


@pytest.mark.parametrize("sizes", [[11, 11], [17, 3]])
def test_a_director_of_another_task_is_refused(sizes):
    with pytest.raises(ValueError, match=f"director: it leads from {sizes[0]} numbers to {sizes[1]}"):
        DirectorAttack(Victim(sizes, gaussian=True), make_victim(), BUDGET)


def test_a_director_in_training_cannot_attack_alone():
    attack = DirectorAttack(None, make_victim(), BUDGET)
    attack.reset([0])
    with pytest.raises(ValueError, match="director is None"):
        attack(torch.zeros(1, 11))
