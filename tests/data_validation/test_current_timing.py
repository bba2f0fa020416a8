"""Currents that were read under the voltage of their own row are named; those before it are not."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.data_validation.current_timing import check_currents
from hframe_gym.effects import EFFECTS
from hframe_gym.machine import BUILTIN_MACHINES, Machine, Sensor
from hframe_gym.recordings import Recording

TIME = np.arange(1000) * 1e-3


def axis() -> Machine:
    return BUILTIN_MACHINES["axis"]().with_components(Sensor("motor_A", {"motor": 1.0}, kind="current"))


def recording(machine: Machine, *, rows_early: int = 0, noise: float = 0.05) -> Recording:
    """Return a run with a new voltage in each row, whose current is logged some rows too early."""
    rng = np.random.default_rng(0)
    volts = 2.0 * np.sin(9.0 * TIME) + rng.normal(0.0, 0.5, len(TIME))
    outputs = machine.simulate(TIME, volts[:, None]).outputs
    current = outputs[:, -1] + noise * rng.normal(size=len(TIME))
    outputs[:, -1] = np.append(current[rows_early:], np.full(rows_early, np.nan))
    return Recording("run", TIME, volts[:, None], outputs)


def test_a_current_under_the_voltage_of_its_own_row_is_named_with_its_response() -> None:
    """The response is the reciprocal of the resistance."""
    machine = axis()
    (finding,) = check_currents([recording(machine, rows_early=1)], machine)
    assert (finding.severity, finding.channel) == ("advice", "motor_A")
    stated = float(finding.message.partition("own row (")[2].partition(" ")[0])
    assert stated == pytest.approx(1.0 / machine.drives[0].resistance, rel=0.05)


@pytest.mark.parametrize("lag_s", [0.0, 0.002])
def test_a_current_before_its_voltage_is_not_named(lag_s: float) -> None:
    """Nor one that an inductance delays."""
    machine = axis()
    if lag_s:
        machine = machine.with_effects(EFFECTS["electrical_lag"].at("motor", tau=lag_s))
    assert check_currents([recording(machine)], machine) == []


def test_a_controller_that_answers_the_current_of_the_row_is_not_named() -> None:
    """A voltage that is computed from the current depends on it with the opposite sign."""
    machine, rng = axis(), np.random.default_rng(1)
    resistance = machine.drives[0].resistance
    volts, current = np.zeros(len(TIME)), np.zeros(len(TIME))
    for k in range(1, len(TIME)):
        current[k] = volts[k - 1] / resistance + 0.05 * rng.normal()
        volts[k] = 0.9 * volts[k - 1] + resistance * (rng.normal() - 0.5 * current[k])
    outputs = np.column_stack([np.zeros(len(TIME)), current])
    assert check_currents([Recording("run", TIME, volts[:, None], outputs)], machine) == []


def test_unmeasured_currents_are_not_named() -> None:
    machine = axis()
    run = recording(machine)
    run.outputs[:, -1] = np.nan
    assert check_currents([run], machine) == []
