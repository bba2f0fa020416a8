"""Signs that differ between the runs."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.data_validation import check_before_fit
from hframe_gym.data_validation.run_signs import check_signs_of_runs
from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.machine import BUILTIN_MACHINES, AppliedEffect, Machine, Sensor
from hframe_gym.preparation.session import prepare_within_ranges
from hframe_gym.recordings import Recording
from tests.data_validation.planted_mistakes import measure

PERIOD_S = 5e-3
TIME = np.arange(600) * PERIOD_S
STEP = np.full_like(TIME, 12.0)
RAMP = np.linspace(1.0, 12.0, len(TIME))
STAIRS = np.repeat([3.0, 6.0, 12.0, 8.0, 4.0, 10.0], 100)


def motor(kind: str, *effects: AppliedEffect) -> Machine:
    """Return a motor with one sensor of the shaft."""
    machine = BUILTIN_MACHINES["motor"]()
    sensor = Sensor("shaft", {"shaft": 1.0}, noise=1e-2, kind=kind)
    return machine.replace(sensors=(sensor,), effects=effects)


def run(machine: Machine, volts: np.ndarray, name: str, sign: float = 1.0) -> Recording:
    """Return a simulated run whose column of the voltage has a sign."""
    rated = machine.drives[0].rated_voltage if machine.drives[0].kind == "duty-cycle" else 1.0
    inputs = volts[:, None] / rated
    outputs = measure(machine, simulate(machine, TIME, inputs).outputs, seed=len(name))
    return Recording(name, TIME, sign * inputs, outputs)


def findings(runs: list[Recording], machine: Machine) -> list[str]:
    """Return the findings about signs that differ."""
    return [str(f) for f in check_before_fit(runs, machine) if "against the sign" in f.message]


def test_a_sign_that_differs_in_one_run_is_a_fault() -> None:
    machine = motor("speed")
    runs = [run(machine, STEP, "step"), run(machine, STAIRS, "stairs", -1.0), run(machine, RAMP, "ramp")]
    [line] = findings(runs, machine)
    assert line.startswith("fault: ")
    assert "in stairs, and with it in step and 1 more run" in line
    assert (
        findings([run(machine, v, n) for v, n in ((STEP, "s"), (STAIRS, "t"), (-RAMP, "r"))], machine) == []
    )


def test_a_sign_that_is_wrong_in_all_runs_does_not_differ() -> None:
    """A run that coasts has no sign."""
    machine = motor("speed")
    coasting = run(machine, np.where(TIME < 0.5, 12.0, 0.0), "pushed")
    coasting = dataclasses.replace(coasting, inputs=np.zeros_like(coasting.inputs))
    reversed_runs = [run(machine, volts, f"run_{i}", -1.0) for i, volts in enumerate((STEP, STAIRS, RAMP))]
    data, _ = prepare_within_ranges([*reversed_runs, coasting], machine)
    assert check_signs_of_runs(data.runs, machine) == []
    first = dataclasses.replace(data.runs[0], inputs=-data.runs[0].inputs)
    assert check_signs_of_runs([first, *data.runs[1:]], machine) != []


def test_a_run_of_one_voltage_alone_may_be_driven_by_a_load() -> None:
    """Its force does not change, so that a load of its own would explain the motion as well."""
    machine = motor("speed")
    [line] = findings([run(machine, STEP, "step", -1.0), run(machine, STAIRS, "stairs")], machine)
    assert line.startswith("advice: ")
    assert "another load" in line


BRAKED = np.repeat([12.0, -3.0, 12.0, -3.0, 12.0, -3.0], 100)
SLOW = np.repeat([1.5, -1.5, 1.0, -1.0, 1.5, 0.0], 100)


@pytest.mark.parametrize("kind", ["speed", "encoder"])
@pytest.mark.parametrize("case", ["braked", "pendulum", "spring", "load", "loads"])
def test_other_forces_are_no_fault(kind: str, case: str) -> None:
    """A machine file that lacks a weight or a spring; brakes; a load that is lowered against the voltage."""
    coulomb = motor(kind).coordinates[0].coulomb
    forces: tuple[tuple[AppliedEffect, ...], ...] = {
        "braked": ((), ()),
        "pendulum": 2 * ((EFFECTS["unbalance"].at("shaft", A=20 * coulomb, p=0.0),),),
        "spring": 2 * ((EFFECTS["cable_spring"].at("shaft", k=0.2 * coulomb, q0=0.0),),),
        "load": 2 * ((EFFECTS["constant_force"].at("shaft", size=30 * coulomb),),),
        "loads": tuple((EFFECTS["constant_force"].at("shaft", size=size * coulomb),) for size in (2, 30)),
    }[case]
    lacking = motor(kind)
    volts = (BRAKED, SLOW) if case != "loads" else (-np.abs(SLOW), np.abs(SLOW))
    for first, second in (volts, (STAIRS / 4, SLOW)):
        runs = [run(motor(kind, *forces[0]), first, "first"), run(motor(kind, *forces[1]), second, "second")]
        assert findings(runs, lacking) == []
