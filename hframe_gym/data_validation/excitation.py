"""What the inputs excite: amplitude over breakaway, both directions, frequencies, travel, speeds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..identification import Dataset
from ..machine import Machine, mode_frequencies
from ..recordings import Recording
from .findings import Finding
from .rigid_kinematics import directions, readings

_NARROW = 0.3  # of a coordinate's range: travel below that leaves what depends on position untold
_ONE_SIDED = 0.15  # share of the moving time in the rarer direction
_SLOW = 0.1  # of the top speed
_SLOW_SHARE = 0.05  # of the moving time that should be slow, for friction at low speed
_WINDOW = 0.02  # s, over which speed is measured

Array = NDArray[np.float64]


def inputs(recordings: Sequence[Recording], machine: Machine) -> list[Finding]:
    """Inputs that never move in a run, or go beyond the rated voltage."""
    found = []
    for recording in recordings:
        for channel, values in zip(machine.input_channels, recording.inputs.T, strict=True):
            if np.ptp(values) == 0.0:
                found.append(
                    Finding("advice", recording.name, channel, f"never moves, it is {values[0]:.4g} V throughout")
                )
    for j, d in enumerate(machine.drives):
        largest = max(float(np.abs(r.inputs[:, j]).max()) for r in recordings)
        if largest > 1.2 * d.rated_voltage:
            message = f"reaches {largest:.4g} V, rated {d.rated_voltage:.4g} V: other units, or a share in percent?"
            found.append(Finding("advice", "", d.channel, message))
    return found


def drive_over_breakaway(recording: Recording, machine: Machine) -> dict[str, Array]:
    """Force of all drives along each rigid direction over the dry friction met in it, (n,), by coordinate.

    Directions without friction are left out.
    """
    coulomb = np.array([c.coulomb for c in machine.coordinates])
    found = {}
    for name, motion in directions(machine).items():
        friction = float(np.abs(motion) @ coulomb)
        if friction > 0:
            gains = [d.gain * motion[machine.coordinate_names.index(d.coordinate)] for d in machine.drives]
            found[name] = recording.inputs @ np.array(gains) / friction
    return found


def amplitude(recordings: Sequence[Recording], machine: Machine) -> list[Finding]:
    """How far the drives go beyond breakaway in each direction, forwards and backwards."""
    ratios = [drive_over_breakaway(r, machine) for r in recordings]
    found = []
    for name in ratios[0]:
        push = np.concatenate([r[name] for r in ratios])
        high, low = float(push.max()), float(push.min())
        above = float(np.mean(np.abs(push) > 1.0))
        message = f"driven at {low:+.3g} to {high:+.3g} times breakaway, above it for {100 * above:.0f} % of the time"
        if max(high, -low) < 1.0:
            found.append(Finding("advice", "", name, f"{message}: it never breaks away"))
        elif min(high, -low) < 1.0:
            found.append(Finding("advice", "", name, f"{message}: in one direction only"))
        else:
            found.append(Finding("note", "", name, message))
    return found


def frequencies(recordings: Sequence[Recording], machine: Machine) -> list[Finding]:
    """Where the inputs' power lies, against the machine's lowest belt mode."""
    found = []
    modes = [float(f) for f in mode_frequencies(machine) if f > 0]
    for j, channel in enumerate(machine.input_channels):
        grids, powers = [], []
        for r in recordings:
            values = r.inputs[:, j] - r.inputs[:, j].mean()
            if len(values) > 8 and np.any(values):
                period = float(np.median(np.diff(r.time_s)))
                grids.append(np.fft.rfftfreq(len(values), period))
                powers.append(np.abs(np.fft.rfft(values * np.hanning(len(values)))) ** 2 * period / len(values))
        if not grids:
            continue
        order = np.argsort(frequency := np.concatenate(grids))
        share = np.cumsum(np.concatenate(powers)[order])
        half, most = (float(frequency[order][np.searchsorted(share, p * share[-1])]) for p in (0.5, 0.95))
        message = f"half its power below {half:.3g} Hz, 95 % below {most:.3g} Hz"
        near = float(np.interp(modes[0] * 0.7, frequency[order], share / share[-1])) if modes else 0.0
        if modes and 1 - near < 1e-3:
            message += f"; nearly nothing near the lowest belt mode ({modes[0]:.1f} Hz): belts are told badly"
            found.append(Finding("advice", "", channel, message))
        else:
            found.append(Finding("note", "", channel, message))
    return found


def coverage(data: Dataset, machine: Machine) -> list[Finding]:
    """Travel, speeds, directions and slow motion of each coordinate that leads a rigid direction."""
    found = []
    M = readings(machine)
    names = list(directions(machine))
    travels: list[list[Array]] = [[] for _ in names]
    speeds: list[list[Array]] = [[] for _ in names]
    for run in data.runs:
        known = np.isfinite(run.outputs).any(axis=0)
        if np.linalg.matrix_rank(M[known]) < len(names) or len(run.time_s) < 3:
            continue
        size = np.linalg.norm(M[known], axis=1)
        amount = (run.outputs[:, known] / size) @ np.linalg.pinv(M[known] / size[:, None]).T
        period = float(np.median(np.diff(run.time_s)))
        window = max(1, min(len(amount) - 1, round(_WINDOW / period)))
        elapsed = run.time_s[window:] - run.time_s[:-window]
        speed = (amount[window:] - amount[:-window]) / elapsed[:, None]
        for k in range(len(names)):
            travels[k].append(amount[:, k])
            speeds[k].append(speed[:, k])
    for k, name in enumerate(names):
        if travels[k]:
            found += _travel(name, np.concatenate(travels[k]), machine)
            found += _speed(name, np.concatenate(speeds[k]), machine)
    return found


def _travel(name: str, travel: Array, machine: Machine) -> list[Finding]:
    c = machine.coordinate(name)
    low, high = float(np.nanmin(travel)), float(np.nanmax(travel))
    message = f"travels from {low:.4g} to {high:.4g} {c.unit('position')}"
    if c.range is None:
        return [Finding("note", "", name, message)]
    share = (high - low) / (c.range[1] - c.range[0])
    if share > 1.05:
        return [Finding("advice", "", name, f"{message}, more than its declared range {list(c.range)}")]
    message += f", {100 * share:.0f} % of its range"
    if share < _NARROW:
        return [Finding("advice", "", name, f"{message}: what depends on position is told badly")]
    return [Finding("note", "", name, message)]


def _speed(name: str, speed: Array, machine: Machine) -> list[Finding]:
    speed = speed[np.isfinite(speed)]
    if len(speed) == 0:
        return []
    unit = machine.coordinate(name).unit("speed")
    top = float(np.percentile(np.abs(speed), 99))
    moving = np.abs(speed) > 0.01 * top
    if top == 0.0 or not moving.any():
        return []
    backward = float(np.mean(speed[moving] < 0))
    slow = float(np.mean(np.abs(speed[moving]) < _SLOW * top))
    found = [
        Finding("note", "", name, f"speeds to {top:.3g} {unit}, {100 * slow:.0f} % of the motion below a tenth of it")
    ]
    if min(backward, 1 - backward) < _ONE_SIDED:
        message = (
            f"moves {'backwards' if backward > 0.5 else 'forwards'} {100 * max(backward, 1 - backward):.0f} % of the"
        )
        found.append(Finding("advice", "", name, f"{message} time: friction that differs by direction is told badly"))
    if slow < _SLOW_SHARE:
        message = f"only {100 * slow:.1f} % of the motion is slow: friction at low speed is told badly"
        found.append(Finding("advice", "", name, message))
    return found


def all_of(recordings: Sequence[Recording], data: Dataset, machine: Machine) -> list[Finding]:
    """Everything there is to say of the excitation."""
    found = inputs(recordings, machine)
    if directions(machine):
        found += amplitude(recordings, machine) + coverage(data, machine)
    return found + frequencies(recordings, machine)
