"""What a fitted machine leaves unexplained: error per channel, force per coordinate, and what that force follows."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from ..machine import Machine
from .dataset import Dataset, PreparedRecording
from .effect_perturbation import MotionRecord, effects_force
from .prediction import POLISH_STEP, map_runs, observer_gains, predict, sensor_offsets

Array = NDArray[np.float64]

_BINS = 16
_FORCE_CUTOFF = 100.0  # Hz; the inverse dynamics' zero-phase low-pass, as in the EMPS benchmark (Janot et al. 2019)
_FORCE_DECIMATION = 10


class ChannelError(NamedTuple):
    """rmse in the channel's unit and over its noise, both None where the channel was never measured."""

    rmse: float | None
    noise_ratio: float | None


class Dependence(NamedTuple):
    """Share of the variance of the force residual on `coordinate` that a curve over `variable` explains."""

    variable: str
    coordinate: str
    share: float


def free_run_error(machine: Machine, run: PreparedRecording, data: Dataset) -> Array:
    """Measured minus predicted (n, sensors) of a free run from the resting rows, own units; NaN where not measured.

    What the sensors' zeros explain is taken off, from every machine alike (see `prediction.zeros`).
    """
    motion = predict(machine, run, "simulation", period=data.period, longest_step=POLISH_STEP)
    measured = np.isfinite(run.outputs)
    error = np.where(measured, run.outputs - motion.readings, 0.0)
    return np.where(measured, (error - sensor_offsets(run, data, error, measured))[0], np.nan)


def channel_errors(machine: Machine, data: Dataset) -> dict[str, ChannelError]:
    """Free-run error of each output channel over all runs; the offset is that of the resting rows, nothing fitted."""
    errors = np.concatenate(list(map_runs(lambda run: free_run_error(machine, run, data), data)))
    found = {}
    for j, channel in enumerate(machine.output_channels):
        column = errors[:, j][np.isfinite(errors[:, j])]
        if len(column) == 0:
            found[channel] = ChannelError(None, None)
            continue
        rmse = float(np.sqrt(np.mean(column**2)))
        found[channel] = ChannelError(rmse, rmse / float(data.noise[j]))
    return found


def smooth_force_residual(machine: Machine, run: PreparedRecording, data: Dataset) -> Array:
    """`force_residual` below 30 Hz, without phase: the answer to white noise is fast, a missing effect slow."""
    low_pass = signal.butter(2, min(0.9, 60.0 * data.period), output="sos")
    return signal.sosfiltfilt(low_pass, force_residual(machine, run, data), axis=0)


def variables(machine: Machine, run: PreparedRecording, data: Dataset) -> dict[str, Array]:
    """What a missing effect may follow, each (n,): positions and speeds along the fitted motion, inputs, the clock."""
    motion = predict(machine, run, "one_step", period=data.period, states=True)
    found = {f"position of {c}": motion.positions[0, :, i] for i, c in enumerate(machine.coordinate_names)}
    found |= {f"velocity of {c}": motion.velocities[0, :, i] for i, c in enumerate(machine.coordinate_names)}
    found |= {c: run.inputs[:, j] for j, c in enumerate(machine.input_channels)}
    return found | {"time": run.time_s}


def force_residual(machine: Machine, run: PreparedRecording, data: Dataset) -> Array:
    """Force (n, coordinates), own units, that would have to be added for the machine to follow the data.

    It is what the output injection puts into the velocities, a disturbance observer: right below its bandwidth.
    """
    count = len(machine.coordinates)
    readings = predict(machine, run, "one_step", period=data.period).readings[0]
    innovation = np.nan_to_num(run.outputs - readings)
    gains = observer_gains(machine, data.period)[count:]
    mass = np.array([c.mass for c in machine.coordinates])
    return innovation @ gains.T / data.period * mass


def missing_force(machine: Machine, data: Dataset) -> dict[str, Array]:
    """By coordinate: position, velocity and missing force (n, 3) along all runs, own units.

    The observer shows a missing force through its own two poles; they are taken off, up to 40 Hz.
    """
    count = len(machine.coordinates)
    slowness = 2.0 * data.period / np.maximum(observer_gains(machine, data.period)[:count].sum(axis=1), 1e-12)
    low_pass = signal.butter(2, min(0.9, 80.0 * data.period), output="sos")

    def of(run: PreparedRecording) -> Array:
        motion = predict(machine, run, "one_step", period=data.period, states=True)
        force = signal.sosfiltfilt(low_pass, force_residual(machine, run, data), axis=0)
        rate = np.gradient(force, run.time_s, axis=0)
        bend = np.gradient(rate, run.time_s, axis=0)
        whole = force + 2 * slowness * rate + slowness**2 * bend
        return np.stack([motion.positions[0], motion.velocities[0], whole], axis=2)

    parts = np.concatenate(list(map_runs(of, data)))
    return {name: parts[:, i] for i, name in enumerate(machine.coordinate_names)}


def depends_on(machine: Machine, data: Dataset) -> list[Dependence]:
    """What the force residual follows, best first: coordinates' positions and speeds, inputs, time."""
    force = np.concatenate([smooth_force_residual(machine, run, data) for run in data.runs])
    by_run = [variables(machine, run, data) for run in data.runs]
    found = [
        Dependence(name, coordinate, _explained(force[:, i], np.concatenate([v[name] for v in by_run])))
        for i, coordinate in enumerate(machine.coordinate_names)
        for name in by_run[0]
    ]
    return sorted((d for d in found if d.share > 0.05), key=lambda d: -d.share)


def _explained(values: Array, by: Array) -> float:
    """Share of the variance of `values` that its mean in bins of `by` explains (correlation ratio, Fisher 1925)."""
    total = float(np.var(values))
    if total == 0.0 or np.ptp(by) == 0.0:
        return 0.0
    ranks = np.argsort(np.argsort(by, kind="stable"), kind="stable")
    bins = ranks * _BINS // len(by)
    means = np.bincount(bins, values, _BINS) / np.maximum(np.bincount(bins, minlength=_BINS), 1)
    return float(np.var(means[bins]) / total)


def is_white(machine: Machine, data: Dataset) -> bool:
    """Whether the free run's residual is only the sensors' noise.

    Noise that is white has no memory: block means over 20 ms shrink with the root of their length.  A quantised channel
    is held to its quantum instead.
    """
    rows = max(2, round(0.02 / data.period))
    errors = [free_run_error(machine, run, data) for run in data.runs]
    for j in range(len(machine.sensors)):
        means = []
        for e in errors:
            column = e[: len(e) // rows * rows, j].reshape(-1, rows)
            column = column[np.isfinite(column).all(axis=1)]
            means.append(column.mean(axis=1) - column.mean() if len(column) else np.zeros(0))
        spread = float(np.sqrt(np.mean(np.concatenate(means) ** 2))) if any(map(len, means)) else 0.0
        if spread > 0.6 * data.noise[j]:
            return False
    return True


def force_error(machine: Machine, data: Dataset) -> float | None:
    """Relative error of the drives' force by inverse dynamics, |F_drive - F_model| / |F_drive|, over all runs.

    For machines whose coordinates are all driven and measured by themselves, without belts; None for others.
    Position is low-passed at 100 Hz without phase, differentiated centrally, forces decimated by ten, as the EMPS
    benchmark does.
    """
    direct = {s.coordinate: j for j, s in enumerate(machine.sensors) if len(s.row) == 1}
    driven = {d.coordinate for d in machine.drives}
    if machine.belts or driven != set(machine.coordinate_names) or not driven <= set(direct):
        return None
    wrong, size = 0.0, 0.0
    for run in data.runs:
        measured = run.outputs[:, [direct[name] for name in machine.coordinate_names]]
        if not np.all(np.isfinite(measured)):
            continue
        period = float(np.median(np.diff(run.time_s)))
        low_pass = signal.butter(4, min(0.9, 2 * _FORCE_CUTOFF * period), output="sos")
        q = signal.sosfiltfilt(low_pass, measured, axis=0)
        trim = int(0.05 / period)
        drive, model = (
            signal.decimate(f[trim:-trim], _FORCE_DECIMATION, ftype="fir", axis=0)
            for f in _forces(machine, run, q, np.gradient(q, run.time_s, axis=0))
        )
        wrong += float(np.sum((drive - model) ** 2))
        size += float(np.sum(drive**2))
    return float(np.sqrt(wrong / size)) if size else None


def _held_mean(time_s: Array, values: Array, late: float) -> Array:
    """Mean of an input, held from each row until the next, over one period around each row, `late` seconds ago (n,).

    A central difference sees the force around its row, half of which the row before still sets.
    """
    period = float(np.median(np.diff(time_s)))
    area = np.concatenate([[0.0], np.cumsum(values[:-1] * np.diff(time_s))])
    edges = np.concatenate([time_s - late - period / 2, time_s - late + period / 2])
    below, above = np.interp(edges, time_s, area).reshape(2, -1)
    return (above - below) / period


def _forces(machine: Machine, run: PreparedRecording, q: Array, v: Array) -> tuple[Array, Array]:
    """(drive, model) forces (n, coordinates) along a measured motion, with the machine's effects."""
    drive = np.zeros_like(q)
    for j, d in enumerate(machine.drives):
        i = machine.coordinate_names.index(d.coordinate)
        late = [e("delay") for e in machine.effects if e.definition.delay and e.site in (d.name, "drives")]
        drive[:, i] += d.gain * _held_mean(run.time_s, run.inputs[:, j], sum(late)) - d.back_emf * v[:, i]
    mass, viscous, coulomb = (
        np.array([getattr(c, key) for c in machine.coordinates]) for key in ("mass", "viscous", "coulomb")
    )
    model = mass * np.gradient(v, run.time_s, axis=0) + viscous * v + coulomb * np.sign(v)
    motion = MotionRecord(run.time_s, run.inputs, q, v, q @ machine.sensor_matrix.T)
    # What comes late is in the drives' force already.
    prompt = machine.replace(effects=tuple(e for e in machine.effects if not e.definition.delay))
    return drive, model - effects_force(prompt, motion)
