"""The attacker's side. An attack has ``needs``, what it knows of the victim; ``reset(episodes)``, called with one seed
an episode; and ``attack(obs, world) -> perturbed``, all ``[N, obs_dim]``.

What can be needed: "policy" (with its gradients), "critic", "simulator" (the world's present state), "defense" (its
networks and memory), and "adversary" (a policy that was learned before, on the victim as a black box in the simulator).

Those that need the defense are in ``attacks.printed`` and ``attacks.adaptive``, and are imported from there: the rest
of this package knows no defence.
"""

from detden_lite.attacks.enchanting import EnchantingAttack
from detden_lite.attacks.noise import GaussianNoise, UniformNoise
from detden_lite.attacks.opposite import OppositeAttack
from detden_lite.attacks.optimal import OptimalAttack
from detden_lite.attacks.qfunction import QFunctionAttack
from detden_lite.attacks.timing import After, Always, Random, Vulnerable

__all__ = [
    "After", "Always", "EnchantingAttack", "GaussianNoise", "OppositeAttack", "OptimalAttack", "QFunctionAttack",
    "Random", "UniformNoise", "Vulnerable",
]  # fmt: skip
