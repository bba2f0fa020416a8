"""Currents and set points of two drives that are swapped are named; others are not."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.arrays import Array
from hframe_gym.data_validation import check_before_fit
from hframe_gym.data_validation.swapped_drives import check_swapped_currents, check_swapped_set_points
from hframe_gym.identification import prepare
from hframe_gym.machine import Machine, Sensor
from hframe_gym.recordings import MachineOptions, Recording, new_machine
from tests.data_validation.planted_mistakes import faults, measure, with_change

MOTION = np.arange(1500) * 1e-3  # s


def with_currents(like: str, drive: str | None = None) -> Machine:
    """Return a machine of a template with a sensor of each drive's current, whose noise is 50 mA."""
    machine = new_machine(like, like, MachineOptions(drive=drive))
    sensors = (Sensor(f"{d.name}_A", {d.name: 1.0}, noise=0.05, kind="current") for d in machine.drives)
    return machine.with_components(*sensors)


def runs(machine: Machine, commands: list[Array]) -> list[Recording]:
    """Return simulated runs with the declared noise and resolution of the sensors."""
    return [
        Recording(f"run_{k}", MOTION, u, measure(machine, machine.simulate(MOTION, u).outputs, k))
        for k, u in enumerate(commands)
    ]


def levels(seed: int, size: float, rows: int = 100) -> Array:
    """Return two commands that change every 0.1 s, at rest in the first and the last, shape (1500, 2)."""
    drawn = np.random.default_rng(seed).uniform(-size, size, (len(MOTION) // rows, 2))
    drawn[[0, -1]] = 0.0
    return np.repeat(drawn, rows, axis=0)


def curves(seed: int, size: float) -> Array:
    """Return two smooth commands that begin at 0, shape (1500, 2)."""
    rng = np.random.default_rng(seed)
    rates = rng.uniform(3.0, 9.0, (2, 3))
    time_s = np.maximum(MOTION - 0.1, 0.0)[:, None]
    return np.stack([size * np.sin(time_s * rate).sum(axis=1) / 3 for rate in rates], axis=1)


def with_swapped_currents(recordings: list[Recording]) -> list[Recording]:
    """Return the runs with their last two columns, the currents, exchanged."""
    return with_change(recordings, lambda u, y: (u, np.hstack([y[:, :-2], y[:, :-3:-1]])))


@pytest.mark.parametrize(
    ("like", "drive", "size"),
    [("hframe", None, 8.0), ("corexy", None, 8.0), ("xy-table", None, 8.0), ("hframe", "current", 2.0)],
)
def test_swapped_currents_of_two_drives_are_named(like: str, drive: str | None, size: float) -> None:
    machine = with_currents(like, drive)
    right = runs(machine, [levels(seed, size) for seed in range(2)])
    assert faults(check_before_fit(right, machine)) == []
    (fault,) = faults(check_before_fit(with_swapped_currents(right), machine))
    first, second = machine.output_channels[-2:]
    assert f"{first} and {second} are swapped" in fault


def test_a_wrong_resistance_and_ke_do_not_hide_or_imitate_swapped_currents() -> None:
    machine = with_currents("xy-table")
    first, second = machine.drives
    other = {f"{first.name}.{key}": 0.5 * getattr(first, key) for key in ("resistance", "Ke")}
    other |= {f"{second.name}.{key}": 2.0 * getattr(second, key) for key in ("resistance", "Ke")}
    right = runs(machine.replace(other), [levels(seed, 8.0) for seed in range(2)])
    assert not any("swapped" in line for line in faults(check_before_fit(right, machine)))
    assert len(check_swapped_currents(prepare(with_swapped_currents(right), machine).runs, machine)) == 1


@pytest.mark.parametrize(
    ("like", "drive", "size"),
    [
        ("xy-table", "position", 0.03),
        ("xy-table", "speed", 0.2),
        ("printer", "position", 2.0),
        ("printer", "stepper", 2.0),
    ],
)
def test_swapped_set_points_of_two_drives_are_named(like: str, drive: str, size: float) -> None:
    machine = new_machine(like, like, MachineOptions(drive=drive))
    right = runs(machine, [curves(seed, size) for seed in range(2)])
    assert faults(check_before_fit(right, machine)) == []
    (fault,) = faults(check_before_fit(with_change(right, lambda u, y: (u[:, ::-1], y)), machine))
    first, second = machine.input_channels
    assert f"{first} and {second}, or the sensors of what they move, are swapped" in fault


def test_set_points_of_speeds_are_compared_with_tachometers_alone() -> None:
    table = new_machine("xy-table", "table", MachineOptions(drive="speed"))
    speeds = (
        Sensor(f"{d.coordinate}_m_s", {d.coordinate: 1.0}, noise=1e-3, kind="speed") for d in table.drives
    )
    machine = table.replace(sensors=tuple(speeds))
    right = runs(machine, [curves(seed, 0.2) for seed in range(2)])
    assert check_swapped_set_points(prepare(right, machine).runs, machine) == []
    swapped = with_change(right, lambda u, y: (u[:, ::-1], y))
    assert len(check_swapped_set_points(prepare(swapped, machine).runs, machine)) == 1


def test_accelerations_alone_tell_no_swap_of_set_points() -> None:
    """They are no positions, and give none: a printer with an accelerometer on its tool."""
    printer = new_machine("printer", "printer", MachineOptions())
    sensors = (Sensor(f"a{axis}_m_s2", {axis: 1.0}, noise=0.05, kind="acceleration") for axis in "xy")
    machine = printer.replace(sensors=tuple(sensors))
    assert faults(check_before_fit(runs(machine, [curves(seed, 2.0) for seed in range(2)]), machine)) == []


def test_equal_commands_tell_no_swap() -> None:
    """Both drives then follow both commands."""
    machine = with_currents("xy-table")
    recordings = runs(machine, [levels(seed, 8.0)[:, [0, 0]] for seed in range(2)])
    assert check_swapped_currents(prepare(with_swapped_currents(recordings), machine).runs, machine) == []
