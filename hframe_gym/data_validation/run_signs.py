"""Find runs in which a coordinate moves against its drive, while it moves with it in others.

A column that has the opposite sign in some runs contradicts itself only in the balance of forces of all runs
together: one machine has one inertia, one friction and one load. The sign of the drive's force in each run
is chosen so that one machine explains as much as possible (`force_equations`). Signs that the motion of all
runs together contradicts are found before (`check_wiring`), where positions are measured.

Loads may differ between the runs: a lift carries its empty cage up and lowers a full one, both by a force in
the same direction. A constant force of its own in each run explains that as well, but not how the force
*changes* within a run. Only if the changes in the runs that are turned contradict the sign, it is certain.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import nnls

from ..arrays import Array
from ..errors import name_runs
from ..identification import PreparedRecording
from ..machine import Machine
from ..preparation.forces.force_balance import EXPLAINED, SPANS, explains_instead
from ..preparation.forces.force_equations import ForceEquations, force_equations
from ..preparation.forces.integrated_speeds import with_integrated_speeds
from ..preparation.forces.motion_windows import motion_windows
from ..recordings import comparison_window
from .findings import Finding

_RIDGE = 1e-9  # of a column's square; makes equations solvable that do not determine a coefficient


class _RunBalance(NamedTuple):
    """Sums of squares and products of the equations of one run, whose columns are scaled for all runs.

    Attributes:
        gram: Products of the columns, shape (coefficients, coefficients).
        projection: Products of the columns with the force, N or Nm, shape (coefficients,).
        power: Squared force, N^2 or N^2 m^2.
    """

    gram: Array
    projection: Array
    power: float

    def left(self, sign: float, coefficients: Array) -> float:
        """Return the squared force that coefficients leave unexplained if it has a sign."""
        explained = 2.0 * sign * self.projection @ coefficients - coefficients @ self.gram @ coefficients
        return float(self.power - explained)


class _Signs(NamedTuple):
    """Sign of the drive's force in each run with which one machine explains most.

    Attributes:
        unexplained: Fraction of the squared force that it leaves, from 0 to 1.
        against: Names of the runs in which the coordinate clearly moves against its drive.
        along: Names of those in which it clearly moves with it.
        certain: Whether the changes of the force in the former runs tell it as well.
    """

    unexplained: float
    against: list[str]
    along: list[str]
    certain: bool


def check_signs_of_runs(runs: Sequence[PreparedRecording], machine: Machine) -> list[Finding]:
    """Report coordinates that move against their drives in some runs and with them in others.

    It is a fault if the changes of the voltages within the runs confirm the sign; otherwise advice, since a
    load may move the coordinate. Three cases are not checked: currents and torques, which may brake a load
    throughout; machines with belts, where other motors move a coordinate as well; and drives whose force is
    not in proportion to their command.

    Args:
        runs: Runs prepared for a fit.
        machine: Machine as declared, with sensors of positions; or with sensors of speeds only, which are
            integrated.
    """
    if machine.belts or machine.drive_laws or len(runs) < 2:
        return []
    if not machine.position_sensors.any():
        runs, machine = with_integrated_speeds(runs, machine)
    if not machine.sensors:
        return []
    findings = []
    for coordinate in dict.fromkeys(drive.coordinate for drive in machine.drives):
        signs = _signs_of_runs(runs, machine, machine.coordinate_names.index(coordinate))
        drives = [drive for drive in machine.drives if drive.coordinate == coordinate]
        if signs is None or any(drive.command != "voltage" for drive in drives):
            continue
        inputs = " and ".join(drive.channel for drive in drives)
        message = (
            f"{coordinate} moves against the sign of {inputs} in {name_runs(signs.against)}, "
            f"and with it in {name_runs(signs.along)}: "
        )
        if signs.certain:
            message += (
                "one machine explains these runs only if the sign differs. Import the former again with the "
                f"opposite sign, such as --scale {drives[0].channel}=-1, or leave them out"
            )
        else:
            message += "does the sign differ between these runs, or does another load move it?"
        findings.append(Finding("fault" if signs.certain else "advice", "", inputs, message))
    return findings


def _signs_of_runs(runs: Sequence[PreparedRecording], machine: Machine, coordinate: int) -> _Signs | None:
    """Return the signs of the runs along a coordinate, by index; None if they do not differ for certain."""
    unchanged = np.eye(len(machine.sensors)), np.eye(len(machine.drives))
    best: _Signs | None = None
    for span in SPANS:  # short windows see fast motion, long ones suppress noise
        windows = [motion_windows(run, comparison_window(run.outputs, run.time_s, span)) for run in runs]
        for equations in force_equations(windows, machine, *unchanged, spring=True):
            if equations.motion == coordinate and equations.determined:
                signs = _compare_signs(equations, [run.name for run in runs])
                best = signs if best is None or signs.unexplained < best.unexplained else best
        if best is not None and best.unexplained < EXPLAINED / 2:
            break
    differ = best is not None and best.unexplained < EXPLAINED and best.against and best.along
    return best if differ else None


def _compare_signs(equations: ForceEquations, names: Sequence[str]) -> _Signs:
    """Choose the signs of all runs, unless one sign for all explains nearly as much.

    A drive that turns the other way in all runs is another matter, which identification settles.
    """
    present = np.unique(equations.runs[equations.force != 0.0])  # a run without force has no sign
    size = np.maximum(np.linalg.norm(equations.columns, axis=0), np.finfo(float).tiny)
    columns = equations.columns / size
    runs = [_sums(columns[equations.runs == run], equations.force[equations.runs == run]) for run in present]
    total = sum(run.power for run in runs)
    alike = [sign * np.ones(len(runs)) for sign in (1.0, -1.0)]
    of_alike = min(_fit(runs, signs)[1] for signs in alike)
    signs, left = min((_descend(runs, signs) for signs in alike), key=lambda each: each[1])
    if not explains_instead(left / total, of_alike / total):
        return _Signs(of_alike / total, [], [], False)
    coefficients, _ = _fit(runs, signs)
    clear = [
        explains_instead(run.left(s, coefficients) / run.power, run.left(-s, coefficients) / run.power)
        and run.left(s, coefficients) < EXPLAINED * run.power
        for run, s in zip(runs, signs, strict=True)
    ]
    of_sign = {
        sign: [names[run] for run, s, c in zip(present, signs, clear, strict=True) if c and s == sign]
        for sign in (-1.0, 1.0)
    }
    changes = [
        _sums(
            columns[rows] - columns[rows].mean(axis=0), equations.force[rows] - equations.force[rows].mean()
        )
        for rows in (equations.runs == run for run in present[signs < 0.0])
    ]
    power = sum(run.power for run in changes)
    turned, unturned = (_fit(changes, np.full(len(changes), sign))[1] for sign in (-1.0, 1.0))
    certain = bool(power) and explains_instead(turned / power, unturned / power)
    return _Signs(left / total, of_sign[-1.0], of_sign[1.0], certain)


def _sums(columns: Array, force: Array) -> _RunBalance:
    """Return the sums of squares and products of the equations of a run."""
    return _RunBalance(columns.T @ columns, columns.T @ force, float(force @ force))


def _descend(runs: Sequence[_RunBalance], signs: Array) -> tuple[Array, float]:
    """Change the sign of one run after the other as long as less force remains; return signs and the rest."""
    left = _fit(runs, signs)[1]
    while True:
        changed = [np.where(np.arange(len(runs)) == run, -signs, signs) for run in range(len(runs))]
        remaining = [_fit(runs, each)[1] for each in changed]
        best = int(np.argmin(remaining))
        if remaining[best] >= left:
            return signs, left
        signs, left = changed[best], remaining[best]


def _fit(runs: Sequence[_RunBalance], signs: Array) -> tuple[Array, float]:
    """Return the coefficients >= 0 for given signs of the force, and the squared force that they leave."""
    gram = np.sum([run.gram for run in runs], axis=0)
    projection = np.sum([s * run.projection for s, run in zip(signs, runs, strict=True)], axis=0)
    root = np.linalg.cholesky(gram + _RIDGE * np.eye(len(gram)))
    coefficients, _ = nnls(root.T, solve_triangular(root, projection, lower=True))
    left = sum(run.left(s, coefficients) for s, run in zip(signs, runs, strict=True))
    return coefficients, max(left, 0.0)
