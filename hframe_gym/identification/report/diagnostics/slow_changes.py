"""Slow effects of which the runs show how fast they change something, but not where the change ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from ....machine import AppliedEffect, Machine
from .parameter_diagnostics import POOR_RELATIVE_STD

_INTERVAL = float(ndtri(0.975))  # standard deviations to each end of a 95 % interval


@dataclass(frozen=True)
class SlowChange:
    """A time constant of which only the least value is determined, and the rate of change that is.

    Attributes:
        label: Label (name@site) of the effect.
        parameter: Name of the time constant.
        least: Lower end of its 95 % interval, which has no upper end, s.
        amplitude: Name of the amplitude that it divides.
        rate: Amplitude / time constant, in the amplitude's unit per second.
        rate_std: Standard deviation of the rate, in the same unit.
        unit: Unit of the amplitude.
    """

    label: str
    parameter: str
    least: float
    amplitude: str
    rate: float
    rate_std: float
    unit: str

    def describe(self) -> str:
        """Return a sentence with the rate per minute, its deviation, and the least time constant."""
        rate, std, unit = (60.0 * self.rate, 60.0 * self.rate_std, f"{self.unit}/min")
        if self.unit == "1" or self.unit.startswith("1/"):  # a relative change
            rate, std = 100.0 * rate, 100.0 * std
            unit = "% per minute" if self.unit == "1" else f"% per {self.unit[2:]} and minute"
        return (
            f"{self.label}: the runs are too short to show where the change ends. "
            f"It is {self.amplitude} / {self.parameter} = {rate:.3g} +- {std:.2g} {unit}, "
            f"and {self.parameter} is at least {self.least:.3g} s; a longer session would show more."
        )


def slow_change(effect: AppliedEffect, machine: Machine) -> SlowChange | None:
    """Return what is determined of an effect whose time constant may be of any length; None for others.

    It may be if the standard deviation of the time constant is more than 20 % of its value. A long time
    constant acts through its inverse, so that the rate, amplitude / time constant, is known where the time
    constant is not. The priors of the fit, whose centers are values that the session shows, then make it too
    short by about a standard deviation or more: only its least value is stated.

    Args:
        effect: Identified effect.
        machine: Machine with the covariance of its parameters; without one, the result is None.
    """
    uncertainty = machine.uncertainty
    for p in effect.definition.parameters:
        names = (f"{effect.label}.{p.slope_of}", f"{effect.label}.{p.name}")
        if not p.slope_of or uncertainty is None or not set(names) <= set(uncertainty.names):
            continue
        amplitude, value = effect.parameters[p.slope_of], effect.parameters[p.name]
        rows = [uncertainty.names.index(name) for name in names]
        covariance = uncertainty.covariance[np.ix_(rows, rows)]
        relative = float(np.sqrt(covariance[1, 1])) / value  # also of the inverse
        if relative <= POOR_RELATIVE_STD:
            continue
        slope = np.array([1.0, -amplitude / value]) / value
        return SlowChange(
            effect.label,
            p.name,
            value / (1.0 + _INTERVAL * relative),
            p.slope_of,
            amplitude / value,
            float(np.sqrt(max(slope @ covariance @ slope, 0.0))),
            machine.effect_unit(effect, p.slope_of),
        )
    return None
