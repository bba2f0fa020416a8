"""Design the next experiment: voltages for which two machines that fit equally predict different motions.

Many excitations are simulated with both machines: alternating steps, ramps through breakaway, staircases,
sines, chirps and random steps, along every combination of the drives and at several amplitudes. Excitations
that drive a machine out of its travel are discarded. The others are compared by the difference of the
predictions that remains when the second machine's parameters adapt to the new run as far as their covariance
allows (linearized optimal discrimination).

References:
    Atkinson and Fedorov (1975), "The design of experiments for discriminating between two rival models".
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from ....arrays import Array
from ....dynamics import simulate_batch
from ....dynamics.simulation import Motion
from ....files import atomic_file
from ....machine import AppliedEffect, Machine
from ....preparation.dataset import Dataset
from ....recordings import recorded_commands
from ...fit.covariance import with_uncertainty
from ...fit.estimation import Fit
from ...predict.linearization import forward_differences
from ...predict.prediction import POLISH_STEP, SEARCH_STEP
from ...propose.trial_fits import fit_in_place_of

FILE = "next_experiment.csv"
# Difference of the predictions, in standard deviations of the sensors' noise, below which no experiment is
# proposed.
MINIMUM_SIGMA = 10.0
# Standard deviations above which the expected difference is stated as "clearly": the models are not as exact
# as a larger number would promise, and where one of them is near instability the number grows without limit.
CLEAR_SIGMA = 100.0
_DURATION_S, _REST_S = 3.0, 0.15  # of the run, and at rest at either end
_AMPLITUDES = (0.05, 0.1, 0.2, 0.35, 0.6, 1.0)  # fractions of the rated voltage
_TRAVEL_MARGIN = 0.1  # fraction of the travel that remains free at either end
_FINALISTS = 8
_DIFFERENCE_STEP = 0.1  # in standard deviations of a parameter
_HOLD_TIMES_S = (0.02, 0.05, 0.15, 0.4)  # of random steps


@dataclass(frozen=True)
class ExperimentDesign:
    """Voltages of the proposed run and the expected difference between the two models' predictions.

    Attributes:
        separates: Labels (name@site) of the two effects between which the run decides.
        time_s: Sample times, s, shape (n,).
        inputs: Inputs of the drives, in their units, shape (n, drives); the run starts at rest at zero.
        sigma: Root of the sum of squared differences of all predicted values, in standard deviations of the
            noise.
        rms: Root mean square of the same differences per predicted value, in standard deviations of the
            noise.
        channel: Output channel with the largest sum of squared differences.
    """

    separates: tuple[str, str]
    time_s: Array
    inputs: Array
    sigma: float
    rms: float
    channel: str

    @property
    def why(self) -> str:
        """Sentences for the report: which effects the run distinguishes, and how clearly."""
        first, second = self.separates
        size = (
            f"by {self.sigma:.3g} standard deviations of the sensors' noise in total "
            f"({self.rms:.2g} rms per measured value, most in {self.channel})"
        )
        if self.sigma > CLEAR_SIGMA:
            size = (
                f"clearly (by more than {CLEAR_SIGMA:.0f} standard deviations "
                f"of the sensors' noise in total, most in {self.channel})"
            )
        return (
            f"{first} and {second} explain the recordings equally well. On this run their predictions "
            f"should differ {size}, even after a refit of the parameters of {second}. Start at rest at zero."
        )

    def write(self, path: Path, machine: Machine) -> None:
        """Write the sample times, s, and commands as a CSV file with columns time_s and one per channel.

        Args:
            path: File to write, which replaces an existing one only when it is complete.
            machine: Machine whose drives name the input columns.

        Raises:
            OSError: If the file cannot be written.
        """
        with atomic_file(path) as file:
            header = ",".join(["time_s", *machine.input_channels])
            table = np.column_stack([self.time_s, recorded_commands(machine, self.inputs)])
            np.savetxt(file, table, fmt="%.9g", delimiter=",", header=header, comments="")


def design_discriminating_experiment(
    current: Fit, corrected: Machine, label: str, rivals: Sequence[AppliedEffect], data: Dataset
) -> ExperimentDesign | None:
    """Design a run whose measurements decide between an identified effect and its best rival.

    A rival is another effect that explains the same data equally well. The best one takes the place of the
    effect in a second machine, which is fitted. Steps, sines and other voltages are simulated with both
    machines. The chosen run is the one on which their predictions differ most (`separate_machines`).

    Args:
        current: Fit of the machine with all selected effects, among them the identified one.
        corrected: The same machine with the covariance of its parameters.
        label: Label (name@site) of the identified effect.
        rivals: Rivals with fitted parameters, best first. Those that add coordinates (structural effects),
            those that the machine already has, and those that no recording can distinguish are not
            considered.
        data: Recordings that were fitted. They also supply the noise and the sampling period of the run.

    Returns:
        Design of the run with its inputs (`ExperimentDesign`). None if the identified effect is structural,
        if it is not among the fitted effects (such as the limited range of a sensor, which is read from the
        measurements), if no rival remains, if the machine with the rival diverges, or if `separate_machines`
        finds no run.
    """
    present = {e.label: e for e in current.machine.effects}
    effect = present.get(label)
    if effect is None:
        return None
    alternatives = [
        r
        for r in rivals
        if r.label not in present
        and not r.definition.structure
        and not effect.definition.is_equivalent(current.machine, effect.site, r.label)
    ]
    if not alternatives or effect.definition.structure:
        return None
    rival_fit = fit_in_place_of(current, label, alternatives[0], data)
    if not math.isfinite(rival_fit.cost):
        return None
    return separate_machines(
        corrected, with_uncertainty(rival_fit, data), (label, alternatives[0].label), data
    )


def separate_machines(
    first: Machine, second: Machine, labels: tuple[str, str], data: Dataset
) -> ExperimentDesign | None:
    """Design the run on which the predictions of two machines differ most.

    Steps, ramps, staircases, sines, chirps and random steps of voltage are simulated with both machines, at
    several amplitudes. Runs that leave the permitted travel are discarded. The parameters of the second
    machine adapt to each run within their uncertainty; only the difference that remains counts.

    Args:
        first: One machine.
        second: The other machine, with its uncertainty. The machines may differ in their effects, but not in
            their sensors and drives.
        labels: Labels (name@site) of the effects that distinguish the first and the second machine.
        data: Recordings that both were fitted to. They supply the sensors' noise, the sampling period and,
            for a coordinate without a declared range, the permitted travel.

    Returns:
        Design of the run with the largest difference. None if there is no run within the travel for which
        `ExperimentDesign.sigma`, the difference in standard deviations, reaches 10.
    """
    rows = round(_DURATION_S / data.period)
    time_s: Array = np.arange(rows, dtype=np.float64) * data.period
    # The voltages with the largest differences are compared by the part that a refit of the second machine
    # leaves.
    finalists = [
        (inputs, difference)
        for inputs in _largest_differences(first, second, time_s, data)
        if (difference := _unexplained_difference(first, second, time_s, inputs, data)) is not None
    ]
    if not finalists:
        return None
    inputs, difference = max(finalists, key=lambda f: float(np.square(f[1]).sum()))
    by_channel = np.square(difference).reshape(rows, -1).sum(axis=0)
    total = float(by_channel.sum())
    if not total >= MINIMUM_SIGMA**2:
        return None
    return ExperimentDesign(
        separates=labels,
        time_s=time_s,
        inputs=inputs,
        sigma=float(np.sqrt(total)),
        rms=float(np.sqrt(total / difference.size)),
        channel=first.output_channels[int(np.argmax(by_channel))],
    )


def _largest_differences(first: Machine, second: Machine, time_s: Array, data: Dataset) -> list[Array]:
    """Return the inputs (n, drives) with the largest differences that keep both machines in the travel."""
    waves = _excitations(time_s, len(first.drives))
    rated = np.array([d.rated_voltage for d in first.drives])
    low, high = _travel(first, data)
    ranked: list[tuple[float, Array]] = []
    for amplitude in _AMPLITUDES:
        inputs = amplitude * rated * waves  # (batch, n, drives)
        motions = [simulate_batch(m, time_s, inputs, longest_step=SEARCH_STEP) for m in (first, second)]
        inside = np.all([_stays_inside(motion, low, high) for motion in motions], axis=0)
        difference = _difference(motions[0].readings, motions[1].readings, data)
        admissible = inside & np.isfinite(difference).all(axis=1)
        squares = np.square(np.where(admissible[:, None], difference, 0.0)).sum(axis=1)
        ranked += [(float(s), inputs[k]) for k, s in enumerate(squares) if s >= MINIMUM_SIGMA**2]
    ranked.sort(key=lambda r: -r[0])
    return [inputs for _, inputs in ranked[:_FINALISTS]]


def _excitations(time_s: Array, drives: int) -> Array:
    """Return excitations (batch, n, drives) in [-1, 1]: every form along all combinations of drives."""
    directions = [
        signs
        for signs in itertools.product((-1.0, 0.0, 1.0), repeat=drives)
        if next((sign for sign in signs if sign), 0.0) > 0.0
    ]
    common = [form[:, None] * np.array(signs) for form in _forms(time_s) for signs in directions]
    rng = np.random.default_rng(0)
    independent = [
        np.stack([_random_steps(time_s, hold, rng) for _ in range(drives)], axis=1) for hold in _HOLD_TIMES_S
    ]
    moving = (time_s >= _REST_S) & (time_s < time_s[-1] - _REST_S)
    return np.array(common + independent) * moving[:, None]


def _forms(time_s: Array) -> list[Array]:
    """Return alternating steps, ramps, staircases of growing steps, slow sines and chirps, shape (n,) each.

    Their phases let the stage travel equally far to both sides.
    """
    t, length = time_s - _REST_S, time_s[-1] - 2 * _REST_S
    steps = [np.sign(np.cos(2 * np.pi * t / period)) for period in (0.15, 0.4, 0.9, 1.8)]
    ramps = [signal.sawtooth(2 * np.pi * t / period + np.pi / 2, 0.5) for period in (0.6, 1.3)]
    stairs = [np.sign(np.cos(2 * np.pi * t / period)) * np.ceil(8 * t / length) / 8 for period in (0.3, 0.7)]
    sines = [np.cos(2 * np.pi * t / period) for period in (0.5, 1.3)]
    chirps = [
        signal.chirp(np.maximum(t, 0.0), 0.5, length, top, "logarithmic", phi=90) for top in (8.0, 50.0)
    ]
    return steps + ramps + stairs + sines + chirps


def _random_steps(time_s: Array, hold: float, rng: np.random.Generator) -> Array:
    """Return uniform random levels in [-1, 1], shape (n,), each held for `hold` seconds."""
    levels = rng.uniform(-1.0, 1.0, int(time_s[-1] / hold) + 2)
    return levels[(time_s / hold).astype(int)]


def _travel(machine: Machine, data: Dataset) -> tuple[Array, Array]:
    """Return lower and upper limits of coordinates, (coordinates,) each, infinite where there is none.

    A coordinate without a declared range may move half of the recorded span to either side.
    """
    low = np.full(len(machine.coordinates), -np.inf)
    high = -low
    for j, sensor in enumerate(machine.sensors):
        if not sensor.of_position:
            continue
        i = machine.coordinate_names.index(sensor.coordinate)
        coordinate = machine.coordinates[i]
        if coordinate.range is not None:
            low[i], high[i] = coordinate.range
        elif not machine.belts:
            values = np.concatenate(data.measured_values(j))
            span = float(np.ptp(values)) / abs(sensor.row[sensor.coordinate]) if len(values) else 0.0
            low[i], high[i] = -span / 2, span / 2
    return low, high


def _stays_inside(motion: Motion, low: Array, high: Array) -> NDArray[np.bool_]:
    """Return which motions of a batch keep a margin to the limits of the travel, shape (batch,)."""
    limited = np.isfinite(low)
    margin = _TRAVEL_MARGIN * (high[limited] - low[limited])
    positions = motion.positions[:, :, : len(low)][:, :, limited]
    inside = (positions > low[limited] + margin) & (positions < high[limited] - margin)
    return np.all(inside, axis=(1, 2))


def _difference(first: Array, second: Array, data: Dataset) -> Array:
    """Return prediction differences (batch, n, sensors) in units of noise, shape (batch, n * sensors).

    The part that the unknown zeros of the sensors absorb is removed.
    """
    difference = first - second
    zeros = np.where(data.behind_belts, difference.mean(axis=1), difference[:, 0])
    difference = difference - (zeros if data.has_zero is None else zeros * data.has_zero)[:, None, :]
    return (difference / data.noise).reshape(len(difference), -1)


def _unexplained_difference(
    first: Machine, second: Machine, time_s: Array, inputs: Array, data: Dataset
) -> Array | None:
    """Return the difference (n * sensors,) that remains when the second machine's parameters adapt.

    The parameters are linear combinations with unit prior variance, so the prior's precision is the identity.
    None if a machine with slightly different parameters diverges.
    """
    parameters, directions = _covariance_root(second)
    table = np.vstack([parameters, parameters + _DIFFERENCE_STEP * directions])
    reference = simulate_batch(first, time_s, inputs, longest_step=POLISH_STEP, states=False).readings
    predicted = simulate_batch(
        second, time_s, inputs, parameters=table, longest_step=POLISH_STEP, states=False
    ).readings
    differences = _difference(reference, predicted, data)  # (k + 1, n * sensors)
    if not np.isfinite(differences).all():
        return None
    return after_adaptation(forward_differences(differences, _DIFFERENCE_STEP), differences[0])


def after_adaptation(jacobian: Array, difference: Array) -> Array:
    """Return the difference of two predictions that remains after one machine's parameters adapt to it.

    They adapt so that the squared remaining difference plus the squared change of the parameters, in standard
    deviations, is smallest.

    Args:
        jacobian: Change of the difference by one standard deviation in each direction of the covariance, in
            standard deviations of the noise, dimensionless, shape (k, values).
        difference: Difference, in the same unit, dimensionless, shape (values,).

    Returns:
        Remaining difference, dimensionless, shape (values,).
    """
    # Of full rank by the identity, however much a machine close to instability responds.
    k = len(jacobian)
    rows, right_side = np.vstack([jacobian.T, np.eye(k)]), np.append(difference, np.zeros(k))
    adaptation = np.linalg.lstsq(rows, right_side, rcond=None)[0]
    remaining: Array = difference - adaptation @ jacobian
    return remaining


def _covariance_root(machine: Machine) -> tuple[Array, Array]:
    """Return a machine's parameters (P,) and a root of their covariance, one direction per row (k, P)."""
    names = list(machine.parameters)
    values = np.array(list(machine.parameters.values()))
    if machine.uncertainty is None:
        return values, np.zeros((0, len(values)))
    variances, axes = np.linalg.eigh(machine.uncertainty.covariance)
    directions = np.zeros((len(variances), len(values)))
    columns = [names.index(name) for name in machine.uncertainty.names]
    directions[:, columns] = (axes * np.sqrt(np.maximum(variances, 0.0))).T
    return values, directions
