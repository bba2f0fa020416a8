"""Rank the causes on which the force that a machine lacks, or the disagreement of its sensors, depends: a hint.

The library of effects is finite; what a machine really lacks may be outside it. Each cause here is weaker than an
effect, and wider: a curve of unknown shape over one variable (`variables_of_motion`), which acts at one component. It
may multiply a direction of motion, a current or a voltage, as friction, torque and supply voltage do: friction that
depends on the position of another axis is a curve over that position, multiplied by the direction.

What refitted parameters can absorb (forces in proportion to accelerations, velocities, directions, voltages) is removed
from force and curves alike. The curve is fitted to all runs but one and then compared with the force in that run; the
sum over all runs is what the cause explains. Chance therefore explains nothing on average, however many causes there
are, and causes at different components compete for the same force: that on a motor acts on both carriages in one ratio.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from ...arrays import Array
from ...machine import HOOKS, AppliedEffect, Machine, argument_names
from ...machine.motion import rigid_motions
from ...preparation.dataset import Dataset
from ..fit.channel_errors import white_sensors
from ..fit.missing_force import (
    Dependence,
    MissingMotion,
    correction_filters,
    low_pass,
    missing_motions,
    motion_directions,
    sensor_combinations,
    smooth_sign,
    variables_of_motion,
)
from ..judge import cause as judge
from ..predict.free_parameters import typical_force

_MOST_ROWS = 10_000  # that are compared; of longer recordings fewer per second
# Fraction of the typical force; a smaller missing force is a rounding error, as on an axis at rest.
_ROUNDING_FORCE = 1e-9
_FORCE_HZ = 150.0  # rate at which forces below 30 Hz are compared
_DISAGREEMENT_HZ = 500.0  # rate at which the sensors are compared, whose noise needs no filter
_PIECES = 6  # fewer runs are divided into at least that many pieces, each of which is left out once
_KNOTS, _KNOTS_OF_FACTOR = 13, 6  # of a curve; of one that multiplies a direction, current or voltage
# Of the mean square of a curve's pieces: pieces that the other runs do not excite get no force, and the more noise
# there is, the flatter is the best curve.
_RIDGES = (1e-4, 0.03, 0.3)
_PLAIN = ("position", "velocity", "current")  # variables that come before others which explain about as much
_RESTING = 0.01  # of the rms speed of each motion; a machine at rest shows no force
_RESTING_S = 0.025  # rows that are that close to motion count as motion, so that breakaways do
_HIGHEST_HZ = 25.0  # frequency of a periodic force in slow motion; a filter removes faster ones
_SLOW_MOTION = 0.2  # fraction of the rows of a motion that are slower
# Periods of a periodic cause in the travel, at least; the most, in multiples of that.
_PERIODS, _MOST_PERIODS = 2.0, 200.0
_SCREENED_ROWS = 1500  # among which the period is searched for
_RESONANCES_HZ = np.geomspace(1.0, 25.0, 30)
_DAMPING = 0.03  # of a resonance: rubber and steel have 0.01 to 0.1
_LAGS_S = (0.005, 0.02, 0.05)  # of what belts do after a change of tension

Columns = Array  # curve at the rows of all runs, one column per coefficient, shape (rows, k)


class _Cause(NamedTuple):
    """Cause that may explain the missing force or the disagreement.

    Attributes:
        component: Where it acts.
        variable: Name of its variable.
        coordinate: The component's coordinate.
        parts: Its curves: forces on a coordinate (index) or errors of a sensor (index); with one set of coefficients.
            With an index of None, all channels have the curve, each with other coefficients.
    """

    component: str
    variable: str
    coordinate: str
    parts: tuple[tuple[int | None, Columns], ...]


class _Signals:
    """Everything that causes depend on, at the rows of all runs that are compared.

    Args:
        machine: Machine that predicts.
        data: Measured runs.
        motions: What its predictions say about each run.
        rate_hz: Rate of the rows that are compared, Hz.
        filtered: Whether forces below 30 Hz are compared.
    """

    def __init__(
        self, machine: Machine, data: Dataset, motions: list[MissingMotion], rate_hz: float, *, filtered: bool
    ):
        self.period, self._filtered = data.period, filtered
        by_run = [
            variables_of_motion(machine, run, data, motion.positions, motion.velocities)
            for run, motion in zip(data.runs, motions, strict=True)
        ]
        self._variables = {name: np.concatenate([of_run[name] for of_run in by_run]) for name in by_run[0]}
        ends = np.cumsum([len(run.time_s) for run in data.runs])
        self._slices = [slice(end - len(run.time_s), end) for end, run in zip(ends, data.runs, strict=True)]
        step = max(1, round(1.0 / (rate_hz * data.period)), ends[-1] // _MOST_ROWS)
        directions = motion_directions(machine, data)
        self._kept = [_moving_rows(motion.velocities @ directions.T, data.period, step) for motion in motions]

    @property
    def count(self) -> int:
        """Number of rows that are compared."""
        return sum(map(len, self._kept))

    def __getitem__(self, name: str) -> Array:
        """Return a variable at all rows of all runs, shape (rows,)."""
        return self._variables[name]

    def compared(self, columns: Columns, lag: tuple[Array, Array] | None = None) -> Columns:
        """Return columns (rows of all runs, k) at the rows that are compared, after a filter and below 30 Hz if so."""
        by_run = [columns[of_run] for of_run in self._slices]
        if lag is not None:
            by_run = [signal.lfilter(*lag, values, axis=0) for values in by_run]
        return self.thinned(by_run)

    def thinned(self, by_run: list[Array]) -> Array:
        """Return arrays by run, of which the first axis is the rows, at the rows that are compared."""
        if self._filtered:
            by_run = [low_pass(values, self.period) for values in by_run]
        return np.concatenate([values[rows] for values, rows in zip(by_run, self._kept, strict=True)])

    def by_run(self, name: str) -> list[Array]:
        """Return a variable by run."""
        return [self._variables[name][rows] for rows in self._slices]

    def filtered(self, name: str, filter_of_run: Callable[[Array], Array]) -> Array:
        """Return the output of a filter, which starts anew in each run, shape (rows, k)."""
        return np.concatenate([filter_of_run(values) for values in self.by_run(name)])

    def pieces(self) -> NDArray[np.int64]:
        """Return the first compared row of each piece: runs, or parts of runs if there are few."""
        each = max(1, -(-_PIECES // len(self._kept)))
        firsts, first = [], 0
        for rows in self._kept:
            firsts += [first + len(rows) * part // each for part in range(each)]
            first += len(rows)
        return np.array(firsts)

    def run_constants(self) -> Array:
        """Return one column per run that is 1 in it and 0 elsewhere, at the compared rows."""
        lengths = [len(rows) for rows in self._kept]
        return np.repeat(np.eye(len(lengths)), lengths, axis=0)


class _Evidence:
    """Forces or disagreements along all runs, what refitted parameters absorb of them, and causes to compare.

    Args:
        signals: Variables, and the rows that are compared.
        values: Forces or disagreements at these rows, shape (n, channels).
        noise: The part of them that noise causes, same shape.
        prompt: The same values without the lag of `filters`, to find periods and resonances, same shape.
        absorbed: Signals of which any linear combination is removed from each channel, at all rows, shape (rows, k).
        constants: The same, at the compared rows, shape (n, l).
        directions: Value of each channel per unit of a cause at each index, shape (channels, indices).
        filters: Numerator and denominator of the filter by which each channel follows causes; None if at once.
    """

    def __init__(
        self,
        signals: _Signals,
        values: Array,
        noise: Array,
        prompt: Array,
        absorbed: Array,
        constants: Array,
        directions: Array,
        filters: list[tuple[Array, Array]] | None,
    ):
        # At the least a millionth of the values: data without noise have none.
        scale = np.maximum(noise.std(axis=0), 1e-6 * values.std(axis=0) + np.finfo(float).tiny)
        self.signals, self._filters = signals, filters
        self._directions, self._pieces = directions / scale[:, None], signals.pieces()
        self._bases = [
            _orthonormal(np.hstack([self._compared(channel, absorbed), constants]))
            for channel in range(len(scale))
        ]
        self._values = self._without_absorbed(values / scale)
        self._prompt = self._without_absorbed(prompt / scale)
        self._noise = self._without_absorbed(noise / scale)
        by_noise = float(np.sum(self._noise**2))
        self.total = float(np.sum(self._values**2))
        self.beyond_noise = judge.beyond_noise(self.total, by_noise)

    def _compared(self, channel: int, columns: Columns) -> Columns:
        """Return columns (rows, k) as a channel shows them, at the compared rows."""
        return self.signals.compared(columns, self._filters[channel] if self._filters else None)

    def _without_absorbed(self, values: Array) -> Array:
        """Return values (n, channels) without what the refitted parameters absorb."""
        columns = [values[:, c] - basis @ (basis.T @ values[:, c]) for c, basis in enumerate(self._bases)]
        return np.stack(columns, axis=1)

    def direction(self, index: int) -> Array:
        """Return the value of each channel per unit of a cause at an index, shape (channels,)."""
        return self._directions[:, index]

    def target(self, index: int) -> Array:
        """Return what a cause at an index has to explain, without lag, shape (n,)."""
        return self._prompt @ self.direction(index)

    def explained(self, cause: _Cause) -> tuple[float, float, float]:
        """Compare a cause with the values.

        Args:
            cause: The cause.

        Returns:
            Reduction of the sum of squares in pieces to which the cause was not fitted.
            The same minus its standard error, from the differences between the pieces.
            Fraction of the values beyond noise that it explains: fitted to all pieces, minus what it explains of noise.
        """
        channels = self._values.shape[1]
        designs: list[Array] = []
        for channel, basis in enumerate(self._bases):
            parts = []
            for index, columns in cause.parts:
                compared = self._compared(channel, columns)
                if index is not None:
                    parts.append(self._directions[channel, index] * compared)
                else:
                    parts.append(np.kron(np.eye(channels)[channel], compared))
            design = np.sum(parts, axis=0)
            designs.append(design - basis @ (basis.T @ design))
        squares, products = [], []
        for first, last in zip(self._pieces, [*self._pieces[1:], len(self._values)], strict=True):
            rows = slice(first, last)
            squares.append(np.sum([d[rows].T @ d[rows] for d in designs], axis=0))
            products.append(
                np.sum([d[rows].T @ self._values[rows, c] for c, d in enumerate(designs)], axis=0)
            )
        all_squares, all_products = np.sum(squares, axis=0), np.sum(products, axis=0)
        of_noise = np.sum([d.T @ self._noise[:, c] for c, d in enumerate(designs)], axis=0)
        best, certain, fraction = 0.0, 0.0, 0.0
        for relative in _RIDGES:
            ridge = relative * np.trace(all_squares) / len(all_squares) * np.eye(len(all_squares))
            if ridge[0, 0] <= 0.0:
                break
            reductions = []
            for square, product in zip(squares, products, strict=True):
                weights = np.linalg.solve(all_squares - square + ridge, all_products - product)
                reductions.append(float(2.0 * weights @ product - weights @ square @ weights))
            reduction, error = float(np.sum(reductions)), float(np.std(reductions) * np.sqrt(len(reductions)))
            if reduction > best:
                inverse = np.linalg.inv(all_squares + ridge)
                squared = float(all_products @ inverse @ all_products - of_noise @ inverse @ of_noise)
                best, certain, fraction = reduction, reduction - error, squared / self.beyond_noise
        return best, certain, min(max(fraction, 0.0), 1.0)


def _orthonormal(columns: Array) -> Array:
    """Return an orthonormal basis of columns, shape (n, rank)."""
    size = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), np.finfo(float).tiny)
    basis, singular, _ = np.linalg.svd(columns / size, full_matrices=False)
    return np.asarray(basis[:, singular > 1e-6 * singular[0]])


def _moving_rows(velocities: Array, period: float, step: int) -> NDArray[np.int64]:
    """Return every step-th row in which the machine moves along a motion, (n, motions), or shortly before or after."""
    speeds = np.abs(velocities)
    moving = (speeds > _RESTING * np.sqrt(np.mean(speeds**2, axis=0))).any(axis=1)
    near = np.convolve(moving, np.ones(2 * round(_RESTING_S / period) + 1), mode="same") > 0.0
    rows = np.arange(0, len(near), step)
    return np.asarray(rows[near[rows]])


def rank_dependences(machine: Machine, data: Dataset) -> list[Dependence]:
    """Rank the causes of the force that the model lacks and of what the sensors disagree about, as a hint.

    Args:
        machine: Machine that predicts, with its parameters fitted.

    Returns:
        Variables with their components that explain more than 5 % of the force, or of the disagreement, beyond noise.
        Sorted by the fraction, noise included, that they explain for certain (one standard error) in runs to which they
        were not fitted, largest first. A coordinate has none if its sensors show only white noise in a simulation, or
        if it never moves.
    """
    white = white_sensors(machine, data)
    deviating = _deviating(machine, white)
    if not deviating.any():
        return []
    motions = missing_motions(machine, data)
    if not all(np.isfinite(array).all() for motion in motions for array in motion):
        return []  # the prediction diverges
    signals = _Signals(machine, data, motions, _FORCE_HZ, filtered=True)
    if not signals.count:
        return []
    ranked: list[tuple[float, Dependence]] = []

    def rank(evidence: _Evidence, causes: Iterator[_Cause]) -> None:
        for cause in causes:
            plain = cause.variable.startswith(_PLAIN)
            found = judge.CauseEvidence(*evidence.explained(cause), evidence.beyond_noise, plain)
            if judge.is_cause(found):
                dependence = Dependence(cause.variable, cause.coordinate, found.fraction, cause.component)
                ranked.append((judge.rank_of_cause(found, evidence.total), dependence))

    force = np.concatenate([motion.force for motion in motions])
    if np.abs(force).max() > _ROUNDING_FORCE * typical_force(machine):
        absorbed, directions = _absorbed(machine, signals), motion_directions(machine, data)
        evidence = _Evidence(
            signals,
            signals.thinned([motion.correction for motion in motions]),
            signals.thinned([motion.correction_noise for motion in motions]),
            signals.compared(force),
            absorbed,
            np.zeros((signals.count, 0)),
            directions,
            correction_filters(machine, data),
        )
        rank(evidence, _causes_of_force(machine, evidence, directions, deviating))
        if motions[0].disagreement.shape[1]:
            signals = _Signals(machine, data, motions, _DISAGREEMENT_HZ, filtered=False)
            disagreement = signals.thinned([motion.disagreement for motion in motions])
            evidence = _Evidence(
                signals,
                disagreement,
                signals.thinned([motion.disagreement_noise for motion in motions]),
                disagreement,
                np.hstack([absorbed, force]),  # a missing force stretches belts as well
                signals.run_constants(),
                sensor_combinations(machine, data).T,
                None,
            )
            rank(evidence, _causes_of_disagreement(machine, evidence, ~white))
    best: dict[tuple[str, str], tuple[float, Dependence]] = {}
    for entry in sorted(ranked, key=lambda entry: -entry[0]):
        best.setdefault((entry[1].component, entry[1].variable), entry)
    return [dependence for _, dependence in best.values()]


def _deviating(machine: Machine, white: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mark the coordinates whose sensors show more than white noise in a simulation, shape (coordinates,).

    For a coordinate without a sensor, the sensors of the coordinates that move with it count.
    """
    names = machine.coordinate_names
    sites = [machine.coordinate_of_sensor(sensor) for sensor in machine.sensors]
    measured = np.array([[site == name for site in sites] for name in names])
    related = measured.copy()
    for motion in rigid_motions(machine).values():
        related |= np.outer(motion != 0.0, measured[motion != 0.0].any(axis=0))
    related[measured.any(axis=1)] = measured[measured.any(axis=1)]
    return np.asarray((related & ~white).any(axis=1))


def _absorbed(machine: Machine, signals: _Signals) -> Array:
    """Return the signals in proportion to which refitted parameters change the force, shape (rows, k)."""
    names = machine.coordinate_names
    columns = [signals[f"acceleration of {name}"] for name in names]
    columns += [signals[f"velocity of {name}"] for name in names]
    columns += [smooth_sign(signals[f"velocity of {name}"]) for name in names]
    columns += [signals[channel] for channel in machine.input_channels]
    return np.stack(columns, axis=1)


def _causes_of_force(
    machine: Machine, evidence: _Evidence, directions: Array, deviating: NDArray[np.bool_]
) -> Iterator[_Cause]:
    """Yield causes that are forces: on each coordinate, by each drive, by both drives, and the clock."""
    signals = evidence.signals
    names = machine.coordinate_names
    linear = [c.name for c in machine.coordinates if c.kind == "linear"]
    acting = [i for i in range(len(names)) if deviating[i] and np.any(directions[:, i] != 0.0)]
    for i in acting:
        name = names[i]

        def on(variable: str, columns: Columns, i: int = i, name: str = name) -> _Cause:
            return _Cause(name, variable, name, ((i, columns),))

        sign = smooth_sign(signals[f"velocity of {name}"])[:, None]
        for variable in (f"position of {name}", f"velocity of {name}"):
            yield on(variable, _curve(signals[variable], _KNOTS))
        position = f"position of {name}"
        for factor in (np.ones_like(sign), sign):
            yield on(position, factor * _periodic(evidence, i, position, f"velocity of {name}", factor))
        for other in (f"{what} of {n}" for n in linear if n != name for what in ("position", "velocity")):
            values = signals[other] if other.startswith("position") else np.abs(signals[other])
            yield on(other, sign * _curve(values, _KNOTS_OF_FACTOR))
        yield on(position, sign * _curve(signals[position], _KNOTS_OF_FACTOR))
        yield on(f"dwell of {name}", sign * _curve(signals[f"dwell of {name}"], _KNOTS_OF_FACTOR))
        for variable in (f"path of {name}", "time", "time in the run"):  # as friction warms up: slowly
            yield on(variable, sign * _polynomial(signals[variable]))
        yield on(f"acceleration of {name}", _resonance(evidence, i, f"acceleration of {name}"))
    together: dict[str, list[tuple[int | None, Columns]]] = {}
    for j, drive in enumerate(machine.drives):
        i = names.index(drive.coordinate)
        if i not in acting:
            continue
        current = signals[f"current of {drive.name}"][:, None]
        volts = signals[machine.input_channels[j]][:, None]
        power = signals["power of drives"]
        position, speed = f"position of {drive.coordinate}", f"velocity of {drive.coordinate}"
        causes = {
            f"current of {drive.name}": _curve(current[:, 0], _KNOTS),
            machine.input_channels[j]: _curve(volts[:, 0], _KNOTS),
            f"heat of {drive.name}": current * _polynomial(signals[f"heat of {drive.name}"]),
            "time in the run": current * _polynomial(signals["time in the run"]),
            position: current * _periodic(evidence, i, position, speed, current),
        }
        for variable, columns in causes.items():
            yield _Cause(drive.name, variable, drive.coordinate, ((i, columns),))
        shared = {
            "current of drives": np.hstack([current * np.abs(current), current**3]),
            "power of drives": volts * _polynomial(power),
        }
        for variable, columns in shared.items():
            together.setdefault(variable, []).append((i, drive.gain * columns))
    for variable, parts in together.items():
        if len(parts) > 1:
            yield _Cause("drives", variable, machine.drives[0].coordinate, tuple(parts))
    if len(acting):
        yield _clock(machine, signals, acting)


def _clock(machine: Machine, signals: _Signals, acting: list[int]) -> _Cause:
    """Return the cause of a clock whose rate changes during the runs: all accelerations and velocities are wrong."""
    names, late = machine.coordinate_names, signals["time in the run"][:, None]
    middle = late - 0.5 * late.max()
    parts = []
    for i in acting:
        coordinate = machine.coordinates[i]
        damping = coordinate.viscous + sum(
            d.gain * d.emf_constant for d in machine.drives if d.coordinate == names[i]
        )
        force = 2.0 * coordinate.mass * signals[f"acceleration of {names[i]}"]
        force += damping * signals[f"velocity of {names[i]}"]
        parts.append((i, force[:, None] * np.hstack([middle, middle**2])))
    return _Cause("clock", "time in the run", names[acting[0]], tuple(parts))


def _causes_of_disagreement(
    machine: Machine, evidence: _Evidence, deviating: NDArray[np.bool_]
) -> Iterator[_Cause]:
    """Yield causes that are errors of one sensor, gaps or slip between a motor and its encoder, and of the belts."""
    signals = evidence.signals
    by_coordinate = {sensor.coordinate: j for j, sensor in enumerate(machine.sensors) if sensor.of_position}
    for j, sensor in enumerate(machine.sensors):
        if not sensor.of_position or not deviating[j] or not np.any(evidence.direction(j)):
            continue
        name, channel = sensor.coordinate, machine.output_channels[j]
        position, speed = f"position of {name}", f"velocity of {name}"
        for variable, columns in (
            (position, _curve(signals[position], _KNOTS)),
            (position, _periodic(evidence, j, position, speed, np.ones((len(signals[speed]), 1)))),
            (speed, _curve(signals[speed], _KNOTS)),
        ):
            yield _Cause(channel, variable, name, ((j, columns),))
    loads: list[tuple[int | None, Columns]] = []
    for drive in machine.drives:
        sensor_index = by_coordinate.get(drive.coordinate)
        if sensor_index is None or not np.any(evidence.direction(sensor_index)):
            continue
        # A gap is open towards the load: its sign counts, its size bends shafts.
        load = signals[f"load of {drive.name}"]
        loads.append((sensor_index, _curve(load / (float(load.std()) or 1.0), _KNOTS)))
        for what, columns in (
            ("load", loads[-1][1]),
            ("impulse", signals[f"impulse of {drive.name}"][:, None]),
        ):
            yield _Cause(drive.name, f"{what} of {drive.name}", drive.coordinate, ((sensor_index, columns),))
    if len(loads) > 1 and len({columns.shape for _, columns in loads}) == 1:
        yield _Cause("drives", "load of drives", machine.drives[0].coordinate, tuple(loads))
    if machine.belts and machine.drives:
        lagged = np.hstack(
            [signals.filtered(f"load of {drive.name}", _Lags(signals)) for drive in machine.drives]
        )
        name = machine.drives[0].coordinate
        yield _Cause("belts", "tension rate of belts", name, ((None, lagged),))


class _Lags:
    """Filter that returns how much a signal differs from its delayed values, first-order lags of `_LAGS_S`."""

    def __init__(self, signals: _Signals):
        self._forgotten = [float(np.exp(-signals.period / lag)) for lag in _LAGS_S]

    def __call__(self, values: Array) -> Array:
        """Return the differences, shape (n, lags)."""
        lagged = [signal.lfilter([1.0 - kept], [1.0, -kept], values) for kept in self._forgotten]
        return np.stack([values - late for late in lagged], axis=1)


def _polynomial(values: Array) -> Columns:
    """Return the change of a variable since the first row, and its square, each of about unit size, shape (n, 2)."""
    shifted = values - values[0]
    scaled = shifted / (float(np.abs(shifted).max()) or 1.0)
    return np.stack([scaled, scaled**2], axis=1)


def _curve(values: Array, knots: int) -> Columns:
    """Return the pieces of a curve with straight parts over a variable; between knots are as many rows.

    Args:
        values: The variable, shape (n,).
        knots: Number of knots; fewer if the variable has fewer values.

    Returns:
        Hat functions, shape (n, at most knots).
    """
    places = np.unique(np.quantile(values, np.linspace(0.0, 1.0, knots)))
    if len(places) < 2:
        return np.ones((len(values), 1))
    return np.stack([np.interp(values, places, hat) for hat in np.eye(len(places))], axis=1)


def _periodic(evidence: _Evidence, index: int, position: str, speed: str, factor: Columns) -> Columns:
    """Return sine and cosine of the period in a position that explains the most; nothing of short periods is seen.

    Args:
        evidence: Force or disagreement that is explained.
        index: Coordinate or sensor at which the cause acts.
        position: Name of the position.
        speed: Name of its rate.
        factor: What the sine multiplies, shape (rows, 1).

    Returns:
        Sine and cosine, shape (rows, 2).
    """
    signals = evidence.signals
    places = signals.compared(signals[position][:, None])[:, 0]
    factors = signals.compared(factor)[:, 0]
    travel = float(np.ptp(places))
    slow = float(np.quantile(np.abs(signals.compared(signals[speed][:, None])), _SLOW_MOTION))
    if travel == 0.0 or slow == 0.0:
        return np.zeros((len(signals[position]), 2))
    lowest, highest = 2.0 * np.pi * _PERIODS / travel, 2.0 * np.pi * _HIGHEST_HZ / slow
    highest = min(max(highest, 2.0 * lowest), _MOST_PERIODS * lowest)
    numbers = np.arange(lowest, highest, 0.3 * 2.0 * np.pi / travel)
    every = slice(None, None, max(1, len(places) // _SCREENED_ROWS))
    places, seen = places[every], evidence.target(index)[every] * factors[every]
    wave, turn = seen * np.exp(1j * numbers[0] * places), np.exp(1j * (numbers[1] - numbers[0]) * places)
    sizes = np.empty(len(numbers))
    for k in range(len(numbers)):
        sizes[k] = abs(wave.sum())
        wave *= turn
    best = numbers[int(np.argmax(sizes))]
    angle = best * signals[position]
    return np.stack([np.sin(angle), np.cos(angle)], axis=1)


def _resonance(evidence: _Evidence, index: int, acceleration: str) -> Columns:
    """Return position and velocity of the resonator, driven by an acceleration, that explains the most."""
    signals, target = evidence.signals, evidence.target(index)
    best, most = np.zeros((len(signals[acceleration]), 2)), 0.0
    for hertz in _RESONANCES_HZ:
        w = 2.0 * np.pi * hertz
        resonator = (
            [[0.0, 1.0], [-w * w, -2.0 * _DAMPING * w]],
            [[0.0], [-1.0]],
            np.diag([w * w, w]),
            np.zeros((2, 1)),
        )
        discrete = signal.cont2discrete(tuple(np.array(matrix) for matrix in resonator), signals.period)
        filters, denominator = signal.ss2tf(*discrete[:4])
        motion = signals.filtered(acceleration, partial(_filtered, filters, denominator))
        compared = signals.compared(motion)
        weights = np.linalg.lstsq(compared, target, rcond=None)[0]
        explained = float(2.0 * weights @ (compared.T @ target) - np.sum((compared @ weights) ** 2))
        if explained > most:
            best, most = motion, explained
    return best


def _filtered(filters: Array, denominator: Array, values: Array) -> Array:
    """Return the outputs of filters with one denominator, shape (n, filters)."""
    return np.stack([signal.lfilter(numerator, denominator, values) for numerator in filters], axis=1)


# Variables of a force by the arguments of its formula. Other formulas (of a voltage, a tension) may depend on any
# variable of their component.
_VARIABLES = {"q": "position", "v": "velocity", "direction": "velocity", "t": "time", "drive": "load"}
_FRICTION_HOOKS = ("coulomb", "friction", "viscous")  # it changes its sign with the velocity
_SENSOR_HOOKS = {"measurement", "measurement_delay"}


def are_causes(effects: Sequence[AppliedEffect], ranked: Sequence[Dependence], machine: Machine) -> bool:
    """Return whether effects are the causes of a missing force that were found without the form of any effect.

    Args:
        effects: Effects that are to be named.
        ranked: Causes of the force that the machine without them lacks, the strongest first.

    Returns:
        True if the strongest cause is that of an effect, and each effect has a cause among them: it acts on the same
        component, and its formula depends on the same kind of variable. An effect of a sensor is no cause of a force:
        belts that slip imitate a wrong scale, and a true error of a sensor leaves none of the disagreement.
    """
    return judge.names_causes(
        [[_is_cause(effect, cause, effects, machine) for cause in ranked] for effect in effects]
    )


def _is_cause(
    effect: AppliedEffect, cause: Dependence, effects: Sequence[AppliedEffect], machine: Machine
) -> bool:
    """Return whether an effect acts on the component of a cause, and its formula depends on the cause's variable.

    An effect that each drive has acts on the drives together.
    """
    definition = effect.definition
    components = [effect.site, machine.coordinate_of_site(effect.site, definition.site)]
    alike = {e.site for e in effects if e.definition.name == definition.name}
    if alike >= {drive.name for drive in machine.drives}:
        components.append("drives")
    if cause.component not in components:
        return False
    hooks = {hook: getattr(definition, hook) for hook in HOOKS if getattr(definition, hook)}
    if hooks.keys() & _SENSOR_HOOKS:
        return False
    if not hooks.keys() & {"force", *_FRICTION_HOOKS}:
        return True
    kinds = {_VARIABLES[name] for f in hooks.values() for name in argument_names(f) if name in _VARIABLES}
    if hooks.keys() & set(_FRICTION_HOOKS):
        kinds.add("velocity")
    return cause.variable.partition(" of ")[0] in kinds
