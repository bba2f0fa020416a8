"""Find mistakes in the wiring that contradict the machine model: signs, swapped channels, units and ratios.

Rigid kinematics (belts that do not stretch) alone cannot distinguish swapped encoders from a laser that counts
backwards; the motion that the machine simulates under the recorded voltages can. Therefore each single mistake (one
channel negated, two channels swapped) is corrected in turn, and the correction that fits the data best is reported.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ..dynamics import resolved_step, rollout
from ..identification import Dataset, PreparedRecording
from ..machine import Machine, Sensor, rigid_motions
from ..recordings import bridge_blanks, comparison_window
from .findings import Finding, channel_unit

Array = NDArray[np.float64]

_WINDOW = 0.02  # s, least time over which motion is compared; long enough to average out noise
_MAX_ROWS = 20_000  # rows of a run that are simulated; enough to determine a sign
_STEP = 1e-3  # s, longest integration step; the comparison needs no accuracy
_GOOD_AGREEMENT = 0.7  # correlation of measured and simulated speed above which no mistake is suspected
_POOR_AGREEMENT = 0.35  # correlation below which the machine itself is doubted
_GOOD_MISFIT = 0.2  # relative misfit of the rigid kinematics below which no mistake is suspected
_IMPROVEMENT = 0.2  # minimum improvement of the score that makes a correction credible
_CERTAIN_SCORE = 0.5  # score after a correction above which the mistake is certain, not only likely
_TIE = 0.05  # corrections whose scores differ by less are equally likely
_RATIO_TOLERANCE = 0.02  # relative error of a pulley radius or gear ratio that is not reported
_MAX_RATIO_ERROR = 0.5  # a larger relative error is no inaccurate radius or scale but a mistake
_RATIO_CORRELATION = 0.9  # minimum correlation at which a ratio is reported
_MIN_ROWS = 10  # rows that a correlation or slope needs
_SPEED_FACTOR = 8.0  # factor between measured and simulated speed beyond which a unit is suspected
_CONTRADICTION = 4.0  # factor between measured motion and prediction by other channels that proves a contradiction
_UNIT_TOLERANCE = 2.0  # factor between measured and simulated speed, beyond that of a unit, that a model may cause
_CAUSE = "is its unit or gain wrong?"
_LESS_VOLTAGE = "is it blocked, or does less than the recorded voltage act (amplifier limit, emergency stop)?"
# Suspected unit by the unit of the channel: value per m or rad, and its name.
_SUSPECTS = {"m": ((1000.0, "millimeters"), (0.001, "kilometers")), "rad": ((180 / np.pi, "degrees"),)}


def sensor_motions(machine: Machine) -> Array:
    """Return how much each sensor's measurement changes per unit of each rigid motion.

    A rigid motion stretches no belt: a carriage moves, and the pulleys follow. Without belts, one coordinate moves.

    Args:
        machine: Machine with sensors.

    Returns:
        Change of each measurement, m or rad, per m or rad of the coordinate that leads the motion (for example x or y),
        shape (sensors, motions), with columns in the order of `rigid_motions(machine)`.
    """
    motions = np.array(list(rigid_motions(machine).values())).reshape(-1, len(machine.coordinates))
    return machine.sensor_matrix @ motions.T


def rigid_prediction(outputs: Array, channel: int, machine: Machine) -> tuple[Array, Array] | None:
    """Predict one sensor's measurements from the other sensors by rigid kinematics (belts that do not stretch).

    Args:
        outputs: Measurements, m or rad, shape (n, sensors), NaN where not measured. A column without any measurement is
            not used.
        channel: Index of the sensor to predict.
        machine: Machine with these sensors.

    Returns:
        prediction: Predicted measurements, m or rad, shape (n,), correct except for an unknown constant; NaN where a
            sensor that is used has no measurement.
        weights: Weight of each sensor in the prediction, in the unit of the predicted sensor per unit of the weighted
            one, shape (sensors,); 0 for sensors that are not used.

        None instead of both if the other sensors do not determine this one.
    """
    M = sensor_motions(machine)  # (sensors, rigid motions)
    others = [k for k in range(len(M)) if k != channel and np.isfinite(outputs[:, k]).any()]
    if not others or M.shape[1] == 0:
        return None
    size = np.linalg.norm(M[others], axis=1)  # makes measurements in m and in rad comparable
    scaled = M[others] / size[:, None]
    # This sensor's row of M as a combination of the others' rows; without one, they do not determine it.
    other_weights = M[channel] @ np.linalg.pinv(scaled)
    if not np.allclose(other_weights @ scaled, M[channel], atol=1e-9 * max(1.0, float(np.abs(M[channel]).max()))):
        return None
    weights = np.zeros(len(M))
    weights[others] = other_weights / size
    return (outputs[:, others] / size) @ other_weights, weights


def rigid_misfit(motion: Array, machine: Machine) -> float:
    """Compute which fraction of a measured motion contradicts rigid kinematics (belts that do not stretch).

    Channels are divided by their change per unit of rigid motion, so that angles and lengths are comparable. A rigid
    motion is fitted to each row by least squares; the residual contradicts rigid kinematics.

    Args:
        motion: Displacements or changes of the measurements, m or rad, shape (n, sensors), NaN where not measured. A
            column without any measurement is not used; a row that lacks another one is left out.
        machine: Machine with these sensors.

    Returns:
        sqrt(sum of squared residuals / sum of squares of the scaled channels), dimensionless, 0 to 1. It is 0 if
        nothing moves, or if the channels are not redundant and thus cannot contradict each other.
    """
    M = sensor_motions(machine)  # (sensors, rigid motions)
    used = np.isfinite(motion).any(axis=0) & (np.linalg.norm(M, axis=1) > 0)
    rows, size = motion[:, used], np.linalg.norm(M[used], axis=1)
    scaled = rows[np.isfinite(rows).all(axis=1)] / size  # (rows, used sensors)
    basis = M[used] / size[:, None]  # (used sensors, rigid motions)
    # Subtract the least-squares projection of each row on the rigid motions.
    residual = scaled - scaled @ np.linalg.pinv(basis).T @ basis.T
    total = float(np.sum(scaled**2))
    return float(np.sqrt(np.sum(residual**2) / total)) if total else 0.0


def check_wiring(data: Dataset, machine: Machine) -> list[Finding]:
    """Check for channels with a wrong sign, unit or gear ratio and for swapped channels.

    For signs, swaps and units, measured speeds are compared with those of a simulation with the recorded voltages, over
    all runs together. If this gives no fault in signs and swaps, each single run is checked for them as well. For gear
    ratios, encoders are compared with sensors that have a fixed zero.

    Args:
        data: Runs in which the machine moves (times, voltages, measurements, SI), with initial states and zeros; at
            least one.
        machine: Declared machine.

    Returns:
        Findings (severity, run, channel, message) about all runs together, and faults of single runs.
    """
    # Matrices that undo one mistake (a sign, or two swapped channels), by its description.
    output_corrections, input_corrections = _single_corrections(machine)
    transforms = np.array([np.eye(len(machine.drives)), *input_corrections.values()])  # the first: inputs as recorded
    runs = [_first_rows(run) for run in data.runs]
    measured, simulated = [], []  # arrays of shape (rows, sensors) and (transforms, rows, sensors)
    for run in runs:
        span = comparison_window(run.outputs, run.time_s, _WINDOW)
        measured.append(_speeds(bridge_blanks(run.outputs, run.time_s, span), run.time_s, span))
        simulated.append(_speeds(_simulate_outputs(machine, run, transforms), run.time_s, span))
    labels = list(input_corrections)
    all_measured, all_simulated = np.concatenate(measured), np.concatenate(simulated, axis=1)
    findings = _signs_and_swaps(all_measured, all_simulated, output_corrections, labels, machine)
    if not any(finding.severity == "fault" for finding in findings):
        for run, speeds, predictions in zip(runs, measured, simulated, strict=True):
            alone = _signs_and_swaps(speeds, predictions, output_corrections, labels, machine)
            findings += [dataclasses.replace(f, run=run.name) for f in alone if f.severity == "fault"]
    units = _units(all_measured, all_simulated[0], data, machine)
    # A wrong unit of one channel makes the ratios of others wrong as well.
    ratios = [] if any(finding.severity == "fault" for finding in units) else _ratios(data, machine)
    return findings + units + [ratio for ratio in ratios if ratio.channel not in {unit.channel for unit in units}]


def _speeds(outputs: Array, time_s: Array, span: float) -> Array:
    """Return the change of each channel over a span in s, shape (..., rows, channels): mean speed times span."""
    period = float(np.median(np.diff(time_s)))
    window = max(1, min(len(time_s) - 1, round(span / period)))
    return (outputs[..., window:, :] - outputs[..., :-window, :])[..., :: max(1, window // 4), :]


def _first_rows(run: PreparedRecording) -> PreparedRecording:
    """Return a run with at most `_MAX_ROWS` rows, which begin where the first input changes."""
    if len(run.time_s) <= _MAX_ROWS:
        return run
    changed = np.any(run.inputs != run.inputs[0], axis=1)
    first = min(int(np.argmax(changed)), len(run.time_s) - _MAX_ROWS)
    rows = slice(first, first + _MAX_ROWS)
    return dataclasses.replace(run, time_s=run.time_s[rows], inputs=run.inputs[rows], outputs=run.outputs[rows])


def _simulate_outputs(machine: Machine, run: PreparedRecording, transforms: Array) -> Array:
    """Simulate outputs, shape (transforms, n, sensors), for the inputs multiplied by each matrix.

    The simulation starts at the center of the workspace: a position in a wrong unit would be far outside.
    """
    inputs = np.einsum("vij,nj->vni", transforms, run.inputs)
    step = resolved_step(machine, _STEP)
    return rollout(machine, run.time_s, inputs, longest_step=step) @ machine.sensor_matrix.T


def _single_corrections(machine: Machine) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the corrections of all single mistakes, by description: matrices on the outputs and on the inputs."""
    groups = []
    for sensor in machine.sensors:
        # A sensor of several coordinates cannot be swapped with another one.
        groups.append(machine.coordinate(sensor.coordinate).kind if len(sensor.row) == 1 else sensor.channel)
    outputs = _corrections(machine.output_channels, groups)
    return outputs, _corrections(machine.input_channels, ["drive"] * len(machine.drives))


def _corrections(channels: Sequence[str], groups: Sequence[str]) -> dict[str, Array]:
    """Return matrices that negate one channel or swap two channels of one group, by description."""
    corrections = {}
    for j, channel in enumerate(channels):
        negation = np.eye(len(channels))
        negation[j, j] = -1.0
        corrections[f"{channel} has the wrong sign"] = negation
    for first, second in combinations(range(len(channels)), 2):
        if groups[first] == groups[second]:
            order = list(range(len(channels)))
            order[first], order[second] = second, first
            corrections[f"{channels[first]} and {channels[second]} are swapped"] = np.eye(len(channels))[order]
    return corrections


def _signs_and_swaps(
    measured: Array, simulated: Array, output_corrections: dict[str, Array], input_labels: list[str], machine: Machine
) -> list[Finding]:
    """Report the single correction that makes measured and simulated speeds agree, or that they do not agree."""
    unchanged = np.eye(len(machine.sensors))
    initial_score = _score(measured, simulated[0], unchanged, machine)
    agreement, misfit = _agreement(measured, simulated[0]), rigid_misfit(measured, machine)
    if initial_score is None or (agreement > _GOOD_AGREEMENT and misfit < _GOOD_MISFIT):
        return []
    of_outputs = {label: (simulated[0], matrix) for label, matrix in output_corrections.items()}
    of_inputs = {label: (simulated[i], unchanged) for i, label in enumerate(input_labels, start=1)}
    all_scores = {
        label: _score(measured, *correction, machine) for label, correction in (of_outputs | of_inputs).items()
    }
    scores = {label: score for label, score in all_scores.items() if score is not None}
    best = max(scores.values())
    if best > initial_score + _IMPROVEMENT:
        likely = " or ".join(label for label, score in scores.items() if score > best - _TIE)
        if best > _CERTAIN_SCORE:
            remedy = "correct the columns of the file, or the declaration in machine.json"
            return [Finding("fault", "", "", f"{likely}: {remedy}")]
        return [Finding("advice", "", "", f"{likely}? The speeds would agree better with the simulated ones")]
    if agreement < _POOR_AGREEMENT:
        message = f"measured and simulated speeds do not agree (correlation {agreement:.2f}): "
        return [Finding("advice", "", "", message + "is the machine file that of the recorded machine?")]
    return []


def _units(measured: Array, simulated: Array, data: Dataset, machine: Machine) -> list[Finding]:
    """Report channels whose measured speed is a multiple or a fraction of the simulated one.

    This is a fault if the other channels contradict the channel too, or if no other channel measures the motion and the
    factor is that of a known unit. Otherwise the machine file may be wrong, and the finding is advice.
    """
    findings = []
    for j, sensor in enumerate(machine.sensors):
        rows = np.isfinite(measured[:, j])
        size = float(np.std(simulated[rows, j])) if rows.any() else 0.0
        if size == 0.0:
            continue
        unit = channel_unit(sensor.channel, machine)
        factor = float(np.std(measured[rows, j])) / size
        if 1 / _SPEED_FACTOR < factor < _SPEED_FACTOR or (factor < 1 and _is_resting(measured[rows, j], data, j)):
            continue
        near = [s for s in _SUSPECTS[unit] if 1 / _SPEED_FACTOR < factor / s[0] < _SPEED_FACTOR]
        suspects = near if factor > 1 else []
        prediction = rigid_prediction(measured, j, machine)
        if prediction is None:
            certain = any(1 / _UNIT_TOLERANCE < factor / value < _UNIT_TOLERANCE for value, _ in suspects)
        else:
            both = rows & np.isfinite(prediction[0])
            expected = float(np.std(prediction[0][both])) if both.any() else 0.0
            ratio = float(np.std(measured[both, j])) / expected if expected else 1.0
            certain = not 1 / _CONTRADICTION < ratio < _CONTRADICTION
        cause = f"is the column in {suspects[0][1]}, not in {unit}?" if suspects else _CAUSE
        message = f"moves {factor:.3g} times as fast as the machine simulates: {cause}"
        if factor < 1:
            message = f"moves at {factor:.2g} of the simulated speed: {_CAUSE[:-1]}, {_LESS_VOLTAGE}"
        findings.append(Finding("fault" if certain else "advice", "", sensor.channel, message))
    return findings


def _ratios(data: Dataset, machine: Machine) -> list[Finding]:
    """Report encoders that move too far or too little for the travel that sensors with a fixed zero measure.

    Positions are compared over complete runs, because fast motion also stretches the belts. A small deviation is
    advice, not a fault: a scale error of the other sensors, which identification can find, has the same appearance.
    """
    findings = []
    kinds = [machine.coordinate(s.coordinate).kind for s in machine.sensors]
    compared = [j for j, s in enumerate(machine.sensors) if s.incremental or kinds[j] == "rotary"]
    for column in compared:
        parts = []
        for run in data.runs:
            fixed_only = run.outputs.copy()
            fixed_only[:, compared] = np.nan  # other encoders may have the same mistake
            prediction = rigid_prediction(fixed_only, column, machine)
            both = np.column_stack([run.outputs[:, column], prediction[0]]) if prediction else np.zeros((0, 2))
            both = both[np.isfinite(both).all(axis=1)]
            parts.append(both - both.mean(axis=0) if len(both) else both)
        rows = np.concatenate(parts) if parts else np.zeros((0, 2))
        if len(rows) < _MIN_ROWS or not np.any(rows[:, 1]):
            continue
        measured, predicted = rows.T
        slope = float(measured @ predicted / (predicted @ predicted))
        if abs(slope - 1) > _RATIO_TOLERANCE and _correlation(measured, predicted) > _RATIO_CORRELATION:
            findings.append(_ratio_finding(machine, machine.sensors[column], slope))
    return findings


def _ratio_finding(machine: Machine, sensor: Sensor, ratio: float) -> Finding:
    """Return the finding about an encoder that moves a multiple of the travel that other sensors measure."""
    if abs(ratio - 1) > _MAX_RATIO_ERROR:
        cause = "a unit, scale factor or gear ratio is wrong"
        message = f"moves {ratio:.3g} times as far as the sensors with a fixed zero measure: {cause}"
        return Finding("fault", "", sensor.channel, message)
    coordinate, direction = machine.coordinate(sensor.coordinate), "far" if ratio > 1 else "little"
    too_far = f"{100 * abs(ratio - 1):.1f} % too {direction}"
    message = f"moves {too_far} for what other sensors measure: its scale factor or a gear ratio is wrong"
    if coordinate.kind == "rotary":
        radii = f"{coordinate.radius / ratio:.4g} m instead of {coordinate.radius:.4g} m"
        cause = f"the pulley has a radius of {radii}, or a gear ratio is wrong by that factor"
        message = f"turns {too_far} for the carriage's travel: {cause}"
    return Finding("advice", "", sensor.channel, message)


def _score(measured: Array, simulated: Array, correction: Array, machine: Machine) -> float | None:
    """Return the score of a correction: agreement with the simulation minus rigid misfit; None if nothing moves."""
    available = np.isfinite(measured).any(axis=0)
    missing = np.abs(correction) @ (~available).astype(float) > 0
    corrected = np.where(missing, np.nan, np.nan_to_num(measured) @ correction.T)
    corrected[~np.isfinite(measured).all(axis=1) & available.all()] = np.nan
    agreement = _agreement(corrected, simulated)
    return None if np.isnan(agreement) else agreement - rigid_misfit(corrected, machine)


def _agreement(measured: Array, simulated: Array) -> float:
    """Return the mean correlation of measured and simulated speeds over the channels that move, or NaN."""
    correlations = []
    for measured_speed, simulated_speed in zip(measured.T, simulated.T, strict=True):
        rows = np.isfinite(measured_speed) & np.isfinite(simulated_speed)
        if rows.sum() > _MIN_ROWS and np.any(measured_speed[rows]) and np.any(simulated_speed[rows]):
            correlations.append(_correlation(measured_speed[rows], simulated_speed[rows]))
    return float(np.mean(correlations)) if correlations else float("nan")


def _correlation(a: Array, b: Array) -> float:
    """Return the correlation about zero, not about the means: a constant speed has a sign too."""
    return float(a @ b / np.sqrt((a @ a) * (b @ b)))


def _is_resting(changes: Array, data: Dataset, channel: int) -> bool:
    """Return whether changes of a channel are within its noise and quantum."""
    return bool(np.ptp(changes) < max(10 * data.noise[channel], 3 * data.quantum[channel]))
