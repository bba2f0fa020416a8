"""Judge sensors: whether one deviates alone, so that it or its mounting is in error, not the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from .error import FAR


@dataclass(frozen=True)
class SensorEvidence:
    """What the sensors say about the error of one of them.

    Attributes:
        noise_ratio: Simulation error of the sensor in units of its noise.
        others: For each motion that the sensor measures, the error of each other sensor of this motion / the
            error that it would have if the machine had moved as the sensor says.
    """

    noise_ratio: float
    others: Sequence[Sequence[float]]


def deviates_alone(evidence: SensorEvidence) -> bool:
    """Return whether a sensor or its mounting is in error, not the model of the machine.

    It is if its squared simulation error is more than 10 times (`FAR`) its noise, if each motion that it
    measures has another sensor, and if the squared error of each of these is less than a tenth of what it
    would be if the machine had moved as the suspect sensor says.
    """
    if not evidence.noise_ratio**2 > FAR or not evidence.others:
        return False
    return all(ratios and all(FAR * ratio**2 < 1.0 for ratio in ratios) for ratios in evidence.others)
