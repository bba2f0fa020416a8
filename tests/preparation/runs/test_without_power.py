"""Beginnings and ends of runs in which commands have no effect."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.arrays import Array
from hframe_gym.data_validation import check_before_fit
from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.machine import BUILTIN_MACHINES, AppliedEffect, Machine, Sensor
from hframe_gym.preparation.runs.without_power import with_power, without_power
from hframe_gym.preparation.session import prepare_session
from hframe_gym.recordings import Recording

PULSE = 25  # rows of 20 ms


def motor(kind: str = "encoder") -> Machine:
    """Return a motor with an encoder of 12 bits or a tachometer."""
    if kind == "speed":
        sensor = Sensor("speed_rad_s", {"shaft": 1.0}, noise=0.1, kind="speed")
    else:
        sensor = Sensor("angle_rad", {"shaft": 1.0}, resolution=2.0 * np.pi / 4096, kind="encoder")
    return BUILTIN_MACHINES["motor"]().replace(sensors=(sensor,))


def run(machine: Machine, powered: tuple[bool, ...], level: float = 4.0) -> Recording:
    """Return a run with a pulse and a pause of 0.5 s each; without power it has no effect."""
    volts = np.tile(np.repeat([0.0, level, 0.0], PULSE), len(powered))[:, None]
    acting = volts * np.repeat(powered, 3 * PULSE)[:, None]
    time_s = 0.02 * np.arange(len(volts))
    outputs: Array = simulate(machine, time_s, acting).outputs
    sensor = machine.sensors[0]
    if sensor.noise:
        outputs = outputs + sensor.noise * np.random.default_rng(0).normal(size=outputs.shape)
    else:
        outputs = sensor.resolution * np.rint(outputs / sensor.resolution)
    return Recording(f"run_{level:g}V", time_s, volts, outputs)


@pytest.mark.parametrize("kind", ["encoder", "speed"])
def test_beginnings_and_ends_without_power_are_not_used(kind: str) -> None:
    machine = motor(kind)
    recorded = run(machine, (False,) * 3 + (True,) * 4 + (False,) * 2)
    findings = [f for f in check_before_fit([recorded], machine) if "amplifier off" in f.message]
    last = 2 * 3 * PULSE + 2 * PULSE  # end of the third pulse
    first = 7 * 3 * PULSE + PULSE  # begin of the eighth one
    assert [finding.severity for finding in findings] == ["advice"] * 2
    assert f"rows 1 to {last} (3 starts)" in findings[0].message
    assert f"rows {first + 1} to {len(recorded.time_s)} (2 starts)" in findings[1].message
    for finding, row in zip(findings, (last, first), strict=True):
        assert f"cut the log at {recorded.time_s[row]:.6g} s" in finding.message
    lines: list[str] = []
    [prepared] = prepare_session([recorded], machine, lines.append).data.runs
    assert f"run_4V: not used from 0 s to {recorded.time_s[last - 1]:.6g} s: v_V without effect" in lines
    assert prepared.time_s[0] == pytest.approx(recorded.time_s[last])
    assert prepared.time_s[-1] == pytest.approx(recorded.time_s[first - 1])


def test_what_is_prepared_again_is_logged_once() -> None:
    machine = motor()
    lines: list[str] = []
    with_outlier = run(machine, (True, True), 5.0)
    with_outlier.outputs[2 * PULSE + 10] += 20.0
    prepare_session([run(machine, (False,) * 3 + (True,) * 4), with_outlier], machine, lines.append)
    assert sum("without effect" in line for line in lines) == 1
    assert sum("outlier" in line for line in lines) == 1


def test_a_log_may_be_a_row_late() -> None:
    """Its rows at the beginning of a push show the motion that follows, which is no lack of rest."""
    machine = motor()
    recorded = run(machine, (False,) * 3 + (True,) * 4)
    early = dataclasses.replace(recorded, outputs=np.vstack([recorded.outputs[1:], recorded.outputs[-1:]]))
    data = prepare_session([early], machine, lambda _: None).data
    [part] = without_power([early], data.noise, data.quantum, machine)
    assert (part.first, part.last, part.pushes) == (0, 2 * 3 * PULSE + 2 * PULSE - 1, 3)


def test_a_run_of_which_too_few_rows_would_remain_is_kept() -> None:
    machine = motor()
    recorded = run(machine, (False,) * 3 + (True,) * 2)
    data = prepare_session([recorded], machine, lambda _: None).data
    [part] = without_power([recorded], data.noise, data.quantum, machine)
    [shorter] = with_power([recorded], [part])
    assert len(shorter.time_s) == len(recorded.time_s) - part.last - 1
    assert with_power([recorded], [part._replace(last=len(recorded.time_s) - 5)]) == [recorded]


@pytest.mark.parametrize(
    "powered",
    [
        (True,) * 4,
        (False, True, True, True),
        (False, False, True, False, True, True),
        (False, False, False, True),
    ],
)
def test_stiction_is_no_lack_of_power(powered: tuple[bool, ...]) -> None:
    """One failed start, some between others, and a single start that succeeds prove nothing."""
    machine = motor()
    data = prepare_session([run(machine, powered)], machine, lambda _: None).data
    recordings = [run(machine, powered)]
    assert without_power(recordings, data.noise, data.quantum, machine) == []


def test_one_failed_start_by_a_strong_push_suffices() -> None:
    """4 V start the motor in another run, so that 8 V would do it for certain."""
    machine = motor()
    recordings = [run(machine, (False, True, True), 8.0), run(machine, (True, True))]
    data = prepare_session(recordings, machine, lambda _: None).data
    [part] = without_power(recordings, data.noise, data.quantum, machine)
    assert (part.run, part.first, part.last, part.pushes) == ("run_8V", 0, 2 * PULSE - 1, 1)


@pytest.mark.parametrize(("stiffness", "level"), [(0.02, 2.0), (0.02, 1.6), (0.05, 1.6)])
def test_a_spring_that_friction_holds_is_no_lack_of_power(stiffness: float, level: float) -> None:
    """The spring ends the first motion and holds against equal commands afterwards."""
    machine = motor().replace({"shaft.mass": 1e-3, "shaft.coulomb": 0.05})
    spring = AppliedEffect(EFFECTS["cable_spring"], "shaft", {"k": stiffness, "q0": 0.0})
    recordings = [run(machine.with_effects(spring), (True,) * 8, level)]
    data = prepare_session(recordings, machine, lambda _: None).data
    assert without_power(recordings, data.noise, data.quantum, machine) == []
