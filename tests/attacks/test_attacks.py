import numpy as np
import pytest
import torch
from builders import BUDGET, NORMS, FixedPlan, Quadratic, cases, excess, make_victim, normal, steady
from hypothesis import given
from hypothesis import strategies as st

from detden_lite.attacks.enchanting import EnchantingAttack
from detden_lite.attacks.noise import GaussianNoise, UniformNoise
from detden_lite.attacks.opposite import OppositeAttack, opposite_objective
from detden_lite.attacks.optimal import OptimalAttack
from detden_lite.attacks.qfunction import QFunctionAttack, q_objective
from detden_lite.core.budget import Budget
from detden_lite.core.gradients import value_and_gradient
from detden_lite.core.tasks import TASKS
from detden_lite.core.types import World
from detden_lite.simulation.planner import CEMPlanner
from detden_lite.simulation.simulator import Simulator
from detden_lite.victims.victim import Victim


def attack_once(attack, obs, episodes=None):
    attack.reset(range(len(obs)) if episodes is None else episodes)
    return attack(obs)


def opposite(budget, seed=0):
    return OppositeAttack(make_victim(), budget, steps=3, restarts=2, seed=seed)


def make_adversary(obs_dim: int) -> Victim:
    torch.manual_seed(1)
    return Victim([obs_dim, 8, obs_dim], gaussian=True)


def optimal(budget):
    return OptimalAttack(make_adversary(11), budget)


@steady
@given(cases(), st.integers(0, 100))
def test_noise_stays_in_the_ball(case, seed):
    budget, obs, _ = case
    for kind in (UniformNoise, GaussianNoise):
        assert excess(budget, obs, attack_once(kind(budget, seed), obs)) <= 0


@steady
@given(cases(), st.integers(1, 3), st.integers(1, 2), st.booleans())
def test_the_opposite_attack_stays_in_the_ball(case, steps, restarts, gaussian):
    budget, obs, _ = case
    torch.manual_seed(0)
    victim = Victim([obs.shape[1], 8, 2], gaussian=gaussian)
    assert excess(budget, obs, attack_once(OppositeAttack(victim, budget, steps, restarts), obs)) <= 0


@steady
@given(cases(), st.floats(1e-3, 1e3), st.booleans())
def test_the_optimal_attack_stays_in_the_ball(case, size, linear):
    """Whatever its adversary puts out."""
    budget, obs, _ = case
    torch.manual_seed(0)
    adversary = Victim([obs.shape[1], *([] if linear else [8]), obs.shape[1]], gaussian=True)
    adversary.actor[-1].weight.mul_(size)
    assert excess(budget, obs, attack_once(OptimalAttack(adversary, budget), obs)) <= 0


@pytest.mark.parametrize("name", TASKS)
def test_the_opposite_attack_works_on_every_task(name):
    task = TASKS[name]
    victim, obs = make_victim(task), normal(4, task.obs_dim)
    perturbed = attack_once(OppositeAttack(victim, Budget(task.epsilon), steps=5), obs)
    assert excess(Budget(task.epsilon), obs, perturbed) <= 0
    assert (opposite_objective(victim, obs)(perturbed) > 0).all()


@pytest.mark.parametrize("kind", [UniformNoise, GaussianNoise, opposite, optimal])
@pytest.mark.parametrize("norm", NORMS)
def test_epsilon_zero_changes_nothing(kind, norm):
    obs = normal(4, 11)
    assert torch.equal(attack_once(kind(Budget(0.0, norm)), obs), obs)


@pytest.mark.parametrize("gaussian", [False, True])
@pytest.mark.parametrize("norm", NORMS)
def test_on_a_linear_policy_the_known_optimum_is_found(gaussian, norm):
    """One action w.o + b: the distance is largest, (epsilon * dual norm of w)^2, at one of two opposite corners."""
    torch.manual_seed(0)
    victim = Victim([6, 1], gaussian=gaussian)
    if gaussian:
        victim.action_std.fill_(0.5)
    weight, obs = victim.actor[0].weight[0], normal(10, 6)
    budget = Budget(0.05, norm, torch.linspace(0.5, 2, 6))
    dual = {float("inf"): 1, 2: 2, 1: float("inf")}[norm]
    reach = 0.05 * torch.linalg.vector_norm(weight * budget.scale, ord=dual)
    attack = OppositeAttack(victim, budget, steps=100, restarts=3)
    perturbed = attack_once(attack, obs)
    moved = (victim.actor[0](perturbed) - victim.actor[0](obs)).abs().squeeze(-1)
    # On the l2 sphere steps of 2.5 epsilon in all turn a bad start only so far.
    assert np.allclose(moved, reach, rtol=2e-2 if norm == 2 else 1e-3)
    if gaussian:  # the squared Mahalanobis distance of the means
        assert torch.allclose(opposite_objective(victim, obs)(perturbed), (moved / 0.5).square(), rtol=1e-3)


def test_the_objective_weighs_actions_by_the_inverse_variance():
    victim, obs = make_victim(gaussian=True), normal(5, 11)
    victim.action_std.copy_(torch.tensor([0.1, 1.0, 10.0]))
    perturbed = obs + 0.1
    moved = victim.mean(perturbed) - victim.mean(obs)
    expected = torch.stack([m @ torch.diag(victim.action_std**-2) @ m for m in moved])
    assert torch.allclose(opposite_objective(victim, obs)(perturbed), expected, rtol=1e-4)


def test_the_gradient_attack_is_stronger_than_noise():
    victim, obs = make_victim(hidden=64), normal(100, 11)
    objective = opposite_objective(victim, obs)
    noise = [UniformNoise(BUDGET), GaussianNoise(BUDGET)]
    gradient = [OppositeAttack(victim, BUDGET, steps) for steps in (1, 20)]
    uniform, gaussian, fgsm, pgd = [objective(attack_once(attack, obs)).mean() for attack in noise + gradient]
    assert max(uniform, gaussian) < fgsm < pgd


def test_restarts_make_the_opposite_attack_stronger():
    victim, obs = make_victim(hidden=64), normal(100, 11)
    objective = opposite_objective(victim, obs)
    once, often = (objective(attack_once(OppositeAttack(victim, BUDGET, 5, restarts), obs)) for restarts in (1, 5))
    assert (often >= once).all() and (often > once).any()


def test_five_restarts_reach_the_best_corner_of_a_linear_policy():
    """All corners are tried: of a length that is convex in the perturbation one of them is the maximum."""
    corners = torch.cartesian_prod(*[torch.tensor([-1.0, 1.0])] * 11)
    shares = []
    for seed in range(20):
        victim, obs = Victim([11, 3], gaussian=True), normal(10, 11, seed=seed)
        victim.actor[0].weight.copy_(normal(3, 11, seed=seed))
        most = (0.1 * corners @ victim.actor[0].weight.T).norm(dim=-1).max()
        found = attack_once(OppositeAttack(victim, Budget(0.1), steps=20, restarts=5), obs)
        shares.append(opposite_objective(victim, obs)(found).sqrt() / most)
    assert 0.99 < torch.cat(shares).mean() < 1 + 1e-5


def test_gaussian_noise_is_as_wide_as_the_ball():
    perturbed = attack_once(GaussianNoise(Budget(1.0)), torch.zeros(20_000, 1), [0])
    inside = perturbed[perturbed.abs() < 1]
    assert abs(len(inside) / len(perturbed) - 0.683) < 0.02  # the rest was projected on the border
    assert abs(float((inside.abs() < 0.5).double().mean()) - 0.561) < 0.02
    scaled = attack_once(GaussianNoise(Budget(1.0, scale=torch.tensor([0.1, 10.0]))), torch.zeros(20_000, 2), [0])
    assert scaled.std(0)[1] / scaled.std(0)[0] == pytest.approx(100, rel=0.05)


@pytest.mark.parametrize("kind", [UniformNoise, GaussianNoise, opposite])
def test_an_episodes_attack_depends_on_its_own_seed_alone(kind):
    obs = normal(3, 11)
    together = attack_once(kind(BUDGET), obs, [4, 5, 6])
    assert torch.allclose(attack_once(kind(BUDGET), obs[1:2], [5])[0], together[1], atol=1e-6)
    assert torch.equal(attack_once(kind(BUDGET), obs, [4, 5, 6]), together)
    assert not torch.equal(attack_once(kind(BUDGET), obs, [7, 8, 9]), together)
    assert not torch.equal(attack_once(kind(BUDGET, seed=1), obs, [4, 5, 6]), together)


def test_attacks_declare_what_they_know():
    assert UniformNoise(BUDGET).needs == GaussianNoise(BUDGET).needs == frozenset()
    assert OppositeAttack(make_victim(), BUDGET).needs == {"policy"}
    assert QFunctionAttack(make_victim(), BUDGET).needs == {"policy", "critic"}
    assert EnchantingAttack(make_victim(), BUDGET, CEMPlanner("Hopper-v5")).needs == {"policy", "simulator"}
    assert OptimalAttack(make_adversary(11), BUDGET).needs == {"adversary"}


@pytest.mark.parametrize("norm", NORMS)
def test_the_q_attack_finds_the_worst_action(norm):
    """The end of the reachable interval that is farther from the best action."""
    victim, obs = Quadratic(), normal(20, 6)
    dual = {float("inf"): 1, 2: 2, 1: float("inf")}[norm]
    reach = 0.05 * torch.linalg.vector_norm(victim.actor[0].weight[0], ord=dual)
    perturbed = attack_once(QFunctionAttack(victim, Budget(0.05, norm), steps=100, restarts=5), obs)
    worst = ((victim(obs)[:, 0] - obs[:, 0]).abs() + reach).square()
    assert torch.allclose(q_objective(victim, obs)(perturbed), worst, rtol=1e-3, atol=1e-3)


def test_the_q_attack_asks_q_about_the_true_observation():
    """With Q of the perturbed observation, as the paper's released code has it, another point would be found."""
    victim, obs = Quadratic(), normal(20, 6)
    wrong = obs.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(-victim.qs(wrong, victim(wrong)).sum(), wrong)
    one_step = obs + 0.05 * gradient.sign()
    right = attack_once(QFunctionAttack(victim, Budget(0.05), steps=100, restarts=5), obs)
    objective = q_objective(victim, obs)
    assert (objective(right) > objective(one_step) + 1e-4).any()
    assert (objective(right) >= objective(one_step) - 1e-5).all()


def test_a_clipped_gaussian_policy_can_still_be_attacked():
    victim, obs = Quadratic(), normal(20, 6)
    victim.action_high.fill_(-0.5)  # below most means: clipping would hide the gradient
    victim.action_low.fill_(-0.6)
    attack = QFunctionAttack(victim, Budget(1.0), steps=20)
    assert torch.isfinite(attack_once(attack, obs)).all()
    x = obs.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(victim.straight_through(x).sum(), x)
    assert torch.allclose(gradient, victim.actor[0].weight.expand_as(gradient))
    assert torch.allclose(victim.straight_through(obs), victim(obs))


def unlike(dim: int, gaussian: bool, activation: str, seed: int) -> Victim:
    """A victim whose normaliser, bounds and Sigma all differ from the defaults."""
    torch.manual_seed(seed)
    victim = Victim(
        [dim, 16, 16, 2], [dim + 2, 8, 1], n_critics=2, activation=activation, critic_activation="tanh",
        gaussian=gaussian,
    )  # fmt: skip
    victim.obs_mean.copy_(torch.randn(dim)), victim.obs_std.copy_(torch.rand(dim) + 0.2), victim.obs_clip.fill_(1.5)
    victim.action_low.copy_(torch.tensor([-0.2, -3.0])), victim.action_high.copy_(torch.tensor([0.1, 2.0]))
    if gaussian:
        victim.action_std.copy_(torch.tensor([0.5, 2.0]))
    return victim


@steady
@given(
    st.integers(1, 9), st.booleans(), st.sampled_from(["relu", "tanh"]), st.booleans(), st.integers(0, 99),
    st.integers(1, 6),
)  # fmt: skip
def test_gradients_by_hand_are_those_of_autograd(dim, gaussian, activation, plain, seed, n):
    victim = unlike(dim, gaussian, activation, seed)
    if plain:  # no normaliser
        victim.obs_mean.zero_(), victim.obs_std.fill_(1), victim.obs_clip.fill_(torch.inf)
    obs, target = normal(n, dim, seed=seed), normal(n, 2, seed=seed + 1)
    enchanting = EnchantingAttack(victim, BUDGET, FixedPlan("Hopper-v5", plan=target))
    world = World(np.ones(n, dtype=bool), Simulator("Hopper-v5", range(n)))
    simple = {
        OppositeAttack(victim, BUDGET): opposite_objective(victim, obs),
        QFunctionAttack(victim, BUDGET): q_objective(victim, obs),
        enchanting: lambda x: -(victim.straight_through(x) - target).square().sum(-1),
    }
    for attack, objective in simple.items():
        by_hand = attack.objective(obs, world)
        points = (obs + 0.1, obs[:1].expand(n, dim) - 0.5)  # the buffers of the first are used again
        for x in (*points, torch.stack(points)):
            expected, slope = value_and_gradient(objective if x.ndim == 2 else torch.vmap(objective), x)
            found, hand = by_hand.value_and_gradient(x)
            assert torch.allclose(found, expected, rtol=1e-4, atol=1e-5)
            assert torch.allclose(by_hand(x), expected, rtol=1e-4, atol=1e-5)
            assert torch.allclose(hand, slope, rtol=1e-3, atol=1e-4 * float(slope.abs().max()) + 1e-6)


@pytest.mark.parametrize("kind", [OppositeAttack, QFunctionAttack])
def test_the_switch_to_autograd_finds_an_equal_maximum(kind):
    victim, obs = unlike(11, gaussian=False, activation="tanh", seed=3), normal(50, 11)
    objective = kind(victim, BUDGET).objective(obs)
    hand, auto = (objective(attack_once(kind(victim, BUDGET, by_hand=on), obs, [0])) for on in (True, False))
    assert torch.allclose(hand, auto, rtol=0.02, atol=1e-3)


@pytest.mark.parametrize("kind", [OppositeAttack, QFunctionAttack])
def test_bfloat16_finds_nearly_the_same_maximum(kind):
    victim, obs = make_victim(hidden=64), normal(500, 11)
    objective = dict(zip((OppositeAttack, QFunctionAttack), (opposite_objective, q_objective), strict=True))[kind]
    before = objective(victim, obs)(obs).mean()
    full, half = (
        objective(victim, obs)(attack_once(kind(victim, BUDGET, dtype=dtype), obs, [0])).mean() - before
        for dtype in (torch.float32, torch.bfloat16)
    )
    assert full > 0 and half > 0.95 * full


@pytest.mark.parametrize("kind", [OppositeAttack, QFunctionAttack])
def test_only_wanted_rows_are_perturbed_independently_of_the_others(kind):
    obs, attack = normal(4, 11), kind(make_victim(), BUDGET, steps=3, restarts=2)
    attack.reset(range(4))
    first, second = attack(obs), attack(obs)
    attack.reset(range(4))
    none = attack(obs, World(np.zeros(4, dtype=bool)))
    some = attack(obs, World(np.array([True, False, True, False])))
    assert torch.equal(none, obs) and torch.equal(some[1::2], obs[1::2])
    assert torch.allclose(some[::2], second[::2], atol=1e-6) and not torch.allclose(first, second)


def test_a_victim_without_a_critic_is_refused():
    with pytest.raises(ValueError, match="no Q-function"):
        attack_once(QFunctionAttack(make_victim(gaussian=True), BUDGET), normal(2, 11))


def test_the_enchanting_attack_reaches_the_planned_action():
    """As near as the ball lets it, on a linear policy."""
    victim, obs = Quadratic(), normal(20, 6)
    world = World(np.ones(20, dtype=bool), Simulator("Hopper-v5", range(20)))
    attack = EnchantingAttack(victim, Budget(0.3), FixedPlan("Hopper-v5"), steps=200, restarts=3)
    attack.reset(range(20))
    found = victim(attack(obs, world))[:, 0]
    action, reach = victim(obs)[:, 0], 0.3 * victim.actor[0].weight.abs().sum()
    nearest = torch.full((20,), 0.3).clamp(action - reach, action + reach)
    assert (nearest == 0.3).any() and (nearest != 0.3).any()
    assert torch.allclose(found, nearest, atol=3e-3)


def test_the_optimal_attack_scales_the_adversary_by_the_ball():
    """Half the radius up in one observation; and a corner that is outside an l2 ball is brought to its surface."""
    adversary, scale = Victim([3, 3], gaussian=True), torch.tensor([1.0, 2.0, 4.0])
    adversary.actor[0].weight.zero_()
    adversary.actor[0].bias.copy_(torch.tensor([0.5, 0.0, 0.0]))
    obs = normal(5, 3)
    for norm in NORMS:
        perturbed = attack_once(OptimalAttack(adversary, Budget(0.2, norm, scale)), obs)
        assert torch.allclose(perturbed - obs, torch.tensor([0.1, 0.0, 0.0]), atol=1e-6)
    adversary.actor[0].bias.copy_(torch.tensor([7.0, -7.0, 7.0]))  # clipped to the corner (1, -1, 1)
    for norm, length in zip(NORMS, (1, 3**0.5, 3), strict=True):
        perturbed = attack_once(OptimalAttack(adversary, Budget(0.2, norm, scale)), obs)
        assert torch.allclose(perturbed - obs, 0.2 / length * scale * torch.tensor([1.0, -1.0, 1.0]), atol=1e-6)


@pytest.mark.parametrize("adversary", [make_adversary(17), make_victim()], ids=["another task", "a victim"])
def test_an_adversary_of_another_task_is_refused(adversary):
    with pytest.raises(ValueError, match="adversary: .*give the adversary of this task"):
        attack_once(OptimalAttack(adversary, BUDGET), normal(4, 11))
