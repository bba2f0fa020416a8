"""Find measured currents, or set points, of two drives that are swapped.

A drive's current follows its own voltage, (V - Ke w) / R, and a coordinate that follows a set point its own
set point. Whether another drive's explains them instead is asked of two drives together, so that one that
rests, or both with the same command, tell nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from scipy.optimize import nnls

from ..arrays import Array
from ..identification import PreparedRecording
from ..machine import Machine
from ..preparation.forces.force_balance import EXPLAINED, SPANS, explains_instead
from ..preparation.forces.force_equations import leading_motions
from ..preparation.forces.integrated_speeds import with_integrated_speeds
from ..preparation.forces.motion_windows import MotionWindows, motion_windows
from ..recordings import comparison_window
from .findings import Finding
from .wiring import REMEDY, sensor_motions

_MIN_ROWS = 20  # that a comparison needs, all runs together
# Fraction of a run over which motions are compared: long enough that a drive which follows with a lag has
# followed, short enough that an offset of a commanded speed does not add up.
_WINDOW = 0.1


def check_swapped_currents(runs: Sequence[PreparedRecording], machine: Machine) -> list[Finding]:
    """Report, as faults, measured currents of two drives that follow each other's voltage.

    A current follows a voltage if a combination of the voltage, the speed of the drive's coordinate (by the
    back-EMF) and a constant explains it. The voltages of both drives must explain the exchanged currents
    except for 20 % of their squares (`EXPLAINED`), and clearly better than the currents as declared
    (`explains_instead`). The factors of voltage and speed are fitted, with the signs that they have on any
    motor, so that a wrong resistance or Ke of the machine file is no fault.
    """
    names = [drive.name for drive in machine.drives]
    sensors: dict[int, int] = {}  # index of the sensor that measures a drive's current, by index of the drive
    for j, sensor in enumerate(machine.sensors):
        [(site, coefficient), *others] = sensor.row.items()
        if sensor.quantity == "current" and not others and site in names and coefficient > 0.0:
            sensors.setdefault(names.index(site), j)
    drives = [i for i in sensors if machine.drives[i].law is None]
    if len(drives) < 2:
        return []
    for span in SPANS:  # short windows see fast changes, long ones suppress noise
        windows = [motion_windows(run, comparison_window(run.outputs, run.time_s, span)) for run in runs]
        measured = {i: np.concatenate([w.position[:, sensors[i]] for w in windows]) for i in drives}
        causes = {i: _causes_of_current(windows, i, machine) for i in drives}
        pairs = _swapped(measured, causes)
        if pairs:
            channels = [[machine.sensors[sensors[i]].channel for i in pair] for pair in pairs]
            return [
                Finding("fault", "", "", f"{a} and {b} are swapped: {_follows('voltage')}; {REMEDY}")
                for a, b in channels
            ]
    return []


def check_swapped_set_points(runs: Sequence[PreparedRecording], machine: Machine) -> list[Finding]:
    """Report, as faults, set points of two drives whose coordinates follow each other's.

    Positions are measured, or speeds, which are integrated. Only drives that command the same quantity of
    coordinates of the same kind are compared.
    """
    if not machine.position_sensors.any():
        runs, machine = with_integrated_speeds(runs, machine)
    drives = [i for i, drive in enumerate(machine.drives) if drive.command in ("position", "speed")]
    if len(drives) < 2:
        return []
    weights = {i: _weights(machine, machine.drives[i].coordinate, [r.outputs for r in runs]) for i in drives}
    known = {i: each for i, each in weights.items() if each is not None}
    findings = []
    for quantity in ("position", "speed"):
        for kind in ("linear", "rotary"):
            group = [
                i
                for i in known
                if machine.drives[i].command == quantity
                and machine.coordinate(machine.drives[i].coordinate).kind == kind
            ]
            changes = [_travel_changes(run, group, known, quantity) for run in runs]
            measured, commanded = (np.concatenate(each, axis=1) for each in zip(*changes, strict=True))
            pairs = _swapped(
                dict(zip(group, measured, strict=True)),
                dict(zip(group, commanded[:, :, None], strict=True)),
            )
            for pair in pairs:
                a, b = (machine.drives[i].channel for i in pair)
                text = f"{a} and {b}, or the sensors of what they move, are swapped: {_follows('set point')}"
                findings.append(Finding("fault", "", "", f"{text}; {REMEDY}"))
    return findings


def _follows(command: str) -> str:
    """Return the reason of a finding."""
    return f"each follows the {command} of the other drive"


def _swapped(measured: dict[int, Array], causes: dict[int, Array]) -> list[tuple[int, int]]:
    """Return pairs of drives of which each measurement follows the other drive's cause.

    Args:
        measured: Measurements of each drive, all in one unit, shape (rows,), NaN where not measured.
        causes: Quantities in proportion to which it is, with factors >= 0, shape (rows, causes).
    """
    pairs = []
    for pair in combinations(measured, 2):
        rows = np.all([np.isfinite(measured[i]) & np.isfinite(causes[i]).all(axis=1) for i in pair], axis=0)
        total = sum(float(np.sum((measured[i][rows] - measured[i][rows].mean()) ** 2)) for i in pair)
        if np.count_nonzero(rows) < _MIN_ROWS or not total:
            continue
        declared, exchanged = (
            sum(_unexplained(measured[i][rows], causes[k][rows]) for i, k in zip(pair, order, strict=True))
            / total
            for order in (pair, pair[::-1])
        )
        if exchanged < EXPLAINED and explains_instead(exchanged, declared):
            pairs.append(pair)
    return pairs


def _unexplained(measured: Array, causes: Array) -> float:
    """Return the sum of squares of a measurement that causes with factors >= 0 and a constant leave."""
    constant = np.ones(len(measured))
    columns = np.column_stack([causes, constant, -constant])
    scale = np.maximum(np.linalg.norm(columns, axis=0), np.finfo(float).tiny)
    return float(nnls(columns / scale, measured)[1] ** 2)


def _causes_of_current(windows: Sequence[MotionWindows], drive: int, machine: Machine) -> Array:
    """Return the voltage and, where it is known, the back-EMF of a drive, shape (rows, causes)."""
    causes = [np.concatenate([w.inputs[:, drive] for w in windows])]
    emf, coordinate = machine.drives[drive].emf_constant, machine.drives[drive].coordinate
    velocity = _velocity(windows, coordinate, machine) if emf else None
    if velocity is not None:
        causes.append(-np.sign(emf) * velocity)
    return np.column_stack(causes)


def _velocity(windows: Sequence[MotionWindows], coordinate: str, machine: Machine) -> Array | None:
    """Return a coordinate's velocity in windows, m/s or rad/s, shape (rows,); None if it is not measured."""
    for j, sensor in enumerate(machine.sensors):
        if sensor.of_velocity and list(sensor.row) == [coordinate]:
            return np.concatenate([w.position[:, j] for w in windows]) / sensor.row[coordinate]
    weights = _weights(machine, coordinate, [w.position for w in windows])
    return None if weights is None else np.concatenate([_weighted(w.velocity, weights) for w in windows])


def _weights(machine: Machine, coordinate: str, outputs: Sequence[Array]) -> Array | None:
    """Return the weights of the measurements whose sum is a coordinate's position but for a constant.

    Belts do not stretch. None if the sensors of positions that measured do not determine it.
    """
    used = machine.position_sensors & np.any([np.isfinite(each).any(axis=0) for each in outputs], axis=0)
    motions = leading_motions(machine).reshape(-1, len(machine.coordinates))
    wanted = motions[:, machine.coordinate_names.index(coordinate)]
    of_sensors = sensor_motions(machine)
    size = np.maximum(np.linalg.norm(of_sensors, axis=1), np.finfo(float).tiny)
    scaled = (of_sensors / size[:, None])[used]
    weights = np.zeros(len(machine.sensors))
    weights[used] = wanted @ np.linalg.pinv(scaled) / size[used]
    reached = weights @ of_sensors
    return weights if wanted.any() and np.allclose(reached, wanted, rtol=1e-6, atol=1e-9) else None


def _weighted(outputs: Array, weights: Array) -> Array:
    """Return the weighted sum of measurements, NaN where one that counts is missing, shape (rows,)."""
    counts = weights != 0.0
    return np.asarray(outputs[:, counts] @ weights[counts])


def _travel_changes(
    run: PreparedRecording, drives: Sequence[int], weights: dict[int, Array], quantity: str
) -> tuple[Array, Array]:
    """Return measured and commanded changes of the positions that drives move, shape (drives, parts) each."""
    window = max(1, round(_WINDOW * len(run.time_s)))
    steps = np.diff(run.time_s)
    changes = []
    for drive in drives:
        commanded = run.inputs[:, drive]
        if quantity == "speed":
            commanded = np.concatenate([[0.0], np.cumsum(commanded[:-1] * steps)])
        measured = _weighted(run.outputs, weights[drive])
        known = np.isfinite(measured)
        if known.any():
            measured = np.interp(run.time_s, run.time_s[known], measured[known])
        both = np.stack([measured, commanded])
        changes.append((both[:, window:] - both[:, :-window])[:, :: max(1, window // 4)])
    measured_and_commanded = np.stack(changes, axis=1) if changes else np.zeros((2, 0, 0))
    return measured_and_commanded[0], measured_and_commanded[1]
