"""The next experiment: voltages on which two machines that explain the recordings equally well differ most.

A family of plain excitations (alternating steps, ramps through breakaway, staircases, chirps, random steps), along
every combination of the drives and at several amplitudes, is run through both machines.  Those that keep both inside
the travel compete; the difference that counts is what is left when the second machine's parameters have followed the
new run as far as the old ones let them (optimal discrimination in the sense of Atkinson and Fedorov 1975, linearised).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from ..atomic_files import whole_file
from ..dynamics.simulation import Motion, simulate_batch
from ..machine import AppliedEffect, Machine
from .candidates import effect_parameters
from .covariance import with_uncertainty
from .dataset import Dataset
from .estimation import Fit, fit
from .forward_selection import typical
from .prediction import POLISH_STEP, SEARCH_STEP
from .typical_scales import TypicalScales

Array = NDArray[np.float64]
FILE = "next_experiment.csv"
# Below this many standard deviations of the sensors' noise nothing is promised.
LEAST_SIGMA = 10.0
_SECONDS, _REST = 3.0, 0.15  # of a run, and at rest at either end
_AMPLITUDES = (0.05, 0.1, 0.2, 0.35, 0.6, 1.0)  # of the rated voltage
_MARGIN = 0.1  # of the travel, kept free at either end
_FINALISTS = 8
_STEP = 0.1  # forward difference, in standard deviations of a parameter


@dataclass(frozen=True)
class ExperimentDesign:
    """Voltages (n, drives) at times (n,), from rest at zero, and what they are expected to tell.

    separates: labels of the two effects.  sigma: root of the sum of squared differences of all readings, in units of
    the sensors' noise; rms: the same a reading; channel: the output that shows most of it.
    """

    separates: tuple[str, str]
    time_s: Array
    inputs: Array
    sigma: float
    rms: float
    channel: str

    @property
    def why(self) -> str:
        first, second = self.separates
        return (
            f"{first} and {second} explain the recordings equally well. On this run they should differ by "
            f"{self.sigma:.3g} standard deviations of the sensors' noise in all, {self.rms:.2g} a reading, most in "
            f"{self.channel}, even with the parameters of {second} refitted. Begin at rest at zero."
        )

    def as_json(self) -> dict[str, Any]:
        return {"separates": list(self.separates), "file": FILE, "why": self.why}

    def write(self, path: Path, machine: Machine) -> None:
        """Write the voltages in the recordings' format, whole."""
        with whole_file(path) as temporary:
            header = ",".join(["time_s", *machine.input_channels])
            table = np.column_stack([self.time_s, self.inputs])
            np.savetxt(temporary, table, fmt="%.9g", delimiter=",", header=header, comments="")


def design_discriminating_experiment(
    after: Fit, corrected: Machine, label: str, rivals: Sequence[AppliedEffect], data: Dataset
) -> ExperimentDesign | None:
    """The run that tells the effect `label` of the corrected machine from the best of its rivals, as they were fitted.

    after: the corrected machine's fit.  None where there is no rival, where one of the two changes the machine's
    tables, or where no run is sure to tell them apart.
    """
    present = {e.label: e for e in after.machine.effects}
    others = [r for r in rivals if r.label not in present and not r.definition.structure]
    if not others or present[label].definition.structure:
        return None
    rival = rival_of(after, label, others[0], data, typical(after, data))
    return next_experiment(corrected, rival, (label, others[0].label), data)


def rival_of(after: Fit, label: str, rival: AppliedEffect, data: Dataset, scale: TypicalScales) -> Machine:
    """The machine with a rival in the place of the effect `label`, everything fitted anew, with its covariance."""
    others = tuple(e for e in after.machine.effects if e.label != label)
    machine = after.machine.replace(effects=others, uncertainty=None).with_effects(rival)
    kept = [f for f in after.free if f.name in machine.parameters and not f.name.startswith(f"{label}.")]
    theta = [t for f, t in zip(after.free, after.theta, strict=True) if f in kept]
    names = {f.name for f in kept}
    own = [f for f in effect_parameters(rival, machine, scale) if f.name not in names]
    start = np.concatenate([theta, np.zeros(len(own))])
    return with_uncertainty(fit(machine, kept + own, data, after.mode, theta=start, longest_step=POLISH_STEP), data)


def next_experiment(first: Machine, second: Machine, labels: tuple[str, str], data: Dataset) -> ExperimentDesign | None:
    """The run that tells two fitted machines apart best, or None where none that was tried is sure to.

    data: the recordings behind both, for the sensors' noise, the sampling period and, where a machine declares no
    range, the travel.  Machines may differ in their effects, not in their sensors and drives.
    """
    rows = round(_SECONDS / data.period)
    time_s: Array = np.arange(rows, dtype=np.float64) * data.period
    waves = _waves(time_s, len(first.drives))
    rated = np.array([d.rated_voltage for d in first.drives])
    low, high = _reach(first, data)
    ranked: list[tuple[float, Array]] = []
    for amplitude in _AMPLITUDES:
        inputs = amplitude * rated * waves
        motions = [simulate_batch(m, time_s, inputs, longest_step=SEARCH_STEP) for m in (first, second)]
        inside = np.all([_inside(motion, low, high) for motion in motions], axis=0)
        difference = _difference(motions[0].readings, motions[1].readings, time_s, data)
        size = np.where(inside & np.isfinite(difference).all(axis=1), np.square(difference).sum(axis=1), 0.0)
        ranked += [(float(s), inputs[k]) for k, s in enumerate(size) if s >= LEAST_SIGMA**2]
    ranked.sort(key=lambda r: -r[0])
    finals = [(inputs, _adapted(first, second, time_s, inputs, data)) for _, inputs in ranked[:_FINALISTS]]
    if not finals:
        return None
    inputs, left = max(finals, key=lambda f: float(np.square(f[1]).sum()))
    by_channel = np.square(left).reshape(rows, -1).sum(axis=0)
    total = float(by_channel.sum())
    if not total >= LEAST_SIGMA**2:
        return None
    return ExperimentDesign(
        separates=labels,
        time_s=time_s,
        inputs=inputs,
        sigma=float(np.sqrt(total)),
        rms=float(np.sqrt(total / left.size)),
        channel=first.output_channels[int(np.argmax(by_channel))],
    )


def _waves(time_s: Array, drives: int) -> Array:
    """Excitations (B, n, drives) between -1 and 1: every form along every combination of the drives, up to its sign."""
    signs = [s for s in itertools.product((-1.0, 0.0, 1.0), repeat=drives) if next((v for v in s if v), 0.0) > 0.0]
    forms = _forms(time_s)
    together = [form[:, None] * np.array(s) for form in forms for s in signs]
    rng = np.random.default_rng(0)
    apart = [np.stack([_random(time_s, hold, rng) for _ in range(drives)], axis=1) for hold in (0.02, 0.05, 0.15, 0.4)]
    moving = (time_s >= _REST) & (time_s < time_s[-1] - _REST)
    return np.array(together + apart) * moving[:, None]


def _forms(time_s: Array) -> list[Array]:
    """Alternating steps, ramps, staircases of growing steps, slow sines and chirps, (n,) each.

    Phases are such that the stage goes as far one way as the other.
    """
    t, length = time_s - _REST, time_s[-1] - 2 * _REST
    steps = [np.sign(np.cos(2 * np.pi * t / period)) for period in (0.15, 0.4, 0.9, 1.8)]
    ramps = [signal.sawtooth(2 * np.pi * t / period + np.pi / 2, 0.5) for period in (0.6, 1.3)]
    stairs = [np.sign(np.cos(2 * np.pi * t / period)) * np.ceil(8 * t / length) / 8 for period in (0.3, 0.7)]
    sines = [np.cos(2 * np.pi * t / period) for period in (0.5, 1.3)]
    chirps = [signal.chirp(np.maximum(t, 0.0), 0.5, length, top, "logarithmic", phi=90) for top in (8.0, 50.0)]
    return steps + ramps + stairs + sines + chirps


def _random(time_s: Array, hold: float, rng: np.random.Generator) -> Array:
    levels = rng.uniform(-1.0, 1.0, int(time_s[-1] / hold) + 2)
    return levels[(time_s / hold).astype(int)]


def _reach(machine: Machine, data: Dataset) -> tuple[Array, Array]:
    """Where coordinates may go (coordinates,) each: their range, else half of what the recordings span either way."""
    low = np.full(len(machine.coordinates), -np.inf)
    high = -low
    for j, sensor in enumerate(machine.sensors):
        i = machine.coordinate_names.index(sensor.coordinate)
        coordinate = machine.coordinates[i]
        if coordinate.range is not None:
            low[i], high[i] = coordinate.range
        elif not machine.belts:
            readings = np.concatenate([run.outputs[:, j] for run in data.runs])
            known = readings[np.isfinite(readings)]
            span = float(np.ptp(known)) / abs(sensor.row[sensor.coordinate]) if len(known) else 0.0
            low[i], high[i] = -span / 2, span / 2
    return low, high


def _inside(motion: Motion, low: Array, high: Array) -> NDArray[np.bool_]:
    """Which runs (B,) keep a margin to the ends of the travel."""
    finite = np.isfinite(low)
    margin = _MARGIN * (high[finite] - low[finite])
    places = motion.positions[:, :, : len(low)][:, :, finite]
    return np.all((places > low[finite] + margin) & (places < high[finite] - margin), axis=(1, 2))


def _difference(one: Array, other: Array, time_s: Array, data: Dataset) -> Array:
    """Difference of readings (B, n, sensors), less what the sensors' zeros take up, in units of the noise, (B, n s)."""
    difference = one - other
    difference = difference - np.where(data.behind_belts, difference.mean(axis=1), difference[:, 0])[:, None, :]
    return (difference / data.noise).reshape(len(difference), -1)


def _adapted(first: Machine, second: Machine, time_s: Array, inputs: Array, data: Dataset) -> Array:
    """The difference (n sensors,) that is left when the second machine's parameters follow, within their covariance."""
    parameters, directions = _spread(second)
    table = np.vstack([parameters, parameters + _STEP * directions])
    truth = simulate_batch(first, time_s, inputs, longest_step=POLISH_STEP, states=False).readings
    readings = simulate_batch(second, time_s, inputs, parameters=table, longest_step=POLISH_STEP, states=False).readings
    missed = _difference(truth, readings, time_s, data)
    columns = (missed[1:] - missed[0]) / _STEP
    weight = np.linalg.inv(np.eye(len(columns)) + columns @ columns.T) @ (columns @ missed[0])
    return missed[0] - weight @ columns


def _spread(machine: Machine) -> tuple[Array, Array]:
    """A machine's parameters (P,) and the columns of a root of their covariance, (k, P)."""
    names = list(machine.parameters)
    values = np.array(list(machine.parameters.values()))
    if machine.uncertainty is None:
        return values, np.zeros((0, len(values)))
    size, axes = np.linalg.eigh(machine.uncertainty.covariance)
    directions = np.zeros((len(size), len(values)))
    directions[:, [names.index(n) for n in machine.uncertainty.names]] = (axes * np.sqrt(np.maximum(size, 0.0))).T
    return values, directions
