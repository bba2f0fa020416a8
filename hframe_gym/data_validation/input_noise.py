"""Recognize inputs that were measured: their noise acts on a simulated machine as a force that the real one lacked."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..machine import Machine
from ..recordings import Recording
from .findings import Finding, channel_unit

# Fraction of an input's root mean square. Current sensors of amplifiers have 0.1 to 2 %; a recorded motor whose current
# had 20 % was simulated eight times as well with a current that was smoothed.
_MUCH = 0.05
# The median of |u[k+1] - 2 u[k] + u[k-1]| of white noise is this multiple of its standard deviation.
_MEDIAN_SECOND_DIFFERENCE = 0.6745 * np.sqrt(6.0)


def noisy_inputs(recordings: Sequence[Recording], machine: Machine) -> list[Finding]:
    """Report inputs that change from row to row like noise, where the input is a current, a torque or a force.

    Voltages are commands as a rule, and a command may be random by intention. The median of second differences is zero
    for a command that holds its values over several rows, and small for one that is smooth.

    Args:
        recordings: Runs as recorded.
        machine: Declared machine, which names the input channels.

    Returns:
        One finding of severity "advice" for each run and each input channel with much noise.
    """
    findings = []
    for recording in recordings:
        for channel, values in zip(machine.input_channels, recording.inputs.T, strict=True):
            unit = channel_unit(channel, machine)
            size = float(np.sqrt(np.mean(values**2)))
            if unit == "V" or len(values) < 3 or size == 0.0:
                continue
            noise = float(np.median(np.abs(np.diff(values, 2)))) / _MEDIAN_SECOND_DIFFERENCE
            if noise > _MUCH * size:
                findings.append(
                    Finding(
                        "advice",
                        recording.name,
                        channel,
                        f"changes from row to row like noise of {noise:.2g} {unit}, {100 * noise / size:.2g} % of its "
                        "size. If it was measured, the real drive did not follow this noise, but a simulated one does: "
                        "record the command instead, or smooth the column before the import, with a centered average "
                        "that delays nothing",
                    )
                )
    return findings
