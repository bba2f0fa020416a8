"""Values as pages write them: the unit of a channel, and fractions in percent."""

from __future__ import annotations

from ...recordings import split_unit

_SCALES = {"m": ((1e6, "µm"), (1e3, "mm")), "rad": ((1e3, "mrad"),)}


def readable_unit(channel: str, largest: float) -> tuple[float, str]:
    """Choose the smallest unit (µm, mm, m; mrad, rad) in which a value of a channel is below 1000.

    Args:
        channel: Name of the output channel, which ends with its unit, for example "x_m".
        largest: Largest value to be written, in the channel's unit.

    Returns:
        factor: Number by which values in the channel's unit are multiplied, for example 1e6.
        unit: Name of the readable unit, for example "µm"; the channel's unit if it is neither m nor rad.
    """
    base = split_unit(channel)[1] or channel.rpartition("_")[2]
    return next((s for s in _SCALES.get(base, ()) if s[0] * largest < 1000.0), (1.0, base))


def percent(fraction: float) -> str:
    """Format a fraction in percent to three digits, without the sign: "12.3" for 0.123.

    A fraction above 0.9995, which would round to 100, is "more than 99.9".

    Args:
        fraction: The fraction, dimensionless.
    """
    return "more than 99.9" if fraction > 0.9995 else f"{100 * fraction:.3g}"
