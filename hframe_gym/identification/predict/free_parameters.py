"""Free parameters of a fit: which parameters of a machine are estimated, in which coordinates and prior."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import lsq_linear

from ...arrays import Array
from ...machine import DRIVE_KINDS, Belt, Drive, Machine

# Standard deviations of the priors, relative to the declared value. Dry friction and viscous friction vary
# most from one machine to the next, belt lengths least.
_MASS_PRIOR = 0.3
_FRICTION_PRIOR = 0.7
_BELT_PRIOR = 0.3
_LENGTH_PRIOR = 0.1
_MOTOR_PRIOR = 0.2
_EFFECT_PRIOR = 0.5
# The logarithm of a parameter of the machine may move this many standard deviations of its prior. With wider
# limits, a refit without the missing effects may end so far away (a mass twenty times the declared one
# instead of a spring) that the search does not return. Linear parameters of effects have no such limit,
# because the typical sizes by which they are divided are only rough estimates (a spring may be stronger than
# the drives).
_MAXIMUM_DEVIATION = 4.0
_LIMIT_TOLERANCE = 0.01  # relative
# Friction of a coordinate that declares none: unit of theta as a fraction of the typical force.
_UNDECLARED_COULOMB, _UNDECLARED_VISCOUS = 0.01, 0.1


@dataclass(frozen=True)
class FreeParameter:
    """One fitted parameter of a machine and the dimensionless variable theta that the optimizer changes.

    The parameter's value is `center * exp(theta)`, or `center + scale * theta` where `scale` is given.

    Attributes:
        name: Full name of the machine parameter, e.g. `x.coulomb`.
        center: Value at theta = 0, SI.
        prior: Standard deviation of theta around 0.
        scale: Change of the value per unit of theta, SI; None for a parameter that is fitted as a logarithm.
        lower: Lower bound of the value.
        upper: Upper bound of the value.
        along: Name of the table (curve given by its values at knots) of which this parameter is one value; ""
            if it belongs to no table. Values of one table follow each other in order; the prior also
            penalizes their second differences.
        switch: Whether the parameter is a threshold: predictions change in steps as it changes. Derivatives
            do not lead to the best value, so a fit also tries values at a distance.
    """

    name: str
    center: float
    prior: float
    scale: float | None = None
    lower: float = 0.0
    upper: float = math.inf
    along: str = ""
    switch: bool = False

    @property
    def of_effect(self) -> bool:
        """Whether the parameter belongs to an effect (name@site.parameter), not to the machine itself."""
        return "@" in self.name  # the label of an effect is name@site

    @cached_property
    def theta_limits(self) -> tuple[float, float]:
        """Smallest and largest theta (dimensionless variable of the optimizer) that a fit may reach.

        They are +-4 standard deviations of the prior for a parameter that is fitted as a logarithm. For any
        other parameter, the bounds of its value determine them.
        """
        if self.scale is None:
            return -_MAXIMUM_DEVIATION * self.prior, _MAXIMUM_DEVIATION * self.prior
        low, high = sorted((self.theta(self.lower), self.theta(self.upper)))
        return low, high

    def at_limit(self, theta: float) -> bool:
        """Return whether a fit has moved the parameter to its limit, so that its value is not reliable.

        Args:
            theta: Dimensionless optimizer variable that the fit returned.

        Returns:
            True if theta has passed 99 % of the way from 0 to its smallest or largest permitted value
            (`theta_limits`). A limit at 0 does not count: friction that is declared as zero may remain zero.
        """
        low, high = ((1.0 - _LIMIT_TOLERANCE) * limit for limit in self.theta_limits)
        return theta < low < 0.0 or 0.0 < high < theta

    def beyond_limit(self, theta: float) -> bool:
        """Return whether a fit of this parameter could not reach a given `theta`, dimensionless.

        That is a theta beyond 101 % of the way from 0 to the smallest or largest permitted one
        (`theta_limits`). As in `at_limit`, a limit at 0 does not count.
        """
        low, high = ((1.0 + _LIMIT_TOLERANCE) * limit for limit in self.theta_limits)
        return theta < low < 0.0 or 0.0 < high < theta

    def value(self, theta: Array) -> Array:
        """Convert `theta`, dimensionless, of any shape, to the value, SI, clipped to the bounds.

        The value is center * exp(theta), or center + scale * theta where `scale` is given.
        """
        raw = self.center * np.exp(theta) if self.scale is None else self.center + self.scale * theta
        # For few values, a fifth of the time of `clip`.
        return np.minimum(np.maximum(raw, self.lower), self.upper)

    def theta(self, value: float) -> float:
        """Convert `value`, SI, to theta, the dimensionless variable of the optimizer.

        It is log(value / center), or (value - center) / scale where `scale` is given.

        Raises:
            ValueError: If the parameter is fitted as a logarithm and the value is zero or has not the sign of
                the attribute `center`.
        """
        return math.log(value / self.center) if self.scale is None else (value - self.center) / self.scale

    def slope(self, theta: float) -> float:
        """Return the derivative of the value, without its bounds, by `theta`, in the value's SI unit.

        It is center * exp(`theta`), or `scale` where this is given; `theta` is dimensionless.
        """
        return self.center * math.exp(theta) if self.scale is None else self.scale

    def prior_std(self, value: float) -> float:
        """Convert the prior's standard deviation from theta to the parameter's value.

        Args:
            value: Value of the parameter, SI. It is used only if the parameter is fitted as a logarithm.

        Returns:
            Standard deviation in the SI unit of the value: `prior` * |value| for a parameter that is fitted
            as a logarithm, otherwise `prior` * `scale`.
        """
        return self.prior * (abs(value) if self.scale is None else self.scale)


def values_at(free: Sequence[FreeParameter], theta: Array) -> dict[str, float]:
    """Convert the optimizer's variables theta to values: center * exp(theta), or center + scale * theta.

    Args:
        free: Free parameters, k of them.
        theta: Dimensionless variable of each free parameter, shape (k,).

    Returns:
        Value, SI, by full parameter name such as "x.coulomb".
    """
    return {f.name: float(f.value(t)) for f, t in zip(free, theta, strict=True)}


def parameter_table(machine: Machine, free: Sequence[FreeParameter], thetas: Array) -> Array:
    """Convert the optimizer's variables theta of several simulations to parameter vectors of the machine.

    Args:
        machine: Machine that supplies all parameters that are not free.
        free: Free parameters, k of them.
        thetas: Dimensionless variable of each free parameter for every simulation of a batch,
            shape (batch, k).

    Returns:
        All parameters of the machine, SI, in the order of `Machine.parameters`, shape (batch, parameters), as
        `simulate_batch` takes them.

    Raises:
        ValueError: If the name of a free parameter is not one of the machine's parameters.
    """
    names = list(machine.parameters)
    table = np.tile(np.array(list(machine.parameters.values())), (len(thetas), 1))
    for j, parameter in enumerate(free):
        table[:, names.index(parameter.name)] = parameter.value(thetas[:, j])
    return table


def second_difference_penalty(count: int) -> Array:
    """Return the matrix P, dimensionless, of a penalty on the curvature of a table.

    y^T P y is the sum of the squared second differences of the table's ordinates y, shape (count,).

    Args:
        count: Number of ordinates.

    Returns:
        P, shape (count, count); 0 for fewer than three ordinates.
    """
    second_difference = np.diff(np.eye(count), n=2, axis=0)
    penalty: Array = second_difference.T @ second_difference
    return penalty


def prior_precision(free: Sequence[FreeParameter]) -> Array:
    """Return the inverse covariance of the Gaussian prior of theta, the optimizer's dimensionless variables.

    The prior has mean 0 and independent components with the standard deviations `FreeParameter.prior`.
    Parameters that are the ordinates of one table (a curve given by its values at knots) have a further
    prior: their second differences have unit variance, which favors smooth curves.

    Args:
        free: Free parameters, k of them.

    Returns:
        Inverse covariance, dimensionless, shape (k, k).
    """
    precision = np.diag([1.0 / f.prior**2 for f in free])
    for curve in dict.fromkeys(f.along for f in free if f.along):
        ordinates = np.array([f.along == curve for f in free])
        precision[np.ix_(ordinates, ordinates)] += second_difference_penalty(int(ordinates.sum()))
    return precision


def bounded_step(free: Sequence[FreeParameter], theta: Array, hessian: Array, gradient: Array) -> Array:
    """Return the step of theta, the optimizer's variables, that minimizes a quadratic cost within limits.

    The model is cost + 2 gradient^T step + step^T hessian step. Each theta stays within
    `FreeParameter.theta_limits`.

    Args:
        free: Free parameters, k of them, with the limits of theta.
        theta: Dimensionless variables before the step, within their limits, shape (k,).
        hessian: Positive definite matrix of the model, dimensionless, shape (k, k).
        gradient: Half the derivative of the cost at theta, dimensionless, shape (k,).

    Returns:
        Step of theta, shape (k,): -hessian^-1 gradient if this stays within the limits, otherwise the minimum
        of the model within the limits.
    """
    low, high = limits_of_theta(free)
    step = minimum_within(hessian, gradient, low - theta, high - theta)
    moved = theta + step
    within = np.all((low <= moved) & (moved <= high))  # rounding may move a parameter past its limit
    return step if within else np.clip(moved, low, high) - theta


def step_in_values(free: Sequence[FreeParameter], theta: Array, step: Array) -> Array:
    """Return the step of theta that changes each value by as much as the step's derivative says.

    A value that is fitted as a logarithm then moves along a straight line, so that sums of values change as
    the linear model of the step says: a part's inertia may grow and the rest of the total inertia shrink.

    Args:
        free: Free parameters, k of them, with the limits of theta.
        theta: Dimensionless variables before the steps, within their limits, shape (k,).
        step: Steps of theta, shape (..., k).

    Returns:
        Steps of theta, shape (..., k), within the limits; to the smallest theta where a logarithm's value
        would not remain positive.
    """
    logarithmic = np.array([f.scale is None for f in free], np.bool_)
    with np.errstate(divide="ignore"):
        changed = np.where(logarithmic, np.log1p(np.maximum(step, -1.0)), step)
    low, high = limits_of_theta(free)
    return np.asarray(np.clip(theta + changed, low, high) - theta)


def limits_of_theta(free: Sequence[FreeParameter]) -> tuple[Array, Array]:
    """Return the smallest and the largest theta of each free parameter, dimensionless, shape (k,) each."""
    low, high = np.array([f.theta_limits for f in free]).reshape(-1, 2).T
    return low, high


def minimum_within(hessian: Array, gradient: Array, low: Array, high: Array) -> Array:
    """Return the step that minimizes 2 gradient^T step + step^T hessian step within limits, shape (k,).

    Args:
        hessian: Positive definite matrix of the model, dimensionless, shape (k, k).
        gradient: Half the derivative of the model at step 0, dimensionless, shape (k,).
        low: Smallest step, not above 0, shape (k,).
        high: Largest step, not below 0, shape (k,).
    """
    step = np.asarray(np.linalg.solve(hessian, -gradient), float)
    if np.all((low <= step) & (step <= high)):
        return step
    bounded = _minimum_by_active_sets(hessian, gradient, low, high)
    if bounded is None:
        bounded = _minimum_by_least_squares(hessian, gradient, (low, high))
    return np.clip(bounded, low, high)


def _minimum_by_active_sets(hessian: Array, gradient: Array, low: Array, high: Array) -> Array | None:
    """Return a quadratic model's minimum within limits, shape (k,); None if no set at the limits settles.

    Each iteration holds those at a limit that the last minimum exceeds, or that its slope pushes against.
    Sets that settle are those of the minimum, which is unique. This takes a quarter of the time of a search
    along the limits.

    References:
        Hintermueller, Ito and Kunisch (2002), "The primal-dual active set strategy as a semismooth Newton
        method".
    """
    at_low = at_high = np.zeros(len(gradient), np.bool_)
    for _ in range(len(gradient)):
        held = at_low | at_high
        step = np.where(at_low, low, np.where(at_high, high, 0.0))
        inner = np.flatnonzero(~held)
        slope = gradient + hessian @ step
        step[inner] = -np.linalg.solve(hessian[np.ix_(inner, inner)], slope[inner])
        slope = gradient + hessian @ step
        now_low = np.where(held, at_low & (slope > 0.0), step < low)
        now_high = np.where(held, at_high & (slope < 0.0), step > high)
        if np.array_equal(now_low, at_low) and np.array_equal(now_high, at_high):
            return step
        at_low, at_high = now_low, now_high
    return None


def _minimum_by_least_squares(hessian: Array, gradient: Array, limits: tuple[Array, Array]) -> Array:
    """Return the minimum of a quadratic model within limits, shape (k,), by a search along the limits."""
    # The quadratic model as a sum of squares, |A step - b|^2; eigenvalues may be negative by rounding.
    eigenvalues, axes = np.linalg.eigh(hessian)
    scales = np.sqrt(np.maximum(eigenvalues, np.finfo(np.float64).eps * eigenvalues.max()))
    A, b = scales[:, None] * axes.T, -(axes.T @ gradient) / scales
    with np.errstate(divide="ignore", invalid="ignore"):
        bounded = lsq_linear(A, b, limits, method="bvls").x
    # SciPy's BVLS divides by zero where rounding moves a parameter past its limit; an interior-point method
    # does not.
    return np.asarray(
        bounded if np.isfinite(bounded).all() else lsq_linear(A, b, limits, method="trf").x, np.float64
    )


def typical_force(machine: Machine) -> float:
    """Return a typical size of forces, N: a tenth of the rated force.

    A fit expresses the amplitudes of effects and undeclared friction relative to it.
    """
    return 0.1 * rated_force(machine)


def rated_force(machine: Machine) -> float:
    """Return the sum of the forces of all drives at standstill and rated voltage, N.

    A force acts at the belt: torque / pulley radius for a rotary coordinate.
    """
    total = 0.0
    for drive in machine.drives:  # drive.gain: force or torque per volt at standstill
        total += drive.gain * drive.rated_voltage / machine.coordinate(drive.coordinate).travel_per_unit
    return total


def default_free_parameters(machine: Machine, *, effects: bool = True) -> tuple[FreeParameter, ...]:
    """Return the parameters that identification refits by default.

    These are:

    - Mass, viscous friction and dry friction of every coordinate.
    - The stiffness EA of every belt section. For a section whose length changes with the position of the
      machine, or to which another one with such a length is tied, also its constant part `rest_length`, the
      length at position 0.
    - The torque constant Kt of every drive that sets no unit of force, and nonzero back-EMF constants Ke.
    - The gains and limits of every drive that follows a set point, without those at their defaults.
    - The resistance of every drive whose current is measured and not controlled, which separates its
      electrical from its mechanical side.
    - The parameters of declared effects.

    Left out are parameters that the machine ties to others, and the torque constant of one drive (the
    `unit_of_force` of a drive with a law, unless its torque or current is measured) in each group of
    coordinates between which forces act. If all torque constants, masses, friction forces and stiffnesses of
    a group are multiplied by the same factor, the same voltages cause the same motion. Recordings without a
    sensor of forces in the group therefore do not determine this factor; the torque constant of its first
    drive sets it. The axes of an XY table are two groups.

    Friction that is declared as zero may become positive. Back-EMF acts like viscous friction, so the data
    determine only their sum. Both are free, because this sum may be smaller than the declared back-EMF alone.

    Args:
        machine: Declared machine.
        effects: Whether the nonzero parameters of the declared effects are included, unless an effect
            declares a parameter as fixed.

    Returns:
        Free parameters with their priors, centered on the declared values.
    """
    free = [*_coordinate_parameters(machine)]
    for belt in machine.belts:
        free.append(FreeParameter(f"{belt.name}.EA", belt.EA, prior=_BELT_PRIOR))
        if _length_changes(belt, machine):
            free.append(FreeParameter(f"{belt.name}.rest_length", belt.rest_length, prior=_LENGTH_PRIOR))
    sensed = {name for sensor in machine.sensors if sensor.quantity == "current" for name in sensor.row}
    setting_units = _drives_that_set_units(machine)
    for drive in machine.drives:
        if not drive.law and drive.name not in setting_units:
            free.append(FreeParameter(f"{drive.name}.Kt", drive.Kt, prior=_MOTOR_PRIOR))
    for drive in machine.drives:
        free += _law_parameters(drive, anchored=drive.name in setting_units and drive.name not in sensed)
    # An amplifier that controls the current or the torque has no parameter for the resistance, which it
    # overcomes.
    resistances = [
        drive
        for drive in machine.drives
        if drive.name in sensed and not drive.law and f"{drive.name}.resistance" in machine.parameters
    ]
    free += [
        FreeParameter(f"{drive.name}.resistance", drive.resistance, prior=_MOTOR_PRIOR)
        for drive in resistances
    ]
    free += [_damping(f"{drive.name}.Ke", drive.Ke, _MOTOR_PRIOR) for drive in machine.drives if drive.Ke > 0]
    if effects:
        free += _declared_effect_parameters(machine)
    return tuple(parameter for parameter in free if parameter.name not in machine.ties)


def _length_changes(belt: Belt, machine: Machine) -> bool:
    """Return whether the length of a belt section, or of one tied to it, changes with the position."""
    name = f"{belt.name}.rest_length"
    tied = (b for b in machine.belts if machine.ties.get(f"{b.name}.rest_length", ("", 0.0))[0] == name)
    return any(bool(b.length) for b in (belt, *tied))


def coupled_coordinates(machine: Machine) -> dict[str, set[str]]:
    """Return the group of each coordinate: itself and all coordinates that forces connect to it.

    Belts and effects that act on two coordinates connect them. A common factor of all forces, masses and
    torque constants of a group leaves its motion unchanged.

    Returns:
        Names of the coordinates of the group, by name of the coordinate.
    """
    links = [set(belt.extension) for belt in machine.belts]
    links += [
        {e.coordinate, machine.coordinate_of_site(e.site, e.definition.site) or e.coordinate}
        for e in machine.effects
        if e.coordinate
    ]
    group = {name: {name} for name in machine.coordinate_names}
    for link in links:
        joined = set().union(*(group[name] for name in link if name in group))
        group |= dict.fromkeys(joined, joined)
    return group


def _drives_that_set_units(machine: Machine) -> set[str]:
    """Return the first drives of groups of coordinates between which forces act, without sensor of forces."""
    group = coupled_coordinates(machine)
    scaled = {machine.coordinate_of_sensor(s) for s in machine.sensors if s.sensed.is_force}
    first = set()
    for drive in machine.drives:
        if not scaled & group[drive.coordinate]:
            first.add(drive.name)
            scaled.add(drive.coordinate)
    return first


def _law_parameters(drive: Drive, *, anchored: bool) -> list[FreeParameter]:
    """Return the free parameters of a drive's law; `anchored`: the drive sets a unit of force."""
    kind = DRIVE_KINDS.get(drive.kind)
    free = []
    for p in kind.law.parameters if kind.law else ():
        value = drive.law_parameters[p.name]
        known = p.role == "fixed" or value == 0.0 or kind.defaults.get(p.name) == value
        if not known and not (anchored and p.name == kind.unit_of_force):
            name = f"{drive.name}.{p.name}"
            free.append(FreeParameter(name, value, _EFFECT_PRIOR, lower=p.lower, upper=p.upper))
    return free


def _coordinate_parameters(machine: Machine) -> list[FreeParameter]:
    """Return mass and friction of every coordinate as free parameters."""
    force = typical_force(machine)
    free = []
    for c in machine.coordinates:
        radius = c.travel_per_unit
        free.append(FreeParameter(f"{c.name}.mass", c.mass, prior=_MASS_PRIOR))
        undeclared = {
            "viscous": _UNDECLARED_VISCOUS * force * radius**2,
            "coulomb": _UNDECLARED_COULOMB * force * radius,
        }
        for key, scale in undeclared.items():
            value = getattr(c, key)
            if value > 0:
                parameter = _damping if key == "viscous" else FreeParameter
                free.append(parameter(f"{c.name}.{key}", value, _FRICTION_PRIOR))
            else:
                free.append(FreeParameter(f"{c.name}.{key}", value, prior=1.0, scale=scale))
    return free


def _damping(name: str, value: float, prior: float) -> FreeParameter:
    """Return a viscous friction or back-EMF constant as a linear parameter, with a logarithmic one's range.

    The data determine the sum of viscous friction and back-EMF only. The set of equal sums is straight in
    linear parameters. In logarithms it is curved, and a fit that follows it to the most probable values does
    not converge.
    """
    factor = math.exp(_MAXIMUM_DEVIATION * prior)
    return FreeParameter(name, value, prior, scale=value, lower=value / factor, upper=value * factor)


def _declared_effect_parameters(machine: Machine) -> list[FreeParameter]:
    """Return the nonzero parameters of a machine's effects as free parameters."""
    free = []
    for effect in machine.effects:
        for p in effect.definition.parameters:
            value = effect.parameters[p.name]
            if p.role == "fixed" or value == 0.0:
                continue
            scale = None
            if p.lower < 0.0:  # the sign is free: linear, not logarithmic
                scale = 1.0 if p.role == "phase" else abs(value)
            name = f"{effect.label}.{p.name}"
            free.append(
                FreeParameter(name, value, prior=_EFFECT_PRIOR, scale=scale, lower=p.lower, upper=p.upper)
            )
    return free
