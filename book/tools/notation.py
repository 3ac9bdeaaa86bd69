"""The tables of the page about notation: symbols with their names in the code, and the library's list of defences."""

import inspect
import re

from detden_lite.defense import variants
from detden_lite.defense.variants import DATASETS, MAIN, VARIANTS
from detden_lite.training.gruvae_training import VAERecipe

# symbol, in words, name in the code, shape; each name is looked up by a test
SYMBOLS = (
    (r"$o_t$", "true observation", "Episodes.obs", "`[N, obs_dim]`"),
    (r"$\hat o_t$", "what the policy is shown by an attacker", "Episodes.perturbed", "`[N, obs_dim]`"),
    (r"$o'_t$", "the detector's reconstruction of its input", "Detector.step", "`[N, obs_dim]`"),
    (r"$\mathrm{den}(\hat o)$", "what the denoiser makes of it", "Episodes.denoised", "`[N, obs_dim]`"),
    (r"$a_t = \pi(o_t)$", "action; the mean of a stochastic policy", "Victim.forward", "`[N, action_dim]`"),
    (
        r"$\Sigma$",
        "covariance of a Gaussian policy; the code has its root",
        "Victim.action_std",
        "`[action_dim]`",
    ),
    (r"$Q(o, a)$, $V(o)$", "expected discounted return", "Victim.q, Victim.value", "`[N]`"),
    (r"$G_t$", "discounted return from step t on", "", "`[steps]`"),
    (r"$\gamma$", "discount of later rewards", "FiniteMDP.gamma", "a number"),
    (r"$B(o)$, $\varepsilon$", "the ball of allowed perturbations, its radius", "Budget, Budget.epsilon", "a number"),
    (r"$\delta$", "perturbation, $\\hat o - o$".replace("\\\\", "\\"), "", "`[N, obs_dim]`"),
    (r"$1_{vul}$, $C_{vul}$", "whether the attacker strikes; its threshold", "Vulnerable.threshold", "`[N]` bool"),
    (r"$1_{anomaly}$, $C_{anomaly}$", "alarm; its threshold", "Episodes.alarm, Detector.threshold", "`[N]` bool"),
    (r"$h^o$, $h^z$", "memories of encoder and decoder", "GRUVAE.encode, GRUVAE.decode", "`[layers, N, hidden]`"),
    (r"$z$, $\mu$, $\sigma$", "latent, its mean and standard deviation", "GRUVAE.encode", "`[N, latent_dim]`"),
    (r"$\beta$", "weight of the KL term", "VAERecipe.beta", "a number"),
    (r"$\lambda$", "weight of the regulariser", "VAERecipe.lam", "a number"),
    (r"$D_{normal}$", "clean trajectories", "Trajectories.obs", "`[episodes, steps, obs_dim]`"),
    (r"$D_{adv}$", "the same, attacked offline", "augment", "`[episodes, steps, obs_dim]`"),
    (r"$R_{ppo}$, $R_{td3}$", "distance of two actions", "mahalanobis, euclidean", "`[N]`"),
)
EXPLORATION = {
    "plain": "none",
    "diverse": "none and a little, up to {most:g} of half the action range",
    "coloured": "as *diverse*, white or correlated for up to {memory:g} steps",
}


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    return "\n".join("| " + " | ".join(row) + " |" for row in (head, ("---",) * len(head), *rows))


def _code(names: str) -> str:
    return ", ".join(f"`{name}`" for name in names.split(", ")) if names else "none"


def symbols() -> str:
    """Symbol, meaning, name in the code and shape."""
    rows = [(symbol, words, _code(names), shape) for symbol, words, names, shape in SYMBOLS]
    return _table(("symbol", "what it is", "in `detden_lite`", "shape"), rows)


def trained() -> str:
    """The trained defences of the library's list."""
    attacks = dict(zip(variants.PARTS, ("opposite", "opposite and Q-function"), strict=True))
    rows = []
    for name, variant in VARIANTS.items():
        changed = ", ".join(f"`{key}={value}`" for key, value in variant.recipe.items())
        noise = DATASETS[variant.data]
        exploration = EXPLORATION[variant.data].format(most=max(noise.noise), memory=max(noise.memory))
        attacked = attacks[variant.adversarial[-1]] if variant.adversarial else "none"
        gruvae = changed or "as printed in the paper"
        denoiser = "a model of the motion and a filter, no GRU-VAE" if variant.predicts else gruvae
        shown = f"**{name}** (the main one)" if name == MAIN else f"*{name}*"
        rows.append((shown, exploration, attacked, denoiser))
    return _table(("name", "noise on the actions in $D_{normal}$", "attacks in $D_{adv}$", "denoiser"), rows)


def settings() -> str:
    """What the settings mean that differ between the defences, from the docstring of ``VAERecipe``."""
    told = inspect.getdoc(VAERecipe) or ""
    used = dict.fromkeys(key for variant in VARIANTS.values() for key in variant.recipe)
    lines = []
    for key in used:
        found = re.search(rf"^    {key}: (.+?)(?=^    \w+: |^\S|\Z)", told, re.M | re.S)
        words = re.sub(r"``([^`]+)``", r"`\1`", " ".join(found[1].split()))
        lines.append(f"- `{key}`: {words}")
    return "\n".join(lines)


def assembled() -> str:
    """The defences that are made from the parts of the main one."""
    kinds = (
        ("a change", variants.ABLATIONS),
        ("another network", variants.BASELINES),
        ("a ceiling", variants.CEILINGS),
    )
    rows = [(f"*{name}*", kind, words) for kind, group in kinds for name, words in group.items()]
    return _table(("name", "what it is", "in words"), rows)
