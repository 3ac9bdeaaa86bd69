"""Detect-and-denoise defences of deep reinforcement-learning policies (Xiong et al., ECML-PKDD 2022).

The names below are the public face. Each is loaded when it is first asked for, so that ``import detden_lite`` is quick
and needs no more than what is used.
"""

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("detden-lite")
except PackageNotFoundError:  # a checkout that was never installed
    __version__ = "0"

# By module: what it offers here.
_FACE = {
    "core.budget": "Budget",
    "core.tasks": "Task TASKS SWIMMER get_task",
    "core.types": "Episodes Trajectories Verdict World",
    "core.random_streams": "RandomStreams",
    "core.ascent": "ascend",
    "core.distances": "euclidean mahalanobis",
    "core.gradients": "value_and_gradient",
    "core.networks": "mlp",
    "core.estimates": "Estimate estimate iqm",
    "core.metrics": "detector_scores detection_delay f1_at live_dimensions mean_absolute_error score_auroc summarize",
    "core.files": "ArtifactError",
    "victims.victim": "Victim",
    "victims.action_gradients": "ActionObjective",
    "victims.critic": "QRecipe learn_q",
    "simulation.rollout": "rollout",
    "simulation.simulator": "Simulator",
    "simulation.fast_simulator": "make_simulator",
    "simulation.planner": "CEMPlanner OpenLoop",
    "simulation.collection": "collect_normal",
    "defense.gruvae": "GRUVAE kl_divergence reconstruction_loss",
    "defense.detector": "Detector linf_score",
    "training.thresholds": "calibrate clean_scores conformal_threshold tuned_threshold",
    "defense.denoiser": "Denoiser",
    "defense.dynamics": "Dynamics",
    "defense.bounded_noise": "truncated_moments",
    "defense.predict_correct": "PredictCorrect Surprise",
    "defense.pipeline": "DetectAndDenoise",
    "defense.defended": "Defended",
    "defense.augmentation": "augment intermittent",
    "training.gruvae_training": "VAERecipe train_gruvae",
    "training.regularizer": "Regularizer",
    "defense.variants": "MAIN VARIANTS",
    "defense.baselines": "Identity KalmanFilter MahalanobisDetector PredictionDetector",
    "defense.linear_models": "Gaussian LinearModel",
    "defense.oracles": "OracleDenoiser OracleDetector",
    "attacks.noise": "GaussianNoise UniformNoise",
    "attacks.gradient": "GradientAttack",
    "attacks.opposite": "OppositeAttack opposite_objective",
    "attacks.qfunction": "QFunctionAttack q_objective",
    "attacks.optimal": "OptimalAttack",
    "attacks.held": "CornerAttack HeldAttack OffsetAttack",
    "attacks.director": "DirectorAttack",
    "attacks.enchanting": "EnchantingAttack",
    "attacks.adaptive": "AdaptiveAttack CoupledAttack GradientFreeAttack StealthyAttack",
    "attacks.outcome": "Outcome",
    "attacks.printed": "PrintedAttack",
    "attacks.informed": "View view_defense",
    "attacks.search": "climb evolve",
    "recipe.linear_search": "LinearMaps LinearRecipe elite_weights",
    "training.dynamics_training": "DynamicsRecipe train_dynamics",
    "training.adversary_world": "AdversaryEnv",
    "attacks.timing": "After Always Random Vulnerable",
    "attacks.threat": "Threat",
    "attacks.catalogue": "CATALOGUE",
    "attacks.attacked_observations": "AttackedObservations",
    "store.manifest": "DATA read_json",
    "store.models": "load_adversary load_defense load_model load_victim",
    "results.cells": "Cell table_cells",
    "results.records": "EpisodeScores Record load_record",
    "results.bare_victims": "UNATTACKED",
    "looking.widgets": "frames",
    "looking.robot": "Robot",
    "looking.takes": "takes",
    "looking.recordings": "record",
    "theory.worst_error": "worst_error worst_errors",
    "theory.finite_mdp": "FiniteMDP largest_tv leaving",
    "recipe.defend": "defend",
    "recipe.judge": "Judgement judge",
    "recipe.critic_fit": "judge_q",
    "recipe.task_from_env": "task_of",
    "recipe.run": "Run",
    "recipe.evaluation": "run_cell",
    "recipe.sweeps": "over_planners over_sizes",
    "recipe.scales": "get_scale defense_scale DefenseScale",
    "recipe.trajectories": "load_trajectories",
    "recipe.episode_seeds": "seeds",
    "recipe.defense_stages": "FALSE_ALARMS",
}
# Modules that are offered whole, since their names are short and belong together.
_MODULES = (
    "attacks.catalogue", "recipe.sanity", "theory.bound", "results.adaptive_attacks", "results.bare_victims",
    "results.defended_victims", "results.paper", "results.published", "results.strength", "results.victim_cards",
    "results.adversary_cards",
    "looking.figures", "looking.films", "defense.variants", "recipe.bound_along_training", "recipe.latent_noise",
)  # fmt: skip
_HOME = {name: module for module, names in _FACE.items() for name in names.split()}
_WHOLE = {module.rpartition(".")[2]: module for module in _MODULES}
__all__ = ["__version__", *sorted(_HOME | _WHOLE)]


def __getattr__(name: str) -> object:
    if name in _WHOLE:
        value = import_module(f"{__name__}.{_WHOLE[name]}")
    elif name in _HOME:
        value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
