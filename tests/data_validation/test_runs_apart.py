"""Runs in another unit than the others."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.data_validation import Finding, check_before_fit
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.recordings import Recording
from tests.data_validation.planted_mistakes import measure

MACHINE = BUILTIN_MACHINES["belt-axis"]()


def belt_axis_runs() -> list[Recording]:
    """Return four runs of an axis with an encoder on the motor and a laser at the carriage."""
    rng = np.random.default_rng(1)
    runs = []
    for k in range(4):
        time = np.arange(600) * 2e-3
        volts = np.repeat(rng.uniform(1.0, 6.0, 12) * rng.choice([-1.0, 1.0], 12), 50)
        volts[:100] = 0.0
        outputs = MACHINE.simulate(time, volts[:, None]).outputs
        runs.append(Recording(f"run_{k}", 10.0 * k + time, volts[:, None], measure(MACHINE, outputs, k)))
    return runs


def of_one_run(**change: np.ndarray | float) -> list[Finding]:
    """Return the findings on such runs, of which the third has columns times a factor."""
    runs = belt_axis_runs()
    changed = {name: factor * getattr(runs[2], name) for name, factor in change.items()}
    runs[2] = dataclasses.replace(runs[2], **changed)
    return [finding for finding in check_before_fit(runs, MACHINE) if finding.run]


def test_runs_in_one_unit_have_no_findings() -> None:
    assert of_one_run() == []


@pytest.mark.parametrize(
    ("factors", "channel", "ratio"),
    [
        ([1.0, 1e-3], "x_m", "0.001 times"),
        ([180.0 / np.pi, 1.0], "phi_rad", "57.3 times"),
    ],
)
def test_a_sensor_in_another_unit_in_one_run_is_a_fault(
    factors: list[float], channel: str, ratio: str
) -> None:
    [fault] = of_one_run(outputs=np.array(factors))
    assert (fault.severity, fault.run, fault.channel) == ("fault", "run_2", channel)
    assert f"moves {ratio} as far as other sensors measure" in fault.message


def test_times_of_one_run_in_another_unit_are_advice() -> None:
    first, second = (f for f in of_one_run(time_s=1e-3) if f.channel == "time_s")
    assert str(first) == "advice: run_2, time_s: is only 1.2 ms long: are its times in another unit?"
    assert "is sampled at 5e+05 Hz, the other runs at 500 Hz" in second.message


def test_an_input_that_is_far_too_small_in_one_run_is_advice() -> None:
    [advice] = of_one_run(inputs=1e-3)
    assert (advice.severity, advice.run, advice.channel) == ("advice", "run_2", "v_V")
    assert "times smaller than in the other runs" in advice.message


def test_a_stuck_sensor_has_no_scale() -> None:
    """An encoder that is stuck in one run turns too little for the travel of all runs."""
    runs = belt_axis_runs()
    stuck = runs[2].outputs * [0.0, 1.0]
    findings = check_before_fit([*runs[:2], dataclasses.replace(runs[2], outputs=stuck), runs[3]], MACHINE)
    [fault] = [f for f in findings if f.channel == "phi_rad"]
    assert fault.message.endswith("stuck. Leave these cells empty, or delete the run")
