"""The model of how the robot moves."""

import pytest
import torch

from detden_lite.defense.dynamics import Dynamics


def test_sensors_depend_on_the_state_and_the_action_alone():
    torch.manual_seed(0)
    model = Dynamics(obs_dim=5, action_dim=2, state_dim=3, hidden=8)
    state, action = torch.randn(4, 3), torch.randn(4, 2)
    (moved, std), (sensors, _) = model(state, action)
    assert moved.shape == (4, 3) and sensors.shape == (4, 2) and (std > 0).all()
    assert torch.equal(model.next_state(state, action)[0], moved)


def test_an_untrained_output_of_zero_leaves_the_state_where_it_is():
    model = Dynamics(obs_dim=3, action_dim=1, hidden=4)
    for part in model.heads[0].parameters():
        torch.nn.init.zeros_(part)
    state = torch.randn(2, 3)
    assert torch.equal(model.next_state(state, torch.zeros(2, 1))[0], state)


def test_a_model_is_made_again_from_its_state():
    torch.manual_seed(0)
    model = Dynamics(obs_dim=4, action_dim=1, state_dim=2, hidden=6)
    copied = Dynamics.from_state(model.config, model.state_dict())
    state, action = torch.randn(3, 2), torch.randn(3, 1)
    assert torch.equal(copied(state, action)[1][0], model(state, action)[1][0])
    assert not any(p.requires_grad for p in copied.parameters())


@pytest.mark.parametrize("state_dim", [0, 4, 1.5])
def test_a_state_that_is_no_part_of_the_observation_is_refused(state_dim):
    with pytest.raises(ValueError, match="state_dim"):
        Dynamics(obs_dim=3, action_dim=1, state_dim=state_dim)
