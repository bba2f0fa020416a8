"""Actuators: converter, current limit and dead time, against motor equation and the machine's declaration."""

import dataclasses

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.envs import Actuators, HFrameEnv, Reach
from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES

CENTER = Reach(start=(0.0, 0.0), target=(0.1, 0.0))
PULLEY_RADIUS, GEAR_RATIO, TORQUE_CONSTANT, ROTOR_INERTIA = 0.0194, 5.9, 23e-3, 1.12e-4


def run(actions, **options):
    """Return observations after each action, from rest at the center, shape (n, 8)."""
    env = HFrameEnv(task=CENTER, **options)
    env.reset(seed=0)
    return np.array([env.step(np.asarray(a))[0]["observation"] for a in actions], np.float64)


def test_converter_rounds_to_its_levels():
    # 3 bits over 12 V: levels 3 V apart, the highest 9 V.
    drives = Actuators(bits=3)
    ideal = run([(0.25, -0.5)] * 5)
    np.testing.assert_array_equal(run([(0.3, -0.45)] * 5, drives=drives), ideal)
    np.testing.assert_array_equal(run([(1.0, -1.0)] * 5, drives=drives), run([(0.75, -1.0)] * 5))


def test_voltage_range_clips():
    np.testing.assert_array_equal(
        run([(1.0, -1.0)] * 5, drives=Actuators(range_V=6.0)), run([(0.5, -0.5)] * 5)
    )


def test_declared_converters_act_on_request():
    machine = BUILTIN_MACHINES["hframe"]()
    declared = [dataclasses.replace(d, converter_bits=3, voltage_range=6.0) for d in machine.drives]
    machine = machine.replace(drives=tuple(declared))
    actions = [(0.3, -0.45)] * 5
    expected = run(actions, drives=Actuators(bits=3, range_V=6.0))
    np.testing.assert_array_equal(run(actions, machine=machine, drives="machine"), expected)
    np.testing.assert_array_equal(run(actions, machine=machine), run(actions))


def frictionless():
    """Return the machine without friction."""
    machine = BUILTIN_MACHINES["hframe"]()
    return machine.replace(
        {f"{c.name}.{key}": 0.0 for c in machine.coordinates for key in ("viscous", "coulomb")}
    )


def test_limited_current_at_standstill():
    # The rotors alone move in the first 0.1 ms: their acceleration is that of the limit's torque.
    limit, period = 5.0, 0.1e-3
    state = run([(1.0, 1.0)], machine=frictionless(), drives=Actuators(current_limit=limit), period=period)
    expected = GEAR_RATIO * TORQUE_CONSTANT * limit / ROTOR_INERTIA * period
    np.testing.assert_allclose(state[0, 6:], expected, rtol=2e-4)


def test_limited_current_gives_constant_force():
    # Both motors at the limit: the momentum of cart and rotors in y grows by 2 N Kt I / r, at any speed.
    limit = 2.0
    v = run([(-1.0, -1.0)] * 8, machine=frictionless(), drives=Actuators(current_limit=limit))
    momentum = 1.0412 * v[:, 5] - ROTOR_INERTIA / PULLEY_RADIUS * (v[:, 6] + v[:, 7])
    force = np.diff(momentum) / 0.01
    np.testing.assert_allclose(force, 2 * GEAR_RATIO * TORQUE_CONSTANT * limit / PULLEY_RADIUS, rtol=2e-3)


def test_a_limit_that_is_never_reached_changes_nothing():
    actions = [(0.5, -0.2)] * 30
    np.testing.assert_allclose(run(actions, drives=Actuators(current_limit=100.0)), run(actions), rtol=1e-6)


def test_the_smaller_of_two_current_limits_acts():
    limits = [EFFECTS["current_limit"].at(d, I=3.0) for d in ("motor1", "motor2")]
    machine = BUILTIN_MACHINES["hframe"]().with_effects(*limits)
    for drives, expected in ((Actuators(current_limit=12.0), 3.0), (Actuators(current_limit=2.0), 2.0)):
        env = HFrameEnv(machine=machine, drives=drives)
        assert env.batch.machine.parameters["current_limit@motor1.I"] == expected
        assert len(env.batch.machine.effects) == 2


def test_dead_time_is_an_effect_of_the_machine():
    delayed, prompt = run([(0.5, 0.2)] * 6, drives=Actuators(delay=0.02)), run([(0.5, 0.2)] * 6)
    np.testing.assert_array_equal(delayed[:2, 4:], 0.0)
    np.testing.assert_allclose(delayed[2:], prompt[:4], rtol=1e-6, atol=1e-9)
    machine = HFrameEnv(drives=Actuators(delay=0.003, current_limit=12.0, bits=12)).batch.machine
    assert machine.parameters["input_delay@drives.d"] == 0.003
    with pytest.raises(InputError, match="dead time already"):
        HFrameEnv(machine=machine, drives=Actuators(delay=0.003))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"bits": 0}, "bits is 0, it must be an integer from 1 to 32 or None"),
        ({"bits": 2.5}, "bits is 2.5, it must be an integer"),
        ({"bits": "12"}, "bits is '12', it must be an integer"),
        ({"range_V": -1.0}, "range_V is -1.0"),
        ({"range_V": "12"}, "range_V is '12', it must be a positive number or None"),
        ({"current_limit": 0.0}, "current_limit is 0.0"),
        ({"current_limit": [12.0]}, r"current_limit is \[12.0\], it must be a positive number"),
        ({"delay": 1.0}, "delay is 1.0"),
        ({"delay": None}, "delay is None, it must be a number from 0 to 0.1 s"),
    ],
)
def test_invalid_actuators_are_refused(settings, message):
    with pytest.raises(InputError, match=message):
        Actuators(**settings)


@pytest.mark.parametrize("drives", ["best", None])
def test_unknown_actuators_are_refused(drives):
    with pytest.raises(InputError, match="choose one of ideal, rig, machine"):
        HFrameEnv(drives=drives)
