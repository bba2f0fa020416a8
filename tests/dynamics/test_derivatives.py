"""Derivatives of simulated motions against central differences of the kernel, and at friction's corner."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.dynamics import DifferentiableMotion, simulate_batch
from hframe_gym.dynamics.codegen import derivative_formulas as formulas
from hframe_gym.dynamics.physics.friction import decay_integral, end_weight, ramp
from hframe_gym.effects import EFFECTS
from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES, rest_state
from tests.dynamics.lanes import run
from tests.effects.one_of_each import CASES

MACHINE = BUILTIN_MACHINES["hframe"]()
PERIOD, STEP = 0.01, 0.5e-3
FEW = (
    "stribeck_friction",
    "presliding",
    "cogging",
    "belt_slack",
    "eccentric_pulley",
    "input_delay",
    "bridge_yaw",
)


class Case:
    """Motions of four machines in all directions of state, voltages and parameters, and a weighted sum."""

    def __init__(self, machine, periods=5, seed=0):
        generator = np.random.default_rng(seed)
        self.motion = motion = DifferentiableMotion(machine, PERIOD, longest_step=STEP)
        batch, count = 4, len(machine.coordinates)
        nominal = np.tile(list(machine.parameters.values()), (batch, 1))
        parameters = nominal * generator.uniform(0.97, 1.03, nominal.shape)
        linear = [i for i, c in enumerate(machine.coordinates) if c.kind == "linear"]
        start = np.zeros((batch, motion.state_size))
        tools = generator.uniform(-0.03, 0.03, (batch, len(linear)))
        start[:, : 2 * count] = [rest_state(machine, tool) for tool in tools]
        ahead = 1e-3 * np.linspace(1.0, 0.4, len(linear))  # not all equal: then a pulley would be at rest
        moved = np.array([rest_state(machine, tool + ahead)[:count] for tool in tools]) - start[:, :count]
        start[:, count : 2 * count] = moved * generator.uniform(200.0, 400.0, (batch, 1))  # 0.2 to 0.4 m/s
        # |z| has a corner at 0
        start[:, 2 * count :] = generator.uniform(1e-6, 2e-6, start[:, 2 * count :].shape)
        self.arrays = {
            "start": start,
            "inputs": generator.uniform(0.0, 4.0, (batch, periods, len(machine.drives))),
            "earlier": generator.uniform(-2.0, 2.0, (batch, 3, len(machine.drives))),
            "parameters": parameters,
        }
        self.units = {  # of the steps of the differences
            "start": np.concatenate(
                [np.tile(np.maximum(np.abs(start[:, :count]), 1e-3), 2), start[:, 2 * count :]], 1
            ),
            "inputs": 1.0,
            "earlier": 1.0,
            "parameters": np.abs(parameters),
        }
        self.weights = generator.normal(size=(batch, periods + 1, motion.state_size))
        self.weights[:, :, : 2 * count] /= np.repeat([1e-3, 0.05], count)
        self.of_readings = generator.normal(size=(batch, periods + 1, len(machine.sensors))) / 1e-3

    def simulate(self, arrays):
        return self.motion.simulate(
            arrays["start"], arrays["inputs"], arrays["parameters"], earlier=arrays["earlier"], start_time=0.3
        )

    def value(self, arrays):
        states = self.simulate(arrays).states
        readings = self.motion.readings(states, arrays["parameters"])
        return (states * self.weights).sum((1, 2)) + (readings * self.of_readings).sum((1, 2))

    def gradients(self):
        motions = self.simulate(self.arrays)
        by_states, by_parameters = self.motion.readings_gradients(
            motions.states, self.arrays["parameters"], self.of_readings
        )
        found = self.motion.gradients(motions, self.weights + by_states)
        earlier = self.arrays["earlier"].shape[1]
        return {
            "start": found.start,
            "inputs": found.inputs[:, earlier:],
            "earlier": found.inputs[:, :earlier],
            "parameters": found.parameters + by_parameters,
        }

    def difference(self, name, direction):
        """Central difference along a direction, for the step at which two of them agree best."""
        quotients = []
        for step in (1e-4, 3e-5, 1e-5, 3e-6, 1e-6, 3e-7):
            ends = [
                self.value({**self.arrays, name: self.arrays[name] + sign * step * direction})
                for sign in (1.0, -1.0)
            ]
            quotients.append((ends[0] - ends[1]) / (2.0 * step))
        quotients = np.array(quotients)
        best = np.abs(np.diff(quotients, axis=0)).argmin(axis=0)
        return np.take_along_axis(quotients, best[None] + 1, axis=0)[0]

    def errors(self, name, directions=3):
        """Relative errors of the derivatives along random directions, by machine."""
        generator, gradient = np.random.default_rng(1), self.gradients()[name]
        assert np.isfinite(gradient).all()
        for _ in range(directions):
            direction = generator.normal(size=gradient.shape) * self.units[name]
            found = (gradient * direction).reshape(len(gradient), -1).sum(1)
            size = np.sqrt(((gradient * self.units[name]) ** 2).reshape(len(gradient), -1).sum(1))
            yield from np.abs(self.difference(name, direction) - found) / size


@pytest.mark.parametrize("name", ["start", "inputs", "parameters"])
@pytest.mark.parametrize("machine", ["hframe", "hframe-linear", "hframe-literal", "hframe-order20", "axis"])
def test_derivatives_agree_with_central_differences_of_the_kernel(machine, name):
    assert max(Case(BUILTIN_MACHINES[machine]()).errors(name)) < 1e-6


@pytest.mark.integration
@pytest.mark.parametrize("effect", FEW)
def test_derivatives_contain_the_effects(effect):
    case = Case(MACHINE.with_effects(CASES[effect].effect))
    for name in ("start", "inputs", "parameters"):
        assert max(case.errors(name)) < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("effect", sorted(set(CASES) - {*FEW, "clock_drift"}))
def test_derivatives_contain_every_effect_of_the_library(effect):
    case = Case(MACHINE.with_effects(CASES[effect].effect))
    for name in ("start", "inputs", "parameters"):
        assert max(case.errors(name)) < 1e-6


def test_the_motion_is_that_of_the_simulator_to_the_bit():
    case = Case(MACHINE)
    parameters = np.tile(list(MACHINE.parameters.values()), (4, 1))
    motions = case.simulate({**case.arrays, "parameters": parameters})
    inputs = case.arrays["inputs"]
    expected = simulate_batch(
        MACHINE,
        np.arange(inputs.shape[1] + 1) * PERIOD,
        np.concatenate([inputs, inputs[:, -1:]], axis=1),
        parameters=parameters,
        start=case.arrays["start"],
        longest_step=STEP,
    )
    np.testing.assert_array_equal(motions.states, np.concatenate(expected[:2], axis=2))


def test_a_delay_applies_earlier_voltages_and_is_differentiated():
    machine = MACHINE.with_effects(EFFECTS["input_delay"].at("drives", d=0.0137))
    case = Case(machine)
    times = np.arange(9) * PERIOD
    start = np.tile(rest_state(machine), (4, 1))
    parameters = np.tile(list(machine.parameters.values()), (4, 1))
    both = np.concatenate([case.arrays["earlier"], case.arrays["inputs"]], axis=1)
    inputs = np.concatenate([both, both[:, -1:]], axis=1)
    whole = simulate_batch(machine, times, inputs, parameters=parameters, start=start, longest_step=STEP)
    whole_states = np.concatenate(whole[:2], axis=2)
    arrays = {**case.arrays, "start": whole_states[:, 3], "parameters": parameters}
    np.testing.assert_allclose(case.simulate(arrays).states, whole_states[:, 3:], rtol=0.0, atol=1e-9)
    assert max(case.errors("earlier")) < 1e-6
    assert np.abs(case.gradients()["earlier"][:, 1:]).min() > 0.0
    assert not case.gradients()["earlier"][:, 0].any()


def axis_at_rest(coulomb, friction, volts):
    machine = BUILTIN_MACHINES["axis"]()
    motion = DifferentiableMotion(machine, PERIOD, longest_step=STEP, friction=friction)
    values = {**machine.parameters, f"{machine.coordinates[0].name}.coulomb": coulomb}
    motions = motion.simulate(np.zeros((1, 2)), np.full((1, 3, 1), volts), np.array([list(values.values())]))
    weights = np.zeros(motions.states.shape)
    weights[0, -1] = [1.0, 0.1]
    return motions, motion.gradients(motions, weights)


def test_a_voltage_that_friction_holds_has_no_influence():
    motions, gradients = axis_at_rest(1e3, "exact", 1.0)
    assert not motions.states.any()
    assert not gradients.inputs.any()
    assert not gradients.start[:, 1].any()  # a small speed would stop at once
    assert gradients.start[0, 0] == 1.0


def test_sliding_derivatives_are_those_of_a_motion_with_constant_friction():
    motions, held = axis_at_rest(1e3, "sliding", 1.0)
    assert not motions.states.any()
    # The axis is linear: without friction its derivatives are constant.
    _, moving = axis_at_rest(0.0, "exact", 1.0)
    np.testing.assert_allclose(held.inputs, moving.inputs, rtol=1e-12)
    np.testing.assert_allclose(held.start, moving.start, rtol=1e-12)


def test_smoothed_derivatives_grow_with_the_force_that_friction_holds():
    found = [axis_at_rest(1e3, "smoothed", volts)[1].inputs for volts in (1.0, 2.0)]
    assert np.abs(found[0][0, -1]).min() > 0.0
    np.testing.assert_allclose(found[1], 2.0 * found[0], rtol=1e-12)
    moving = [axis_at_rest(0.01, friction, 8.0)[1].inputs for friction in ("exact", "smoothed", "sliding")]
    np.testing.assert_array_equal(moving[1], moving[0])  # where nothing is held, all treatments are equal
    np.testing.assert_array_equal(moving[2], moving[0])


@pytest.mark.parametrize(("volts", "reverses"), [(0.0, False), (-8.0, True)])
def test_derivatives_pass_through_a_stop(volts, reverses):
    machine = BUILTIN_MACHINES["axis"]()
    motion = DifferentiableMotion(machine, PERIOD, longest_step=STEP)
    parameters = np.array([list(machine.parameters.values())])

    def value(speed, applied):
        states = motion.simulate(np.array([[0.0, speed]]), np.full((1, 4, 1), applied), parameters).states
        return states[0, -1], states

    speed = 0.02
    end, states = value(speed, volts)
    assert states[0, 0, 1] > 0.0
    assert (end[1] < 0.0) if reverses else (end[1] == 0.0)
    motions = motion.simulate(np.array([[0.0, speed]]), np.full((1, 4, 1), volts), parameters)
    weights = np.zeros(motions.states.shape)
    weights[0, -1] = [1.0, 0.1]
    found = motion.gradients(motions, weights)
    for by, change in ((found.start[0, 1], (1e-6, 0.0)), (found.inputs.sum(), (0.0, 1e-5))):
        ends = [value(speed + s * change[0], volts + s * change[1])[0] @ [1.0, 0.1] for s in (1.0, -1.0)]
        assert by == pytest.approx((ends[0] - ends[1]) / (2.0 * sum(change)), rel=1e-6)


def test_derivatives_are_the_same_in_threads_and_in_every_batch(monkeypatch):
    monkeypatch.setenv("HFRAME_THREADS", "2")
    motion = DifferentiableMotion(MACHINE, PERIOD, longest_step=STEP)
    generator = np.random.default_rng(2)
    start, inputs = np.tile(rest_state(MACHINE), (37, 1)), generator.uniform(-6.0, 6.0, (37, 4, 2))
    parameters = np.tile(list(MACHINE.parameters.values()), (37, 1)) * generator.uniform(0.9, 1.1, (37, 1))

    def gradients(rows, *, parallel):
        motions = motion.simulate(start[rows], inputs[rows], parameters[rows], parallel=parallel)
        return motion.gradients(motions, np.ones(motions.states.shape), parallel=parallel)

    together, one = gradients(slice(None), parallel=True), gradients(slice(20, 21), parallel=False)
    serial = gradients(slice(None), parallel=False)
    for name in ("start", "inputs", "parameters"):
        np.testing.assert_array_equal(getattr(together, name), getattr(serial, name))
        np.testing.assert_array_equal(getattr(together, name)[20], getattr(one, name)[0])


def test_derivatives_by_parameters_can_be_left_out():
    case = Case(MACHINE)
    motions = case.simulate(case.arrays)
    complete = case.motion.gradients(motions, case.weights)
    fewer = case.motion.gradients(motions, case.weights, by_parameters=False)
    np.testing.assert_allclose(fewer.start, complete.start, rtol=1e-12)
    np.testing.assert_allclose(fewer.inputs, complete.inputs, rtol=1e-12)
    assert complete.parameters.any()
    assert not fewer.parameters.any()


@pytest.mark.parametrize(
    ("function", "slope"),
    [
        (decay_integral, formulas.decay_integral_slope),
        (end_weight, formulas.end_weight_slope),
        (ramp, formulas.ramp_slope),
    ],
)
@pytest.mark.parametrize("z", [0.0, 1e-3, 0.2, 0.26, 0.49, 0.51, 2.0, 9.0])
def test_slopes_of_the_damping_formulas(function, slope, z):
    lanes = np.zeros((1, 16))

    def compiled(name, value):
        operand, result = np.full((1, 16), value), np.zeros_like(lanes)
        run(f"def f(x, y):\n    store(y, 0, {name}(load(x, 0)))\n", operand, result)
        return result[0, 0]

    step = 1e-4
    values = [
        compiled(function.__name__, z + k * step)
        for k in ((-2, -1, 1, 2) if z or function is ramp else (0, 1))
    ]
    if len(values) == 4:
        expected = (values[0] - 8.0 * values[1] + 8.0 * values[2] - values[3]) / (12.0 * step)
        assert compiled(slope.__name__, z) == pytest.approx(expected, rel=1e-8)
    else:
        assert compiled(slope.__name__, z) == pytest.approx((values[1] - values[0]) / step, rel=1e-3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"period": 0.0}, "must be positive"),
        ({"friction": "smooth"}, "choose one of exact, smoothed, sliding"),
    ],
)
def test_wrong_options_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        DifferentiableMotion(MACHINE, **{"period": PERIOD, **options})


def test_a_drifting_clock_is_refused() -> None:
    machine = BUILTIN_MACHINES["hframe"]().with_effects(EFFECTS["clock_drift"].at("machine", a=0.01))
    with pytest.raises(InputError, match="drifting clock"):
        DifferentiableMotion(machine, 1e-3)
