"""What a machine predicts for a run, for a batch of parameter values at once, and what is left.

`innovations`: at every row the measured minus the predicted reading is fed back into position and velocity, so that a
wrong model's error stays local in time.  `free run`: nothing is fed back.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..dynamics.simulation import Motion, simulate_batch
from ..machine import Machine
from .dataset import Dataset, PreparedRecording
from .initial_state import settled
from .static_equilibrium import static_equilibrium

Array = NDArray[np.float64]
Mode = Literal["innovations", "free"]

# Bandwidth of the feedback, rad/s: encoders are quiet, the slower lasers' noise must not shake the model.
_ENCODER_RATE = 60.0
_LASER_RATE = 25.0
SEARCH_STEP = 0.5e-3  # s
_INVERSIONS, _INVERTED = 4, 1e-6  # steps, of which each leaves a few hundredths, and m or rad
_COARSE = 4e-3  # s; what an effect does to the readings is slower
POLISH_STEP = 0.125e-3  # s; an input that changes inside a step costs a micrometre at twice that


def observer_gains(machine: Machine, period: float) -> Array:
    """Gains (2 coordinates, sensors) of the output injection at a sampling period, s: critically damped observers."""
    count = len(machine.coordinates)
    gains = np.zeros((2 * count, len(machine.sensors)))
    geared = any(c.kind == "rotary" for c in machine.coordinates)
    for j, sensor in enumerate(machine.sensors):
        name = sensor.coordinate
        i = machine.coordinate_names.index(name)
        slow = geared and machine.coordinate(name).kind == "linear"
        rate = (_LASER_RATE if slow else _ENCODER_RATE) * min(period, 5e-3)
        gains[i, j] = 2 * rate / sensor.row[name]
        gains[count + i, j] = rate**2 / period / sensor.row[name]
    return gains


def predict(
    machine: Machine,
    run: PreparedRecording,
    mode: Mode,
    *,
    period: float,
    parameters: Array | None = None,
    extra_force: Array | None = None,
    extra_reading: Array | None = None,
    start: Array | None = None,
    longest_step: float = SEARCH_STEP,
    states: bool = False,
) -> Motion:
    """The machine's readings over a run, with its motion if asked, for a batch of parameters or additions.

    start (B, 2 coordinates) in place of the run's own; extra_force (B, n, coordinates); extra_reading (B, n, sensors):
    what the sensors show beyond the machine's readings.
    """
    observed = mode == "innovations"
    own = initial_state_of_run(machine, run)
    measured = None
    if observed:
        known = len(run.start) // 2
        encoders = [machine.coordinate(sensor.coordinate).kind == "rotary" for sensor in machine.sensors]
        # Encoders count from where the run starts, wherever that is.
        away = np.where(encoders, machine.sensor_matrix[:, :known] @ (own[:known] - run.start[:known]), 0.0)
        measured = run.outputs + away
        if extra_reading is not None:
            measured = measured - extra_reading
    motion = simulate_batch(
        machine,
        run.time_s,
        run.inputs,
        parameters=parameters,
        start=own if start is None else start,
        extra_force=extra_force,
        measured=measured,
        gains=observer_gains(machine, period) if observed else None,
        longest_step=longest_step,
        states=states,
        parallel=False,
    )
    return motion if extra_reading is None else motion._replace(readings=motion.readings + extra_reading)


def initial_state_of_run(machine: Machine, run: PreparedRecording) -> Array:
    """The run's resting state.

    Encoders that tell of a stretch place their pulleys; all others stand where belts hold what the machine's effects
    do at rest.  So does a pulley that runs out of true, and so do all where an effect changes what sensors tell of the
    place, until that effect's machine has put the zeros right: before, what seemed a stretch was the effect.
    """
    if not machine.belts:
        return run.start
    known = len(run.start) // 2
    place = position_from_readings(machine, run)
    position = static_equilibrium(machine, place)
    if run.zeroed or np.array_equal(place, run.start[:known]):
        untrue = [] if run.zeroed else [machine.site_coordinate(e.site) for e in machine.effects if e.definition.behind]
        for i, angle in encoder_angles(machine, run).items():
            if machine.coordinate_names[i] not in untrue:
                position[i] = angle
    return np.concatenate([position, np.zeros_like(position)])


def encoder_angles(machine: Machine, run: PreparedRecording) -> dict[int, float]:
    """By coordinate, the angle of a round pulley where encoders that tell of a stretch place theirs, rad."""
    angles: dict[int, float] = {}
    for j in np.flatnonzero(run.told):
        i = machine.coordinate_names.index(machine.sensors[j].coordinate)
        angles[i] = shown = float(run.start[i])
        for e in machine.effects:
            if e.definition.behind and machine.site_coordinate(e.site) == machine.coordinate_names[i]:
                angles[i] += float(e("behind", q=shown, per_radius=1.0 / machine.radii[i]))
    return angles


def position_from_readings(machine: Machine, run: PreparedRecording) -> Array:
    """Positions (coordinates,) of a run's start with those of its lasers put where their readings come from."""
    at = run.start[: len(run.start) // 2].copy()
    names = machine.coordinate_names
    for e in machine.effects:
        if not e.definition.reading or machine.coordinate(machine.site_coordinate(e.site) or "").kind != "linear":
            continue
        sensor = machine.sensors[machine.output_channels.index(e.site)]
        own, other = names.index(sensor.coordinate), machine.across(sensor.coordinate)
        shown, across = float(at[own]), at[names.index(other)] if other else 0.0
        place = shown
        for _ in range(_INVERSIONS):
            place -= float(e("reading", r=place, across=across)) - shown
        # A reading that no place gives, beyond the end of a range, has not placed the run: others have.
        if abs(float(e("reading", r=place, across=across)) - shown) < _INVERTED:
            at[own] = place
    return at


def coarse(data: Dataset) -> int:
    """How many rows may be averaged where only the answer to mechanical effects counts."""
    return max(1, round(_COARSE / data.period))


def residuals(run: PreparedRecording, data: Dataset, readings: Array, rows: int = 1) -> Array:
    """Measured minus predicted readings (B, n, sensors) in units of the noise, (B, n * sensors); zero where unmeasured.

    rows: how many are averaged, and scaled so that white noise keeps its size; what changes more slowly keeps its
    products, and there is that much less to multiply.  Each channel's zero is where its resting rows put it, given
    where the machine comes to rest (see `zeros`).
    """
    measured = np.isfinite(run.outputs)
    counted = measured if run.rows is None else measured & run.rows[:, None]
    with np.errstate(over="ignore", invalid="ignore"):  # parameters that make a machine run away cost infinitely much
        left = run.outputs - readings if measured.all() else np.where(measured, run.outputs - readings, 0.0)
        left -= zeros(run, data, left, measured)
        left *= counted / data.noise
    if rows > 1:
        blocks = left.shape[1] // rows
        left = left[:, : blocks * rows].reshape(len(left), blocks, rows, -1).sum(axis=2) / np.sqrt(rows)
    return left.reshape(len(left), -1)


def zeros(run: PreparedRecording, data: Dataset, error: Array, measured: NDArray[np.bool_]) -> Array:
    """What the sensors' zeros explain (B, 1, sensors) of errors (B, n, sensors), zero where not measured.

    The mean over the settled resting rows: a sensor counts from wherever it was switched on.  Those rows
    place a quantised channel only to within its quantum, so of the mean then left over the whole run up to half a
    quantum is taken off too; not more, for under output injection a constant force shows as just such a mean.  An
    encoder behind belts loses its mean whole: stiction holds a stretch of the belts at rest that nothing tells.
    """
    rest = settled(run.rest)
    counts = np.maximum(measured.sum(axis=0), 1)
    at_rest = error[:, rest].sum(axis=1) / np.maximum(measured[rest].sum(axis=0), 1)
    mean = error.sum(axis=1) / counts - at_rest * (measured.sum(axis=0) / counts)
    most = np.where(data.behind_belts, np.inf, data.quantum / 2)
    found: Array = (at_rest + np.clip(mean, -most, most))[:, None, :]
    return found
