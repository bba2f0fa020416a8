"""What a rig's sensors give, against the true state and the sensors' own numbers."""

import numpy as np
import pytest
from scipy.stats import kstest, norm

from hframe_gym.envs import Encoders, HFrameEnv, HFrameVectorEnv, Lasers, Reach, Sensors
from hframe_gym.machine import BUILTIN_MACHINES, rest_state

COUNT = 2 * np.pi / (4 * 512 * 5.9)  # rad, section II of the paper
AT_ODDS = Reach(start=(0.012, -0.031), target=(0.03, 0.0))


def moved(sensors, steps=25, action=(0.4, -0.1), task=AT_ODDS, **options):
    """Observations of an episode with the true state beside them."""
    env = HFrameEnv(sensors=sensors, privileged=True, task=task, **options)
    rows = [env.reset(seed=0)[0]]
    rows += [env.step(np.array(action, np.float32))[0] for _ in range(steps)]
    return env, {key: np.array([row[key] for row in rows], np.float64) for key in rows[0]}


def test_encoders_count():
    env, seen = moved("rig")
    assert [e.name for e in env.entries[:4]] == ["x", "y", "phi1", "phi2"]
    counts = seen["observation"][:, 2:4] / COUNT
    np.testing.assert_allclose(counts, np.rint(counts), atol=2e-3)
    assert np.abs(seen["observation"][:, 2:4] - seen["privileged"][:, 2:4]).max() <= 0.5001 * COUNT
    assert len(np.unique(counts[:, 0])) > 10


def test_lasers_are_noisy_within_their_range():
    envs = HFrameVectorEnv(4000, sensors="rig", privileged=True, task=AT_ODDS)
    observation, _ = envs.reset(seed=0)
    noise = observation["observation"][:, :2].astype(float) - observation["privileged"][:, :2]
    for column in noise.T:
        assert kstest(column / 20e-6, norm.cdf).pvalue > 1e-3
    assert abs(np.corrcoef(noise.T)[0, 1]) < 0.05


def test_a_laser_sticks_at_the_end_of_its_range():
    # (1, -1) V moves in -x; away from the range the reading is its end, to the bit.
    _, seen = moved(Sensors(lasers=Lasers(span=0.02, centre=(0.012, -0.031))), steps=40, action=(0.6, -0.6))
    x, true = seen["observation"][:, 0], seen["privileged"][:, 0]
    beyond = np.abs(true - 0.012) > 0.0102
    assert beyond.sum() > 10
    ends = 0.012 + np.array([-0.01, 0.01])
    assert np.all(np.isin(x[beyond].astype(np.float32), ends.astype(np.float32)))
    assert np.abs(x - true)[~beyond].max() < 3e-4


def test_velocities_are_differences_of_readings():
    _, seen = moved("rig")
    readings, speeds = seen["observation"][:, :4], seen["observation"][:, 4:]
    np.testing.assert_array_equal(speeds[0], 0.0)
    np.testing.assert_allclose(speeds[1:], np.diff(readings, axis=0) / 0.01, atol=2e-3)


def test_achieved_goal_is_the_laser_s_or_else_the_encoders_():
    _, seen = moved("rig")
    inside = np.abs(seen["observation"][:, :2]) < 0.05
    np.testing.assert_array_equal(seen["achieved_goal"][inside], seen["observation"][:, :2][inside])
    assert np.abs(seen["achieved_goal"] - seen["privileged"][:, :2]).max() < 3e-3
    assert 10 < inside[:, 1].sum() < len(inside)
    machine = BUILTIN_MACHINES["hframe"]()
    env, seen = moved(Sensors(lasers=None))
    assert [e.name for e in env.entries] == ["phi1", "phi2", "phi1 velocity", "phi2 velocity"]
    # Unstretched belts: the positions of which rest_state makes the angles that were read.
    angles = np.array([rest_state(machine, place)[2:4] for place in seen["achieved_goal"]])
    np.testing.assert_allclose(angles, seen["observation"][:, :2], atol=1e-5)
    # Belts do stretch, by fractions of a millimetre.
    error = np.abs(seen["achieved_goal"] - seen["privileged"][:, :2]).max()
    assert 1e-5 < error < 3e-3


def test_lasers_alone():
    env, seen = moved(Sensors(encoders=None, lasers=Lasers(span=np.inf, noise=0.0)))
    assert [e.name for e in env.entries] == ["x", "y", "x velocity", "y velocity"]
    np.testing.assert_allclose(seen["observation"][:, :2], seen["privileged"][:, :2], atol=1e-7)


def test_success_and_distance_are_the_truth_s():
    env = HFrameEnv(sensors=Sensors(lasers=Lasers(noise=1e-2)), task=Reach(start=(0.0, 0.0), target=(0.0, 0.0)))
    _, info = env.reset(seed=0)
    assert info["distance_m"] == 0.0
    observation, reward, *_, info = env.step(np.zeros(2))
    assert info["is_success"]
    assert np.abs(observation["achieved_goal"]).max() > 1e-3
    assert reward == env.compute_reward(observation["achieved_goal"], observation["desired_goal"], {})


def test_privileged_holds_what_was_drawn():
    env = HFrameEnv(randomize="wide", privileged=True, machine="hframe-order20")
    observation, info = env.reset(seed=3)
    entries = env.privileged_entries
    assert observation["privileged"].shape == (len(entries),) == env.observation_space["privileged"].shape
    assert len(entries) == 2 * 10 + len(info["parameters"])
    nominal = env.batch.machine.parameters
    for entry, value in zip(entries, observation["privileged"], strict=True):
        if not entry.coordinate:
            assert value * nominal[entry.name] == pytest.approx(info["parameters"][entry.name], rel=1e-6)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Sensors(encoders=None, lasers=None), "neither"),
        (lambda: Encoders(lines=0), "lines is 0"),
        (lambda: Lasers(noise=-1.0), "noise is -1.0"),
        (lambda: Lasers(span=float("nan")), "span is nan"),
        (lambda: Lasers(centre=(0.0,)), "centre"),
        (lambda: HFrameEnv(sensors="eyes"), "eyes"),
        (lambda: HFrameEnv(sensors=None), "None"),
        (lambda: HFrameEnv(privileged="yes"), "yes"),
    ],
)
def test_sensors_that_cannot_be_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
