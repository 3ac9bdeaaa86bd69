"""Every entry of the list of attacks makes an attack that keeps its contract, and says the truth about it."""

import subprocess
import sys

import numpy as np
import pytest
import torch
from builders import BUDGET, HOPPER, excess, make_defense, make_victim

from detden_lite.attacks.catalogue import ATTACKS, CATALOGUE, TITLES, names
from detden_lite.attacks.threat import Threat
from detden_lite.core.types import KNOWLEDGE, World
from detden_lite.simulation import guests
from detden_lite.simulation.simulator import Simulator
from detden_lite.victims.victim import Victim

EPISODES = [4, 5, 6]


def make_threat() -> Threat:
    torch.manual_seed(0)
    kinds = ("optimal", "linear", "offset", "adaptive-optimal", "adaptive-offset")
    adversaries = {kind: Victim([11, 11], gaussian=True) for kind in kinds}
    adversaries |= {kind: Victim([11, 3], gaussian=True) for kind in ("director", "adaptive-director")}
    planner = dict(horizon=3, population=4, iterations=1, elites=2)
    return Threat(
        BUDGET, 2, planner=planner, adversaries=adversaries, adaptive=dict(steps=2, restarts=1, samples=2, fresh=2)
    )


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_entry_makes_an_attack_that_keeps_its_contract(name):
    attack = CATALOGUE[name].make(make_threat(), make_victim(), HOPPER)
    defense, simulator = make_defense(), Simulator("Hopper-v5", EPISODES)
    obs, everyone = torch.from_numpy(simulator.reset()), torch.ones(3, dtype=torch.bool)
    defense.reset(EPISODES)
    guests.check_guests(attack, None, defense)

    def strike() -> torch.Tensor:
        attack.reset(EPISODES)
        return attack(obs, World(np.ones(3, dtype=bool), simulator, defense))

    perturbed = strike()
    guests.check_perturbed(attack, perturbed, obs, everyone)
    assert excess(BUDGET, obs, perturbed) <= 0 and (perturbed != obs).any()
    assert torch.equal(strike(), perturbed)
    assert attack.needs == CATALOGUE[name].needs <= set(KNOWLEDGE)


def test_names_titles_and_colours_are_distinct():
    colours = [entry.colour for entry in CATALOGUE.values() if entry.colour]
    assert len(set(colours)) == len(colours) > 5
    assert len(set(TITLES.values())) == len(TITLES) == len(CATALOGUE) + 1


def test_attacks_that_know_the_defence_name_one_that_does_not():
    for entry in CATALOGUE.values():
        assert (entry.group == "aware") == (entry.unaware is not None)
        assert entry.unaware is None or entry.unaware in ATTACKS
    assert set(CATALOGUE) == {*ATTACKS, *names("aware")}


def test_a_missing_adversary_is_named():
    with pytest.raises(ValueError, match="adversaries: the linear one is missing"):
        CATALOGUE["linear"].make(Threat(BUDGET), make_victim(), HOPPER)


def test_reading_the_list_loads_no_network():
    script = "import detden_lite.attacks.catalogue, sys; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", script]).returncode == 0
