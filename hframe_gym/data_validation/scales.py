"""Find wrong scales: units and gear ratios of the outputs, and the unit of time.

A factor between measured and simulated motion may come from the column (turns instead of radians) or from the machine
file (another gain). It is a fault only if another sensor decides between them, or if the factor is that of a unit and,
with it, inertia and friction agree with the machine file as well. Otherwise it is advice.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..dynamics import resolved_step, rollout
from ..identification import Dataset, PreparedRecording
from ..machine import Machine, Sensor, commanded_state
from ..preparation.force_balance import EXPLAINED, Balance
from ..recordings import bridge_blanks, comparison_window
from .findings import Finding, channel_unit
from .wiring import declared_balance, rigid_prediction

_WINDOW = 0.02  # s, least time over which motion is compared; long enough to average out noise
_MAX_ROWS = 20_000  # rows of a run that are simulated; enough to determine a factor
_STEP = 1e-3  # s, longest integration step; the comparison needs no accuracy
_RATIO_TOLERANCE = 0.02  # relative error of a pulley radius or gear ratio that is not reported
_MAX_RATIO_ERROR = 0.5  # a larger relative error is no inaccurate radius or scale but a mistake
_RATIO_CORRELATION = 0.9  # minimum correlation at which a ratio is reported
_MIN_ROWS = 10  # rows that a correlation or slope needs
_SPEED_FACTOR = 8.0  # factor between measured and simulated speed beyond which a unit is always suspected
# A smaller factor is suspected if it is that of a unit in every run, and if inertia and friction need the same factor,
# since a spring slows a motion, too. It may be off by 1.5: motors are specified within some 20 %, and friction slows
# small motions.
_NEAR_UNIT = 1.5
# Factor between the motion of a channel and what the others predict for it, beyond which they contradict it.
_CONTRADICTION = 4.0
# Factor between measured and expected, beyond that of a unit, that a machine file may cause.
_UNIT_TOLERANCE = 2.0
_CAUSE = "is its unit or gain wrong, or are the file's masses and motor constants guesses?"
_LESS_VOLTAGE = "is it blocked, or does less than the recorded voltage act (amplifier limit, emergency stop)?"
# Suspected unit by the unit of the channel: value per m or rad, and its name.
_SUSPECTS = {
    "m": ((1000.0, "millimeters"), (100.0, "centimeters"), (1000.0 / 25.4, "inches"), (0.001, "kilometers")),
    "rad": ((180 / math.pi, "degrees"), (0.5 / math.pi, "turns")),
}
_FEWEST_COUNTS = 800  # per turn, of encoders in use; fewer cannot be told from degrees
_SPEED_CORRELATION = 0.9  # of a column that is a speed with the simulated speed
_POSITION_CORRELATION = 0.5  # largest correlation of its changes with the simulated speed
# Factors of a time in another unit: milliseconds, hundredths, minutes, or a wrong rate.
_CLOCK_FACTORS = (10.0, 60.0, 100.0, 1000.0, 0.1, 0.01, 0.001)
# True unit of the times by factor; other factors are wrong rates.
_CLOCK_UNITS = {1000.0: "ms", 60.0: "s", 0.001: "s"}
# Factor between the fitted viscous friction and the clock's; twice as wide for the inertia.
_CLOCK_TOLERANCE = 1.6


def check_scales(data: Dataset, machine: Machine) -> list[Finding]:
    """Check for channels with a wrong unit or gear ratio, and for times in a wrong unit.

    For units, measured speeds are compared with those of a simulation with the recorded voltages; for gear ratios,
    encoders with other sensors; for times, fitted inertia and friction with the declared ones.
    """
    balance = declared_balance(data, machine)
    clock = _clock(data, balance)
    if clock:
        return clock  # a wrong clock makes all speeds wrong
    motion = _span_motion(data, machine)
    units = _units(motion, data, machine, balance)
    # A wrong unit of one channel makes the ratios of others wrong as well.
    ratios = [] if any(finding.severity == "fault" for finding in units) else _ratios(motion, data, machine)
    contradicted = {ratio.channel for ratio in ratios if ratio.severity == "fault"}
    named = {unit.channel for unit in units}
    return [unit for unit in units if unit.channel not in contradicted] + [
        ratio for ratio in ratios if ratio.severity == "fault" or ratio.channel not in named
    ]


def _clock(data: Dataset, balance: Balance | None) -> list[Finding]:
    """Report times in a wrong unit.

    With times too large by f, the motion requires f^2 times the inertia and f times the viscous friction. A wrong unit
    of a position or a wrong gain changes both by the same factor.
    """
    if balance is None or balance.unexplained > EXPLAINED:
        return []
    if not np.isfinite([balance.inertia, balance.viscous]).all():
        return []
    for factor in _CLOCK_FACTORS:
        friction = np.abs(np.log(np.maximum(balance.viscous, 1e-12) / factor))
        inertia = np.abs(np.log(np.maximum(balance.inertia, 1e-12) / factor**2))
        if (friction < math.log(_CLOCK_TOLERANCE)).all() and (inertia < 2 * math.log(_CLOCK_TOLERANCE)).all():
            direction = f"{factor:g} times too long" if factor > 1 else f"{1 / factor:g} times too short"
            period = float(np.median(np.concatenate([np.diff(run.time_s) for run in data.runs])))
            unit = _CLOCK_UNITS.get(factor)
            option = f"--unit time_s={unit}" if unit else f"--map time_s={factor / period:.4g}Hz"
            message = (
                f"the times may be {direction}: as logged, the motion requires "
                f"{float(np.median(balance.inertia)):.2g} times the declared inertia and "
                f"{float(np.median(balance.viscous)):.2g} times the viscous friction. If these were not guessed, state "
                f"the unit or the rate of the times: hframe import FILE {option}"
            )
            return [Finding("advice", "", "time_s", message)]
    return []


@dataclasses.dataclass(frozen=True)
class _SpanMotion:
    """Measured and simulated motion over short spans of time of one length, of all runs together.

    A change over a span is the mean speed times the length of the span, so that ratios of changes are those of speeds.

    Attributes:
        measured: Changes of the measurements over each span, in the sensors' units, shape (rows, sensors).
        simulated: Changes of the simulated measurements, in the sensors' units, shape (rows, sensors).
        values: Measurements at the middle of each span, in the sensors' units, shape (rows, sensors).
        run: Index of the run of each row, shape (rows,).
    """

    measured: Array
    simulated: Array
    values: Array
    run: NDArray[np.int_]

    def speed_ratio(self, sensor: int) -> float:
        """Return the ratio of measured to simulated speed of a sensor, root mean square; 0 if nothing moves."""
        return self._ratio(np.isfinite(self.measured[:, sensor]), sensor)

    def speed_ratios_by_run(self, sensor: int) -> list[float]:
        """Return the same ratio for each run in which the simulated machine moves."""
        finite = np.isfinite(self.measured[:, sensor])
        ratios = (self._ratio(finite & (self.run == run), sensor) for run in np.unique(self.run))
        return [ratio for ratio in ratios if ratio]

    def _ratio(self, rows: NDArray[np.bool_], sensor: int) -> float:
        if np.count_nonzero(rows) < _MIN_ROWS:
            return 0.0
        size = float(np.std(self.simulated[rows, sensor]))
        return float(np.std(self.measured[rows, sensor])) / size if size else 0.0


def _span_motion(data: Dataset, machine: Machine) -> _SpanMotion:
    """Return measured and simulated motion over short spans."""
    parts = []
    for i, run in enumerate(map(_first_rows, data.runs)):
        span = comparison_window(run.outputs, run.time_s, _WINDOW)
        bridged = bridge_blanks(run.outputs, run.time_s, span)
        measured = _changes(bridged, run.time_s, span)
        simulated = _changes(_simulate_outputs(machine, run), run.time_s, span)
        values = _middles(bridged, run.time_s, span)
        parts.append((measured, simulated, values, np.full(len(measured), i)))
    return _SpanMotion(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def _window_rows(time_s: Array, span: float) -> int:
    """Return the number of rows of a span in s."""
    return max(1, min(len(time_s) - 1, round(span / float(np.median(np.diff(time_s))))))


def _changes(outputs: Array, time_s: Array, span: float) -> Array:
    """Return the change of each channel over each span (in s), in its unit, shape (rows, channels)."""
    window = _window_rows(time_s, span)
    return (outputs[window:] - outputs[:-window])[:: max(1, window // 4)]


def _middles(outputs: Array, time_s: Array, span: float) -> Array:
    """Return the measurements at the middle of each span of `_changes`, shape (rows, channels)."""
    window = _window_rows(time_s, span)
    return outputs[window // 2 : len(outputs) - window + window // 2][:: max(1, window // 4)]


def _first_rows(run: PreparedRecording) -> PreparedRecording:
    """Return a run with at most `_MAX_ROWS` rows, which begin where the first input changes."""
    if len(run.time_s) <= _MAX_ROWS:
        return run
    changed = np.any(run.inputs != run.inputs[0], axis=1)
    first = min(int(np.argmax(changed)), len(run.time_s) - _MAX_ROWS)
    rows = slice(first, first + _MAX_ROWS)
    return dataclasses.replace(
        run, time_s=run.time_s[rows], inputs=run.inputs[rows], outputs=run.outputs[rows]
    )


def _simulate_outputs(machine: Machine, run: PreparedRecording) -> Array:
    """Simulate outputs, shape (n, sensors), from the center of the workspace or, if it is commanded, that position.

    A measured position in a wrong unit would be far outside.
    """
    step, start = resolved_step(machine, _STEP), commanded_state(machine, run.inputs[0])
    positions = rollout(machine, run.time_s, run.inputs, start=start, longest_step=step)[0]
    return np.asarray(positions @ machine.sensor_matrix.T)


def _units(motion: _SpanMotion, data: Dataset, machine: Machine, balance: Balance | None) -> list[Finding]:
    """Report channels whose measured speed is a multiple or a fraction of the simulated one, and speeds as positions.

    This is a fault if the other channels contradict the channel too, or if no other channel measures the motion and
    everything agrees with the factor of a unit. Otherwise the machine file may be wrong, and the finding is advice.
    """
    findings = []
    for j, sensor in enumerate(machine.sensors):
        factor = motion.speed_ratio(j)
        unit = channel_unit(sensor.channel, machine)
        if _is_speed(motion, j):
            speed_unit = "rpm" if unit == "rad" else "mm/s"
            message = (
                "looks like a speed, not like a position: it follows the simulated speed. Convert it, for example by "
                f"hframe import FILE --unit {sensor.channel}={speed_unit}; a spring or a weight that the machine file "
                "lacks looks alike in slow motion"
            )
            findings.append(Finding("advice", "", sensor.channel, message))
            continue
        resting = factor < 1 and _is_resting(motion.measured[:, j], data, j)
        suspect = _suspect(factor, unit)
        if not factor or resting:
            continue
        if not _is_extreme(factor) and not (
            suspect and _in_every_run(motion, j, suspect[0]) and _agrees(balance, suspect[0])
        ):
            continue
        prediction = rigid_prediction(motion.measured, j, machine)
        if prediction is None:
            certain = suspect is not None and _is_extreme(factor) and _agrees(balance, suspect[0])
        else:
            both = np.isfinite(motion.measured[:, j]) & np.isfinite(prediction[0])
            expected = float(np.std(prediction[0][both])) if both.any() else 0.0
            ratio = float(np.std(motion.measured[both, j])) / expected if expected else 1.0
            certain = not 1 / _CONTRADICTION < ratio < _CONTRADICTION
            if not certain and not _is_extreme(factor):
                continue  # other sensors agree with it
        message = _describe_factor(factor, suspect, unit, data)
        findings.append(Finding("fault" if certain else "advice", "", sensor.channel, message))
    return findings


def _describe_factor(factor: float, suspect: tuple[float, str] | None, unit: str, data: Dataset) -> str:
    """Return a sentence about a channel that moves faster or slower than simulated."""
    if not suspect:
        if factor < 1:
            slower = f"{float(f'{1 / factor:.2g}'):,.{0 if factor < 0.1 else 1}f}"
            cause = f"{_CAUSE[:-1]}, {_LESS_VOLTAGE}"
            return f"moves {slower} times slower than a simulation with the machine file: {cause}"
        return f"moves {factor:.3g} times as fast as a simulation with the machine file: {_CAUSE}"
    value, name = suspect
    speed = f"{factor:.3g} times as fast as" if factor > 1 else f"{1 / factor:.3g} times slower than"
    where = f" in all {len(data.runs)} runs" if len(data.runs) > 1 else ""
    return (
        f"moves {speed} the machine simulates{where}: is the column in {name}, not in {unit}? Then multiply it by "
        f"{1 / value:.4g}; otherwise a gain, a mass or a gear ratio of the machine file is wrong"
    )


def _is_extreme(factor: float) -> bool:
    """Return whether a factor between measured and simulated speed is beyond what a machine file explains."""
    return not 1 / _SPEED_FACTOR < factor < _SPEED_FACTOR


def _suspect(factor: float, unit: str) -> tuple[float, str] | None:
    """Return value per SI unit and name of the unit that explains a factor between measured and simulated speed."""
    candidates = list(_SUSPECTS[unit])
    counts = 2 * math.pi * factor  # per turn
    if unit == "rad" and counts > _FEWEST_COUNTS:
        candidates.append((factor, f"counts of an encoder (about {counts:.2g} per turn)"))
    tolerance = _UNIT_TOLERANCE if _is_extreme(factor) else _NEAR_UNIT
    if factor <= 0.0:
        return None
    value, name = min(candidates, key=lambda candidate: abs(math.log(factor / candidate[0])))
    return (value, name) if abs(math.log(factor / value)) < math.log(tolerance) else None


def _in_every_run(motion: _SpanMotion, sensor: int, value: float) -> bool:
    """Return whether the speed of a sensor differs from the simulated one by the factor of a unit in every run."""
    return all(
        abs(math.log(ratio / value)) < math.log(_UNIT_TOLERANCE)
        for ratio in motion.speed_ratios_by_run(sensor)
    )


def _agrees(balance: Balance | None, value: float) -> bool:
    """Return whether inertia and friction agree with the machine file once the measurements are divided by a value."""
    if balance is None or balance.unexplained > EXPLAINED:
        return False
    ratios = value * np.concatenate([balance.inertia, balance.viscous])
    ratios = ratios[np.isfinite(ratios)]
    return bool(len(ratios)) and bool(np.all((ratios > 1 / _UNIT_TOLERANCE) & (ratios < _UNIT_TOLERANCE)))


def _is_speed(motion: _SpanMotion, sensor: int) -> bool:
    """Return whether a column follows the simulated speed of its sensor, and its changes do not."""
    rows = np.isfinite(motion.measured[:, sensor]) & np.isfinite(motion.values[:, sensor])
    columns = (motion.values[rows, sensor], motion.measured[rows, sensor], motion.simulated[rows, sensor])
    if np.count_nonzero(rows) < _MIN_ROWS or not all(column.any() for column in columns):
        return False
    value, change, speed = columns
    return (
        _correlation(value, speed) > _SPEED_CORRELATION
        and _correlation(change, speed) < _POSITION_CORRELATION
    )


def _ratios(motion: _SpanMotion, data: Dataset, machine: Machine) -> list[Finding]:
    """Report encoders that move too far or too little for the travel that other sensors measure.

    The reference are sensors with a fixed zero, elsewhere encoders compared with each other. Complete runs are
    compared, because fast motion also stretches the belts. A small deviation is advice: a scale error of the other
    sensors, which identification can find, has the same appearance.
    """
    kinds = [machine.coordinate(s.coordinate).kind for s in machine.sensors]
    compared = [j for j, s in enumerate(machine.sensors) if s.incremental or kinds[j] == "rotary"]
    findings, undetermined = [], []
    for column in compared:
        ratio = _travel_ratio(data, machine, column, [j for j in compared if j != column])
        if ratio is None:
            undetermined.append(column)
        elif abs(ratio - 1) > _RATIO_TOLERANCE:
            findings.append(
                _ratio_finding(
                    machine, machine.sensors[column], ratio, "the sensors with a fixed zero measure"
                )
            )
    among = {column: _travel_ratio(data, machine, column, []) for column in undetermined}
    wrong = {column: r for column, r in among.items() if r is not None and abs(r - 1) > _RATIO_TOLERANCE}
    if wrong:

        def suspicion(column: int) -> float:
            factor = motion.speed_ratio(column)
            return abs(math.log(factor)) if factor else 0.0

        column = max(wrong, key=suspicion)
        others = ", ".join(machine.sensors[j].channel for j in compared if j != column)
        verb = "measure" if "," in others else "measures"
        findings.append(_ratio_finding(machine, machine.sensors[column], wrong[column], f"{others} {verb}"))
    return findings


def _travel_ratio(data: Dataset, machine: Machine, column: int, ignored: list[int]) -> float | None:
    """Return measured travel / travel that the other sensors predict; None if they do not, or do not correlate."""
    parts = []
    for run in data.runs:
        others = run.outputs.copy()
        others[:, ignored] = np.nan  # they may have the same mistake
        prediction = rigid_prediction(others, column, machine)
        both = np.column_stack([run.outputs[:, column], prediction[0]]) if prediction else np.zeros((0, 2))
        both = both[np.isfinite(both).all(axis=1)]
        parts.append(both - both.mean(axis=0) if len(both) else both)
    measured, predicted = np.concatenate(parts).T
    if len(measured) < _MIN_ROWS or not predicted.any() or not measured.any():
        return None
    if _correlation(measured, predicted) <= _RATIO_CORRELATION:
        return None
    return float(measured @ predicted / (predicted @ predicted))


def _ratio_finding(machine: Machine, sensor: Sensor, ratio: float, others: str) -> Finding:
    """Return the finding about an encoder that moves a multiple of the travel that other sensors measure."""
    if abs(ratio - 1) > _MAX_RATIO_ERROR:
        cause = "a unit, scale factor or gear ratio is wrong"
        message = f"moves {ratio:.3g} times as far as {others}: {cause}"
        return Finding("fault", "", sensor.channel, message)
    coordinate, direction = machine.coordinate(sensor.coordinate), "far" if ratio > 1 else "little"
    too_far = f"{100 * abs(ratio - 1):.1f} % too {direction}"
    message = f"moves {too_far} for what other sensors measure: its scale factor or a gear ratio is wrong"
    if coordinate.kind == "rotary":
        radii = f"{coordinate.radius / ratio:.4g} m instead of {coordinate.radius:.4g} m"
        cause = f"the pulley has a radius of {radii}, or a gear ratio is wrong by that factor"
        message = f"turns {too_far} for the carriage's travel: {cause}"
    return Finding("advice", "", sensor.channel, message)


def _correlation(a: Array, b: Array) -> float:
    """Return the correlation about zero, not about the means: a constant speed has a sign too."""
    return float(a @ b / np.sqrt((a @ a) * (b @ b)))


def _is_resting(changes: Array, data: Dataset, channel: int) -> bool:
    """Return whether changes of a channel are within its noise and quantum."""
    return bool(np.ptp(changes) < max(10 * data.noise[channel], 3 * data.quantum[channel]))
