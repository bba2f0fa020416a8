"""What a rig's drives make of an action, against the motor's own equation."""

import numpy as np
import pytest

from hframe_gym.envs import Actuators, HFrameEnv, Reach
from hframe_gym.machine import BUILTIN_MACHINES

CENTRE = Reach(start=(0.0, 0.0), target=(0.1, 0.0))


def stepped(actions, **options):
    """True velocities after each action, from rest at the centre."""
    env = HFrameEnv(task=CENTRE, **options)
    env.reset(seed=0)
    return np.array([env.step(np.asarray(a))[0]["observation"] for a in actions], np.float64)


def test_converter_rounds_to_its_levels():
    # 3 bits over 12 V: levels 3 V apart, the highest 9 V.
    drives = Actuators(bits=3)
    ideal = stepped([(0.25, -0.5)] * 5)
    np.testing.assert_array_equal(stepped([(0.3, -0.45)] * 5, drives=drives), ideal)
    np.testing.assert_array_equal(stepped([(1.0, -1.0)] * 5, drives=drives), stepped([(0.75, -1.0)] * 5))


def test_range_clips():
    np.testing.assert_array_equal(stepped([(1.0, -1.0)] * 5, drives=Actuators(range_V=6.0)), stepped([(0.5, -0.5)] * 5))


def test_current_stays_within_its_limit():
    # At rest a limit of I is a voltage of I R; a limit never reached changes nothing but the step's own rounding.
    limit = 5.0
    start = stepped([(1.0, 1.0)], drives=Actuators(current_limit=limit), period=0.5e-3)
    np.testing.assert_allclose(start, stepped([np.full(2, limit * 0.71 / 12)], period=0.5e-3), rtol=1e-6)
    np.testing.assert_allclose(
        stepped([(0.5, -0.2)] * 30, drives=Actuators(current_limit=100.0)), stepped([(0.5, -0.2)] * 30), rtol=1e-6
    )


def test_limited_acceleration_is_that_of_the_limit():
    # Both motors at the limit, no friction: the momentum of cart and rotors in y grows by 2 N Kt I / r, at any speed.
    machine = BUILTIN_MACHINES["hframe"]()
    machine = machine.replace({f"{c.name}.{key}": 0.0 for c in machine.coordinates for key in ("viscous", "coulomb")})
    limit, r = 2.0, 0.0194
    v = stepped([(-1.0, -1.0)] * 8, machine=machine, drives=Actuators(current_limit=limit))
    momentum = 1.0412 * v[:, 5] - 1.12e-4 / r * (v[:, 6] + v[:, 7])
    force = np.diff(momentum) / 0.01
    # The back-EMF is half a step old on average: the current is off by a few percent while the speed changes.
    np.testing.assert_allclose(force, 2 * 5.9 * 23e-3 * limit / r, rtol=0.06)
    np.testing.assert_allclose(force.mean(), 2 * 5.9 * 23e-3 * limit / r, rtol=0.03)


def test_delay_is_an_effect_of_the_machine():
    late, now = stepped([(0.5, 0.2)] * 6, drives=Actuators(delay=0.02)), stepped([(0.5, 0.2)] * 6)
    np.testing.assert_array_equal(late[:2, 4:], 0.0)
    np.testing.assert_allclose(late[2:], now[:4], rtol=1e-6, atol=1e-9)
    env = HFrameEnv(drives=Actuators(delay=0.003, current_limit=12.0, bits=12))
    assert "input_delay@drives.d" in env.batch.machine.parameters
    twice = env.batch.machine
    with pytest.raises(ValueError, match="dead time already"):
        HFrameEnv(machine=twice, drives=Actuators(delay=0.003))


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ({"bits": 0}, "bits is 0"),
        ({"range_V": -1.0}, "range_V is -1.0"),
        ({"current_limit": 0.0}, "current_limit is 0.0"),
        ({"delay": 1.0}, "delay is 1.0"),
    ],
)
def test_drives_that_cannot_be_are_refused(numbers, message):
    with pytest.raises(ValueError, match=message):
        Actuators(**numbers)


@pytest.mark.parametrize("drives", ["best", None])
def test_unknown_drives_are_refused(drives):
    with pytest.raises(ValueError, match="choose one of ideal, rig"):
        HFrameEnv(drives=drives)
