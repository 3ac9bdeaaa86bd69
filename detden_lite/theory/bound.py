"""Appendix A of the paper, link by link: from the denoiser's error to the value that an attack can cost.

    V_pi(s) - V_{pi o nu}(s)  <=  alpha max TV                       ``alpha``
    TV                        <=  sqrt(KL / 2)                       ``pinsker``
    KL                        <=  C_1 C_2 ||mu_2 - mu_1||^2          ``c_1``, ``c_2``
    ||mu_2 - mu_1||           <=  L ||o' - o||                       ``lipschitz_certified``
    ||o' - o||                <=  max ||den(o_hat) - o||             ``detden_lite.theory.worst_error``

Here nu is the attacker together with the defence, if there is one: the policy acts on nu(s) and the world goes on from
s. The paper prints V_pi(o) - V_pi(o') on the left of the first line, which is another quantity and is not bounded so.
"""

from math import inf, sqrt

import torch
from torch import Tensor, nn

from detden_lite.core.arguments import check_between
from detden_lite.core.distances import mahalanobis
from detden_lite.core.gradients import value_and_gradient
from detden_lite.victims.victim import Victim


def kl_parts(mean_1: Tensor, cov_1: Tensor, mean_2: Tensor, cov_2: Tensor) -> tuple[Tensor, Tensor]:
    """The two terms of D_KL(N(mean_1, cov_1) || N(mean_2, cov_2)), which is their sum.

    The first, 1/2 (log |cov_2| / |cov_1| - d + tr(cov_2^-1 cov_1)), does not depend on the means; the second,
    1/2 (mean_2 - mean_1)^T cov_2^-1 (mean_2 - mean_1), is half the squared Mahalanobis distance.

    Args:
        mean_1: ``[..., d]``, where d is the number of *actions*.
        cov_1: ``[d, d]``, positive definite.
        mean_2: ``[..., d]``.
        cov_2: ``[d, d]``, positive definite.

    Returns:
        A number and a tensor ``[...]``, neither of them negative.

    Example:
        >>> one = torch.eye(1)
        >>> [term.item() for term in kl_parts(torch.zeros(1), one, torch.ones(1), one)]
        [0.0, 0.5]
    """
    d = cov_1.shape[-1]
    log_ratio = torch.linalg.slogdet(cov_2).logabsdet - torch.linalg.slogdet(cov_1).logabsdet
    trace = torch.linalg.solve(cov_2, cov_1).diagonal(dim1=-2, dim2=-1).sum(-1)
    return 0.5 * (log_ratio - d + trace), 0.5 * mahalanobis(mean_2, mean_1, factor=torch.linalg.cholesky(cov_2))


def total_variation(distance: Tensor) -> Tensor:
    """The total variation of two Gaussians of EQUAL covariance, exactly: 2 Phi(distance / 2) - 1.

    The difference of the densities lies along the line through the means; half-way between them they cross.

    Args:
        distance: the Mahalanobis distance of their means (not squared), any shape.

    Example:
        >>> total_variation(torch.tensor([0.0, 1.0, 10.0]))
        tensor([0.0000, 0.3829, 1.0000])
    """
    return torch.erf(distance / (2 * sqrt(2)))


def pinsker(kl: Tensor) -> Tensor:
    """Pinsker's inequality, the appendix's first: TV <= sqrt(KL / 2). It says nothing from KL = 2 on."""
    return (0.5 * kl).sqrt()


def c_1(cov_1: Tensor, cov_2: Tensor) -> float:
    """The smallest C_1 with KL <= C_1 (mu_2 - mu_1)^T cov_2^-1 (mu_2 - mu_1) for all means.

    1/2 for equal covariances, and then KL is equal to the right side. Otherwise there is none, here infinity: at equal
    means the right side is 0 and the KL is not.

    Args:
        cov_1: ``[d, d]``.
        cov_2: ``[d, d]``.
    """
    return 0.5 if torch.equal(cov_1, cov_2) else inf


def c_2(cov: Tensor) -> float:
    """The smallest C_2 with x^T cov^-1 x <= C_2 ||x||^2 for all x: the largest eigenvalue of cov^-1, cov ``[d, d]``.

    Raises:
        ValueError: if ``cov`` is not positive definite.

    Example:
        >>> c_2(torch.diag(torch.tensor([4.0, 0.25])))
        4.0
    """
    smallest = torch.linalg.eigvalsh(cov)[0].item()
    if not smallest > 0:
        raise ValueError(f"cov must be positive definite; its smallest eigenvalue is {smallest:.3g}")
    return 1 / smallest


def lipschitz_certified(victim: Victim) -> float:
    """An L with ||mu(o') - mu(o)||_2 <= L ||o' - o||_2 for ALL observations: the product of the layers' spectral norms.

    ReLU, tanh and the clipping of normalised observations do not stretch distances. The normaliser's scale belongs to
    the first layer and a TD3 action's scale to the last, and are multiplied into them before their norms are taken.
    """
    weights = [layer.weight for layer in victim.actor if isinstance(layer, nn.Linear)]
    weights[0] = weights[0] / victim.obs_std
    if victim.action_std is None:
        weights[-1] = 0.5 * (victim.action_high - victim.action_low)[:, None] * weights[-1]
    norms = [torch.linalg.matrix_norm(weight.double(), ord=2) for weight in weights]
    return torch.stack(norms).prod().item()


def stretches(victim: Victim, obs: Tensor) -> Tensor:
    """How much the policy stretches at most around each observation: the largest singular value of its Jacobian.

    No L is smaller than any of these, so their largest is a LOWER estimate of the smallest L.

    Args:
        victim: the policy; its unclipped mean is differentiated.
        obs: ``[N, obs_dim]``.

    Returns:
        ``[N]``.
    """

    def gradient(i: int) -> Tensor:
        return value_and_gradient(lambda x: victim.mean(x)[:, i], obs)[1]

    rows = [gradient(i) for i in range(victim.action_dim)]
    return torch.linalg.matrix_norm(torch.stack(rows, 1), ord=2)  # of the Jacobians, [N, action_dim, obs_dim]


def alpha(gamma: float, reward_range: float) -> float:
    """The smallest alpha with V_pi(s) - V_{pi o nu}(s) <= alpha max TV in every MDP: (R_max - R_min) / (1 - gamma)^2.

    TV is half the l1 distance of the action distributions, as in Pinsker's inequality.

    Args:
        gamma: the discount, in [0, 1).
        reward_range: R_max - R_min; at most 2 max |R|.

    Raises:
        ValueError: for another gamma.
    """
    return _checked(gamma, reward_range) / (1 - gamma) ** 2


def alpha_printed(gamma: float, reward_range: float) -> float:
    """alpha as in Theorem 5 of Zhang et al. (2020), 2 [1 + gamma / (1 - gamma)^2] max |R|, for 2 max |R| = the range.

    It is smaller than ``alpha`` for every gamma in (0, 1), and too small: ``finite_mdp.leaving`` loses more. With TV
    as the whole l1 distance it would be large enough, but Pinsker's inequality would need another constant.
    """
    return _checked(gamma, reward_range) * (1 + gamma / (1 - gamma) ** 2)


def most_that_can_be_lost(gamma: float, reward_range: float) -> float:
    """The limit that V_pi(s) - V_{pi o nu}(s) never exceeds: (R_max - R_min) / (1 - gamma)."""
    return _checked(gamma, reward_range) / (1 - gamma)


def coupled(tv: float, gamma: float, reward_range: float) -> float:
    """The sharpest bound that knows nothing but max TV: range * TV / ((1 - gamma) (1 - gamma + gamma TV)).

    Both robots can be run so that they act alike with probability 1 - TV at every step; the rewards of a step differ
    only if they have parted by then, and sum_t gamma^t (1 - (1 - TV)^(t + 1)) is this. ``alpha`` is its slope at 0.

    Raises:
        ValueError: for a ``tv`` that is not between 0 and 1, or another gamma.

    Example:
        >>> coupled(tv=1.0, gamma=0.5, reward_range=2.0) == most_that_can_be_lost(gamma=0.5, reward_range=2.0)
        True
    """
    check_between(0, 1, tv=tv)
    return most_that_can_be_lost(gamma, reward_range) * tv / (1 - gamma + gamma * tv)


def largest_gamma(tv: float) -> float:
    """The discount from which on alpha * TV is vacuous, no less than the most that can be lost: 1 - TV.

    Put otherwise, the bound speaks only if the horizon 1 / (1 - gamma) is shorter than 1 / TV, the expected number of
    steps until the two robots part.
    """
    check_between(0, 1, tv=tv)
    return max(0.0, 1 - tv)


def beta(alpha: float, lipschitz: float, c_2: float, c_1: float = 0.5) -> float:
    """The factor of the paper's theorem 1, alpha L sqrt(C_1 C_2 / 2). L and C_2 are those of pi, and so beta is too."""
    check_between(0, inf, alpha=alpha, lipschitz=lipschitz, c_2=c_2, c_1=c_1)
    return alpha * lipschitz * sqrt(0.5 * c_1 * c_2)


def _checked(gamma: float, reward_range: float) -> float:
    if not 0 <= gamma < 1:
        raise ValueError(f"gamma must be in [0, 1), not {gamma}: the values are sums of discounted rewards")
    if not 0 <= reward_range < inf:
        raise ValueError(f"reward_range is the largest reward minus the smallest, not {reward_range}")
    return reward_range
