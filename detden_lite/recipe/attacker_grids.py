"""What attackers choose from at each scale: planners of the enchanting attack, and adversaries to train."""

from detden_lite.training.adversary_recipe import AdversaryRecipe

# The planner of the enchanting attack where no sweep has chosen one; below, those of the sweep.
PLANNER = dict(horizon=10, population=8, iterations=1, elites=2)

# Ant, TD3, on 8 tuning episodes of 400 steps: one step ahead left -221, three -158, and ten -127 at ten times the cost.
PLANNER_OF = {"ant": PLANNER | dict(horizon=1)}

PLANNERS = tuple(
    dict(horizon=horizon, population=population, iterations=iterations, elites=elites)
    for population, iterations, elites in ((8, 1, 2), (32, 2, 6), (64, 4, 8))
    for horizon in (1, 3, 10, 30)
)

# The attacked steps of an episode of the sweep: fewer where a plan costs several times as much.
PLANNED_STEPS = {"ant": 50, "humanoid": 50}

TINY_PLANNER = dict(horizon=3, population=8, iterations=1, elites=2)

TINY_PLANNERS = (TINY_PLANNER, TINY_PLANNER | dict(horizon=5))

# The grid of the optimal attack and of the director. The paper does not say how its adversary was trained; at the
# paper's scale the grid is of ATLA's size.
LITE_ADVERSARIES = (
    AdversaryRecipe(),
    AdversaryRecipe(learning_rate=3e-3),
    AdversaryRecipe(timing="vulnerable"),
    AdversaryRecipe(history=3),
    AdversaryRecipe(warm=True, learning_rate=3e-4, log_std=-1.0),
    AdversaryRecipe(director=True),
    AdversaryRecipe(director=True, learning_rate=3e-3),
)

PAPER_ADVERSARIES = LITE_ADVERSARIES + tuple(
    AdversaryRecipe(learning_rate=rate, timing=timing, clip=clip)
    for rate in (3e-4, 1e-3, 3e-3)
    for timing in ("always", "vulnerable")
    for clip in (0.2, 0.4)
)

TINY_ADVERSARIES = tuple(
    AdversaryRecipe(steps=1_024, segment=512, net=32, envs=4, epochs=2, **kind)
    for kind in (dict(timing="vulnerable"), dict(history=2), dict(warm=True), dict(director=True))
)
