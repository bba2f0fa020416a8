"""Speeds that are a multiple of the rate of the position in a part of a run."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.arrays import Array
from hframe_gym.data_validation import check_before_fit
from hframe_gym.data_validation.speeds import check_speeds_in_parts
from hframe_gym.dynamics import simulate
from hframe_gym.machine import BUILTIN_MACHINES, Machine, Sensor
from hframe_gym.preparation.forces.contradicted_sensors import without_contradictions
from hframe_gym.preparation.sensors.contradicted_speeds import contradicted_speeds
from hframe_gym.preparation.session import prepare_session
from hframe_gym.recordings import Recording

HALF = 750  # rows


def motor() -> Machine:
    """Return a motor with an encoder of 12 bits and a tachometer."""
    angle = Sensor("angle_rad", {"shaft": 1.0}, resolution=2.0 * np.pi / 4096, kind="encoder")
    speed = Sensor("speed_rad_s", {"shaft": 1.0}, noise=0.3, kind="speed")
    return BUILTIN_MACHINES["motor"]().replace(sensors=(angle, speed))


def runs() -> list[Recording]:
    """Return three runs of 1.5 s with random voltages."""
    recorded = []
    time_s = np.arange(2 * HALF) * 1e-3
    for seed in range(3):
        rng = np.random.default_rng(seed)
        volts = np.repeat(rng.uniform(-12.0, 12.0, 10), 150)[:, None]
        volts[:150] = 0.0
        outputs = simulate(motor(), time_s, volts).outputs.copy()
        outputs[:, 1] += 0.3 * rng.normal(size=len(time_s))
        recorded.append(Recording(f"run_{seed}", time_s, volts, outputs))
    return recorded


def with_outputs(recording: Recording, angle: Array, speed: Array) -> Recording:
    """Return a recording with other measurements."""
    return dataclasses.replace(recording, outputs=np.column_stack([angle, speed]))


@pytest.mark.parametrize("wrong", ["angle_rad", "speed_rad_s"])
def test_the_sensor_that_does_not_follow_from_the_voltages_is_left_out(wrong: str) -> None:
    """From the middle of a run on, an encoder loses every second pulse, or a counter counts twice."""
    first, *others = runs()
    angle, speed = first.outputs.T.copy()
    if wrong == "angle_rad":
        angle[HALF:] = angle[HALF] + 0.5 * (angle[HALF:] - angle[HALF])
    else:
        speed[HALF:] *= 2.0
    faulty = [with_outputs(first, angle, speed), *others]
    [part] = contradicted_speeds(faulty, motor())
    assert (part.run, part.speed, part.position) == ("run_0", "speed_rad_s", "angle_rad")
    assert part.ratio == pytest.approx(2.0, abs=0.1)
    assert abs(part.first - HALF) <= 100
    assert part.last >= 2 * HALF - 100
    [finding] = [f for f in check_before_fit(faulty, motor()) if "in other parts" in f.message]
    assert (finding.severity, finding.run, finding.channel) == ("advice", "run_0", "speed_rad_s")
    session = prepare_session(faulty, motor(), lambda _: None)
    [statement] = session.statements
    assert statement.startswith("In parts of run_0, speed_rad_s is about 2")
    left_out = np.isnan(session.data.runs[0].outputs).mean(axis=0)
    if wrong == "angle_rad":
        assert list(left_out) == [1.0, 0.0]
    else:
        assert left_out[0] == 0.0
        assert left_out[1] == pytest.approx(0.5, abs=0.1)
    assert not any(np.isnan(run.outputs).any() for run in session.data.runs[1:])


def test_where_the_forces_are_not_known_the_speed_is_left_out() -> None:
    """A servo follows its set point, whatever force that takes."""
    servo = BUILTIN_MACHINES["servo"]()
    row = {servo.coordinate_names[0]: 1.0}
    servo = servo.replace(sensors=tuple(dataclasses.replace(s, row=row) for s in motor().sensors))
    first, *others = runs()
    angle, speed = first.outputs.T.copy()
    angle[HALF:] = angle[HALF] + 0.5 * (angle[HALF:] - angle[HALF])
    faulty = [with_outputs(first, angle, speed), *others]
    [finding] = check_speeds_in_parts(faulty, servo)
    assert "Identification leaves out the speed. " in finding.message
    cleaned, [statement] = without_contradictions(faulty, (), servo)
    assert statement.endswith("speed_rad_s is left out there.")
    assert list(np.isnan(cleaned[0].outputs).any(axis=0)) == [False, True]


@pytest.mark.parametrize("lag_s", [0.0, 0.05])
@pytest.mark.parametrize("factor", [1.0, 1.3, 3.0])
def test_a_constant_ratio_and_a_filtered_speed_are_no_contradiction(factor: float, lag_s: float) -> None:
    """A ratio that is the same everywhere is a wrong unit; a filter is late after each step only."""
    measured = []
    for recording in runs():
        angle, speed = recording.outputs.T
        if lag_s:
            kernel = np.exp(-np.arange(2 * HALF) * 1e-3 / lag_s)
            speed = np.convolve(speed, kernel / kernel.sum())[: 2 * HALF]
        measured.append(with_outputs(recording, angle, factor * speed))
    assert contradicted_speeds(measured, motor()) == []
