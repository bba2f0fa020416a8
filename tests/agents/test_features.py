"""Features: what a policy receives of an observation."""

import gymnasium as gym
import numpy as np
import pytest
import torch

from hframe_gym.agents.features import feature_parameters
from hframe_gym.agents.feedback_laws import TransferBank
from hframe_gym.agents.residual_action import ResidualAction
from hframe_gym.agents.sb3_adapters import LogScaleFeatures
from hframe_gym.envs import HFrameVectorEnv, observation_space
from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES
from tests.agents.observations import rest_observation

MACHINE = BUILTIN_MACHINES["hframe"]()


def extract(observation):
    extractor = LogScaleFeatures(observation_space(MACHINE), **feature_parameters(MACHINE))
    return extractor({key: torch.as_tensor(values) for key, values in observation.items()}).numpy()[0]


def test_all_features_but_the_position_are_zero_at_rest_at_the_goal():
    features = extract(rest_observation(MACHINE, (0.1, -0.05), (0.1, -0.05)))
    # float32 positions are accurate to about 1e-8 m, a ten-thousandth of the finest scale.
    assert np.abs(features[2:]).max() < 1e-3
    assert features[0] > 0.0 > features[1]


def test_an_error_of_a_tenth_of_a_millimeter_changes_the_features():
    near, at_goal = (
        extract(rest_observation(MACHINE, (0.1 + error, -0.05), (0.1, -0.05))) for error in (1e-4, 0.0)
    )
    assert np.abs(near - at_goal).max() > 0.05


def test_features_of_random_motion_have_magnitudes_of_order_one():
    envs = HFrameVectorEnv(64, randomize="default")
    observation, _ = envs.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(30):
        observation = envs.step(rng.uniform(-1.0, 1.0, (64, 2)).round())[0]
    space = envs.single_observation_space
    assert isinstance(space, gym.spaces.Dict)
    extractor = LogScaleFeatures(space, **feature_parameters(MACHINE))
    features = extractor({key: torch.as_tensor(values) for key, values in observation.items()})
    assert features.shape == (64, extractor.features_dim)
    assert 0.5 < float(features.abs().max()) < 1.5


def test_one_axis_without_motor_coordinate_has_features_of_error_and_speed():
    axis = BUILTIN_MACHINES["axis"]()
    space = observation_space(axis)
    extractor = LogScaleFeatures(space, **feature_parameters(axis))
    observation = {key: torch.zeros((1, *box.shape)) for key, box in space.items()}
    assert float(extractor(observation).abs().max()) == 0.0
    observation["desired_goal"][0, 0] = 1e-4
    assert float(extractor(observation).abs().max()) > 0.05


def test_features_of_a_rotary_axis_are_those_of_the_way_of_an_arm():
    motor, axis = BUILTIN_MACHINES["motor"](), BUILTIN_MACHINES["axis"]()
    features = []
    for machine, length in ((motor, 1.0), (axis, 0.1)):
        space = observation_space(machine)
        extractor = LogScaleFeatures(space, **feature_parameters(machine))
        observation = {key: torch.zeros((1, *box.shape)) for key, box in space.items()}
        observation["observation"][0] = length * torch.tensor([0.4, -2.0])  # rad and rad/s of the motor
        observation["desired_goal"][0, 0] = length * 0.3
        features.append(extractor(observation))
    torch.testing.assert_close(features[0], features[1], rtol=1e-5, atol=1e-6)


def test_features_of_transfers_that_the_machine_lacks_are_refused():
    axis = BUILTIN_MACHINES["axis"]()
    with pytest.raises(InputError, match=r"transfers are \[0, 41\]; machine 'axis' has those of 0 to 40"):
        feature_parameters(axis, transfers=[0, 41])


@pytest.mark.parametrize("transfers", [[4, 0, 8], [0, 4, 4]])
def test_durations_of_transfers_that_are_not_ascending_are_refused(transfers):
    with pytest.raises(InputError, match="list durations in ascending order"):
        TransferBank(MACHINE, 0.01, transfers)


def test_the_integral_of_a_resting_error_is_a_feature_of_the_tool_and_of_the_motors():
    observation = rest_observation(MACHINE, (0.1, -0.05), (0.1, -0.05))
    space = ResidualAction(MACHINE, 0.01, integral=True).observation_space(observation_space(MACHINE))
    extractor = LogScaleFeatures(space, **feature_parameters(MACHINE))
    observation["last_observation"], observation["last_action"] = observation["observation"], np.zeros((1, 2))
    rows = []
    for integral in (0.0, 1e-6):  # an error of 0.1 mm along x for one period
        observation["error_integral"] = np.array([[integral, 0.0]])
        rows.append(extractor({k: torch.as_tensor(v.astype(np.float32)) for k, v in observation.items()})[0])
    changed = (rows[1] - rows[0]).numpy()
    assert np.abs(changed[:-8]).max() == 0.0
    by_scale = changed[-8:].reshape(2, 4)  # x, y, and the travel of both belts
    assert by_scale[1, 0] == pytest.approx(np.log(2.0) / np.log1p(1e2), rel=1e-4)
    assert by_scale[:, 1] == pytest.approx([0.0, 0.0])
    assert (np.abs(by_scale[:, 2:]) > 0.01).all()
