"""Speeds that contradict positions, and motion at a constant speed."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from hframe_gym.data_validation import check_before_fit, check_recordings
from hframe_gym.data_validation.speeds import check_computed_speeds
from hframe_gym.data_validation.wiring import REMEDY
from hframe_gym.dynamics import simulate
from hframe_gym.identification import prepare
from hframe_gym.machine import BUILTIN_MACHINES, Machine, Sensor
from hframe_gym.preparation.runs.moving import runs_that_should_move
from hframe_gym.recordings import Recording
from tests.data_validation.planted_mistakes import faults

SPEED_NOISE = 0.3  # rad/s


def motor(*, position: bool = True) -> Machine:
    """Return a motor with a tachometer and, if wanted, a coarse encoder."""
    speed = Sensor("speed_rad_s", {"shaft": 1.0}, noise=SPEED_NOISE, kind="speed")
    encoder = Sensor("angle_rad", {"shaft": 1.0}, resolution=0.3, kind="encoder")
    return BUILTIN_MACHINES["motor"]().replace(sensors=(encoder, speed) if position else (speed,))


def run(machine: Machine, volts: tuple[float, ...], name: str = "run") -> Recording:
    """Return a simulated run with voltage levels of 0.25 s each, and the noise of the tachometer."""
    time_s = np.arange(250 * len(volts)) * 1e-3
    inputs = np.repeat(volts, 250)[:, None]
    outputs = simulate(machine, time_s, inputs).outputs.copy()
    outputs[:, -1] += SPEED_NOISE * np.random.default_rng(len(volts)).normal(size=len(time_s))
    if outputs.shape[1] > 1:
        outputs[:, 0] = 0.3 * np.rint(outputs[:, 0] / 0.3)
    return Recording(name, time_s, inputs, outputs)


def scaled(factors: tuple[float, float]) -> list[str]:
    """Return the faults of a run whose angle and speed are multiplied by factors."""
    measured = run(motor(), (0.0, 6.0, -4.0, 8.0, -10.0, 3.0, 0.0))
    return faults(
        check_before_fit([dataclasses.replace(measured, outputs=measured.outputs * factors)], motor())
    )


@pytest.mark.parametrize("computed", [True, False])
def test_a_speed_that_was_computed_from_the_counts_is_named(computed: bool) -> None:
    """As a sketch logs it, in rpm with one decimal; an ideal tachometer beside the encoder is not named."""
    step = 2.0 * np.pi / 1320
    machine = motor().with_components(Sensor("angle_rad", {"shaft": 1.0}, resolution=step, kind="encoder"))
    time_s = np.arange(400) * 1e-2
    volts = np.repeat(np.random.default_rng(0).uniform(-12.0, 12.0, 20), 20)[:, None]
    outputs = simulate(machine, time_s, volts).outputs.copy()
    outputs[:, 0] = step * np.rint(outputs[:, 0] / step)
    if computed:
        rpm = np.diff(outputs[:, 0], prepend=outputs[0, 0]) / 1e-2 * 30.0 / np.pi
        outputs[:, 1] = np.round(rpm, 1) * np.pi / 30.0
    found = check_computed_speeds([Recording("run", time_s, volts, outputs)], machine)
    assert [(finding.severity, finding.channel) for finding in found] == [
        ("advice", "speed_rad_s")
    ] * computed
    assert all("5 ms late" in finding.message for finding in found)


@pytest.mark.parametrize("factors", [(1.0, 1.0), (1.0, 1.2)])
def test_speeds_that_agree_with_positions_are_no_fault(factors: tuple[float, float]) -> None:
    assert scaled(factors) == []


@pytest.mark.parametrize(
    ("factors", "message"),
    [
        ((1.0, 60 / (2 * np.pi)), "speed_rad_s: is 9.5[0-9] times the speed at which angle_rad changes"),
        ((4.9, 1.0), "speed_rad_s: is 0.204 times the speed at which angle_rad changes.*speed_rad_s=4.9"),
        ((1.0, -1.0), "speed_rad_s: is (-1|-0.99.) times"),
    ],
)
def test_a_speed_that_contradicts_the_position_is_a_fault(factors: tuple[float, float], message: str) -> None:
    [line] = scaled(factors)
    assert re.search(message, line)


def test_swapped_speeds_are_named() -> None:
    """Swapped speeds of two motors with encoders contradict both; one motor alone moves in the second run."""
    hframe = BUILTIN_MACHINES["hframe"]()
    speeds = (Sensor(f"w{i}_rad_s", {f"phi{i}": 1.0}, noise=SPEED_NOISE, kind="speed") for i in (1, 2))
    machine = hframe.replace(sensors=(*hframe.sensors[:2], *speeds))
    rng = np.random.default_rng(0)
    runs = []
    for k, pulls in enumerate([(3.0, 3.0), (3.0, 0.0)]):
        time_s = np.arange(1000) * 1e-3
        volts = np.repeat(rng.uniform(-1.0, 1.0, (10, 2)) * pulls, 100, axis=0)
        volts[:100] = 0.0
        outputs = simulate(machine, time_s, volts).outputs
        runs.append(Recording(f"run_{k}", time_s, volts, outputs + 1e-3 * rng.normal(size=outputs.shape)))
    assert faults(check_recordings(runs, machine)) == []
    swapped = [dataclasses.replace(r, outputs=r.outputs[:, [0, 1, 3, 2]]) for r in runs]
    assert faults(check_recordings(swapped, machine)) == [
        f"fault: w1_rad_s and w2_rad_s are swapped: {REMEDY}"
    ]


def test_a_run_at_a_constant_speed_moves_and_copies_are_told() -> None:
    """The tachometer shows 230 rad/s throughout one run; in another one, it was not connected."""
    machine = motor(position=False)
    started = run(machine, (0.0, 12.0, 12.0), "started")
    steady = Recording("steady", started.time_s[500:], started.inputs[500:], started.outputs[500:])
    blocked = dataclasses.replace(steady, name="blocked", outputs=0.0 * steady.outputs)
    copy = dataclasses.replace(started, name="the copy")
    runs = [started, steady, blocked]
    assert runs_that_should_move(prepare(runs, machine), machine, ["started"]) == {"blocked": "started"}
    findings = check_recordings([*runs, copy], machine)
    assert [f.run for f in findings if "nothing moves" in f.message] == ["blocked"]
    assert [f.run for f in findings if "is a copy of started" in f.message] == ["the copy"]


def test_a_constant_speed_of_a_few_counts_is_motion() -> None:
    """A speed of 230 rad/s in steps of 37 rad/s is no offset of the sensor."""
    machine = motor(position=False)
    started = run(machine, (0.0, 12.0, 12.0), "started")
    step = np.nanmedian(started.outputs[500:]) / 6.2
    counts = np.random.default_rng(0).uniform(0.0, 1.0, started.outputs.shape)
    coarse = dataclasses.replace(started, outputs=step * np.floor(started.outputs / step + counts))
    steady = Recording("steady", coarse.time_s[500:], coarse.inputs[500:], coarse.outputs[500:])
    blocked = dataclasses.replace(steady, name="blocked", outputs=0.0 * steady.outputs)
    runs = [coarse, steady, blocked]
    assert runs_that_should_move(prepare(runs, machine), machine, ["started"]) == {"blocked": "started"}
