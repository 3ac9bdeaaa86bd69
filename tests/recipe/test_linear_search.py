from dataclasses import replace
from itertools import product
from math import inf, nan

import numpy as np
import pytest
import torch
from builders import HOPPER, normal
from safetensors.torch import load_file

from detden_lite.attacks.optimal import OptimalAttack
from detden_lite.core.budget import Budget
from detden_lite.core.tasks import Task
from detden_lite.recipe.linear_search import LinearMaps, LinearRecipe, elite_weights, fit, search
from detden_lite.simulation.rollout import rollout
from detden_lite.victims.victim import Victim

TOY = Task("toy", "none", 0.1, obs_dim=4, action_dim=1)
CLEAN = (3 + 2 * normal(50, 4)).numpy()
RECIPE = LinearRecipe(generations=15, population=32, elites=8, episodes=1)


def adversaries(folder, recipe=RECIPE, task=TOY):
    return [
        Victim.from_state(recipe.config(task), load_file(path)) for path in sorted((folder / "snapshots").iterdir())
    ]


def test_the_best_elite_counts_most_and_the_worst_still_counts():
    weights = elite_weights(8)
    assert float(weights.sum()) == pytest.approx(1) and (weights.diff() < 0).all() and weights[-1] > 0
    assert weights[0] > 0.25


def test_the_distribution_is_fitted_to_the_lowest_returns():
    samples, returns = normal(5, 2, 3), torch.tensor([3.0, 1.0, 5.0, 2.0, 4.0])
    mean, std = fit(samples, returns, 2)
    (w1, w2), best, second = elite_weights(2), samples[1], samples[3]
    assert torch.allclose(mean, w1 * best + w2 * second)
    assert torch.allclose(std.square(), w1 * w2 * (best - second).square(), atol=1e-6)
    assert torch.equal(fit(samples, returns, 1)[0], best) and not fit(samples, returns, 1)[1].any()


def test_each_map_equals_an_adversary_of_one_layer():
    normalizer = Victim([4, 4], gaussian=True)
    normalizer.obs_mean.fill_(0.5)
    normalizer.obs_std.fill_(2.0)
    maps, obs = normal(6, 4, 5), normal(6, 4, seed=1)
    found = LinearMaps(normalizer, maps)(obs)
    assert (found.abs() == 1).any() and (found.abs() < 1).any()
    for row, o, m in zip(found, obs, maps, strict=True):
        normalizer.actor[0].weight.copy_(m[:, :4])
        normalizer.actor[0].bias.copy_(m[:, 4])
        assert torch.allclose(row, normalizer(o), atol=1e-6)


def harm(obs: torch.Tensor, weight: torch.Tensor):
    """A return that rises with every perturbation by as much as ``weight`` says, at each of some observations."""

    def measure(maps: LinearMaps, generation: int) -> torch.Tensor:
        n = len(maps.maps)
        return torch.stack([maps(o.expand(n, -1)) @ weight for o in obs]).mean(0)

    return measure


def test_the_best_constant_perturbation_is_found(tmp_path):
    """At no observation can a return be lower than at the corner against the weights."""
    obs, weight = torch.from_numpy(CLEAN[:10]), torch.tensor([1.0, -2.0, 0.5, -0.25])
    search(replace(RECIPE, generations=40), TOY, 0, tmp_path, CLEAN, harm(obs, weight))
    found = [float((adversary(obs) @ weight).mean()) for adversary in adversaries(tmp_path)]
    assert found[-1] < found[0] and found[-1] == pytest.approx(-3.75, rel=0.05)


def test_it_harms_a_robot_like_the_worst_constant_perturbation(tmp_path):
    """The victim is linear and sees three observations; of constant perturbations all corners are tried."""
    torch.manual_seed(0)
    victim, budget, steps = Victim([11, 3], gaussian=True), Budget(0.5), 12
    victim.actor[0].weight[:, 3:] = 0
    corners = torch.tensor(list(product((-1.0, 1.0), repeat=3)))

    class Constant(Victim):
        def forward(self, obs):
            return torch.cat([self.corner, torch.zeros(len(obs), 8)], 1)

    constant = Constant([11, 11], gaussian=True)
    constant.corner = corners
    seeds = [5] * len(corners)
    worst = rollout(victim, HOPPER, seeds, attack=OptimalAttack(constant, budget), steps=steps).returns.min()
    clean = rollout(victim, HOPPER, [5], steps=steps)

    def measure(maps, generation):
        rows = rollout(victim, HOPPER, [5] * len(maps.maps), attack=OptimalAttack(maps, budget), steps=steps)
        return torch.from_numpy(rows.returns)

    search(RECIPE, HOPPER, 0, tmp_path, clean.obs[clean.mask], measure)
    last = adversaries(tmp_path, task=HOPPER)[-1]
    found = rollout(victim, HOPPER, [5], attack=OptimalAttack(last, budget), steps=steps).returns[0]
    damage = clean.returns[0] - worst
    assert damage > 0.5 and clean.returns[0] - found > 0.98 * damage


def test_the_normaliser_is_fitted_to_the_clean_observations(tmp_path):
    clean = CLEAN.copy()
    clean[:, 2] = 7.0  # one that never changes
    search(replace(RECIPE, generations=1), TOY, 0, tmp_path, clean, harm(normal(2, 4), torch.ones(4)))
    (adversary,) = adversaries(tmp_path)
    assert np.allclose(adversary.obs_mean, clean.mean(0), rtol=1e-5)
    assert np.allclose(adversary.obs_std, [*clean.std(0)[:2], 1.0, clean.std(0)[3]], rtol=1e-5)


def contents(folder):
    return {path.name: path.read_bytes() for path in (folder / "snapshots").iterdir()}


def test_a_resumed_search_equals_an_uninterrupted_one(tmp_path):
    measure, asked = harm(normal(5, 4), normal(4)), []

    def failing(maps, generation):
        asked.append(generation)
        if len(asked) == 7:
            raise KeyboardInterrupt
        return measure(maps, generation)

    search(RECIPE, TOY, 3, tmp_path / "whole", CLEAN, measure)
    with pytest.raises(KeyboardInterrupt):
        search(RECIPE, TOY, 3, tmp_path / "killed", CLEAN, failing)
    assert len(contents(tmp_path / "killed")) == 6
    search(RECIPE, TOY, 3, tmp_path / "killed", CLEAN, failing)
    assert contents(tmp_path / "killed") == contents(tmp_path / "whole")
    assert asked == [*range(7), *range(6, 15)]
    search(RECIPE, TOY, 3, tmp_path / "killed", CLEAN, failing)
    assert len(asked) == 16  # it is finished


@pytest.mark.parametrize("change", [dict(seed=1), dict(about=dict(victim="b")), dict(spread=2.0)])
def test_a_folder_with_another_search_is_refused(tmp_path, change):
    measure, recipe = harm(normal(5, 4), normal(4)), replace(RECIPE, generations=1)
    search(recipe, TOY, 0, tmp_path, CLEAN, measure, dict(victim="a"))
    seed, about = change.pop("seed", 0), change.pop("about", dict(victim="a"))
    with pytest.raises(ValueError, match="recipe.json describes another run"):
        search(replace(recipe, **change), TOY, seed, tmp_path, CLEAN, measure, about)


@pytest.mark.parametrize(
    ("argument", "value"),
    [
        *product(("generations", "population", "elites", "episodes"), (0, -1, 1.5, nan, "many")),
        *product(("spread",), (0, -1, nan, inf)),
        *product(("floor",), (-0.1, 1.1, nan)),
        ("elites", 65),
    ],
)
def test_senseless_sizes_are_named(argument, value):
    with pytest.raises(ValueError, match=argument):
        LinearRecipe(**{argument: value})
