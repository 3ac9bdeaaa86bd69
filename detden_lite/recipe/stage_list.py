"""The list of the recipe's stages: what the command line offers, and which rules of data/Snakefile run each of them.

Reading it loads neither torch nor MuJoCo; ``detden_lite.recipe.cli`` imports a stage's module when it runs the stage.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from detden_lite.attacks.catalogue import ATTACKS, FOUR
from detden_lite.defense.variants import ASSEMBLED, DATASETS, MAIN, VARIANTS

GROUPS = dict(
    victim="The victim",
    attack="What the attacker prepares",
    defense="The defence",
    measure="Measurements",
    look="Films and recordings (they need a GL driver)",
    ship="Shipping",
)


@dataclass(frozen=True)
class Stage:
    """One stage.

    Args:
        name: on the command line.
        group: a key of ``GROUPS``.
        text: what it does.
        function: "module:function", in ``detden_lite``.
        rules: of the Snakefile that run it.
        options: of the command line, beside those that all have: name and the arguments of ``add_argument``.
        row: whether it is of one victim; otherwise of the whole run.
    """

    name: str
    group: str
    text: str
    function: str
    rules: tuple[str, ...] = ()
    options: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    row: bool = True


_SEED = {"--seed": dict(type=int, default=0, help="default: %(default)s")}
_DATA = {
    "--data": dict(choices=list(DATASETS), default="diverse", help="exploration in D_normal; default: %(default)s")
}
_VARIANT = {"--variant": dict(choices=list(VARIANTS), default=MAIN, help="default: %(default)s")}
_DEFENDED = {"--defended": dict(action="store_true", help="the victim has its main defence")}
_MEMBER = {"--member": dict(type=int, default=0, help="its place in the grid; default: %(default)s")}

_STAGES = (
    Stage("victim", "victim", "train one seed of the victim", "recipe.victim_stages:train_victim", ("victim",), _SEED),
    Stage(
        "select", "victim", "choose the best snapshot of all seeds, and evaluate it",
        "recipe.victim_stages:select_victim", ("select",),
    ),
    Stage(
        "qfunction", "victim", "learn the Q-function that a PPO victim lacks", "recipe.victim_stages:learn_q",
        ("qfunction",),
    ),
    Stage("timing", "attack", "tune when the attacker strikes", "recipe.vulnerability:tune_timing", ("timing",)),
    Stage(
        "adversary", "attack", "train a member of the grid of adversaries", "recipe.adversary_stages:train_member",
        ("adversary", "adversary_defended"), _MEMBER | _DEFENDED,
    ),
    Stage(
        "choose", "attack", "choose the adversary that leaves the victim the least", "recipe.adversary_stages:choose",
        ("choose", "choose_defended"), _DEFENDED,
    ),
    Stage(
        "linear", "attack", "search for a linear adversary", "recipe.adversary_stages:search_linear", ("linear",)
    ),
    Stage(
        "collect", "defense", "collect D_normal, and held-out episodes for calibration",
        "recipe.defense_stages:collect", ("trajectories",), _DATA,
    ),
    Stage(
        "augment", "defense", "make D_adv from D_normal, offline, with both attacks", "recipe.defense_stages:augment",
        ("augmentation",), _DATA,
    ),
    Stage(
        "detector", "defense", "train the detector and calibrate its threshold", "recipe.defense_stages:train_detector",
        ("detector",), _DATA,
    ),
    Stage(
        "denoiser", "defense", "train a denoiser", "recipe.defense_stages:train_denoiser", ("denoiser",), _VARIANT
    ),
    Stage(
        "baselines", "defense", "fit what the GRU-VAEs have to beat", "recipe.ablations:fit_baselines", ("baselines",)
    ),
    Stage(
        "threshold", "defense", "tune C_anomaly as the paper does, on attacked episodes",
        "recipe.ablations:tune_threshold", ("threshold",),
    ),
    Stage(
        "defend", "defense", "defend the victim in one call, and evaluate it with the defence and without",
        "recipe.defend:defend_victim", ("defend",),
    ),
    Stage(
        "evaluate", "measure", "run every cell of the tables", "recipe.evaluation:evaluate", ("attacks", "evaluation"),
        {
            "--defenses": dict(
                nargs="+", choices=["none", *VARIANTS, *ASSEMBLED], default=["none", MAIN],
                help="none is the bare victim; default: %(default)s",
            ),
            "--attacks": dict(
                nargs="+", choices=["none", *ATTACKS], default=["none", *ATTACKS], help="default: all of them"
            ),
        },
    ),
    Stage(
        "ablate", "measure", "run the cells of ablations, baselines and ceilings", "recipe.evaluation:ablate",
        ("ablation",),
    ),
    Stage(
        "explain", "measure", "run the cells that tell which part of the main defence falls short",
        "recipe.evaluation:explain", ("ceilings",),
    ),
    Stage(
        "adapt", "measure", "run the cells of the attacks that know the defence", "recipe.evaluation:adapt",
        ("adaptive",),
        {"--defenses": dict(nargs="+", choices=list(VARIANTS), default=[MAIN], help="default: %(default)s")},
    ),
    Stage("epsilon", "measure", "attack at several sizes of the ball", "recipe.sweeps:epsilon", ("epsilon",)),
    Stage(
        "planning", "measure", "run the enchanting attack with several planners", "recipe.sweeps:planning",
        ("planning",),
    ),
    Stage(
        "barrier", "measure", "measure what the noise of the latents costs an attacker",
        "recipe.latent_noise:measure_latent_noise", ("barrier",),
        {
            "--variants": dict(
                nargs="+", choices=list(VARIANTS), default=[MAIN, "standard-prior"],
                help="the defences to measure; default: %(default)s",
            )
        },
    ),
    Stage(
        "curve", "measure", "measure both sides of the appendix's bound along a denoiser's training",
        "recipe.bound_along_training:measure_along_training", ("curve",),
        {"--variant": dict(choices=list(VARIANTS), default="residual", help="default: %(default)s")},
    ),
    Stage(
        "look", "look", "record and film an episode, attacked and not", "recipe.gallery:film_opposite", ("look",),
        _VARIANT,
    ),
    Stage("portrait", "look", "film a clean episode of the victim", "recipe.gallery:film_portrait", ("portrait",)),
    Stage(
        "gallery", "look", "film and record an episode under each attack", "recipe.gallery:film_attacks",
        ("gallery",),
        {"--attacks": dict(nargs="+", choices=list(ATTACKS), default=list(FOUR), help="default: %(default)s")}
        | _VARIANT,
    ),
    Stage(
        "slip", "look", "record an episode under an attack that raises no alarm", "recipe.gallery:film_stealthy",
        ("slip",),
    ),
    Stage("publish", "ship", "copy what is shipped into data/", "recipe.publish:publish", ("publish",)),
    Stage(
        "table", "ship", "gather the records of all victims in one table", "results.table:write_table", ("table",),
        row=False,
    ),
)  # fmt: skip
STAGES = {stage.name: stage for stage in _STAGES}
