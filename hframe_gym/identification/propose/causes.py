"""Causes of a missing force and of sensors' disagreement, each a curve of unknown shape at one component.

What a machine lacks may be no effect of the library. A cause says less than an effect, and covers more: it is
any curve over one variable (`variables_of_motion`), at one component. The curve may be multiplied by the
direction of motion (then it is friction), by a current (a torque) or by a voltage. Friction that depends on
the position of another axis, for example, is a curve over that position, multiplied by the direction.

Functions here return a cause as columns, of which `CauseComparison` fits the coefficients.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from ...arrays import Array
from ...machine import Machine
from ..forces.motion_variables import motor_variable, smooth_sign
from .cause_comparison import Cause, CauseComparison, Columns, Signals

CONSTANT = "constant"  # in the place of a variable: a force that depends on nothing
_KNOTS, _KNOTS_OF_FRICTION = 13, 6  # of a curve; of one that is multiplied by the direction of motion
# A force that is periodic in the position has this frequency, Hz, at most in slow motion: what is compared is
# below 30.
_HIGHEST_HZ = 25.0
_SLOW_MOTION = 0.2  # fraction of the rows that are slower than slow motion
_FEWEST_PERIODS, _MOST_PERIODS = 2.0, 400.0  # of a periodic cause, in the travel
_WAVENUMBER_STEP = 0.3  # of the search, in periods over the travel; a peak is about one wide
_SCREENED_ROWS = 1500  # in which the period is searched for
_RESONANCES_HZ = np.geomspace(1.0, 25.0, 30)
_DAMPING = 0.03  # damping ratio of a resonance: rubber and steel have 0.01 to 0.1
_LAGS_S = (0.005, 0.02, 0.05)  # time constants of what belts do after a change of tension


def causes_of_force(
    machine: Machine, comparison: CauseComparison, directions: Array, deviating: NDArray[np.bool_]
) -> Iterator[Cause]:
    """Yield possible causes of the missing force, as curves that `CauseComparison` fits.

    They act on each coordinate (a constant force, forces and friction over a variable, a resonance), by each
    drive, by all drives together (such as a supply that sags), and by a clock that drifts.

    Args:
        machine: Machine with its coordinates and drives.
        comparison: Comparison with the missing force.
        directions: Force along each motion per force on a coordinate, dimensionless, shape (motions,
            coordinates). A force on a coordinate without an influence is no cause.
        deviating: Coordinates whose sensors show more than noise, shape (coordinates,). Other coordinates and
            their drives get no cause; if none deviates, nothing is yielded.
    """
    names = machine.coordinate_names
    acting = [i for i in range(len(names)) if deviating[i] and np.any(directions[:, i] != 0.0)]
    for i in acting:
        yield from _causes_on_coordinate(machine, comparison, i)
    of_all_drives: dict[str, list[tuple[int | None, Columns]]] = {}  # by variable
    for j, drive in enumerate(machine.drives):
        i = names.index(drive.coordinate)
        if i not in acting:
            continue
        yield from _causes_by_drive(machine, comparison, j)
        for variable, columns in _changes_by_supply(machine, comparison.signals, j).items():
            of_all_drives.setdefault(variable, []).append((i, drive.gain * columns))
    for variable, parts in of_all_drives.items():
        if len(parts) > 1:
            yield Cause("drives", variable, machine.drives[0].coordinate, tuple(parts))
    if acting:
        yield _clock(machine, comparison.signals, acting)


def _causes_on_coordinate(machine: Machine, comparison: CauseComparison, i: int) -> Iterator[Cause]:
    """Yield causes that act on coordinate i: forces, a constant one first, varying friction, a resonance."""
    signals, name = comparison.signals, machine.coordinate_names[i]
    position, velocity, acceleration = (
        f"{what} of {name}" for what in ("position", "velocity", "acceleration")
    )

    def on(variable: str, columns: Columns) -> Cause:
        return Cause(name, variable, name, ((i, columns),))

    sign = smooth_sign(signals[velocity])[:, None]
    yield on(CONSTANT, np.ones_like(sign))
    for variable in (position, velocity):
        yield on(variable, _curve(signals[variable], _KNOTS))
    for factor in (np.ones_like(sign), sign):  # a force, and friction
        yield on(position, factor * _periodic(comparison, i, position, velocity, factor))
    others = [c.name for c in machine.coordinates if c.kind == "linear" and c.name != name]
    for other in (f"{what} of {n}" for n in others for what in ("position", "velocity")):
        values = signals[other] if other.startswith("position") else np.abs(signals[other])
        yield on(other, sign * _curve(values, _KNOTS_OF_FRICTION))
    for variable in (position, f"dwell of {name}"):
        yield on(variable, sign * _curve(signals[variable], _KNOTS_OF_FRICTION))
    for variable in (f"path of {name}", "time", "time in the run"):  # as friction warms up: slowly
        yield on(variable, sign * _polynomial(signals[variable]))
    yield on(acceleration, _resonance(comparison, i, acceleration))


def _causes_by_drive(machine: Machine, comparison: CauseComparison, j: int) -> Iterator[Cause]:
    """Yield causes that are forces of drive j: errors of current and command, heat, ripple of the torque."""
    signals, drive, volts = comparison.signals, machine.drives[j], machine.input_channels[j]
    i = machine.coordinate_names.index(drive.coordinate)
    of_motor, heat = f"{motor_variable(drive)} of {drive.name}", f"heat of {drive.name}"
    position, speed = f"position of {drive.coordinate}", f"velocity of {drive.coordinate}"
    current = signals[of_motor][:, None]  # or, in proportion to it, the torque
    causes = {
        of_motor: _curve(signals[of_motor], _KNOTS),
        volts: _curve(signals[volts], _KNOTS),
        heat: current * _polynomial(signals[heat]),
        "time in the run": current * _polynomial(signals["time in the run"]),
        position: current * _periodic(comparison, i, position, speed, current),
    }
    for variable, columns in causes.items():
        yield Cause(drive.name, variable, drive.coordinate, ((i, columns),))


def _changes_by_supply(machine: Machine, signals: Signals, j: int) -> dict[str, Columns]:
    """Return changes of drive force that all drives have alike, as columns by variable, in units of its gain.

    Torque saturates over the current; the voltage of the supply sags with the power.
    """
    drive = machine.drives[j]
    of_motor = motor_variable(drive)
    current = signals[f"{of_motor} of {drive.name}"][:, None]
    supplied = signals[machine.input_channels[j]][:, None] if drive.command == "voltage" else current
    return {
        f"{of_motor} of drives": np.hstack([current * np.abs(current), current**3]),
        "power of drives": supplied * _polynomial(signals["power of drives"]),
    }


def _clock(machine: Machine, signals: Signals, acting: list[int]) -> Cause:
    """Return the cause of a clock whose rate changes during the runs.

    Where time runs faster than the clock by a small fraction e, the true velocity is (1 - e) v and the true
    acceleration (1 - 2 e) a, so that inverse dynamics err by e (2 m a + d v); d: viscous friction and
    back-EMF. Here, e is a polynomial of the time in the run without a constant, which masses absorb.
    """
    names, time = machine.coordinate_names, signals["time in the run"][:, None]
    from_middle = time - 0.5 * time.max()
    parts = []
    for i in acting:
        coordinate = machine.coordinates[i]
        damping = coordinate.viscous + sum(
            d.gain * d.emf_constant for d in machine.drives if d.coordinate == names[i]
        )
        force = 2.0 * coordinate.mass * signals[f"acceleration of {names[i]}"]
        force += damping * signals[f"velocity of {names[i]}"]
        parts.append((i, force[:, None] * np.hstack([from_middle, from_middle**2])))
    return Cause("clock", "time in the run", names[acting[0]], tuple(parts))


def causes_of_disagreement(
    machine: Machine, comparison: CauseComparison, deviating: NDArray[np.bool_]
) -> Iterator[Cause]:
    """Yield possible causes of disagreeing sensors, as curves that `CauseComparison` fits.

    They are an error of a sensor that depends on the position (also periodically) or the speed of its
    coordinate; play or bending between a motor and its sensor, by the drive's load; slip of belts, by the
    integral of this load; and creep of belts.

    Args:
        machine: Machine with its sensors and drives.
        comparison: Comparison with the disagreement.
        deviating: Sensors that show more than noise, shape (sensors,); others get no error of their sensor.
    """
    signals = comparison.signals
    by_coordinate = {sensor.coordinate: j for j, sensor in enumerate(machine.sensors) if sensor.of_position}
    for j, sensor in enumerate(machine.sensors):
        if not sensor.of_position or not deviating[j] or not np.any(comparison.direction(j)):
            continue
        name, channel = sensor.coordinate, machine.output_channels[j]
        position, speed = f"position of {name}", f"velocity of {name}"
        for variable, columns in (
            (position, _curve(signals[position], _KNOTS)),
            (position, _periodic(comparison, j, position, speed, np.ones((len(signals[speed]), 1)))),
            (speed, _curve(signals[speed], _KNOTS)),
        ):
            yield Cause(channel, variable, name, ((j, columns),))
    loads: list[tuple[int | None, Columns]] = []
    for drive in machine.drives:
        sensor_index = by_coordinate.get(drive.coordinate)
        if sensor_index is None or not np.any(comparison.direction(sensor_index)):
            continue
        # Play closes on the side of the load, by its sign; shafts and belts bend in proportion to it.
        load = signals[f"load of {drive.name}"]
        loads.append((sensor_index, _curve(load / (float(load.std()) or 1.0), _KNOTS)))
        for what, columns in (
            ("load", loads[-1][1]),
            ("impulse", signals[f"impulse of {drive.name}"][:, None]),
        ):
            yield Cause(drive.name, f"{what} of {drive.name}", drive.coordinate, ((sensor_index, columns),))
    if len(loads) > 1 and len({columns.shape for _, columns in loads}) == 1:
        yield Cause("drives", "load of drives", machine.drives[0].coordinate, tuple(loads))
    if machine.belts and machine.drives:
        lagged = np.hstack(
            [signals.filtered(f"load of {drive.name}", _Lags(signals)) for drive in machine.drives]
        )
        name = machine.drives[0].coordinate
        yield Cause("belts", "tension rate of belts", name, ((None, lagged),))


class _Lags:
    """Filter that returns how much a signal differs from its values behind first-order lags of `_LAGS_S`."""

    def __init__(self, signals: Signals):
        self._kept = [float(np.exp(-signals.period / lag)) for lag in _LAGS_S]

    def __call__(self, values: Array) -> Array:
        """Return the differences, shape (n, lags)."""
        lagged = [signal.lfilter([1.0 - kept], [1.0, -kept], values) for kept in self._kept]
        return np.stack([values - late for late in lagged], axis=1)


def _polynomial(values: Array) -> Columns:
    """Return a variable's change since the first row, and its square, each about 1 in size, shape (n, 2)."""
    shifted = values - values[0]
    scaled = shifted / (float(np.abs(shifted).max()) or 1.0)
    return np.stack([scaled, scaled**2], axis=1)


def _curve(values: Array, knots: int) -> Columns:
    """Return hat functions over a variable, (n, at most knots); knots divide the rows into equal numbers."""
    places = np.unique(np.quantile(values, np.linspace(0.0, 1.0, knots)))
    if len(places) < 2:
        return np.ones((len(values), 1))
    return np.stack([np.interp(values, places, hat) for hat in np.eye(len(places))], axis=1)


def _periodic(comparison: CauseComparison, index: int, position: str, speed: str, factor: Columns) -> Columns:
    """Return sine and cosine, shape (rows, 2), of the position with the period that explains the most.

    Periods so short that the comparison's filter removes them even in slow motion are not tried.

    Args:
        index: Coordinate, or sensor, on which the periodic cause acts.
        position: Name of the position.
        speed: Name of its velocity.
        factor: By which the caller multiplies sine and cosine, shape (rows, 1).
    """
    signals = comparison.signals
    places = signals.compared(signals[position][:, None])[:, 0]
    factors = signals.compared(factor)[:, 0]
    travel = float(np.ptp(places))
    slow = float(np.quantile(np.abs(signals.compared(signals[speed][:, None])), _SLOW_MOTION))
    if travel == 0.0 or slow == 0.0:
        return np.zeros((len(signals[position]), 2))
    one_period = 2.0 * np.pi / travel  # wavenumbers in rad per unit of the position
    highest = max(2.0 * np.pi * _HIGHEST_HZ / slow, 2.0 * _FEWEST_PERIODS * one_period)
    highest = min(highest, _MOST_PERIODS * one_period)
    numbers = np.arange(_FEWEST_PERIODS * one_period, highest, _WAVENUMBER_STEP * one_period)
    every = slice(None, None, max(1, len(places) // _SCREENED_ROWS))
    places, seen = places[every], comparison.target(index)[every] * factors[every]
    # Fourier sums over unequal positions. From one wavenumber to the next, each term turns by the same angle.
    terms, turn = seen * np.exp(1j * numbers[0] * places), np.exp(1j * (numbers[1] - numbers[0]) * places)
    sizes = np.empty(len(numbers))
    for k in range(len(numbers)):
        sizes[k] = abs(terms.sum())
        terms *= turn
    best = numbers[int(np.argmax(sizes))]
    angle = best * signals[position]
    return np.stack([np.sin(angle), np.cos(angle)], axis=1)


def _resonance(comparison: CauseComparison, index: int, acceleration: str) -> Columns:
    """Return deflection and velocity of the best resonator, as forces per mass, shape (rows, 2).

    A mass on a spring, q'' + 2 D w q' + w^2 q = -a, is driven by the acceleration a of what carries it.
    """
    signals, target = comparison.signals, comparison.target(index)
    best, most = np.zeros((len(signals[acceleration]), 2)), 0.0
    for hertz in _RESONANCES_HZ:
        w = 2.0 * np.pi * hertz
        resonator = (
            [[0.0, 1.0], [-w * w, -2.0 * _DAMPING * w]],
            [[0.0], [-1.0]],
            np.diag([w * w, w]),  # outputs w^2 q and w q'
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
