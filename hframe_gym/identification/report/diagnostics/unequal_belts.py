"""Belts that are declared alike and whose fitted stiffness differs, as a loose belt or a clamp makes it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ....dynamics import stiffness_matrix
from ....machine import Belt, Machine, motion_limits
from ...predict.free_parameters import FreeParameter, coupled_coordinates, default_free_parameters
from .parameter_diagnostics import PRIOR_DOMINATES, is_limited, with_structure_of


@dataclass(frozen=True)
class UnequalBelts:
    """Two belt sections that are declared with the same EA and whose fitted stiffness differs.

    The stiffness EA / rest_length of a section is divided by the declared one, so that sections of different
    lengths can be compared. A clamp that yields lengthens the fitted section, a soft belt lowers its EA.

    Attributes:
        softer: Name of the section of less stiffness.
        stiffer: Name of the other one.
        ratio: Stiffness of the softer section relative to the stiffer one, below 1.
        low: Lower end of the interval of the ratio.
        high: Upper end, below 1.
        stds: Standard deviations from the ratio to the ends of its interval.
    """

    softer: str
    stiffer: str
    ratio: float
    low: float
    high: float
    stds: float

    def sentence(self) -> str:
        """Return a sentence: by how many percent the softer section is less stiff, and what to check."""
        percents = [100.0 * (1.0 - ratio) for ratio in (self.ratio, self.high, self.low)]
        decimals = max(0, -math.floor(math.log10(percents[2] - percents[1])))  # the interval has one digit
        less, least, most = (f"{value:.{decimals}f}" for value in percents)
        return (
            f"The belt sections {self.softer} and {self.stiffer} are declared with the same EA, but for its "
            f"declared length {self.softer} is {less} % less stiff than {self.stiffer} ({least} to {most} %, "
            f"{self.stds:g} standard deviations each way): check its tension, its clamps, and "
            "the rest_length of both in the machine file."
        )


def unequal_belts(machine: Machine, declared: Machine, stds: float) -> tuple[UnequalBelts, ...]:
    """Find belt sections that are declared with the same EA and clearly differ in their fitted stiffness.

    Sections are compared if forces act between their coordinates: between others, as on the two axes of an XY
    table, the ratio is that of the declared torque constants. A section is left out if its EA was not
    fitted, if one of its parameters is at the limit of the fit, or if an effect acts at it alone, because its
    stiffness then depends on more than EA. A difference that no sensor of the machine could show is not told
    either: where the motors are held and the drives' full force acts on the tool, it moves the tool by less
    than the noise of the finest sensor there.

    Args:
        machine: Identified machine with its uncertainty.
        declared: Machine as it was declared, whose parameters are the centers of the priors.
        stds: Standard deviations of the ratio's logarithm from its estimate to the ends of its interval,
            which must not contain 1.

    Returns:
        Of each set of sections that are declared alike, the two that differ most. Empty if the machine has no
        uncertainty.
    """
    declared = with_structure_of(machine, declared)
    priors = {f.name: f for f in default_free_parameters(declared)}
    groups = coupled_coordinates(declared)
    found: dict[tuple[float, frozenset[str]], UnequalBelts] = {}
    for first, second in combinations(_fitted_belts(machine, declared, priors), 2):
        group = groups[next(iter(first.extension))]
        if first.EA != second.EA or not group.issuperset(second.extension):
            continue
        pair = _compared(machine, (first, second), priors, stds)
        key = first.EA, frozenset(group)
        if pair is not None and (key not in found or pair.ratio < found[key].ratio):
            found[key] = pair
    return tuple(pair for pair in found.values() if _shift(machine, pair) >= _finest_noise(machine))


def _shift(machine: Machine, pair: UnequalBelts) -> float:
    """Return by how much the softer belt moves the tool at full force, m, compared with one like the other.

    The motors are held, and the drives' full force acts along one direction of the tool after the other.
    Infinite if the drives move all coordinates, so that no tool behind the belts moves.
    """
    driven = {drive.coordinate for drive in machine.drives}
    free = [i for i, name in enumerate(machine.coordinate_names) if name not in driven]
    name = _fitted_name(pair.softer, "EA", machine)
    stiffer = machine.replace({name: machine.parameters[name] / pair.ratio})
    compliances = [np.linalg.pinv(stiffness_matrix(each)[np.ix_(free, free)]) for each in (machine, stiffer)]
    travel = np.array([machine.coordinates[i].travel_per_unit for i in free])
    shifts = [
        float(np.abs(travel * (compliances[0] - compliances[1])[:, free.index(i)] * limits.force).max())
        for leading, limits in motion_limits(machine).items()
        if (i := machine.coordinate_names.index(leading)) in free
    ]
    return max(shifts, default=math.inf)


def _finest_noise(machine: Machine) -> float:
    """Return the smallest noise of the sensors of the tool's position, rounding included, m.

    Without a sensor of what no drive holds, it is that of the others, in m of belt travel.
    """
    driven = {drive.coordinate for drive in machine.drives}
    of_position = [sensor for sensor in machine.sensors if sensor.of_position]
    at_tool = [sensor for sensor in of_position if driven.isdisjoint(sensor.row)]
    noises = [
        max(sensor.noise, sensor.resolution / math.sqrt(12.0))
        * machine.coordinate(name).travel_per_unit
        / abs(coefficient)
        for sensor in at_tool or of_position
        for name, coefficient in sensor.row.items()
        if coefficient
    ]
    return min(noises, default=0.0)


def _fitted_belts(machine: Machine, declared: Machine, priors: dict[str, FreeParameter]) -> list[Belt]:
    """Return the declared belts whose fitted stiffness can be compared."""
    names = machine.uncertainty.names if machine.uncertainty else ()
    sites = {effect.site for effect in machine.effects}
    return [
        belt
        for belt in declared.belts
        if _fitted_name(belt.name, "EA", machine) in names
        and belt.name not in sites
        and not any(
            is_limited(priors[name], machine.parameters[name])
            for key in ("EA", "rest_length")
            if (name := _fitted_name(belt.name, key, machine)) in names and name in priors
        )
    ]


def _compared(
    machine: Machine, belts: tuple[Belt, Belt], priors: dict[str, FreeParameter], stds: float
) -> UnequalBelts | None:
    """Compare two belts; None if their ratio may be 1, or if the priors determine it more than the data."""
    assert machine.uncertainty is not None
    names = machine.uncertainty.names
    fitted = {belt.name: belt for belt in machine.belts}
    logarithm = 0.0  # of the ratio
    powers: dict[str, int] = {}  # exponents of the fitted parameters in the ratio
    for sign, belt in zip((1, -1), belts, strict=True):
        for power, key in ((sign, "EA"), (-sign, "rest_length")):
            logarithm += power * math.log(getattr(fitted[belt.name], key) / getattr(belt, key))
            name = _fitted_name(belt.name, key, machine)
            if name in names and name in priors:
                powers[name] = powers.get(name, 0) + power
    slopes = np.array([powers[name] / machine.parameters[name] if name in powers else 0.0 for name in names])
    std = math.sqrt(max(float(slopes @ machine.uncertainty.covariance @ slopes), 0.0))
    of_prior = math.hypot(*(power * priors[name].prior for name, power in powers.items()))
    if abs(logarithm) <= stds * std or not 0.0 < std <= PRIOR_DOMINATES * of_prior:
        return None
    softer, stiffer = belts if logarithm < 0.0 else belts[::-1]
    low, ratio, high = (math.exp(k * stds * std - abs(logarithm)) for k in (-1, 0, 1))
    return UnequalBelts(softer.name, stiffer.name, ratio, low, high, stds)


def _fitted_name(belt: str, key: str, machine: Machine) -> str:
    """Return the name of the parameter that determines one of a belt, which may be tied to it."""
    name = f"{belt}.{key}"
    return machine.ties.get(name, (name, 1.0))[0]
