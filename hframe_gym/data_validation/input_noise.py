"""Recognize measured inputs: their noise acts on a simulated machine as a force that the real one lacked."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..machine import Machine
from ..preparation.inputs.measured_noise import noise_of_input, noisy_inputs
from ..recordings import Recording
from .findings import Finding, channel_unit


def check_input_noise(recordings: Sequence[Recording], machine: Machine) -> list[Finding]:
    """Report, as advice, measured currents and torques that change from row to row like noise.

    These are the `noisy_inputs` of a run, with a noise above 5 % of their root mean square. Voltages are not
    checked: they are usually commands, which may be random on purpose.
    """
    findings = []
    for recording in recordings:
        for j in noisy_inputs(recording, machine):
            channel, values = machine.input_channels[j], recording.inputs[:, j]
            unit, noise = channel_unit(channel, machine), noise_of_input(values)
            size = float(np.sqrt(np.mean(values**2)))
            findings.append(
                Finding(
                    "advice",
                    recording.name,
                    channel,
                    f"changes from row to row like noise of {noise:.2g} {unit}, "
                    f"{100 * noise / size:.2g} % of its size. "
                    "If it was measured, the real drive did not follow this noise, but a simulated one does; "
                    "it is therefore averaged over 17 ms. Record the command instead if that is possible",
                )
            )
    return findings
