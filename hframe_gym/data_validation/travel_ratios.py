"""Find encoders whose travel is a multiple of that of other sensors: wrong gear ratios, radii, scales."""

from __future__ import annotations

import math

import numpy as np

from ..identification import Dataset
from ..machine import Machine, Sensor
from .findings import Finding
from .span_motion import MIN_ROWS, SpanMotion, correlation
from .wiring import rigid_prediction

_RATIO_TOLERANCE = 0.02  # relative error of a pulley radius or gear ratio that is not reported
_MAX_RATIO_ERROR = 0.5  # a larger relative error is no inaccurate radius or scale but a mistake
_RATIO_CORRELATION = 0.9  # minimum correlation at which a ratio is reported


def check_travel_ratios(motion: SpanMotion, data: Dataset, machine: Machine) -> list[Finding]:
    """Report encoders that move too far or too little for the travel that other sensors measure.

    The reference are sensors with a fixed zero, elsewhere encoders compared with each other. Complete runs
    are compared, because fast motion also stretches the belts. Only motions that correlate by more than 0.9
    are compared.

    Args:
        motion: Measured and simulated motion of the runs, see `span_motion`.
        data: Runs prepared for a fit.
        machine: Machine as declared.

    Returns:
        Findings about all runs together: a fault for a ratio that differs from 1 by more than 50 %, advice
        for more than 2 %, because a scale error of the other sensors, which identification can find, has the
        same appearance.
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
    """Return measured travel over the travel that other sensors predict; None if these do not correlate."""
    parts = []
    for run in data.runs:
        others = run.outputs.copy()
        others[:, ignored] = np.nan  # they may have the same mistake
        prediction = rigid_prediction(others, column, machine)
        both = np.column_stack([run.outputs[:, column], prediction[0]]) if prediction else np.zeros((0, 2))
        both = both[np.isfinite(both).all(axis=1)]
        parts.append(both - both.mean(axis=0) if len(both) else both)
    measured, predicted = np.concatenate(parts).T
    if len(measured) < MIN_ROWS or not predicted.any() or not measured.any():
        return None
    if correlation(measured, predicted) <= _RATIO_CORRELATION:
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
