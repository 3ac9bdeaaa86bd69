import torch
from builders import BUDGET, HOPPER, make_victim
from stable_baselines3.common.vec_env import VecMonitor

from detden_lite.simulation.rollout import rollout
from detden_lite.training.adversary_recipe import AdversaryRecipe
from detden_lite.training.adversary_world import AdversaryEnv
from detden_lite.training.warm_start import imitate
from detden_lite.victims.victim import Victim

RECIPE = AdversaryRecipe(steps=512, segment=128, net=32, envs=4, rollout=32, batch=32, epochs=2)


def test_the_copy_acts_as_its_teacher_and_can_still_learn():
    torch.manual_seed(0)
    teacher, victim = Victim([11, 11], gaussian=True), make_victim(seed=8)
    teacher.actor[0].weight.mul_(0.5)
    seen = rollout(victim, HOPPER, range(8), steps=30)
    obs = seen.obs[seen.mask]
    model = RECIPE.start(HOPPER, lambda n: VecMonitor(AdversaryEnv(victim, HOPPER, BUDGET, n, steps=20)), 0)
    wanted = teacher(torch.from_numpy(obs))

    def error() -> float:
        copy = Victim.from_sb3(model, model.get_vec_normalize_env())
        return float((copy(torch.from_numpy(obs)) - wanted).square().mean())

    before, memory = error(), model.policy.actor_state.opt_state
    imitate(model, teacher, obs, steps=800)
    assert error() < 0.05 * before
    assert model.policy.actor_state.opt_state is memory  # PPO begins with an optimizer without memory
    model.learn(128)
