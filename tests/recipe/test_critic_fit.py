import pytest
import torch
from builders import BUDGET, HOPPER, make_victim
from cart import CART, GAMMA, TrueQ, make_driver
from torch import nn

from detden_lite.core.budget import Budget
from detden_lite.recipe.critic_fit import Fit, judge_q


class Constant(nn.Module):
    def forward(self, inputs):
        return torch.zeros(*inputs.shape[:-1], 1)


class WrongWay(TrueQ):
    """The truth about the policy's own actions, and a penalty turned into a reward for all others."""

    def forward(self, inputs):
        own = inputs.clone()
        own[..., 1:] = -0.8 * own[..., :1] / 3
        return 2 * super().forward(own) - super().forward(inputs)


def judged(critic: nn.Module) -> Fit:
    driver = make_driver()
    driver.critics = nn.ModuleList([critic])
    return judge_q(driver, CART, range(50), Budget(0.5), GAMMA)


def test_the_truth_predicts_every_effect_and_a_constant_none():
    true, flat, wrong = judged(TrueQ()), judged(Constant()), judged(WrongWay())
    assert true.effect_correlation > 0.95 and true.explained_variance > 0.95
    assert (true.actions, true.episodes) == (200, 50)
    assert (flat.effect_correlation, flat.explained_variance) == (0, pytest.approx(0))
    assert wrong.effect_correlation < -0.95


def test_an_action_is_changed_while_the_episode_lasts():
    found = judge_q(make_victim(), HOPPER, range(6), BUDGET, 0.99, horizon=400)  # an untrained Hopper falls at once
    assert (found.episodes, found.actions) == (6, 24) and found.effect_correlation != 0


@pytest.mark.parametrize("gamma", [0.0, 1.0, -0.1])
def test_a_discount_factor_without_an_end_is_refused(gamma):
    with pytest.raises(ValueError, match="gamma must be"):
        judge_q(make_victim(), HOPPER, range(2), BUDGET, gamma)


def test_a_victim_without_a_critic_is_refused():
    with pytest.raises(ValueError, match="this victim has no Q-function"):
        judge_q(make_victim(gaussian=True), HOPPER, range(2), BUDGET, 0.9, horizon=4)
