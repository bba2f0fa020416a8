"""Drives that turn the other way than declared: found from the motion, by the rule of `hframe check`."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest

from hframe_gym.data_validation import check_before_fit
from hframe_gym.effects import EFFECTS
from hframe_gym.identification import identify, prepare
from hframe_gym.identification.budget import Budget
from hframe_gym.machine import BUILTIN_MACHINES, Machine, Sensor
from hframe_gym.preparation.forces.drive_signs import turned_coordinates, with_turned
from hframe_gym.recordings import Recording, load_machine

PENDULUM = load_machine("pendulum")


def measure(
    machine: Machine,
    volts_per_unit: float = 1.0,
    runs: int = 2,
    *,
    holding_v: float = 0.0,
    steps: float = 0.3,
) -> list[Recording]:
    """Simulate steps of the command from rest about a voltage, and record them multiplied by a factor."""
    time_s = np.arange(0.0, 3.0, 2e-3)
    recordings = []
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        levels = rng.uniform(-steps, steps, (len(time_s) // 150 + 1, len(machine.drives)))
        volts = 12.0 * np.repeat(levels, 150, axis=0)[: len(time_s)]
        volts[:100] = 0.0
        volts += holding_v
        motion = machine.simulate(time_s, volts)
        quanta = np.array([s.resolution for s in machine.sensors])
        noise = np.array([s.noise for s in machine.sensors]) * rng.normal(size=motion.outputs.shape)
        outputs = motion.outputs + noise
        outputs = np.where(quanta > 0.0, np.round(outputs / np.where(quanta, quanta, 1.0)) * quanta, outputs)
        recordings.append(Recording(f"run_{seed + 1:02d}", time_s, volts_per_unit * volts, outputs))
    return recordings


def found(machine: Machine, recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Return the coordinates that turn the other way."""
    return turned_coordinates(machine, prepare(recordings, machine).runs)


@pytest.mark.parametrize("name", ["pendulum", "motor", "axis"])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_direction_follows_from_the_motion_as_for_check(name: str, sign: float) -> None:
    machine = BUILTIN_MACHINES[name]()
    recordings = measure(machine, sign)
    expected = (machine.tool_axes[0],) if sign < 0.0 else ()
    assert found(machine, recordings) == expected
    faults = [f for f in check_before_fit(recordings, machine) if f.severity == "fault"]
    assert bool(faults) == bool(expected)


def test_neither_an_undeclared_weight_nor_a_spring_passes_for_a_direction() -> None:
    assert found(PENDULUM.replace(effects=()), measure(PENDULUM)) == ()
    axis = BUILTIN_MACHINES["axis"]()
    sprung = axis.with_effects(EFFECTS["cable_spring"].at("x", k=400.0, q0=0.0))
    assert found(axis, measure(sprung)) == ()


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_load_that_the_drive_holds_tells_no_direction(sign: float) -> None:
    """A vertical axis: nine tenths of the force hold the load, which an offset explains with either sign."""
    axis = BUILTIN_MACHINES["axis"]()
    (drive,) = axis.drives
    loaded = axis.with_effects(EFFECTS["constant_force"].at("x", size=-9.0 * drive.gain))
    held = [
        dataclasses.replace(r, inputs=sign * r.inputs) for r in measure(loaded, holding_v=9.0, steps=0.08)
    ]
    assert found(axis, held) == (("x",) if sign < 0.0 else ())


def test_of_two_axes_the_one_that_turns_is_named() -> None:
    first = BUILTIN_MACHINES["axis"]()
    second = dataclasses.replace(first.coordinates[0], name="y")
    drive = dataclasses.replace(first.drives[0], name="other", channel="w_V", coordinate="y")
    gantry = first.replace(
        coordinates=(*first.coordinates, second),
        drives=(*first.drives, drive),
        sensors=(*first.sensors, Sensor("y_m", {"y": 1.0}, noise=2e-5)),
    )
    recordings = measure(gantry)
    turned = [dataclasses.replace(r, inputs=r.inputs * np.array([1.0, -1.0])) for r in recordings]
    assert found(gantry, recordings) == ()
    assert found(gantry, turned) == ("y",)


def test_only_sensors_with_a_direction_are_turned() -> None:
    machine = PENDULUM.replace(
        sensors=(
            *PENDULUM.sensors,
            Sensor("arm_rad_s", {"arm": 1.0}, kind="unsigned-speed"),
            Sensor("i_A", {"motor": 1.0}, kind="current"),
        )
    )
    rows = [sensor.row for sensor in with_turned(machine, ("arm",)).sensors]
    assert rows == [{"arm": -1.0}, {"arm": 1.0}, {"motor": 1.0}]


def test_machines_with_belts_are_left_to_check() -> None:
    corexy = BUILTIN_MACHINES["corexy"]()
    recordings = [Recording("run", np.arange(100.0), np.zeros((100, 2)), np.zeros((100, 4)))]
    assert turned_coordinates(corexy, recordings) == ()  # type: ignore[arg-type]


def test_identification_states_the_direction_and_delivers_a_machine_that_has_it() -> None:
    lines: list[str] = []
    recordings = measure(PENDULUM, -1.0, runs=3)
    result = identify(recordings, PENDULUM, log=lines.append, budget=Budget(0.0))
    statement = "A positive command moves arm against the direction in which its sensors count"
    assert any(statement in message for message in result.notes)
    assert any(line.startswith(statement) for line in lines)
    assert result.after.machine.sensors[0].row == {"arm": -1.0}
    assert result.after.held_out.noise_ratio < 1.5
    assert result.plain is not None
    assert result.plain.evaluation.held_out.noise_ratio < 1.5
