"""Signs, swaps and units: the one mistake that would make the data fit the machine's geometry and its own simulation.

Geometry alone cannot tell swapped encoders from a laser that counts backwards; the simulated motion under the recorded
voltages can.  Every single mistake (a channel negated, two of a kind swapped) is undone in turn, and the one whose data
then agree best is named.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ..dynamics import rollout
from ..identification import Dataset
from ..identification.dataset import PreparedRecording
from ..machine import Machine
from .findings import Finding
from .rigid_kinematics import from_others, readings

_WINDOW = 0.02  # s, over which motion is compared
_ROWS = 20_000  # of a run: enough to tell a sign
_GOOD = 0.7  # agreement at which nothing is wrong
_MISFIT = 0.2  # relative error of the geometry at which nothing is wrong
_BETTER = 0.2  # by which undoing a mistake must improve the agreement
_TIE = 0.05
_RATIO = 0.02  # of the pulley's radius or gear
_FACTOR = 8.0  # between measured and simulated speed, beyond which a unit is wrong
_UNITS = ((1000.0, "millimetres under a name in m"), (57.3, "degrees under a name in rad"), (0.001, "in km or krad"))

Array = NDArray[np.float64]


def motion(outputs: Array, time_s: Array) -> Array:
    """Change (rows, channels) of each channel over a window: speed, with the noise averaged down."""
    period = float(np.median(np.diff(time_s)))
    window = max(1, min(len(time_s) - 1, round(_WINDOW / period)))
    return (outputs[..., window:, :] - outputs[..., :-window, :])[..., :: max(1, window // 4), :]


def mistakes(machine: Machine) -> tuple[dict[str, Array], dict[str, Array]]:
    """What may be wrong, by description: matrices that undo it, on the outputs and on the inputs."""
    kinds = [machine.coordinate(next(iter(s.row))).kind for s in machine.sensors]
    return (
        _undo(
            machine.output_channels,
            [k if len(s.row) == 1 else s.channel for k, s in zip(kinds, machine.sensors, strict=True)],
        ),
        _undo(machine.input_channels, ["drive"] * len(machine.drives)),
    )


def _undo(channels: Sequence[str], kinds: Sequence[str]) -> dict[str, Array]:
    found = {}
    for j, channel in enumerate(channels):
        negated = np.eye(len(channels))
        negated[j, j] = -1.0
        found[f"{channel} has its sign the wrong way round"] = negated
    for i, j in combinations(range(len(channels)), 2):
        if kinds[i] == kinds[j]:
            order = list(range(len(channels)))
            order[i], order[j] = j, i
            found[f"{channels[i]} and {channels[j]} are swapped"] = np.eye(len(channels))[order]
    return found


def wiring(data: Dataset, machine: Machine) -> list[Finding]:
    """The single swap or sign that would make measured and simulated motion agree, or that they do not."""
    outputs, inputs = mistakes(machine)
    variants = np.array([np.eye(len(machine.drives)), *inputs.values()])
    pairs = [
        (motion(r.outputs, r.time_s), motion(_simulated(machine, r, variants), r.time_s)) for r in map(_head, data.runs)
    ]
    measured = np.concatenate([m for m, _ in pairs])
    simulated = np.concatenate([s for _, s in pairs], axis=1)
    same = np.eye(len(machine.sensors))
    as_is = _score(measured, simulated[0], same, machine)
    agreement, misfit = _agreement(measured, simulated[0]), _misfit(measured, machine)
    if as_is is None or (agreement > _GOOD and misfit < _MISFIT):
        return []
    scores = {name: _score(measured, simulated[0], undo, machine) for name, undo in outputs.items()}
    scores |= {name: _score(measured, simulated[i + 1], same, machine) for i, name in enumerate(inputs)}
    known = {name: s for name, s in scores.items() if s is not None}
    best = max(known.values())
    if best > as_is + _BETTER:
        likely = [name for name, s in known.items() if s > best - _TIE]
        return [Finding("fault", "", "", " or ".join(likely))]
    if agreement < _GOOD / 2:
        message = (
            f"measured and simulated speeds hardly agree (correlation {agreement:.2f}): is this the right machine?"
        )
        return [Finding("advice", "", "", message)]
    return []


def sizes(data: Dataset, machine: Machine) -> list[Finding]:
    """Channels whose measured speed is many times, or a small part of, what the machine simulates: a wrong unit."""
    found = []
    one = np.eye(len(machine.drives))[None]
    pairs = [
        (motion(r.outputs, r.time_s), motion(_simulated(machine, r, one), r.time_s)[0]) for r in map(_head, data.runs)
    ]
    measured, simulated = (np.concatenate(side) for side in zip(*pairs, strict=True))
    for j, channel in enumerate(machine.output_channels):
        known = np.isfinite(measured[:, j])
        size = float(np.std(simulated[known, j])) if known.any() else 0.0
        if size > 0:
            factor = float(np.std(measured[known, j])) / size
            near = [what for unit, what in _UNITS if 1 / _FACTOR < factor / unit < _FACTOR]
            if factor > _FACTOR:
                message = f"moves {factor:.3g} times as fast as the machine simulates: {near[0] if near else 'gain?'}"
                found.append(Finding("fault", "", channel, message))
            elif factor < 1 / _FACTOR and not _still(measured[known, j], data, j):
                message = (
                    f"moves at {factor:.2g} of the speed that the machine simulates: wrong unit, gain, or blocked?"
                )
                found.append(Finding("fault", "", channel, message))
    return found


def ratios(data: Dataset, machine: Machine) -> list[Finding]:
    """Slope of each rotary channel over what the lasers make of it: a pulley's radius or a gear not as declared."""
    found = []
    for j, sensor in enumerate(machine.sensors):
        coordinate = machine.coordinate(next(iter(sensor.row)))
        if coordinate.kind != "rotary":
            continue
        pairs = []
        for run in data.runs:
            alone = run.outputs.copy()
            rotary = [
                k for k, s in enumerate(machine.sensors) if machine.coordinate(next(iter(s.row))).kind == "rotary"
            ]
            alone[:, rotary] = np.nan  # the lasers alone: encoders share the mistake
            expected = from_others(alone, j, machine)
            if expected is not None:
                both = np.column_stack([run.outputs[:, j], expected])
                pairs.append(both - np.nanmean(both, axis=0))  # whole travels: fast motion also stretches the belts
        rows = np.concatenate(pairs) if pairs else np.zeros((0, 2))
        rows = rows[np.isfinite(rows).all(axis=1)]
        if len(rows) < 10 or not np.any(rows[:, 1]):
            continue
        slope = float(rows[:, 0] @ rows[:, 1] / (rows[:, 1] @ rows[:, 1]))
        if _RATIO < abs(slope - 1) < 0.5 and _correlation(rows[:, 0], rows[:, 1]) > 0.9:
            message = (
                f"turns {100 * (slope - 1):+.1f} % against the carriage: a radius of {coordinate.radius / slope:.4g} m "
                f"in place of {coordinate.radius:.4g} m, or a gear so much off"
            )
            found.append(Finding("fault", "", sensor.channel, message))
    return found


def _head(run: PreparedRecording) -> PreparedRecording:
    if len(run.time_s) <= _ROWS:
        return run
    rows = slice(_ROWS)
    return dataclasses.replace(run, time_s=run.time_s[rows], inputs=run.inputs[rows], outputs=run.outputs[rows])


def _simulated(machine: Machine, run: PreparedRecording, variants: Array) -> Array:
    """Outputs (variants, n, sensors) of the free run with the inputs transformed by each matrix.

    From the middle of the workspace: a position in the wrong unit would be far outside.
    """
    inputs = np.einsum("vij,nj->vni", variants, run.inputs)
    return rollout(machine, run.time_s, inputs, longest_step=1e-3) @ machine.sensor_matrix.T


def _score(measured: Array, simulated: Array, undo: Array, machine: Machine) -> float | None:
    """Agreement with the simulation less the geometry's misfit, one mistake undone; None where nothing moves."""
    known = np.isfinite(measured).any(axis=0)
    blank = np.abs(undo) @ (~known).astype(float) > 0
    repaired = np.where(blank, np.nan, np.nan_to_num(measured) @ undo.T)
    repaired[~np.isfinite(measured).all(axis=1) & known.all()] = np.nan
    agreement = _agreement(repaired, simulated)
    return None if np.isnan(agreement) else agreement - _misfit(repaired, machine)


def _agreement(measured: Array, simulated: Array) -> float:
    """Mean correlation of measured and simulated speed over the channels that move."""
    found = []
    for z, s in zip(measured.T, simulated.T, strict=True):
        known = np.isfinite(z) & np.isfinite(s)
        if known.sum() > 10 and np.any(z[known]) and np.any(s[known]):
            found.append(_correlation(z[known], s[known]))
    return float(np.mean(found)) if found else float("nan")


def _correlation(a: Array, b: Array) -> float:
    """Of two speeds around zero, not around their means: a constant speed has a sign too."""
    return float(a @ b / np.sqrt((a @ a) * (b @ b)))


def _misfit(measured: Array, machine: Machine) -> float:
    """Share of the measured motion, in travel, that no rigid motion explains."""
    M = readings(machine)
    known = np.isfinite(measured).any(axis=0) & (np.linalg.norm(M, axis=1) > 0)
    rows = measured[:, known]
    rows = rows[np.isfinite(rows).all(axis=1)]
    size = np.linalg.norm(M[known], axis=1)
    scaled = rows / size
    basis = M[known] / size[:, None]
    left = scaled - scaled @ np.linalg.pinv(basis).T @ basis.T
    total = float(np.sum(scaled**2))
    return float(np.sqrt(np.sum(left**2) / total)) if total else 0.0


def _still(values: Array, data: Dataset, j: int) -> bool:
    return bool(np.ptp(values) < max(10 * data.noise[j], 3 * data.quantum[j]))
