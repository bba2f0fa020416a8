"""The gap of a gear between a motor and its load, without belts, against a simulator without shared code."""

from __future__ import annotations

import dataclasses
import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hframe_gym.controllers.models.motion_model import MotionModel
from hframe_gym.dynamics import resolved_step, simulate
from hframe_gym.dynamics.simulation import LONGEST_STEP
from hframe_gym.effects import EFFECTS, effect_sites
from hframe_gym.identification import fit, identify, prepare, write_result
from hframe_gym.identification.predict.prediction import POLISH_STEP, SIMULATION
from hframe_gym.identification.propose.candidates import effect_parameters
from hframe_gym.identification.propose.typical_scales import scales_of_motion
from hframe_gym.identification.report.content.saved_result import load_result
from hframe_gym.identification.report.words.instructions import next_steps
from hframe_gym.identification.report.words.rows import effect_rows
from hframe_gym.machine import BUILTIN_MACHINES, Coordinate, Drive, Machine, Sensor
from hframe_gym.recordings import Recording
from tests.reference_simulator.axis import Axis, Gap, Record, held_levels, record

pytestmark = pytest.mark.oracle

ROWS, PERIOD = 1000, 1e-3  # s
GAP = Gap(half=3e-3, stiffness=120.0, damping=0.1, inertia=0.012, viscous=0.004, coulomb=0.03)
TRUE = Axis(inertia=0.01, viscous=0.004, coulomb=0.06, torque_constant=0.6, resistance=1.5, gap=GAP)
RESOLUTION = 2.0 * math.pi / 60000  # rad, of an encoder with 2000 counts a turn before a gear of 30
NOISE_A = 0.02
EFFECT = EFFECTS["gear_backlash"].at(
    "motor",
    d=GAP.half,
    J=GAP.inertia,
    F=GAP.coulomb,
    B=GAP.viscous,
    K=GAP.stiffness,
    Z=0.5 * GAP.damping / math.sqrt(GAP.stiffness * GAP.inertia),
)
MOTOR = Machine(
    "geared motor",
    (
        Coordinate(
            "shaft",
            TRUE.inertia + GAP.inertia,
            TRUE.viscous + GAP.viscous,
            TRUE.coulomb + GAP.coulomb,
            "rotary",
        ),
    ),
    (),
    (Drive("motor", "v_V", "shaft", TRUE.torque_constant, TRUE.torque_constant, TRUE.resistance, 1.0, 12.0),),
    (
        Sensor("shaft_rad", {"shaft": 1.0}, 0.0, RESOLUTION, "encoder"),
        Sensor("motor_A", {"motor": 1.0}, NOISE_A, kind="current"),
    ),
)


def by_scipy(gap: Gap, volts: np.ndarray, start: tuple[float, float, float, float]) -> np.ndarray:
    """Return the angles of motor and load at every row, rad, without dry friction, shape (rows, 2)."""
    state, angles = np.array(start), []

    def rates(_: float, y: np.ndarray, volt: float) -> list[float]:
        teeth = gap.torque(y[0] - y[1], y[2] - y[3])
        motor = TRUE.torque_constant * (volt - TRUE.torque_constant * y[2]) / TRUE.resistance
        return [
            y[2],
            y[3],
            (motor - TRUE.viscous * y[2] - teeth) / TRUE.inertia,
            (teeth - gap.viscous * y[3]) / gap.inertia,
        ]

    for volt in map(float, volts):
        angles.append(state[:2])
        state = solve_ivp(rates, (0.0, PERIOD), state, "Radau", args=(volt,), rtol=1e-8, atol=1e-10).y[:, -1]
    return np.array(angles)


def errors_of_steps(
    stiffness: float, damping_ratio: float, load: float, steps: list[float], *, pressed: bool
) -> list[float]:
    """Return the largest error of the angles for each longest step, rad; `load`: inertia / the motor's."""
    gap = dataclasses.replace(GAP, stiffness=stiffness, inertia=load * TRUE.inertia, coulomb=0.0)
    damping = 2.0 * damping_ratio * math.sqrt(gap.stiffness * gap.inertia)
    gap = dataclasses.replace(gap, damping=damping)
    effect = EFFECTS["gear_backlash"].at(
        "motor", d=gap.half, J=gap.inertia, F=0.0, B=gap.viscous, K=gap.stiffness, Z=damping_ratio
    )
    shaft = dataclasses.replace(
        MOTOR.coordinate("shaft"),
        mass=TRUE.inertia + gap.inertia,
        viscous=TRUE.viscous + gap.viscous,
        coulomb=0.0,
    )
    machine = MOTOR.with_components(shaft).with_effects(effect)
    volts = np.full(100, 8.0) if pressed else np.repeat([8.0, -5.0, 3.0, -8.0, 6.0], 60)
    start = (gap.half, 0.0, 0.0, 0.0) if pressed else (0.0, 0.0, 0.0, 0.0)
    expected, time_s = by_scipy(gap, volts, start), PERIOD * np.arange(len(volts))
    return [
        float(np.abs(trajectory.positions - expected).max())
        for trajectory in (
            simulate(machine, time_s, volts[:, None], start, longest_step=resolved_step(machine, longest))
            for longest in steps
        )
    ]


@pytest.mark.parametrize("load", [0.3, 4.0])
def test_teeth_that_damp_strongly_do_not_need_shorter_steps(load: float) -> None:
    """The teeth brake a light motor before a heavy load within a fraction of the step.

    With the rate before the step, their force would reverse it, and the motion would diverge.
    """
    (error,) = errors_of_steps(3e4, 1.0, load, [LONGEST_STEP], pressed=False)
    assert error < 0.1 * GAP.half


@pytest.mark.parametrize("damping_ratio", [0.1, 1.0])
def test_motion_in_contact_is_of_second_order(damping_ratio: float) -> None:
    errors = errors_of_steps(2e3, damping_ratio, 1.2, [2e-4, 1e-4, 0.5e-4], pressed=True)
    assert errors[0] < 2e-6
    assert errors[1] < 0.3 * errors[0]
    assert errors[2] < 0.3 * errors[1]


@cache
def motion(seed: int) -> Record:
    """Return a motion of the independent simulator under random voltages that are held for 40 ms."""
    return record(TRUE, held_levels(seed, ROWS, 40, 8.0), ROWS, PERIOD)


def test_angle_and_current_agree() -> None:
    """The difference is far smaller than what the gap changes."""
    true = motion(3)

    def errors(machine: Machine) -> np.ndarray:
        readings = simulate(machine, true.time_s, true.command[:, None], longest_step=0.1e-3).outputs
        return np.abs(readings - np.column_stack([true.position, true.current])).max(axis=0)

    assert (errors(MOTOR.with_effects(EFFECT)) < [4e-5, 2e-3]).all(), errors(MOTOR.with_effects(EFFECT))
    assert (errors(MOTOR) > [1e-2, 0.2]).all(), errors(MOTOR)


def runs(seeds: range) -> list[Recording]:
    """Return noisy recordings of motions of the independent simulator."""
    rng = np.random.default_rng(5)
    recordings = []
    for seed in seeds:
        true = motion(seed)
        angle = np.rint(true.position / RESOLUTION) * RESOLUTION
        measured = np.column_stack([angle, true.current + rng.normal(0.0, NOISE_A, ROWS)])
        recordings.append(Recording(f"run_{seed}", true.time_s, true.command[:, None], measured))
    return recordings


def test_identification_names_the_gap_and_says_what_to_do_next(tmp_path: Path) -> None:
    """The inertia and friction that are declared are wrong, and the report proposes a controller."""
    declared = MOTOR.replace({"shaft.mass": 0.026, "shaft.viscous": 0.006, "shaft.coulomb": 0.07})
    result = identify(runs(range(5)), declared)
    assert [s.effect.label for s in result.effects] == [EFFECT.label]
    assert result.verdict == "effect_found"
    assert result.after.machine.effects[0].parameters["d"] == pytest.approx(GAP.half, rel=0.02)
    write_result(result, tmp_path)
    saved = load_result(tmp_path)
    steps = next_steps(saved, tmp_path, effect_rows(saved.report, saved.machine), ["run_4"])
    assert any(step.command.startswith("hframe evaluate pid") for step in steps)


def test_parameters_are_recovered_from_the_motor_alone() -> None:
    """Encoder and current of the motor determine the load behind the gap, although no sensor measures it."""
    recordings = runs(range(3))
    data = prepare(recordings, MOTOR)
    positions, speeds = (
        np.concatenate([getattr(motion(seed), name) for seed in range(3)])[:, None]
        for name in ("position", "speed")
    )
    scale = scales_of_motion(MOTOR, positions, speeds, [r.inputs for r in recordings])
    wrong = {f"{EFFECT.label}.{name}": 0.8 * value for name, value in EFFECT.parameters.items()}
    machine = MOTOR.with_effects(EFFECT).replace(wrong)
    result = fit(
        machine,
        effect_parameters(machine.effects[0], machine, scale),
        data,
        SIMULATION,
        longest_step=POLISH_STEP,
    )
    assert result.chi2 < 1.2  # rounding is not white
    found = result.machine.effects[0].parameters
    assert found == pytest.approx(dict(EFFECT.parameters), rel=0.03)


def test_what_a_motor_turns_has_a_gap_and_a_carriage_has_none() -> None:
    """Without belts, a rotary coordinate's load is behind the gap; a second carriage would be an axis."""
    assert effect_sites(EFFECTS["gear_backlash"], MOTOR) == ("motor",)
    assert effect_sites(EFFECTS["gear_backlash"], BUILTIN_MACHINES["axis"]()) == ()
    assert MOTOR.with_effects(EFFECT).tool_axes == ("shaft_load",)


def test_the_current_shows_no_scale_error_of_the_only_sensor_of_motion() -> None:
    """With inertia, friction and back-EMF larger by its factor, angle and current stay the same."""
    assert effect_sites(EFFECTS["sensor_scale"], MOTOR) == ()
    true, scale = motion(3), EFFECTS["sensor_scale"].at("shaft_rad", g=1.0)
    names = ("shaft.mass", "shaft.viscous", "motor.Ke")
    turned_half = MOTOR.replace({name: 2.0 * MOTOR.parameters[name] for name in names}).with_effects(scale)
    first, second = (simulate(m, true.time_s, true.command[:, None]).outputs for m in (MOTOR, turned_half))
    np.testing.assert_allclose(first, second, atol=1e-6)
    second_encoder = Sensor("hub_rad", {"shaft": 1.0}, 1e-4)
    assert "shaft_rad" in effect_sites(EFFECTS["sensor_scale"], MOTOR.with_components(second_encoder))


def test_controllers_know_the_load_behind_the_gap() -> None:
    """They are designed for both sides of the teeth, whose parameters are tied to those of the effect."""
    model = MotionModel(MOTOR.with_effects(EFFECT))
    assert model.axes == ("shaft_load",)
    np.testing.assert_allclose(model.mass, [TRUE.inertia, GAP.inertia])
    np.testing.assert_allclose(model.coulomb, [TRUE.coulomb, GAP.coulomb])
