"""Find mistakes in the wiring that contradict the machine: wrong signs and swapped channels.

Rigid kinematics (belts that do not stretch) alone cannot distinguish swapped encoders from a laser that
counts backwards; the forces that the motion requires can. Therefore each single mistake (one channel negated,
two channels swapped) is corrected in turn, and the correction with which the inputs explain the motion best
is reported.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from ..arrays import Array
from ..identification import Dataset, PreparedRecording
from ..machine import Machine
from ..preparation.forces.force_balance import EXPLAINED, SPANS, Balance, explains_instead, force_balance
from ..preparation.forces.force_equations import leading_motions
from ..preparation.forces.motion_windows import motion_windows
from ..recordings import comparison_window
from .findings import Finding

# Fractions of the squared force of the drives, or of the squared motion, as `EXPLAINED`.
_UNEXPLAINED = 0.5  # more is unexplained by inputs or a machine of another recording
REMEDY = "correct the columns of the file, or the declaration in machine.json"
_TIE = 0.02  # corrections that differ by less are equally likely


def sensor_motions(machine: Machine) -> Array:
    """Return how much each sensor's measurement changes per unit of each rigid motion.

    In a rigid motion no belt stretches: a carriage moves and the pulleys follow, or two inertias on an
    elastic shaft turn together. Without belts, one coordinate moves.

    Returns:
        Change of each measurement, m or rad, per m or rad of the coordinate that leads the motion (for
        example x or y), shape (sensors, motions), with columns in the order of `leading_motions(machine)`.
    """
    return machine.sensor_matrix @ leading_motions(machine).reshape(-1, len(machine.coordinates)).T


def rigid_prediction(outputs: Array, channel: int, machine: Machine) -> tuple[Array, Array] | None:
    """Predict a sensor's measurements from the others by rigid kinematics (belts that do not stretch).

    Args:
        outputs: Measurements, in the sensors' units, shape (n, sensors), NaN where not measured. A column
            without any measurement is not used.
        channel: Index of the sensor to predict.

    Returns:
        prediction: Predicted measurements, m or rad, shape (n,), correct except for an unknown constant; NaN
            where a sensor that is used has no measurement.
        weights: Weight of each sensor in the prediction, in the unit of the predicted sensor per unit of the
            weighted one, shape (sensors,); 0 for sensors that are not used.

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
    if not np.allclose(
        other_weights @ scaled, M[channel], atol=1e-9 * max(1.0, float(np.abs(M[channel]).max()))
    ):
        return None
    weights = np.zeros(len(M))
    weights[others] = other_weights / size
    return (outputs[:, others] / size) @ other_weights, weights


def rigid_misfit(motion: Array, machine: Machine) -> float:
    """Compute which fraction of a measured motion contradicts rigid kinematics (belts that do not stretch).

    Channels are divided by their change per unit of rigid motion, so that angles and lengths are comparable.
    A rigid motion is fitted to each row by least squares; the residual contradicts rigid kinematics.

    Args:
        motion: Displacements or changes of the measurements, in the sensors' units, shape (n, sensors), NaN
            where not measured. A column without any measurement is not used; a row that lacks another one is
            left out.

    Returns:
        sqrt(sum of squared residuals / sum of squares of the scaled channels), dimensionless, 0 to 1. It is 0
        if nothing moves, or if the channels are not redundant and thus cannot contradict each other.
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
    """Check for channels with a wrong sign and for swapped channels.

    The force of the drives is compared with the one that the motion requires, over all runs together. If this
    gives no fault, each single run is checked as well.

    Returns:
        A fault if exchanging two channels or one sign clearly explains more of the force (`explains_instead`)
        and leaves little; advice if it leaves more, or if no such change explains the motion.
    """
    findings = _signs_and_swaps(data.runs, machine)
    if any(finding.severity == "fault" for finding in findings):
        return findings
    for run in data.runs:
        alone = _signs_and_swaps([run], machine)
        findings += [dataclasses.replace(f, run=run.name) for f in alone if f.severity == "fault"]
    return findings


def declared_balance(data: Dataset, machine: Machine) -> Balance | None:
    """Fit the balance of forces for the channels as declared, see `force_balance`.

    Returns:
        The balance with that length of the averaging window that leaves the smallest fraction unexplained;
        None without motion.
    """
    declared, _ = _explanations(data.runs, machine)
    return declared.balance if declared else None


def _single_corrections(machine: Machine) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return corrections of single mistakes, by description: matrices on the outputs and on the inputs."""
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
            corrections[f"{channels[first]} and {channels[second]} are swapped"] = np.eye(len(channels))[
                order
            ]
    return corrections


class _Explanation(NamedTuple):
    """How well a declared or corrected wiring explains the motion.

    Attributes:
        unexplained: Fraction of the squared force of the drives that no machine explains, plus the fraction
            of the squared motion that contradicts rigid kinematics.
    """

    unexplained: float
    balance: Balance


def _signs_and_swaps(runs: Sequence[PreparedRecording], machine: Machine) -> list[Finding]:
    """Report the single correction that makes the motion explainable, or that the inputs do not explain it.

    It is a fault only if the motion is explained with the correction and clearly not without it, whatever
    spring, weight, friction or offset the machine file lacks.
    """
    declared, corrected = _explanations(runs, machine)
    if declared is None:
        return []
    best = min((explanation.unexplained for explanation in corrected.values()), default=np.inf)
    if explains_instead(best, declared.unexplained):
        likely = " or ".join(label for label, each in corrected.items() if each.unexplained < best + _TIE)
        if best < EXPLAINED:
            return [Finding("fault", "", "", f"{likely}: {REMEDY}")]
        fractions = (
            f"{100 * (1 - best):.0f} % of the motion instead "
            f"of {100 * max(1 - declared.unexplained, 0):.0f} %"
        )
        return [Finding("advice", "", "", f"{likely}? The inputs would then explain {fractions}")]
    if declared.balance.unexplained > _UNEXPLAINED:
        message = (
            f"the inputs explain only {100 * (1 - declared.balance.unexplained):.0f} % "
            "of the forces that the motion requires: is the machine file that of the recorded machine, "
            "and do inputs and outputs belong together?"
        )
        return [Finding("advice", "", "", message)]
    return []


def _explanations(
    runs: Sequence[PreparedRecording], machine: Machine
) -> tuple[_Explanation | None, dict[str, _Explanation]]:
    """Return how well the declared wiring explains the motion, and each single correction, by description.

    The shortest window is used in which one of them explains the motion, otherwise the one in which it
    explains most: noise spoils accelerations over short windows, long ones smooth them away.
    """
    output_corrections, input_corrections = _single_corrections(machine)
    of_outputs, of_inputs = np.eye(len(machine.sensors)), np.eye(len(machine.drives))
    wirings = {"": (of_outputs, of_inputs)}  # as declared
    wirings |= {label: (matrix, of_inputs) for label, matrix in output_corrections.items()}
    wirings |= {label: (of_outputs, matrix) for label, matrix in input_corrections.items()}
    chosen: dict[str, _Explanation] = {}
    least = np.inf
    for window in SPANS:
        windows = [motion_windows(r, comparison_window(r.outputs, r.time_s, window)) for r in runs]
        speeds = np.concatenate([w.velocity for w in windows])
        explanations: dict[str, _Explanation] = {}
        for label, (outputs, inputs) in wirings.items():
            balance = force_balance(windows, machine, outputs, inputs)
            if balance is not None:
                misfit = rigid_misfit(_corrected(speeds, outputs), machine)
                explanations[label] = _Explanation(balance.unexplained + misfit**2, balance)
        best = min((explanation.unexplained for explanation in explanations.values()), default=np.inf)
        if "" in explanations and best < least:
            chosen, least = explanations, best
        if least < EXPLAINED / 2:
            break
    return chosen.pop("", None), chosen


def _corrected(measurements: Array, correction: Array) -> Array:
    """Return measurements after a correction, NaN where one of those it combines is missing."""
    missing = np.isnan(measurements).astype(float) @ np.abs(correction).T > 0.0
    return np.where(missing, np.nan, np.nan_to_num(measurements) @ correction.T)
