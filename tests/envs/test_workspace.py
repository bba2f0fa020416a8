"""The workspace and its end stops: region, parameter order, and independent neighbors in a SIMD block."""

import numpy as np
import pytest

from hframe_gym.dynamics import LANES
from hframe_gym.effects.smooth_table import KNOTS, definition
from hframe_gym.envs import HFrameVectorEnv, RandomizeParameter, Uniform
from hframe_gym.envs.workspace import BUFFER_STIFFNESS, END_STOP, EndStops, unmeasured_workspace
from hframe_gym.machine import BUILTIN_MACHINES


def test_the_active_region_is_where_the_force_is():
    stop = END_STOP.at("x", low=-0.1, high=0.2, stiffness=2e5, damping=1.5, damped=0.01)
    q = np.linspace(-0.2, 0.3, 1001)
    force = stop("force", q=q, v=0.0, t=0.0)
    np.testing.assert_array_equal(stop("active_region", q=q), force != 0.0)
    assert np.all(np.sign(force) == np.sign(np.clip(q, -0.1, 0.2) - q))


@pytest.mark.parametrize(("last", "warned"), [(0.2, False), (0.12, True)])
def test_a_workspace_beyond_a_table_is_told(last, warned):
    axis = BUILTIN_MACHINES["axis"]()
    (low, high) = axis.coordinates[0].range
    knots = np.linspace(low, high * last / 0.2, KNOTS)
    values = {f"k{i:02d}": k for i, k in enumerate(knots)} | {f"f{i:02d}": 1.0 for i in range(KNOTS)}
    machine = axis.with_effects(definition("smooth_force[position of x]").at("x", **values))
    message = unmeasured_workspace(machine)
    assert (message is not None) == warned
    assert unmeasured_workspace(axis) is None
    if warned:
        assert f'"range": [{knots[0]:.3g}, {knots[-1]:.3g}]' in message


def test_the_machine_s_parameters_come_first(hframe):
    both = list(EndStops(hframe, 5e-4).machine.parameters)
    assert both[: len(hframe.parameters)] == list(hframe.parameters)


def test_a_neighbor_at_an_end_stop_changes_no_bit():
    count = LANES  # one block

    def histories(start):
        envs = HFrameVectorEnv(count, randomize="default", max_episode_steps=None)
        envs.reset(seed=0, options={"start": start, "target": np.zeros((count, 2))})
        actions = np.random.default_rng(0).uniform(-1, 1, (40, count, 2)).astype(np.float32)
        actions[:, 2] = [1.0, -1.0]  # along x, which ends 1 mm away from one of the starts
        states = []
        for action in actions:
            envs.step(action)
            states.append(envs.batch.simulator.state[0].copy())
        return np.array(states), envs.batch.workspace

    middle = np.zeros((count, 2))
    free, workspace = histories(middle)
    edges = []
    for x in workspace[0] + np.array([1e-3, -1e-3]):
        start = middle.copy()
        start[2, 0] = x
        edges.append(histories(start)[0])
    others = np.arange(count) != 2
    for pressed in edges:
        np.testing.assert_array_equal(pressed[:, :, others], free[:, :, others])
    beyond = [max(e[:, 0, 2].max() - workspace[0, 1], workspace[0, 0] - e[:, 0, 2].min()) for e in edges]
    assert max(beyond) > 1e-4


def _largest_depth(machine, step, steps=90):
    """Drive the tool from stop to stop with full voltages; return the largest depth in a buffer, m."""
    envs = HFrameVectorEnv(LANES, machine=machine, longest_step=step, max_episode_steps=None)
    envs.reset(seed=0)
    generator, depth, axes = np.random.default_rng(0), 0.0, len(envs.batch.workspace)
    for k in range(steps):
        if k % 15 == 0:
            actions = np.sign(generator.normal(size=envs.action_space.shape)).astype(np.float32)
        envs.step(actions)
        depth = max(depth, float((np.abs(envs.travel[:, :axes]) - envs.batch.workspace[:, 1]).max()))
    return depth


@pytest.mark.parametrize("name", ["corexy", "hframe", "axis"])
@pytest.mark.parametrize(("mass", "limit"), [(0.3, 4e-3), (0.1, 4e-3), (0.02, 9e-3), (0.007, 0.02)])
def test_a_light_carriage_stays_in_the_buffers(name, mass, limit):
    machine = BUILTIN_MACHINES[name]()
    light = machine.replace({f"{axis}.mass": mass for axis in machine.tool_axes})
    assert _largest_depth(light, 5e-4) < limit


def test_a_long_step_gives_softer_buffers():
    machine = BUILTIN_MACHINES["hframe"]().replace({"x.mass": 0.3, "y.mass": 0.3})
    assert _largest_depth(machine, 2e-3) < 8e-3


def test_buffers_follow_the_sampled_mass():
    rule = RandomizeParameter("x.mass", Uniform(0.06, 1.0))
    envs = HFrameVectorEnv(64, machine="corexy", randomize=[rule])
    _, info = envs.reset(seed=0)
    columns = list(envs.batch.simulator._stepped.parameters)
    parameters = envs.batch.simulator.parameters.transpose(0, 2, 1).reshape(-1, len(columns))[:64]
    stiffness = parameters[:, columns.index("end_stop@x.stiffness")]
    mass = info["parameters"]["x.mass"]
    np.testing.assert_array_equal(parameters[:, columns.index("x.mass")], mass)
    np.testing.assert_allclose(stiffness, np.minimum(BUFFER_STIFFNESS, 0.5 * mass / 5e-4**2), rtol=1e-12)
    assert stiffness.min() < BUFFER_STIFFNESS == stiffness.max()
    assert np.all(parameters[:, columns.index("end_stop@y.stiffness")] == BUFFER_STIFFNESS)
