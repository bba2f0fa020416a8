"""Curves of effects over the variable on which they depend, with the band of their uncertainty."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ....arrays import Array
from ....effects.smooth_table import TABLE_FAMILY
from ....machine import AppliedEffect, Coordinate, Machine, argument_names, standard_deviations
from ....web_page import Panel, color, number
from ..content.result_curves import ResultCurves

_POINTS = 400
_BAND = 2.0  # standard deviations
_STEP = 0.5  # of a parameter, in standard deviations: curves may jump
_MAX_PERIODS = 12  # of an effect that repeats; more of them cannot be told apart in a panel
_SPEEDS = 8.0  # Largest speed drawn, in multiples of the speed that a parameter of the effect states.


@dataclasses.dataclass(frozen=True)
class EffectCurve:
    """Force, friction or voltage of an effect as a function of the variable on which it depends.

    Attributes:
        effect: The effect with its parameters.
        variable: Name of the variable with its unit, for example "velocity of x, m/s".
        quantity: Name of what is drawn with its unit, for example "friction on x, N".
        x: Values of the variable, SI, shape (n,).
        y: Values of the curve, SI, shape (n,).
        std: Standard deviation of the curve due to that of the parameters, SI, shape (n,).
    """

    effect: AppliedEffect
    variable: str
    quantity: str
    x: Array
    y: Array
    std: Array

    def panel(self) -> Panel:
        """Return the plot of the curve, with a band of two standard deviations to each side."""
        spread = _BAND * self.std
        low, high = self.y - spread, self.y + spread

        def draw(axes: Any) -> None:
            axes.fill_between(self.x, low, high, color=color("after"), alpha=0.25, lw=0)
            axes.plot(self.x, self.y, color=color("after"), lw=1.6)
            axes.set(xlabel=self.variable, ylabel=self.quantity)
            axes.margins(x=0.01)

        name = self.effect.label.replace("_", " ").replace("@", " at ")
        unit = self.quantity.rpartition(", ")[2]
        description = (
            f"{name}: {self.quantity} against {self.variable}, from {number(float(self.y.min()))} to "
            f"{number(float(self.y.max()))} {unit}; two standard deviations are at most "
            f"{number(float(spread.max()))} {unit}."
        )
        band = (
            f"band: two standard deviations of its parameters, at most ±{number(float(spread.max()))} {unit}"
        )
        return Panel(f"{name}; {band}", description, draw, 2.5)


def effect_curve(effect: AppliedEffect, machine: Machine, curves: ResultCurves) -> EffectCurve | None:
    """Compute the curve of an effect over the variable on which it depends, in the range of the fitted runs.

    The curve is the dry friction of a coordinate including the effect, the force of the effect, or its change
    of a voltage.

    Args:
        effect: Effect of the identified machine.
        machine: The machine, with its uncertainty where it is known.
        curves: Curves of the result; their `coverage` gives the range of the variable.

    Returns:
        The curve with n values each, shape (n,). None if the effect is no function of one variable (it has a
        state or adds coordinates), it is a table, which has its own plot, or the range of its variable is not
        known.
    """
    definition, names = effect.definition, set(effect.parameters)
    if definition.family == TABLE_FAMILY or definition.structure or definition.next_state:
        return None
    coordinate = _coordinate(effect, machine)
    for hook, symbols in (("coulomb", "qvt"), ("force", "qvt"), ("voltage", "V")):
        function = getattr(definition, hook)
        if function is None:
            continue
        needed = set(argument_names(function)) - names - {"level"}
        if len(needed) != 1 or not needed <= set(symbols):
            return None
        (symbol,) = needed
        axis = _axis(symbol, effect, machine, coordinate, curves)
        if axis is None:
            return None
        x, variable = axis
        value, quantity = _value(hook, symbol, x, effect, coordinate)
        turn = 2.0 * math.pi
        if coordinate and coordinate.kind == "rotary" and symbol == "q" and np.ptp(x) > turn:
            ahead, _ = _value(hook, symbol, x + turn, effect, coordinate)
            if np.allclose(value(machine), ahead(machine)):
                x = np.linspace(0.0, turn, _POINTS)
                value, _ = _value(hook, symbol, x, effect, coordinate)
        if hook == "voltage":
            quantity += variable.rpartition(",")[2]
        y = value(machine)
        std = standard_deviations(machine, value, _STEP)
        std = np.zeros_like(y) if std is None else std
        return EffectCurve(effect, variable, quantity, x, y, std) if np.isfinite(y).all() else None
    return None


def _coordinate(effect: AppliedEffect, machine: Machine) -> Coordinate | None:
    """Return the coordinate on which an effect acts, None if it is no single one."""
    of_drive = {drive.name: drive.coordinate for drive in machine.drives}
    name = of_drive.get(effect.site, effect.site) if effect.definition.site == "motor" else effect.site
    return machine.coordinate(name) if name in machine.coordinate_names else None


def _axis(
    symbol: str, effect: AppliedEffect, machine: Machine, coordinate: Coordinate | None, curves: ResultCurves
) -> tuple[Array, str] | None:
    """Return a variable's values at which an effect is drawn, and its name with the unit."""
    if symbol == "V":
        return _command_axis(effect, machine, curves)
    if coordinate is None:
        return None
    if symbol == "t":
        return _time_axis(curves)
    return (_velocity_axis if symbol == "v" else _position_axis)(effect, coordinate, curves)


def _command_axis(effect: AppliedEffect, machine: Machine, curves: ResultCurves) -> tuple[Array, str] | None:
    """Return commands up to the largest one of the fitted runs."""
    drives = [drive for drive in machine.drives if effect.site in (drive.name, "drives")]
    if not drives:
        return None
    seen = [curves.coverage[drive.channel] for drive in drives if drive.channel in curves.coverage]
    top = max((float(np.abs(values).max()) for values in seen), default=0.0)
    return _symmetric(top, f"command of {effect.site}, {machine.command_unit(drives[0])}")


def _time_axis(curves: ResultCurves) -> tuple[Array, str] | None:
    """Return times up to the end of the longest run."""
    ends = [run.time_s[-1] for run in curves.runs.values() if len(run.time_s)]
    return (np.linspace(0.0, max(ends), _POINTS), "time, s") if ends and max(ends) > 0.0 else None


def _velocity_axis(
    effect: AppliedEffect, coordinate: Coordinate, curves: ResultCurves
) -> tuple[Array, str] | None:
    """Return velocities up to that of the fitted runs, or to where a parameter's speed is small."""
    seen = curves.coverage.get(f"velocity of {coordinate.name}")
    top = math.inf if seen is None else float(np.abs(seen).max())
    speeds = [abs(effect.parameters[p.name]) for p in effect.definition.parameters if p.unit == "speed"]
    top = min(top, _SPEEDS * max(speeds)) if speeds else top
    return _symmetric(top, f"velocity of {coordinate.name}, {coordinate.unit('speed')}")


def _position_axis(
    effect: AppliedEffect, coordinate: Coordinate, curves: ResultCurves
) -> tuple[Array, str] | None:
    """Return positions of the fitted runs, one turn if these are unknown, or some periods of the effect."""
    seen = curves.coverage.get(f"position of {coordinate.name}")
    if seen is None and coordinate.kind != "rotary":
        return None
    low, high = (0.0, 2.0 * math.pi) if seen is None else (float(seen.min()), float(seen.max()))
    if period := _period(effect):
        high = min(high, low + _MAX_PERIODS * period)
    label = f"position of {coordinate.name}, {coordinate.unit('position')}"
    return (np.linspace(low, high, _POINTS), label) if high > low else None


def _period(effect: AppliedEffect) -> float | None:
    """Return the distance after which an effect repeats, m or rad; None if it does not."""
    for p in effect.definition.parameters:
        value = abs(effect.parameters[p.name])
        if p.role == "rate" and value > 0.0:
            return 2.0 * math.pi / value
        if p.role == "period" and value > 0.0:
            return float(value)
    return None


def _symmetric(top: float, label: str) -> tuple[Array, str] | None:
    """Return values around zero, with none at zero, where friction jumps."""
    return (np.linspace(-top, top, _POINTS), label) if 0.0 < top < math.inf else None


def _value(
    hook: str, symbol: str, x: Array, effect: AppliedEffect, coordinate: Coordinate | None
) -> tuple[Callable[[Machine], Array], str]:
    """Return the function from a machine with the effect to its curve over `x`, its name and unit."""

    def of(machine: Machine) -> AppliedEffect:
        return next(e for e in machine.effects if e.label == effect.label)

    if hook == "voltage":
        return (lambda m: of(m)(hook, **{symbol: x}) - x), f"change of the command of {effect.site},"
    assert coordinate is not None
    site, unit = coordinate.name, coordinate.unit("force")
    if hook == "force":
        return (lambda m: np.broadcast_to(of(m)(hook, **{symbol: x}), x.shape)), f"force on {site}, {unit}"
    sign, at = (np.sign(x), np.abs(x)) if symbol == "v" else (1.0, x)

    def dry_friction(machine: Machine) -> Array:
        level = machine.coordinate(site).coulomb
        return np.asarray(sign * (level + of(machine)(hook, **{symbol: at}, level=level)))

    return dry_friction, f"dry friction on {site}, {unit}"
