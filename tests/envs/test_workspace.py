"""The workspace and its end stops: active region, parameter order, and independence of neighbors in a SIMD block."""

import numpy as np

from hframe_gym.dynamics import LANES
from hframe_gym.envs import HFrameVectorEnv
from hframe_gym.envs.workspace import END_STOP, with_end_stops


def test_the_active_region_is_where_the_force_is():
    stop = END_STOP.at("x", low=-0.1, high=0.2, stiffness=2e5, damping=1.5)
    q = np.linspace(-0.2, 0.3, 1001)
    force = stop("force", q=q, v=0.0, t=0.0)
    np.testing.assert_array_equal(stop("active_region", q=q), force != 0.0)
    assert np.all(np.sign(force) == np.sign(np.clip(q, -0.1, 0.2) - q))


def test_the_machine_s_parameters_come_first(hframe):
    both = list(with_end_stops(hframe).parameters)
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
