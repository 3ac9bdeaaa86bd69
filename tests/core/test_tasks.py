import gymnasium
import pytest

from detden_lite.core.tasks import TASK_NAMES, TASKS, get_task
from detden_lite.recipe.scales import get_scale


@pytest.mark.parametrize("name", TASK_NAMES)
def test_a_task_is_what_gymnasium_makes_of_it(name):
    task = get_task(name)
    env = gymnasium.make(task.env_id)
    assert env.observation_space.shape == (task.obs_dim,)
    assert env.action_space.shape == (task.action_dim,)
    assert env.spec.max_episode_steps == task.horizon
    env.close()


def test_unknown_names_are_answered_with_the_known_ones():
    with pytest.raises(ValueError, match="hopper, walker2d, halfcheetah, ant, humanoid, swimmer"):
        get_task("Hopper")
    with pytest.raises(ValueError, match="tiny, lite, paper"):
        get_scale("huge", get_task("hopper"))
    with pytest.raises(ValueError, match="no recipe for swimmer with td3; choose one of: ppo"):
        get_scale("lite", get_task("swimmer"))


@pytest.mark.parametrize("name", TASKS)
def test_the_paper_scale_has_the_papers_numbers(name):
    task = get_task(name)
    scale = get_scale("paper", task)
    vae = scale.defense
    assert (scale.trajectories, vae.epochs, vae.batch) == (task.trajectories, task.epochs, task.batch)
    assert (vae.hidden, vae.layers, vae.latent) == (task.hidden, task.layers, task.latent)
    tiny = get_scale("tiny", task)
    assert tiny.trajectories < get_scale("lite", task).trajectories <= scale.trajectories
