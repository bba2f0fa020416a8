"""Tests of linear models of machines with different parameters."""

import numpy as np
import pytest

from hframe_gym.controllers import MotionModel
from hframe_gym.controllers.models import linear_motion
from hframe_gym.machine import BUILTIN_MACHINES
from tests.controllers.different_machines import COUNT, different_machines

MACHINE = BUILTIN_MACHINES["hframe"]()
MODEL = MotionModel(MACHINE)
PERIOD = 0.01


def test_the_discrete_time_matrices_are_those_of_the_matrix_exponential_and_of_each_operating_point():
    parameters = np.tile(list(MACHINE.parameters.values()), (3, 1))
    goal = np.array([[0.0, 0.0], [0.1, 0.05], [-0.1, 0.1]])
    matrices = linear_motion.LinearMotion(MODEL, PERIOD).matrices(parameters, goal)
    for b, point in enumerate(goal):
        for matrix, expected in zip(matrices, MODEL.discretize(point, PERIOD), strict=True):
            np.testing.assert_allclose(matrix[b], expected, rtol=0.0, atol=1e-6 * np.abs(expected).max())


def test_scaled_matrices_describe_the_same_motion_in_other_units():
    generator = np.random.default_rng(0)
    A, B, E = (generator.normal(size=(5, 8, columns)) for columns in (8, 2, 4))
    state, volts, force = (generator.normal(size=(5, columns, 1)) for columns in (8, 2, 4))
    scale = linear_motion.state_scale(8)[:, None]
    scaled = linear_motion.scaled_matrices(A, B, E)
    following = scaled[0] @ (state / scale) + scaled[1] @ volts + scaled[2] @ force
    np.testing.assert_allclose(following * scale, A @ state + B @ volts + E @ force, rtol=1e-12)


@pytest.mark.parametrize("declared", ["with friction", "without friction"])
def test_friction_opposes_motion_and_at_rest_the_way_to_the_goal(declared):
    """The estimated friction counts, also of a coordinate that is declared without friction."""
    machine, names = MACHINE, MACHINE.coordinate_names
    if declared == "without friction":
        machine = MACHINE.replace({f"{name}.coulomb": 0.0 for name in names})
    parameters = different_machines(MACHINE)
    columns = [list(MACHINE.parameters).index(f"{name}.coulomb") for name in names]
    expected = parameters[:, columns] / MACHINE.travel_per_unit  # N
    linear = linear_motion.LinearMotion(MotionModel(machine), PERIOD)
    state, error = np.zeros((2, COUNT, 8))
    error[:, :4] = [0.01, -0.01, 0.01, -0.01]
    at_rest = linear.opposing_friction(state, error, parameters)
    np.testing.assert_allclose(at_rest, expected * [1.0, -1.0, 1.0, -1.0], rtol=1e-6)
    state[:, 4:] = [0.5, 0.5, -0.5, -0.5]
    moving = linear.opposing_friction(state, error, parameters)
    np.testing.assert_allclose(moving, expected * [-1.0, -1.0, 1.0, 1.0], rtol=1e-6)
