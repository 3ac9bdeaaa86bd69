"""The list of the recipe's stages: what the command line offers, and which rules of data/Snakefile run each of them.

A new stage is a function of its own, one entry here, and a rule of the Snakefile that runs it. The command line, the
tool that measures durations and the book's page on the recipe read this list. Reading it loads neither torch nor
MuJoCo; ``detden_lite.recipe.cli`` imports a stage's module when it runs the stage.
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
class Option:
    """One option of a stage: an argument of its function.

    Args:
        flag: on the command line.
        default: a bool for a switch, an int for a whole number, a name, or a tuple of names for several.
        choices: of names.
        text: what it is, if its flag does not say so.
    """

    flag: str
    default: bool | int | str | tuple[str, ...]
    choices: tuple[str, ...] = ()
    text: str = ""


@dataclass(frozen=True)
class Stage:
    """One stage.

    Args:
        name: on the command line.
        group: a key of ``GROUPS``.
        text: what it does.
        function: "module:function", in ``detden_lite``.
        rules: of the Snakefile that run it, each with the victims that it runs for: settings in data/config.
        options: of the command line, beside those that all stages have.
        keeps: what it stores on its way, so that a killed run resumes from there.
        row: whether it is of one victim; otherwise of the whole run.

    Example:
        >>> from detden_lite.recipe.stage_list import STAGES
        >>> STAGES["adversary"].text
        'train a member of the grid of adversaries'
        >>> dict(STAGES["adversary"].rules)
        {'adversary': 'rows online', 'adversary_defended': 'adapted'}
    """

    name: str
    group: str
    text: str
    function: str
    rules: Mapping[str, str] = field(default_factory=dict)
    options: tuple[Option, ...] = ()
    keeps: str = ""
    row: bool = True


_BARE = "rows online"  # what is done to every victim, also to one that has no defence
_SEED = Option("--seed", 0)
_DATA = Option("--data", "diverse", tuple(DATASETS), "exploration in D_normal")
_VARIANT = Option("--variant", MAIN, tuple(VARIANTS))
_DEFENDED = Option("--defended", False, text="the victim has its main defence")
_SNAPSHOTS = "a snapshot every segment, a checkpoint every ten minutes"
_EPOCHS = "a checkpoint every epoch"
_SHARDS = "files of 128 episodes"
_RECORDS = "each record"

_STAGES = (
    Stage(
        "victim", "victim", "train one seed of the victim", "recipe.victim_stages:train_victim",
        dict(victim=_BARE), (_SEED,), _SNAPSHOTS,
    ),
    Stage(
        "select", "victim", "choose the best snapshot of all seeds, and evaluate it",
        "recipe.victim_stages:select_victim", dict(select=_BARE),
    ),
    Stage(
        "qfunction", "victim", "learn the Q-function that a PPO victim lacks", "recipe.victim_stages:learn_q",
        dict(qfunction=_BARE),
    ),
    Stage(
        "converge", "attack", "choose how many steps and restarts the gradient attacks take",
        "recipe.convergence:converge", dict(converge=_BARE, converge_defended="rows"), (_DEFENDED,),
    ),
    Stage(
        "timing", "attack", "tune C_vul: for the most damage a strike, and for strikes at a third of the steps",
        "recipe.vulnerability:tune_timing", dict(timing=_BARE),
    ),
    Stage(
        "planning", "attack", "choose the planner of the enchanting attack from several", "recipe.sweeps:planning",
        dict(planning=_BARE),
    ),
    Stage(
        "adversary", "attack", "train a member of the grid of adversaries", "recipe.adversary_stages:train_member",
        dict(adversary=_BARE, adversary_defended="adapted"),
        (Option("--member", 0, text="its place in the grid"), _DEFENDED), _SNAPSHOTS,
    ),
    Stage(
        "choose", "attack", "choose the adversary and the director that leave the victim the smallest return",
        "recipe.adversary_stages:choose", dict(choose=_BARE, choose_defended="adapted"), (_DEFENDED,),
    ),
    Stage(
        "linear", "attack", "search for a linear adversary by the cross-entropy method",
        "recipe.search_stages:search_linear", dict(linear=_BARE), keeps="every generation",
    ),
    Stage(
        "offset", "attack", "search for the most harmful offset to hold", "recipe.search_stages:search_offset",
        dict(offset=_BARE, offset_defended="adapted"), (_DEFENDED,), "every round",
    ),
    Stage(
        "collect", "defense", "collect D_normal, and held-out episodes for calibration",
        "recipe.defense_stages:collect", dict(trajectories="rows"), (_DATA,), _SHARDS,
    ),
    Stage(
        "augment", "defense", "make D_adv from D_normal, offline, with both attacks", "recipe.defense_stages:augment",
        dict(augmentation="rows"), (_DATA,), _SHARDS,
    ),
    Stage(
        "detector", "defense", "train the detector and calibrate its threshold", "recipe.defense_stages:train_detector",
        dict(detector="rows"), (_DATA,), _EPOCHS,
    ),
    Stage(
        "denoiser", "defense", "train a denoiser", "recipe.defense_stages:train_denoiser", dict(denoiser="rows"),
        (_VARIANT,), _EPOCHS,
    ),
    Stage(
        "baselines", "defense", "fit the linear models and train the auto-encoder that the GRU-VAEs are compared with",
        "recipe.ablations:fit_baselines", dict(baselines="studied"),
    ),
    Stage(
        "threshold", "defense", "tune C_anomaly as the paper does, on attacked episodes",
        "recipe.ablations:tune_threshold", dict(threshold="studied"),
    ),
    Stage(
        "defend", "defense", "defend the victim in one call, and evaluate it with the defence and without",
        "recipe.defend:defend_victim", dict(defend="own"), keeps="what the stages that it consists of keep",
    ),
    Stage(
        "evaluate", "measure", "run every cell of the tables: of the bare victim, or with its defences",
        "recipe.evaluation:evaluate", dict(attacks=_BARE, evaluation="rows"),
        (
            Option(
                "--defenses", ("none", MAIN), ("none", *VARIANTS, *ASSEMBLED), "the defences, none for the bare victim"
            ),
            Option("--attacks", ("none", *ATTACKS), ("none", *ATTACKS), "the attacks"),
        ),
        _RECORDS,
    ),
    Stage(
        "ablate", "measure", "run the cells of ablations, baselines and ceilings", "recipe.evaluation:ablate",
        dict(ablation="studied"), keeps=_RECORDS,
    ),
    Stage(
        "explain", "measure", "run the cells that tell which part of the main defence falls short",
        "recipe.evaluation:explain", dict(ceilings="explained"), keeps=_RECORDS,
    ),
    Stage(
        "adapt", "measure", "run the cells of the attacks that know the defence", "recipe.evaluation:adapt",
        dict(adaptive="adapted"), (Option("--defenses", (MAIN,), tuple(VARIANTS), "the defences"),), _RECORDS,
    ),
    Stage(
        "epsilon", "measure", "attack at several sizes of the ball", "recipe.sweeps:epsilon", dict(epsilon="studied")
    ),
    Stage(
        "barrier", "measure", "measure what the noise of the latents costs an attacker who knows the defence",
        "recipe.latent_noise:measure_latent_noise", dict(barrier="studied"),
        (Option("--variants", (MAIN, "standard-prior"), tuple(VARIANTS), "the defences to measure"),),
    ),
    Stage(
        "curve", "measure", "measure both sides of the appendix's bound along a denoiser's training",
        "recipe.bound_along_training:measure_along_training", dict(curve="studied"),
        (Option("--variant", "residual", tuple(VARIANTS)),), "a checkpoint and a measurement every epoch",
    ),
    Stage(
        "look", "look", "record and film an episode clean, attacked and defended", "recipe.gallery:film_opposite",
        dict(look="rows"), (_VARIANT,),
    ),
    Stage(
        "portrait", "look", "film a clean episode of the victim", "recipe.gallery:film_portrait", dict(portrait=_BARE)
    ),
    Stage(
        "gallery", "look", "film and record an episode under each attack", "recipe.gallery:film_attacks",
        dict(gallery="studied"), (Option("--attacks", FOUR, ATTACKS, "the attacks"), _VARIANT),
    ),
    Stage(
        "slip", "look", "record an episode under an attack that raises no alarm", "recipe.gallery:film_stealthy",
        dict(slip="studied"),
    ),
    Stage("publish", "ship", "copy what is shipped into data/", "recipe.publish:publish", dict(publish=_BARE)),
    Stage(
        "table", "ship", "gather the records of all victims in tables/returns.csv", "results.table:write_table",
        dict(table=_BARE), row=False,
    ),
)  # fmt: skip
STAGES = {stage.name: stage for stage in _STAGES}
