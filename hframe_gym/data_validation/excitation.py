"""Check excitation and identifiability: motion and spectra of the runs, and Cramer-Rao bounds of the parameters.

The Cramer-Rao bound is evaluated for simulations of the declared machine, with white residuals of the size of the
sensors' noise. A fit of real data has larger errors, because no model is exact.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..dynamics import mode_frequencies
from ..identification import Dataset, FreeParameter, PreparedRecording, default_free_parameters
from ..identification.linearization import NormalEquations, ResidualModel
from ..identification.prediction import SIMULATION, map_runs
from ..machine import Machine, rigid_motions
from ..recordings import Recording, bridge_blanks
from .findings import Finding, Severity
from .wiring import sensor_motions

Array = NDArray[np.float64]

_OVERVOLTAGE = 1.2  # times the rated voltage, above which the column's unit is doubted
_NARROW_TRAVEL = 0.3  # fraction of a coordinate's range; less does not determine effects that depend on position
_WIDE_TRAVEL = 1.05  # fraction of a coordinate's range; more contradicts the declared range
_ONE_SIDED = 0.15  # fraction of the moving time in the rarer direction that direction-dependent friction requires
_SLOW = 0.1  # fraction of the top speed; motion below is slow
_SLOW_TIME = 0.05  # fraction of the moving time that should be slow, to determine friction at low speed
_MOVING = 0.01  # fraction of the top speed; motion below is rest
_WINDOW = 0.02  # s, time over which speed is measured
_TOP_PERCENTILE = 99  # percentile of the speeds that counts as top speed; the maximum would be noise
_MODE_MARGIN = 0.7  # fraction of the lowest belt frequency; power above it excites the belts
_MODE_POWER = 1e-3  # fraction of the total power that should be near or above the lowest belt frequency


def check_excitation(recordings: Sequence[Recording], data: Dataset, machine: Machine) -> list[Finding]:
    """Check whether inputs and motion are rich enough for identification.

    The checks cover constant inputs, inputs above the rated voltage, drive force relative to Coulomb friction, range of
    positions, speed, direction, and the spectrum of the inputs relative to the lowest natural frequency of the belts.

    Args:
        recordings: Runs as recorded (times, s; voltages, V; measurements, m or rad).
        data: The same runs, prepared by `identification.prepare`.
        machine: Declared machine.

    Returns:
        Findings (severity, run, channel, message): "advice" where the excitation is insufficient or contradicts the
        machine file, "note" where it suffices. All are about all runs together, except for those about constant inputs.
    """
    findings = constant_inputs(recordings, machine) + _overvoltage(recordings, machine)
    if rigid_motions(machine):
        findings += _amplitude(recordings, machine) + _coverage(data, machine)
    return findings + _frequencies(recordings, machine)


def constant_inputs(recordings: Sequence[Recording], machine: Machine) -> list[Finding]:
    """Report inputs that have one constant value throughout a run.

    Args:
        recordings: Runs as recorded (times, s; voltages, V; measurements, m or rad).
        machine: Declared machine, which names the input channels.

    Returns:
        One finding of severity "advice" for each run and constant channel.
    """
    return [
        Finding("advice", recording.name, channel, f"never changes, it is {values[0]:.4g} V throughout")
        for recording in recordings
        for channel, values in zip(machine.input_channels, recording.inputs.T, strict=True)
        if np.ptp(values) == 0.0
    ]


def _overvoltage(recordings: Sequence[Recording], machine: Machine) -> list[Finding]:
    """Report inputs far above the rated voltage."""
    findings = []
    for column, drive in enumerate(machine.drives):
        largest = max(float(np.abs(recording.inputs[:, column]).max()) for recording in recordings)
        if largest > _OVERVOLTAGE * drive.rated_voltage:
            rated = f"rated {drive.rated_voltage:.4g} V"
            message = f"reaches {largest:.4g} V, {rated}: is the column in another unit or in %?"
            findings.append(Finding("advice", "", drive.channel, message))
    return findings


def _amplitude(recordings: Sequence[Recording], machine: Machine) -> list[Finding]:
    """Report the drive force relative to Coulomb friction along each rigid motion, forward and backward."""
    coulomb = np.array([c.coulomb for c in machine.coordinates])
    findings = []
    for name, motion in rigid_motions(machine).items():
        friction = float(np.abs(motion) @ coulomb)
        if friction == 0.0:
            continue
        gains = np.array([d.gain * motion[machine.coordinate_names.index(d.coordinate)] for d in machine.drives])
        ratio = np.concatenate([r.inputs @ gains for r in recordings]) / friction  # (rows of all runs,)
        high, low = float(ratio.max()), float(ratio.min())
        above = 100 * float(np.mean(np.abs(ratio) > 1.0))
        message = f"drive force {low:+.3g} to {high:+.3g} times Coulomb friction, above it {above:.0f} % of the time"
        if max(high, -low) < 1.0:
            findings.append(Finding("advice", "", name, f"{message}: it never breaks away"))
        elif min(high, -low) < 1.0:
            findings.append(Finding("advice", "", name, f"{message}: in one direction only"))
        else:
            findings.append(Finding("note", "", name, message))
    return findings


def _frequencies(recordings: Sequence[Recording], machine: Machine) -> list[Finding]:
    """Report the spectrum of each input relative to the machine's lowest belt mode."""
    findings = []
    modes = [float(f) for f in mode_frequencies(machine) if f > 0]
    for column, channel in enumerate(machine.input_channels):
        grids, powers = [], []
        for recording in recordings:
            values = recording.inputs[:, column] - recording.inputs[:, column].mean()
            if len(values) > 8 and np.any(values):
                period = float(np.median(np.diff(recording.time_s)))
                grids.append(np.fft.rfftfreq(len(values), period))
                powers.append(np.abs(np.fft.rfft(values * np.hanning(len(values)))) ** 2 * period / len(values))
        if not grids:
            continue
        frequency, power = np.concatenate(grids), np.concatenate(powers)
        order = np.argsort(frequency)
        frequency, power_below = frequency[order], np.cumsum(power[order])
        half, most = (float(frequency[np.searchsorted(power_below, p * power_below[-1])]) for p in (0.5, 0.95))
        message = f"half of its power is below {half:.3g} Hz, 95 % below {most:.3g} Hz"
        fraction = power_below / power_below[-1]
        below_mode = float(np.interp(modes[0] * _MODE_MARGIN, frequency, fraction)) if modes else 0.0
        if modes and 1 - below_mode < _MODE_POWER:
            message += f"; almost none near the lowest belt mode ({modes[0]:.1f} Hz): belts are poorly identifiable"
            findings.append(Finding("advice", "", channel, message))
        else:
            findings.append(Finding("note", "", channel, message))
    return findings


def _coverage(data: Dataset, machine: Machine) -> list[Finding]:
    """Report travel, speeds, directions and slow motion along each rigid motion."""
    M = sensor_motions(machine)  # (sensors, motions)
    names = list(rigid_motions(machine))
    travels: list[Array] = []
    speeds: list[Array] = []
    for run in data.runs:
        measured = np.isfinite(run.outputs).any(axis=0)
        if np.linalg.matrix_rank(M[measured]) < len(names) or len(run.time_s) < 3:
            continue
        size = np.linalg.norm(M[measured], axis=1)
        outputs = bridge_blanks(run.outputs[:, measured], run.time_s, _WINDOW)
        travel = (outputs / size) @ np.linalg.pinv(M[measured] / size[:, None]).T  # (n, motions)
        period = float(np.median(np.diff(run.time_s)))
        window = max(1, min(len(travel) - 1, round(_WINDOW / period)))
        elapsed = run.time_s[window:] - run.time_s[:-window]
        travels.append(travel)
        speeds.append((travel[window:] - travel[:-window]) / elapsed[:, None])
    findings = []
    for k, name in enumerate(names if travels else ()):
        findings += _check_travel(name, np.concatenate([t[:, k] for t in travels]), machine)
        findings += _check_speed(name, np.concatenate([s[:, k] for s in speeds]), machine)
    return findings


def _check_travel(name: str, travel: Array, machine: Machine) -> list[Finding]:
    """Report the travel of a coordinate relative to its range."""
    coordinate = machine.coordinate(name)
    low, high = float(np.fmin.reduce(travel)), float(np.fmax.reduce(travel))
    if np.isnan(low):  # the channels never measure together
        return []
    message = f"travels from {low:.4g} to {high:.4g} {coordinate.unit('position')}"
    if coordinate.range is None:
        return [Finding("note", "", name, message)]
    fraction = (high - low) / (coordinate.range[1] - coordinate.range[0])
    if fraction > _WIDE_TRAVEL:
        return [Finding("advice", "", name, f"{message}, more than its declared range {list(coordinate.range)}")]
    message += f", {100 * fraction:.0f} % of its range"
    if fraction < _NARROW_TRAVEL:
        message += ": effects that depend on position are poorly identifiable"
        return [Finding("advice", "", name, message)]
    return [Finding("note", "", name, message)]


def _check_speed(name: str, speed: Array, machine: Machine) -> list[Finding]:
    """Report speeds of a coordinate, and whether it moves in both directions and slowly."""
    speed = speed[np.isfinite(speed)]
    if len(speed) == 0:
        return []
    unit = machine.coordinate(name).unit("speed")
    top = float(np.percentile(np.abs(speed), _TOP_PERCENTILE))
    moving = speed[np.abs(speed) > _MOVING * top]
    if top == 0.0 or len(moving) == 0:
        return []
    backward = float(np.mean(moving < 0))
    slow = float(np.mean(np.abs(moving) < _SLOW * top))
    message = f"speeds up to {top:.3g} {unit}, {100 * slow:.0f} % of the motion below a tenth of it"
    findings = [Finding("note", "", name, message)]
    if min(backward, 1 - backward) < _ONE_SIDED:
        direction, percent = ("backward" if backward > 0.5 else "forward"), 100 * max(backward, 1 - backward)
        message = f"moves {direction} {percent:.0f} % of the time: direction-dependent friction is poorly identifiable"
        findings.append(Finding("advice", "", name, message))
    if slow < _SLOW_TIME:
        message = f"only {100 * slow:.1f} % of the motion is slow: friction at low speed is poorly identifiable"
        findings.append(Finding("advice", "", name, message))
    return findings


_MAX_ROWS = 20_000  # rows of a run that are simulated
_LARGE_STD = 0.1  # relative standard deviation above which a parameter is reported as poorly identifiable
_INSEPARABLE = 0.98  # correlation above which two parameters are reported as inseparable
_NO_INFLUENCE = 1e-12  # sensitivity relative to the largest one below which a parameter has no influence
_SINGULAR = 1e-13  # eigenvalue of the normalized information matrix below which a combination is not determined


@dataclass(frozen=True)
class CramerRaoBound:
    """Lower bound on the standard deviation of one parameter that is estimated jointly with others.

    Attributes:
        name: Full name of the parameter, e.g. `x.coulomb`.
        relative_std: Smallest possible standard deviation divided by the absolute value of the parameter; infinite if
            the parameter has no influence on the measurements.
        partner: Name of the parameter with the largest absolute correlation, "" if there is no other.
        correlation: Correlation of the estimates of the two, in [-1, 1].
    """

    name: str
    relative_std: float
    partner: str
    correlation: float


def cramer_rao_bounds(data: Dataset, machine: Machine, names: Sequence[str] = ()) -> list[CramerRaoBound]:
    """Compute the Cramer-Rao bounds on the standard deviations of parameters that are estimated jointly.

    The bounds hold for the declared machine, simulated without feedback, with white sensor noise and without priors.
    At most 20000 rows of each run are used.

    Args:
        data: Runs prepared by `identification.prepare` (times, voltages, measurements, noise).
        machine: Declared machine, whose parameter values are the expansion point.
        names: Full names of the parameters. Default: those that identification refits. Parameters whose value is zero
            are left out.

    Returns:
        One bound per parameter, in the order of `names`: smallest possible standard deviation divided by the value,
        dimensionless, and the largest correlation with another parameter.

    Raises:
        KeyError: If the machine has no parameter of a given name.

    References:
        Ljung, System Identification (1999), section 7.4.
    """
    names = names or [f.name for f in default_free_parameters(machine)]
    return _joint_bounds(*_relative_information(data, machine, names))


def _relative_information(data: Dataset, machine: Machine, names: Sequence[str]) -> tuple[list[str], Array]:
    """Return the parameters that are not zero, and the information matrix (k, k) of their relative changes."""
    # Derivatives are with respect to relative changes of the parameters, which do not exist for a value of zero.
    names = [name for name in names if machine.parameters[name] != 0.0]
    data = dataclasses.replace(data, runs=tuple(_first_rows(run, _MAX_ROWS) for run in data.runs))
    forward, backward = (_residual_model(data, machine, names, direction) for direction in (1.0, -1.0))
    at_declared = np.zeros(len(names))

    def normal_equations(run: PreparedRecording) -> NormalEquations:
        """Use central differences; rounding in forward ones would seem to separate inseparable parameters."""
        rows = forward.linearize_run(run, at_declared)
        opposite = backward.linearize_run(run, at_declared)  # derivatives with respect to decreases
        return NormalEquations.from_rows((rows.jacobian - opposite.jacobian) / 2, rows.residual)

    return names, NormalEquations.total(map_runs(normal_equations, data)).information


def check_parameters(data: Dataset, machine: Machine) -> list[Finding]:
    """Report how precisely the recordings can determine each parameter that identification refits.

    The precision is the Cramer-Rao bound: the smallest standard deviation of any unbiased estimate. Viscous friction
    and back-EMF of a motor brake its motion alike; where nothing separates them, the precision of their sum is given.

    Args:
        data: Runs prepared by `identification.prepare` (times, voltages, measurements, SI), in which the machine moves.
        machine: Declared machine.

    Returns:
        One finding (severity, channel, message) per parameter or sum: advice if it has no influence or its relative
        standard deviation is at least 10 %, otherwise a note.
    """
    names, information = _relative_information(data, machine, [f.name for f in default_free_parameters(machine)])
    bounds = _joint_bounds(names, information)
    sums = _inseparable_damping(bounds, machine)
    rows = [i for i, name in enumerate(names) if name not in sums]
    alone = _joint_bounds([names[i] for i in rows], information[np.ix_(rows, rows)])
    damping = {bound.name: bound.relative_std for bound in alone}  # with a known back-EMF constant
    findings = []
    for ke, (viscous, fraction) in sums.items():
        relative_std = damping.pop(viscous) * fraction
        message = (
            f"only their sum can be determined, with a standard error of at least {100 * relative_std:.2g} %: viscous "
            "friction and back-EMF brake the motor alike. Neither is needed alone"
        )
        severity: Severity = "advice" if relative_std > _LARGE_STD else "note"
        findings.append(Finding(severity, "", f"{viscous} and {ke}", message))
    for bound in bounds:
        if bound.name not in damping:
            continue
        if not np.isfinite(bound.relative_std):
            findings.append(Finding("advice", "", bound.name, "has no influence on these runs"))
            continue
        message = f"standard error at least {100 * bound.relative_std:.2g} %"
        if abs(bound.correlation) > _INSEPARABLE:
            message += f"; cannot be separated from {bound.partner} (correlation {bound.correlation:+.3f})"
        severity = "advice" if bound.relative_std > _LARGE_STD else "note"
        findings.append(Finding(severity, "", bound.name, message))
    return findings


def _inseparable_damping(bounds: Sequence[CramerRaoBound], machine: Machine) -> dict[str, tuple[str, float]]:
    """Return back-EMF constants that nothing separates from a viscous friction, its name, and its part of their sum."""
    correlated = {(b.name, b.partner) for b in bounds if b.correlation < -_INSEPARABLE}
    sums = {}
    for drive in machine.drives:
        viscous, ke = f"{drive.coordinate}.viscous", f"{drive.name}.Ke"
        if correlated & {(viscous, ke), (ke, viscous)}:
            back_emf = drive.gain * drive.Ke * drive.gear_ratio  # N s/m or Nm s/rad
            friction = machine.parameters[viscous]
            sums[ke] = (viscous, friction / (friction + back_emf))
    return sums


def _first_rows(run: PreparedRecording, count: int) -> PreparedRecording:
    """Return a run without the rows after the first ones."""
    by_row = ("time_s", "inputs", "outputs", "noise", "weights")
    rows = None if run.rows is None else run.rows[:count]
    return dataclasses.replace(run, rows=rows, **{name: getattr(run, name)[:count] for name in by_row})


def _residual_model(data: Dataset, machine: Machine, names: Sequence[str], direction: float) -> ResidualModel:
    """Return the residual as a function of relative changes, positive or negative, without priors."""
    free = tuple(
        FreeParameter(name, value, prior=np.inf, scale=direction * abs(value), lower=-np.inf)
        for name, value in ((name, machine.parameters[name]) for name in names)
    )
    return ResidualModel(machine, free, data, SIMULATION)


def _joint_bounds(names: Sequence[str], information: Array) -> list[CramerRaoBound]:
    """Invert an information matrix (k, k) of relative changes, without the parameters that have no influence."""
    sensitivity = np.sqrt(np.diag(information))
    influential = sensitivity > _NO_INFLUENCE * max(float(sensitivity.max(initial=0.0)), 1e-300)
    kept = [name for name, used in zip(names, influential, strict=True) if used]
    scale = sensitivity[influential]
    normalized = information[np.ix_(influential, influential)] / np.outer(scale, scale)
    # Parameters that cannot be separated make the matrix singular; rounding may even make an eigenvalue negative.
    eigenvalues, eigenvectors = np.linalg.eigh(normalized)
    covariance = (eigenvectors / np.maximum(eigenvalues, _SINGULAR)) @ eigenvectors.T
    std = np.sqrt(np.diag(covariance))
    bounds = {}
    for i, name in enumerate(kept):
        correlations = covariance[i] / np.maximum(std[i] * std, 1e-300)
        correlations[i] = 0.0
        closest = int(np.argmax(np.abs(correlations)))
        partner = kept[closest] if len(kept) > 1 else ""
        bounds[name] = CramerRaoBound(name, float(std[i] / scale[i]), partner, float(correlations[closest]))
    return [bounds.get(name, CramerRaoBound(name, float("inf"), "", 0.0)) for name in names]
