"""Correlations of the simulation error of a run: with itself at a later time, and with the inputs.

An error that is only noise is correlated with neither. An autocorrelation shows that something systematic is
left; a correlation with an input that comes before the error shows that the machine responds otherwise than
its model.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import signal

from ....arrays import Array
from ....web_page import SERIES, Panel, color, legend_above, number
from ..content.result_curves import ResultCurves

CONFIDENCE = 2.576  # standard deviations of a normal distribution that hold 99 % of the values
_MAX_LAG_S = 0.2
_MIN_ROWS = 50


def correlation(first: Array, second: Array, lags: int) -> Array:
    """Return the correlation of two signals, without their means, over the lag of the second one.

    Args:
        first: Values, any unit, shape (n,); 0 is assumed in place of NaN.
        second: Values at the same times, any unit, shape (n,).
        lags: Largest lag, in samples.

    Returns:
        Correlation coefficients at the lags 0 to `lags`, dimensionless, shape (lags + 1,); 0 if a signal is
        constant. Of independent signals, of which one is white, 99 % are within 2.576 / sqrt(n).
    """
    a, b = (np.nan_to_num(values - np.nanmean(values)) for values in (first, second))
    size = float(np.sqrt(np.sum(a**2) * np.sum(b**2)))
    if size == 0.0:
        return np.zeros(lags + 1)
    full = signal.correlate(b, a, mode="full", method="fft")
    return np.asarray(full[len(a) - 1 : len(a) + lags] / size)


class ErrorCorrelations(NamedTuple):
    """Correlations of the error of a channel in a run.

    Attributes:
        run: Name of the run.
        channel: Name of the output channel.
        lag_s: Time by which the error is later, s, shape (k,).
        values: Correlation coefficients with "itself" and with each input by its name, dimensionless,
            shape (k,).
        limit: Magnitude below which 99 % of the coefficients of white noise are.
    """

    run: str
    channel: str
    lag_s: Array
    values: dict[str, Array]
    limit: float

    def outside(self) -> dict[str, float]:
        """Return the fraction of coefficients at positive lags with a magnitude above `limit`.

        It is dimensionless, and about 0.01 for white noise.

        Returns:
            Fraction by name of the signal: "itself" or an input.
        """
        return {name: float(np.mean(np.abs(r[1:]) > self.limit)) for name, r in self.values.items()}

    def panel(self) -> Panel:
        """Return the plot of the correlations over the lag, with the band of 99 % of white noise."""

        def draw(axes: Any) -> None:
            axes.axhspan(-self.limit, self.limit, color=color("muted"), alpha=0.3, lw=0)
            for role, (name, correlations) in zip(SERIES, self.values.items(), strict=False):
                start = 1 if name == "itself" else 0  # at lag 0, it is 1
                axes.plot(self.lag_s[start:], correlations[start:], color=color(role), lw=1.1, label=name)
            axes.set(xlabel="time by which the error is later, s", ylabel="correlation of the error with")
            axes.margins(x=0.01)
            legend_above(axes)

        parts = [f"{number(100.0 * fraction)} % with {name}" for name, fraction in self.outside().items()]
        text = f"error of {self.channel} in {self.run}. Outside the"
        description = f"Correlations of the {text} region of 99 %: {', '.join(parts)}."
        return Panel(
            f"{self.run}: {self.channel}. Outside the band: {', '.join(parts)}", description, draw, 2.3
        )


def error_correlations(
    curves: ResultCurves, name: str, channels: Sequence[str], inputs: Sequence[str]
) -> list[ErrorCorrelations]:
    """Compute the correlations of the errors of the delivered machine in a run.

    Args:
        name: Name of the run.
        channels: Names of the output channels.
        inputs: Names of the input channels.

    Returns:
        Correlations of each channel; none for a channel with less than 50 measurements, or if the result has
        no inputs.
    """
    run = curves.runs[name]
    if run.inputs is None:
        return []
    errors, commands, time_s = run.errors["after"], run.inputs, run.time_s
    period = float(np.median(np.diff(time_s)))
    found = []
    for j, channel in enumerate(channels):
        error = errors[:, j]
        measured = int(np.isfinite(error).sum())
        if measured < _MIN_ROWS:
            continue
        lags = min(max(10, round(_MAX_LAG_S / period)), len(error) // 4)
        values = {"itself": correlation(error, error, lags)}
        values |= {channel: correlation(commands[:, k], error, lags) for k, channel in enumerate(inputs)}
        lag_s = period * np.arange(lags + 1, dtype=np.float64)
        found.append(ErrorCorrelations(name, channel, lag_s, values, CONFIDENCE / float(np.sqrt(measured))))
    return found
