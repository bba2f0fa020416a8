"""The dead band of a loop of the position, which the H-frame has not: against the independent simulator."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym import load_machine, simulate
from hframe_gym.effects import EFFECTS, effect_sites
from hframe_gym.identification import fit, prepare
from hframe_gym.identification.predict.prediction import POLISH_STEP, SIMULATION
from hframe_gym.identification.propose.candidates import effect_parameters
from hframe_gym.identification.propose.typical_scales import scales_of_motion
from hframe_gym.machine import Machine
from hframe_gym.recordings import Recording
from tests.drives.test_set_point import PERIOD, ROWS, servo_machine
from tests.dynamics.test_derivatives import Case as Derivatives
from tests.dynamics.test_reference_step import largest_difference
from tests.exporters.test_friction_map import rows
from tests.reference_simulator.axis import Axis, Record, Servo, held_levels, record

WIDTH = 0.03  # rad
# All limits and the integral act.
SERVO = Servo(25.0, 12.0, 2e-3, 0.1, 0.03, 3.0, dead_band=WIDTH)
MACHINE = servo_machine("position", SERVO)
EFFECT = EFFECTS["servo_dead_band"].at("motor", s=1.0, d=WIDTH)
NOISE = 1e-3  # rad


def motion(seed: int, servo: Servo = SERVO) -> Record:
    """Return what the independent simulator records of steps of the command."""
    return record(Axis(servo=servo), held_levels(seed, ROWS, 40, 0.6), ROWS, PERIOD)


def errors(machine: Machine, expected: Record) -> tuple[float, float]:
    """Return the largest errors of position and speed, relative to their ranges."""
    found = simulate(machine, expected.time_s, expected.command[:, None])
    pairs = ((found.positions[:, 0], expected.position), (found.velocities[:, 0], expected.speed))
    position, speed = (float(np.abs(a - b).max() / np.ptp(b)) for a, b in pairs)
    return position, speed


@pytest.mark.oracle
def test_the_motion_is_that_of_the_independent_simulator() -> None:
    expected = motion(1)
    with_effect, without = errors(MACHINE.with_effects(EFFECT), expected), errors(MACHINE, expected)
    assert with_effect[0] < 3e-4
    assert with_effect[1] < 5e-4
    assert without[0] > 20 * with_effect[0]


@pytest.mark.oracle
def test_its_width_is_recovered_from_noisy_recordings() -> None:
    rng = np.random.default_rng(3)
    servo = Servo(25.0, 12.0, 2e-3, largest_torque=0.03, gear=3.0, dead_band=WIDTH)
    motions = [motion(seed, servo) for seed in (1, 2)]
    recordings = [
        Recording(
            f"run_{k}", m.time_s, m.command[:, None], m.position[:, None] + NOISE * rng.normal(size=(ROWS, 1))
        )
        for k, m in enumerate(motions)
    ]
    plain = servo_machine("position", servo)
    machine = plain.replace(sensors=(plain.sensors[0].with_values({"noise": NOISE, "resolution": 0.0}),))
    positions, velocities = (
        np.concatenate([getattr(m, name) for m in motions])[:, None] for name in ("position", "speed")
    )
    scales = scales_of_motion(machine, positions, velocities, [r.inputs for r in recordings])
    machine = machine.with_effects(EFFECTS["servo_dead_band"].at("motor", s=0.6, d=0.6 * WIDTH))
    free = effect_parameters(machine.effects[0], machine, scales)
    result = fit(machine, free, prepare(recordings, machine), SIMULATION, longest_step=POLISH_STEP)
    assert result.chi2 < 1.1
    found = result.machine.effects[0].parameters
    assert found["d"] == pytest.approx(WIDTH, rel=0.03)
    assert found["s"] == pytest.approx(1.0, rel=0.03)


def test_the_generated_step_is_the_specified_one() -> None:
    assert largest_difference(MACHINE.with_effects(EFFECT)) < 1e-12


@pytest.mark.parametrize("absent", [{"s": 0.0, "d": WIDTH}, {"s": 1.0, "d": 0.0}])
def test_a_size_of_zero_changes_nothing(absent: dict[str, float]) -> None:
    time_s = np.arange(200) * PERIOD
    commands = np.array([held_levels(2, 200, 20, 1.2)(row) for row in range(200)])[:, None]
    machine = MACHINE.with_effects(EFFECT.with_parameters(absent))
    found, expected = (simulate(m, time_s, commands).positions for m in (machine, MACHINE))
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12)


def test_derivatives_agree_with_central_differences() -> None:
    free = servo_machine("position", Servo(2.0, 12.0, 2e-3, 0.1, 3.0, 3.0))  # within its limits
    case = Derivatives(free.with_effects(EFFECT))
    for name in ("inputs", "parameters"):
        assert max(case.errors(name)) < 1e-6


def test_only_a_loop_of_the_position_has_one() -> None:
    effect = EFFECTS["servo_dead_band"]
    assert effect_sites(effect, MACHINE) == ("motor",)
    assert effect_sites(effect, servo_machine("speed", SERVO)) == ()
    assert effect_sites(effect, load_machine("motor")) == ()


def test_a_map_of_the_friction_leaves_the_loop_out() -> None:
    with_effect, without = rows(MACHINE.with_effects(EFFECT), "shaft"), rows(MACHINE, "shaft")
    for name, values in without.items():
        np.testing.assert_array_equal(with_effect[name], values)
