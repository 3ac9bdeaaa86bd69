"""The adaptive attacks as the paper prints them, in section 4.4 and in appendix B, which contradict each other."""

from collections.abc import Callable
from math import inf

import torch
from torch import Tensor

from detden_lite.attacks.catalogue import FORMS
from detden_lite.attacks.enchanting import EnchantingAttack
from detden_lite.attacks.gradient import GradientAttack
from detden_lite.attacks.informed import InformedAttack, View, Views, view_defense
from detden_lite.attacks.opposite import OppositeAttack
from detden_lite.core.arguments import check_between
from detden_lite.core.random_streams import RandomStreams
from detden_lite.core.types import World
from detden_lite.defense.detector import linf_score


class PrintedAttack(InformedAttack):
    """An attack on pi(den(.)) in place of pi, with the detector's l_det in the objective.

    Three things are wrong with it. Where the detector is deceived the action is pi(o_hat) and not pi(den(o_hat)). The
    appendix's l_det is not the detector's score: to increase it raises the alarm, unless det(o) is far from o already.
    And every gradient is of a single sample of the latents' noise, a new one at each evaluation, because the attack's
    loop calls the networks directly.

    The paper prints lengths without a square, and so they are here: in a sum it matters. l_det is in the units of the
    detector's score, and the opposite attack moves the action away from pi(den(o)).

    Args:
        attack: opposite, Q-function or enchanting; its steps, restarts and random starts are used.
        form: "text" decreases ||det(o_hat) - o_hat||_inf, "appendix" increases ||det(o_hat) - o||_inf.
        weight: of l_det; the paper's is 1.
        seed: of the attacker's latent samples.
        view: see ``InformedAttack``.

    Raises:
        ValueError: for another form, or a weight that is negative or infinite.

    Example:
        >>> from detden_lite import Budget, OppositeAttack, PrintedAttack, Victim
        >>> PrintedAttack(OppositeAttack(Victim([11, 8, 3]), Budget(0.1)), "appendix").settings
        {'form': 'appendix', 'weight': 1.0}
    """

    def __init__(
        self, attack: GradientAttack, form: str = "text", weight: float = 1.0, seed: int = 0,
        view: Callable[..., View] = view_defense,
    ) -> None:  # fmt: skip
        if form not in FORMS:
            raise ValueError(f"form must be one of {', '.join(FORMS)}, not {form!r}")
        check_between(0, inf, weight=weight)
        super().__init__(attack, seed, view)
        self.form, self.weight = form, weight

    @property
    def settings(self) -> dict[str, float | str]:
        return dict(form=self.form, weight=self.weight)

    def perturb(self, obs: Tensor, wanted: Tensor, world: World, views: Views, streams: RandomStreams) -> Tensor:
        true = obs[wanted]
        opposite = isinstance(self.attack, OppositeAttack)
        damage = self.attack.objective(views(1).denoise(true)[0] if opposite else true, world).of_action
        squared = isinstance(self.attack, EnchantingAttack) or (opposite and self.attack.victim.action_std is None)

        def objective(perturbed: Tensor) -> Tensor:
            view = views(1)
            value = damage(self.policy(view.denoise(perturbed)[0]))
            if squared:
                value = value.sign() * (value.abs() + torch.finfo(value.dtype).tiny).sqrt()
            reconstruction, units = view.reconstruct(perturbed)[0], torch.as_tensor(view.scale)
            if self.form == "text":
                return value - self.weight * linf_score(perturbed, reconstruction, units)
            return value + self.weight * linf_score(true, reconstruction, units)

        return self.attack.ascend(objective, obs, wanted)
