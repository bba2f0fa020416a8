"""Test the rigs with effects outside the library: each moves the stage, none at size 0, repeatably."""

import dataclasses
import zlib

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from tests.reference_simulator import Rig, simulate
from tests.reference_simulator.sensors import ENCODER_STEP_RAD, LASER_NOISE_M, Sensors
from tests.rigs.machine_programs import PROGRAMS, draw_path
from tests.rigs.outside_effects import FAMILIES
from tests.rigs.outside_rigs import COUNT, OUTSIDE, draw_rig, drifting_clock
from tests.rigs.random_excitation import MAX_VOLTAGE_V

NOISE = np.array([ENCODER_STEP_RAD / np.sqrt(12.0)] * 2 + [LASER_NOISE_M] * 2)
# What switches an effect off while its other parameters stay.
OFF = {
    "torque_saturation_A": (np.inf, np.inf),
    "supply_ohm": 0.0,
    "heating_ohm": (0.0, 0.0),
    "backlash_rad": (0.0, 0.0),
    "friction_age": (0.0,) * 4,
    "mesh_force_N": (0.0, 0.0),
    "payload": None,
    "belt_relaxation": 0.0,
    "wave": (0.0,) * 4,
    "bend": (0.0,) * 4,
    "friction_cross_position": (0.0,) * 4,
    "current_ripple": (0.0, 0.0),
    "dead_time_V": (0.0, 0.0),
    "belt_creep": (0.0, 0.0),
    "brake_drag": (0.0,) * 4,
    "spring_stiffness": (0.0,) * 4,
    "spring_square": (0.0,) * 4,
}


def _effect(family: str):
    return FAMILIES[family](np.random.default_rng(zlib.crc32(family.encode())))


def _off(rig: Rig, sensors: Sensors) -> tuple[Rig, Sensors]:
    """Return the rig and its sensors with the amplitudes of all effects at zero."""
    switched = []
    for thing in (rig, sensors):
        names = {f.name for f in dataclasses.fields(thing)}
        switched.append(
            dataclasses.replace(thing, **{name: value for name, value in OFF.items() if name in names})
        )
    return switched[0], switched[1]


def _measured(rig: Rig, sensors: Sensors, drift: float = 0.0) -> np.ndarray:
    time_s = np.arange(1200) * 1e-3
    inputs = 4.0 * np.sin(2.0 * np.pi * np.outer(time_s, [1.3, 0.9]))
    inputs[:100] = 0.0
    actual_s = drifting_clock(drift)(time_s) if drift else time_s
    positions, velocities = simulate(rig, actual_s, inputs, (0.03, -0.02), rtol=1e-8, atol=1e-11)
    return sensors.ideal(actual_s, positions, velocities)


@pytest.fixture(scope="module")
def plain() -> np.ndarray:
    return _measured(Rig(), Sensors())


@pytest.mark.parametrize("family", FAMILIES)
def test_each_family_changes_the_motion_measurably(family: str, plain: np.ndarray) -> None:
    effect = _effect(family)
    rig, sensors = effect.build(Rig(), Sensors())
    difference = _measured(rig, sensors, effect.drift) - plain
    rms = np.sqrt(np.mean((difference - difference[0]) ** 2, axis=0)) / NOISE
    assert rms.max() > 3.0
    assert np.abs(difference).max() < 10.0  # rad and m; the stage does not diverge


@pytest.mark.parametrize("family", FAMILIES)
def test_without_amplitude_the_stage_is_the_plain_one(family: str, plain: np.ndarray) -> None:
    rig, sensors = _off(*_effect(family).build(Rig(), Sensors()))
    assert np.abs(_measured(rig, sensors) - plain).max() < 1e-9


def test_no_family_is_an_effect_of_the_library() -> None:
    assert not {family.replace(" ", "_") for family in OUTSIDE} & set(EFFECTS)


def test_a_set_has_many_families_and_both_loops() -> None:
    rigs = [draw_rig(7, index) for index in range(COUNT)]
    assert len({rig.effect.family for rig in rigs}) == len(OUTSIDE)
    assert sum(rig.closed_loop for rig in rigs) == COUNT // 2
    assert [rig.describe() for rig in rigs] == [draw_rig(7, index).describe() for index in range(COUNT)]


def test_parameters_differ_by_5_to_15_percent() -> None:
    rig, declared = draw_rig(7, 0).stage[0], Rig()
    for name in ("mass", "viscous", "coulomb", "belt_EA_N", "torque_constant", "resistance_ohm"):
        off = np.abs(np.array(getattr(rig, name)) / np.array(getattr(declared, name)) - 1.0)
        assert np.all((off >= 0.05 - 1e-12) & (off <= 0.15 + 1e-12))


def test_the_controller_follows_its_program() -> None:
    session = next(
        rig for rig in (draw_rig(7, i) for i in range(1, COUNT, 2)) if rig.effect.site == "x"
    ).record()
    assert {name.partition("_")[2].partition("_")[2] for name in session.truth} == {
        program.replace(" ", "_") for program in PROGRAMS
    }
    for recording in (*session.recordings, *session.unseen):
        assert np.abs(recording.inputs).max() <= MAX_VOLTAGE_V + 5e-3
        assert np.abs(recording.outputs[:, 2:]).max() < 0.3
        assert np.ptp(recording.outputs[:, 2:], axis=0).max() > 0.02


@pytest.mark.parametrize("program", PROGRAMS)
def test_a_program_has_no_jumps(program: str) -> None:
    time_s = np.arange(3000) * 1e-3
    path = draw_path(program, time_s, np.array([0.05, -0.03]), np.random.default_rng(4))
    assert np.allclose(path[:100], [0.05, -0.03])
    assert np.abs(np.diff(path, axis=0)).max() < 0.7e-3  # 0.6 m/s at the most
    assert np.abs(np.diff(path, 2, axis=0)).max() < 25e-6  # 8 m/s^2, and twice that where two moves meet


def test_a_drifting_clock_has_the_nominal_mean_rate() -> None:
    time_s = np.arange(1001) * 1e-3 + 5.0
    actual = drifting_clock(0.02)(time_s)
    assert actual[[0, -1]] == pytest.approx(time_s[[0, -1]])
    assert np.diff(actual)[[0, -1]] == pytest.approx([0.99e-3, 1.01e-3], rel=1e-4)
