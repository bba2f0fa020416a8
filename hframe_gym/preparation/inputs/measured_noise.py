"""Measured inputs: the noise of a current or torque sensor acts on a simulated machine as a false force.

Noise alone moves little, but dry friction rectifies it: a simulated machine whose friction the noise
overcomes for moments creeps where the real one stands, and a fit then finds too little friction. Inputs of
this kind are averaged.

The command of a position controller changes as fast, because it differentiates the rounding of an encoder.
The real drive follows it, so it must stay as it is. It is recognized by the measurements that it answers.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from ...arrays import Array, Measurements
from ...line_log import LineLog
from ...machine import Machine
from ...recordings import Recording
from ...robust_statistics import white_noise

# Fraction of an input's root mean square. Current sensors of amplifiers have 0.1 to 2 %; a recorded motor
# whose current had 20 % was simulated eight times as well with a current that was smoothed.
MUCH_NOISE = 0.05
# Length of the centered average, s: the time constant of the widest observer (60 rad/s). What an input does
# within it cannot be seen in the motion, so that the average loses nothing else.
SMOOTHING_TIME = 1.0 / 60.0
# Measurements that a controller combines: the present one and those of the four rows before.
_ANSWERED_ROWS = 5
# Fraction of an input's fast changes that measurements must explain. A measured current of a motor has 0.001,
# the commands of a simulated servo with an encoder and a limit of the current 0.89 to 0.98.
_ANSWERED = 0.5
# Ends of the names of inputs that may be measured; voltages are commands as a rule.
_FORCE_UNITS = ("A", "Nm")


def noise_of_input(values: Array) -> float:
    """Estimate the standard deviation of the noise of an input.

    It follows from the median of second differences, which is zero for a command that holds its values over
    several rows, and small for a smooth one.

    Args:
        values: Values of the input without gaps (NaN), in any unit, shape (n,).

    Returns:
        Standard deviation, in the unit of the values; 0 for fewer than three rows.
    """
    return white_noise([values], 2)


def answers_measurements(values: Array, outputs: Measurements) -> bool:
    """Return whether an input is a controller's answer to measurements, and not a noisy measurement itself.

    A controller's command depends on the errors of the sensors, up to its row. The noise of a current sensor
    does not.

    Args:
        values: Input, shape (n,).

    Returns:
        True if a linear combination of the measurements explains at least half of the input's second
        differences (mean square).
    """
    measured = outputs[:, np.isfinite(outputs).mean(axis=0) > 0.5]  # others would leave too few rows
    changes, answered = np.diff(values, 2), np.diff(measured, 2, axis=0)
    rows = len(changes) - _ANSWERED_ROWS + 1
    if rows < 1 or not measured.shape[1]:
        return False
    causes = np.hstack([answered[_ANSWERED_ROWS - 1 - k :][:rows] for k in range(_ANSWERED_ROWS)])
    changes = changes[_ANSWERED_ROWS - 1 :]
    complete = np.isfinite(causes).all(axis=1)
    causes, changes = causes[complete], changes[complete]
    if len(changes) < 10 * causes.shape[1]:  # a combination of fewer would explain noise
        return False
    # Sensors have different units.
    causes = causes / np.maximum(np.abs(causes).max(axis=0), np.finfo(float).tiny)
    combination = causes @ np.linalg.lstsq(causes, changes)[0]
    return bool(np.sum((changes - combination) ** 2) < (1.0 - _ANSWERED) * np.sum(changes**2))


def noisy_inputs(recording: Recording, machine: Machine) -> list[int]:
    """Return the inputs that are noisy measurements: currents and torques that vary like noise.

    Args:
        recording: Run (times, s; inputs in the units of the drives' channels).

    Returns:
        Indices of the inputs whose noise is above 5 % of their root mean square, and is not a controller's
        answer to the measurements.
    """
    found = []
    for j, (channel, values) in enumerate(zip(machine.input_channels, recording.inputs.T, strict=True)):
        size = float(np.sqrt(np.mean(np.square(values)))) if len(values) else 0.0
        measurable = channel.rpartition("_")[2] in _FORCE_UNITS
        noisy = measurable and noise_of_input(values) > MUCH_NOISE * size > 0.0
        if noisy and not answers_measurements(values, recording.outputs):
            found.append(j)
    return found


def without_input_noise(recording: Recording, machine: Machine, log: LineLog | None = None) -> Recording:
    """Average noisy measured inputs over a centered window of 17 ms, which delays nothing.

    Args:
        log: Called with a line of text for each input that is averaged.

    Returns:
        Copy with averaged inputs; the same object if none is noisy.
    """
    noisy = noisy_inputs(recording, machine)
    period = float(np.median(np.diff(recording.time_s))) if len(recording.time_s) > 1 else np.inf
    half = round(SMOOTHING_TIME / period / 2) if period > 0.0 else 0
    if not noisy or half < 1:
        return recording
    inputs = recording.inputs.copy()
    kernel = np.ones(2 * half + 1)
    counts = np.convolve(np.ones(len(inputs)), kernel, "same")
    for j in noisy:
        size = float(np.sqrt(np.mean(inputs[:, j] ** 2)))
        if log is not None:
            percent = 100 * noise_of_input(inputs[:, j]) / size
            log(
                f"{recording.name}: {machine.input_channels[j]} changes like "
                f"noise of {percent:.2g} % of its size; it is averaged over {2 * half + 1} rows"
            )
        inputs[:, j] = np.convolve(inputs[:, j], kernel, "same") / counts
    return dataclasses.replace(recording, inputs=inputs)
