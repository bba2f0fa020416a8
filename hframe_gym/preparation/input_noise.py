"""Measured inputs: the noise of a current or torque sensor acts on a simulated machine as a force that was not there.

Noise alone moves little, but dry friction rectifies it: a simulated machine whose friction the noise overcomes for
moments creeps where the real one stands, and a fit then finds too little friction. Inputs of this kind are averaged.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from ..arrays import Array
from ..machine import Machine
from ..recordings import Recording

# Fraction of an input's root mean square. Current sensors of amplifiers have 0.1 to 2 %; a recorded motor whose current
# had 20 % was simulated eight times as well with a current that was smoothed.
MUCH_NOISE = 0.05
# Length of the centered average, s: the time constant of the widest observer (60 rad/s). What an input does within
# it cannot be seen in the motion, so that the average loses nothing else.
SMOOTHING_TIME = 1.0 / 60.0
# The median of |u[k+1] - 2 u[k] + u[k-1]| of white noise is this multiple of its standard deviation.
_MEDIAN_SECOND_DIFFERENCE = 0.6745 * np.sqrt(6.0)
# Ends of the names of inputs that may be measured; voltages are commands as a rule.
_FORCE_UNITS = ("A", "Nm")


def noise_of_input(values: Array) -> float:
    """Estimate the noise by which an input changes from row to row.

    The median of second differences is zero for a command that holds its values over several rows, and small for one
    that is smooth.

    Args:
        values: Input, shape (n,).

    Returns:
        Standard deviation, in the unit of the input; 0 for fewer than three rows.
    """
    return (
        float(np.median(np.abs(np.diff(values, 2)))) / _MEDIAN_SECOND_DIFFERENCE if len(values) > 2 else 0.0
    )


def is_noisy(channel: str, values: Array) -> bool:
    """Return whether an input is a current or a torque, and changes like noise.

    Args:
        channel: Name of the input, which ends with its unit.
        values: Input, shape (n,).

    Returns:
        True if its noise is above 5 % of its root mean square.
    """
    size = float(np.sqrt(np.mean(np.square(values)))) if len(values) else 0.0
    return channel.rpartition("_")[2] in _FORCE_UNITS and noise_of_input(values) > MUCH_NOISE * size > 0.0


def without_input_noise(
    recording: Recording, machine: Machine, log: Callable[[str], object] | None = None
) -> Recording:
    """Average inputs that were measured with much noise over 17 ms, centered, so that nothing is delayed.

    Args:
        machine: Machine with its input channels.
        log: Called with a line of text for each input that is averaged.

    Returns:
        Copy with averaged inputs, shape (n, drives); the same object if none is noisy.
    """
    noisy = [is_noisy(c, u) for c, u in zip(machine.input_channels, recording.inputs.T, strict=True)]
    period = float(np.median(np.diff(recording.time_s))) if len(recording.time_s) > 1 else np.inf
    half = round(SMOOTHING_TIME / period / 2) if period > 0.0 else 0
    if not any(noisy) or half < 1:
        return recording
    inputs = recording.inputs.copy()
    kernel = np.ones(2 * half + 1)
    counts = np.convolve(np.ones(len(inputs)), kernel, "same")
    for j in np.flatnonzero(noisy):
        size = float(np.sqrt(np.mean(inputs[:, j] ** 2)))
        if log is not None:
            percent = 100 * noise_of_input(inputs[:, j]) / size
            log(
                f"{recording.name}: {machine.input_channels[j]} changes like noise of {percent:.2g} % of its size; it "
                f"is averaged over {2 * half + 1} rows"
            )
        inputs[:, j] = np.convolve(inputs[:, j], kernel, "same") / counts
    return dataclasses.replace(recording, inputs=inputs)
