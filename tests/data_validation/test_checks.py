"""Clock and sensors of recordings: planted faults are reported, and good recordings have none."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from hframe_gym.data_validation import check_before_fit, check_recordings
from hframe_gym.data_validation.sampling import check_sampling
from hframe_gym.machine import Machine
from hframe_gym.recordings import Recording, load_machine
from tests.data_validation.planted_mistakes import PHI1, X, Y, faults, measure, with_column
from tests.example_runs import example_runs


def test_good_recordings_have_no_fault(hframe: Machine) -> None:
    runs = example_runs("rig_b")
    findings = check_recordings(runs, hframe)
    assert faults(findings) == []
    assert any("8 runs, 19.99 s in total, sampled at 1000 Hz" in f.message for f in findings)
    assert all(check_before_fit([run], hframe) == [] for run in runs)


def test_a_laser_that_keeps_its_value_is_stuck(runs: list[Recording], hframe: Machine) -> None:
    def stick(y: np.ndarray) -> np.ndarray:
        y[900:1800] = y[900]
        return y

    stuck = with_column(runs[1:2], X, stick)[0]
    [line] = faults(check_recordings([stuck, *runs[2:]], hframe))
    assert "run_02, x_m: for 0.899 s, while other channels move, it stays at 0.05215: stuck" in line
    assert "stuck" in str(check_before_fit([stuck], hframe)[0])


def test_an_encoder_that_keeps_its_value_is_stuck(runs: list[Recording], hframe: Machine) -> None:
    def stick(y: np.ndarray) -> np.ndarray:
        y[900:] = y[900]
        return y

    [warning] = check_before_fit([with_column(runs[1:2], PHI1, stick)[0]], hframe)
    assert warning.channel == "phi1_rad"
    assert "stuck" in warning.message


def axis_runs(outputs_of: Callable[[np.ndarray, np.random.Generator], np.ndarray]) -> list[Recording]:
    """Return three runs of an axis at 1 kHz that is pushed back and forth from 0.2 s on."""
    axis, time = load_machine("axis"), np.arange(2000) * 1e-3
    volts = (6.0 * np.sign(np.sin(4 * np.pi * (time - 0.2))) * (time >= 0.2))[:, None]
    motion = axis.simulate(time, volts).outputs
    rng = np.random.default_rng(4)
    return [Recording(f"run_{k}", 3.0 * k + time, volts, outputs_of(motion.copy(), rng)) for k in range(3)]


def noisy(motion: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return a laser's measurements."""
    return motion + rng.normal(0.0, 20e-6, motion.shape)


def test_the_only_sensor_that_loses_its_noise_is_stuck() -> None:
    """Nothing else shows that it should move, but no sensor at rest is without noise."""
    axis, runs = load_machine("axis"), axis_runs(noisy)
    assert faults(check_before_fit(runs, axis)) == []
    runs[1].outputs[1400:] = runs[1].outputs[1400]
    [line] = faults(check_before_fit(runs, axis))
    assert "run_1, x_m: for 0.599 s, without the noise that it has at rest, it stays at" in line


@pytest.mark.parametrize("rest", [0, 1])
def test_a_sensor_without_noise_that_rests_is_not_stuck(rest: int) -> None:
    """Measurements in steps, or of a simulation, are equal at rest."""
    axis = load_machine("axis")
    runs = axis_runs(lambda motion, rng: np.rint(motion / 1e-4) * 1e-4 if rest else motion)
    still = [dataclasses.replace(r, inputs=r.inputs.copy(), outputs=r.outputs.copy()) for r in runs]
    for run in still:
        run.inputs[1000:], run.outputs[1000:] = 0.0, run.outputs[1000]
    assert [f for f in check_before_fit(still, axis) if "it stays at" in f.message] == []


def test_noise_is_not_estimated_from_rests_that_are_all_too_short() -> None:
    """Five rests of 9 rows are 45 rows, but none of them gives a standard deviation."""
    axis = load_machine("axis")
    axis = axis.replace(sensors=tuple(dataclasses.replace(s, noise=0.0) for s in axis.sensors))
    runs = [r for r in axis_runs(noisy) for _ in range(2)][:5]
    short = [
        Recording(f"run_{k}", r.time_s[193:], r.inputs[193:], r.outputs[193:]) for k, r in enumerate(runs)
    ]
    for recordings, expected in ((runs, False), (short, True)):
        [noise] = [f for f in check_recordings(recordings, axis) if f.message.startswith("noise")]
        assert ("estimated during motion: too few rows are at rest" in noise.message) == expected


def test_an_encoder_that_keeps_its_value_while_its_drive_pushes_both_ways_is_suspect() -> None:
    axis = load_machine("axis")
    runs = axis_runs(lambda motion, rng: np.rint(motion / 1e-4) * 1e-4)
    runs[2].outputs[800:] = runs[2].outputs[800]
    lines = [f for f in check_before_fit(runs, axis) if "it stays at" in f.message]
    assert [(f.severity, f.run) for f in lines] == [("advice", "run_2")]
    assert "while its drive pushes in both directions" in lines[0].message
    assert "is the sensor stuck, or was the drive off?" in lines[0].message


@pytest.mark.parametrize("lasers", [True, False])
@pytest.mark.parametrize("coulomb", [0.3, 1.0])
def test_an_encoder_whose_motor_is_held_by_friction_is_not_stuck(
    lasers: bool, coulomb: float, hframe: Machine
) -> None:
    """Drive motor 2 alone: the carriage moves diagonally, belts stretch, motor 1 rests within friction."""
    machine = hframe.replace({"phi1.coulomb": coulomb, "phi2.coulomb": coulomb})
    time = np.arange(3000) * 1e-3
    volts = (10.0 if coulomb > 0.5 else 4.0) * np.sign(np.sin(2 * np.pi * (time - 0.2))) * (time > 0.2)
    inputs = np.column_stack([np.zeros(3000), volts])
    outputs = measure(machine, machine.simulate(time, inputs).outputs)
    assert np.ptp(outputs[:, 0]) < 0.03  # rad
    assert np.ptp(outputs[:, 1]) > 5.0
    if not lasers:
        outputs[:, [X, Y]] = np.nan
    assert faults(check_before_fit([Recording("diagonal", time, inputs, outputs)], machine)) == []


def test_a_laser_at_the_end_of_its_range_is_clipped(runs: list[Recording], hframe: Machine) -> None:
    clipped = with_column(runs[1:2], X, lambda y: np.minimum(y, np.quantile(y, 0.7)))
    assert "clipped?" in str(check_before_fit([clipped[0]], hframe)[0])


@pytest.mark.parametrize("count", [3, 4])
def test_lasers_that_end_at_their_range_do_not_make_other_channels_suspect(
    hframe: Machine, count: int
) -> None:
    """Lasers of 40 mm range are clipped for most of a run: no encoder is stuck, none has a wrong scale."""
    near = [r for r in example_runs("rig_b")[:count] if np.abs(r.outputs[:, [X, Y]]).max() > 0.05]
    clipped = with_column(
        with_column(near, X, lambda y: np.clip(y, -0.02, 0.02)), Y, lambda y: np.clip(y, -0.02, 0.02)
    )
    findings = check_before_fit(clipped, hframe)
    assert faults(findings) == []
    assert {f.channel for f in findings if "clipped?" in f.message} == {"x_m", "y_m"}


def test_a_run_in_which_one_motor_rests_alone_has_no_fault(hframe: Machine) -> None:
    """The resting motor is held by three times the declared friction; the belts stretch against it."""
    machine = hframe.replace({"phi1.coulomb": 3 * hframe.parameters["phi1.coulomb"]})
    time = np.arange(2000) * 1e-3
    volts = 6.0 * np.sign(np.sin(2 * np.pi * (time - 0.2))) * (time > 0.2)
    inputs = np.column_stack([np.zeros(2000), volts])
    outputs = measure(machine, machine.simulate(time, inputs).outputs)
    assert faults(check_recordings([Recording("single", time, inputs, outputs)], hframe)) == []


@pytest.mark.parametrize("lasers_in_one_row", [True, False])
def test_lasers_that_measure_less_often_than_the_log_has_rows(
    lasers_in_one_row: bool, runs: list[Recording], hframe: Machine
) -> None:
    """A 200 Hz laser in a 1 kHz log: four of five cells stay empty; mistakes in it are still found."""

    def thin(y: np.ndarray, first: int) -> np.ndarray:
        return np.where(np.arange(len(y)) % 5 == first, y, np.nan)

    sparse = with_column(runs, X, lambda y: thin(y, 2))
    sparse = with_column(sparse, Y, lambda y: thin(y, 2 if lasers_in_one_row else 4))
    assert all(np.isfinite(r.outputs[:, X]).sum() == len(r.time_s) // 5 for r in sparse)
    findings = check_recordings(sparse, hframe)
    assert faults(findings) == []
    assert any(f.channel == "x_m" and "80 % of its rows are empty" in f.message for f in findings)
    negated = faults(check_recordings(with_column(sparse, X, lambda y: -y), hframe))
    assert len(negated) == 1
    assert "x_m has the wrong sign" in negated[0]
    stuck = with_column(
        sparse[1:2], X, lambda y: np.where(np.isfinite(y) & (np.arange(len(y)) > 900), y[902], y)
    )
    assert any("stuck" in line for line in faults(check_before_fit([*stuck, *sparse[2:]], hframe)))


def test_outliers_are_reported_by_run_and_channel_and_are_no_fault(
    runs: list[Recording], hframe: Machine
) -> None:
    def jump(y: np.ndarray) -> np.ndarray:
        y[[700, 1500]] += 0.05
        return y

    jumped = [*with_column(runs[:1], X, jump), *runs[1:]]
    findings = check_before_fit(jumped, hframe)
    assert faults(findings) == []
    [line] = [f for f in findings if "outlier" in f.message]
    assert (line.severity, line.run, line.channel) == ("advice", "run_01", "x_m")
    assert line.message.startswith("2 outliers, the first in row 701")


def test_a_sensor_that_is_slower_than_the_log_is_named_once(runs: list[Recording], hframe: Machine) -> None:
    slow = with_column(runs, X, lambda x: x[np.arange(len(x)) // 4 * 4])
    findings = check_before_fit(slow, hframe)
    [line] = [f for f in findings if "repeated between" in f.message]
    assert (line.severity, line.run, line.channel) == ("advice", "", "x_m")
    assert line.message.startswith(f"is measured every 4 rows and repeated between them ({len(runs)} runs)")
    assert faults(findings) == []


def test_an_angle_that_wraps_is_unwrapped_and_named(runs: list[Recording], hframe: Machine) -> None:
    """An absolute encoder of one turn behind a motor that makes several."""
    wrapped = with_column(runs, PHI1, lambda y: y % (2 * np.pi))
    findings = check_before_fit(wrapped, hframe)
    lines = [f for f in findings if "wraps" in f.message]
    assert {(f.severity, f.channel) for f in lines} == {("advice", "phi1_rad")}
    assert all("at one turn (6.28319 rad) and is unwrapped" in f.message for f in lines)
    assert [f for f in findings if f not in lines] == []


@pytest.mark.parametrize(
    ("dropped", "message"), [([500, 900, 901], "2 gaps (3 ms in total"), ([500], "1 gap (1 ms in total")]
)
def test_dropped_samples_are_reported(
    runs: list[Recording], hframe: Machine, dropped: list[int], message: str
) -> None:
    run = runs[0]
    keep = np.ones(len(run.time_s), bool)
    keep[dropped] = False
    [warning] = check_before_fit(
        [Recording("r", run.time_s[keep], run.inputs[keep], run.outputs[keep])], hframe
    )
    assert warning.channel == "time_s"
    assert message in warning.message


def test_jitter_of_a_few_percent_is_a_note_and_more_is_advice(runs: list[Recording], hframe: Machine) -> None:
    run = runs[0]
    jitter = np.random.default_rng(0).uniform(-1e-4, 1e-4, len(run.time_s))

    def sampled_at(times: np.ndarray) -> Recording:
        outputs = np.column_stack([np.interp(times, run.time_s, values) for values in run.outputs.T])
        return dataclasses.replace(run, time_s=times, outputs=outputs)

    jittered = [sampled_at(run.time_s + factor * jitter) for factor in (0.5, 1.0, 3.0)]
    found = [[f for f in check_recordings([r], hframe) if "irregular" in f.message] for r in jittered]
    assert [f[0].severity for f in found] == ["note", "note", "advice"]
    assert found[1][0].message == "sampling is irregular, 0.9964 ms with a jitter of 0.085 ms"
    assert check_before_fit(jittered[:1], hframe) == []


def test_the_jitter_of_the_clock_is_stated(runs: list[Recording], hframe: Machine) -> None:
    assert not any("the clock jitters" in f.message for f in check_recordings(runs, hframe))
    rng = np.random.default_rng(0)
    jittered = []
    for run in runs:
        taken = run.time_s + rng.uniform(-3e-4, 3e-4, len(run.time_s))
        outputs = np.column_stack([np.interp(taken, run.time_s, values) for values in run.outputs.T])
        jittered.append(dataclasses.replace(run, outputs=outputs))
    [line] = [f for f in check_recordings(jittered, hframe) if "the clock jitters" in f.message]
    assert (line.severity, line.channel) == ("note", "time_s")
    assert float(line.message.split("by ")[1].split(" ms")[0]) == pytest.approx(0.6 / np.sqrt(12), rel=0.2)


def test_an_output_that_was_not_measured_is_advice_and_no_fault(
    runs: list[Recording], hframe: Machine
) -> None:
    findings = check_recordings(with_column(runs, Y, lambda y: np.full_like(y, np.nan)), hframe)
    assert faults(findings) == []
    assert sum(f.channel == "y_m" and "was not measured" in f.message for f in findings) == len(runs)


def test_a_run_in_which_nothing_moves_is_advice(runs: list[Recording], hframe: Machine) -> None:
    resting = dataclasses.replace(
        runs[0], name="still", inputs=0 * runs[0].inputs, outputs=0 * runs[0].outputs
    )
    [line] = [f for f in check_recordings([*runs, resting], hframe) if "nothing moves" in f.message]
    assert line.run == "still"
    assert "determines the noise" in line.message
    driven = dataclasses.replace(resting, inputs=runs[0].inputs)
    [line] = [f for f in check_recordings([*runs, driven], hframe) if "nothing moves" in f.message]
    assert f"although {runs[0].name} starts to move with no more" in line.message


def test_the_quantum_of_an_encoder_is_not_lost_among_resting_runs(
    runs: list[Recording], hframe: Machine
) -> None:
    quantum = 2e-3  # rad, four times the declared one
    coarse = with_column(runs[:2], PHI1, lambda y: np.rint(y / quantum) * quantum)
    still = dataclasses.replace(runs[0], inputs=0 * runs[0].inputs, outputs=0 * runs[0].outputs)
    resting = [dataclasses.replace(still, name=f"still_{i}") for i in range(3)]
    findings = check_recordings([*coarse, *resting], hframe)
    [line] = [f.message for f in findings if f.channel == "phi1_rad" and f.message.startswith("noise")]
    assert "steps of 0.002 rad (declared" in line


def test_a_run_that_does_not_begin_at_rest_is_advice(hframe: Machine) -> None:
    time = np.arange(1000) * 1e-3
    inputs = np.full((1000, 2), -3.0)
    outputs = hframe.simulate(time, inputs).outputs
    moving = Recording("push", time[:800], inputs[200:], outputs[200:])
    assert "push: begins in motion, so the initial velocity is estimated" in " ".join(
        str(f) for f in check_recordings([moving], hframe)
    )
    inputs[:20] = 0.0
    findings = check_recordings(
        [Recording("push", time, inputs, hframe.simulate(time, inputs).outputs)], hframe
    )
    assert any(f.run == "push" and f.message.startswith("21 rows (20 ms) at rest before") for f in findings)


def test_a_run_that_begins_with_an_input_but_without_motion_is_no_finding(
    runs: list[Recording], hframe: Machine
) -> None:
    """A controller is active from the first row on; its user cannot do anything about that."""
    closed_loop = [dataclasses.replace(run, inputs=run.inputs + 1e-3) for run in runs]
    advice = [f.message for f in check_recordings(closed_loop, hframe) if f.severity == "advice"]
    assert not [message for message in advice if "at rest" in message or "begins" in message]


@pytest.mark.parametrize("dead", [1, 3])
def test_motion_without_any_voltage_is_a_fault(dead: int, runs: list[Recording], hframe: Machine) -> None:
    """The voltage column of some or of all runs is dead."""
    without = [dataclasses.replace(run, inputs=0.0 * run.inputs) for run in runs[:dead]] + runs[dead:]
    for findings in (check_recordings(without, hframe), check_before_fit(without, hframe)):
        lines = faults(findings)
        assert all(
            "move while v1_V and v2_V are 0 throughout: the voltage was not logged" in line for line in lines
        )
        assert len(lines) == dead
        assert all("x_m" in line for line in lines)


def test_motion_before_the_first_input_is_advice(runs: list[Recording], hframe: Machine) -> None:
    late = 30  # rows of 1 ms
    shifted = [
        dataclasses.replace(run, inputs=np.vstack([np.zeros((late, 2)), run.inputs[:-late]])) for run in runs
    ]
    findings = check_recordings(shifted, hframe)
    assert faults(findings) == []
    lines = [
        f.message for f in findings if "before the first input: is v1_V and v2_V logged late" in f.message
    ]
    assert len(lines) >= 2
    assert any(
        f.channel == "x_m" and f.severity == "note" and f.message.startswith("noise") for f in findings
    )


def test_a_machine_that_still_swings_when_a_run_begins_is_advice(
    runs: list[Recording], hframe: Machine
) -> None:
    rows = np.arange(len(runs[0].time_s))[:, None]
    swing = 2e-3 * np.cos(2 * np.pi * rows / 40) * np.exp(-rows / 10) * hframe.sensor_matrix[:, :1].T
    swinging = [dataclasses.replace(run, outputs=run.outputs + swing) for run in runs]
    findings = check_recordings(swinging, hframe)
    assert [f.run for f in findings if "still moves when the run begins" in f.message] == [
        run.name for run in runs
    ]
    [line] = [f.message for f in findings if f.channel == "x_m" and f.message.startswith("noise")]
    assert float(line.split()[1]) < 30e-6


def test_runs_whose_clock_restarts_are_noted(runs: list[Recording], hframe: Machine) -> None:
    restarted = [dataclasses.replace(run, time_s=run.time_s - run.time_s[0]) for run in runs]
    assert any("the clock restarts" in f.message for f in check_recordings(restarted, hframe))


def test_times_in_milliseconds_are_a_fault(runs: list[Recording], hframe: Machine) -> None:
    wrong = dataclasses.replace(runs[0], time_s=1000 * runs[0].time_s)
    for findings in (check_recordings([wrong], hframe), check_before_fit([wrong], hframe)):
        [line] = faults(findings)
        assert (
            "time_s: samples are 1 s apart, is it in milliseconds? Convert it: hframe import FILE --unit"
            in line
        )


def test_a_run_that_is_too_short_is_left_out_and_no_fault(runs: list[Recording], hframe: Machine) -> None:
    """Five rows a second apart, which a logger with gaps left of a part of its log, show no wrong clock."""
    rows = slice(0, 1000, 200)
    few = Recording("few", runs[0].time_s[rows] * 5, runs[0].inputs[rows], runs[0].outputs[rows])
    for check in (check_recordings, check_before_fit):
        findings = check([*runs, few], hframe)
        assert not faults(findings)
        assert [str(f) for f in findings if f.run == "few"] == [
            "advice: few, time_s: has 5 rows, identification needs at least 20: it is not used"
        ]


def test_a_run_of_many_rows_is_checked_and_should_be_cut(runs: list[Recording], hframe: Machine) -> None:
    repeats = 70
    period = 1e-3
    rows = repeats * len(runs[0].time_s)
    inputs, outputs = (np.tile(values, (repeats, 1)) for values in (runs[0].inputs, runs[0].outputs))
    long = Recording("long", period * np.arange(rows), inputs, outputs)
    findings = check_recordings([long], hframe)
    assert any(
        "s long, which makes a fit slow: cut it by hframe import --split-at-rests" in str(f) for f in findings
    )
    assert any(f.channel == "x.mass" and "standard error" in f.message for f in findings)


def test_late_time_stamps_are_not_lost_rows(runs: list[Recording]) -> None:
    """A logger that samples at a fixed rate stamps some rows late; it loses no row."""
    run = runs[0]
    late = np.where(np.random.default_rng(6).random(len(run.time_s)) < 0.05, 0.7e-3, 0.0)
    [finding] = check_sampling(dataclasses.replace(run, time_s=run.time_s + late))
    assert "no row is missing" in finding.message
    assert "--map time_s=1000Hz" in finding.message


def test_stamps_in_whole_milliseconds_are_neither_gaps_nor_irregular(
    runs: list[Recording], hframe: Machine
) -> None:
    """The motion shows a period of 1.2 ms; steps of 2 ms between the stamps are no missing rows."""
    run = runs[0]
    times = 1.2e-3 * np.arange(len(run.time_s))
    stamped = dataclasses.replace(run, time_s=1e-3 * np.floor(1e3 * times + 1e-6))
    messages = [f.message for f in check_recordings([stamped], hframe) if f.channel == "time_s"]
    [replaced] = [message for message in messages if "stamps" in message]
    assert "equal steps of 1.2 ms" in replaced
    assert not any("dropped" in message or "irregular" in message for message in messages)


@pytest.mark.parametrize("every", [4, 5, 10])
def test_rows_that_are_lost_regularly_are_no_late_stamps(runs: list[Recording], every: int) -> None:
    run = runs[0]
    kept = np.arange(len(run.time_s)) % every > 0
    lossy = dataclasses.replace(
        run, time_s=run.time_s[kept], inputs=run.inputs[kept], outputs=run.outputs[kept]
    )
    assert any("samples were dropped or taken late" in finding.message for finding in check_sampling(lossy))


def test_late_stamps_do_not_hide_that_a_run_is_long() -> None:
    time_s = np.arange(200_000) * 1e-3
    time_s[::20] += 0.7e-3
    long = Recording("long", time_s, np.zeros((200_000, 1)), np.zeros((200_000, 1)))
    messages = [finding.message for finding in check_sampling(long)]
    assert any("no row is missing" in message for message in messages)
    assert any("which makes a fit slow" in message for message in messages)
