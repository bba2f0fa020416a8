"""Effects that act on the simulated machine and that no controller's model declares, sampled per episode.

An effect is a modeled deviation from the basic machine, such as cogging; its site is where it acts, such as
motor1. The simulated machine has every effect of `EFFECT_FAMILIES` at every site listed there. At first each
is *off*: its parameters are such that it has no influence, for example an amplitude of zero or a limit that
nothing reaches. Randomization rules then switch a few of them *on*. An effect is on with probability
`EXPECTED_EFFECTS` / (number of families * number of its sites), independently of the others, so that a family
is on with the same probability as any other, and an episode has two effects on average (13 % of the episodes
have none). The size of an effect that is on is log-uniform from `SMALLEST_SIZE` to 1 times its full size,
which is what a used machine may plausibly have. Further parameters (wavelengths, phases) have the
distributions of the table.

Left out are effects that no parameter value switches off, because they change the machine's structure
(`bridge_yaw`, `idler_inertia`, `frame_resonance`, `payload_swing`, `gear_backlash`) or replace its friction
law (`presliding`, `bouc_wen_hysteresis`). Errors of the sensors' scale, skew and range and periodic ones are
left out too: with them, a tool that is measured at the goal is elsewhere, which no controller can correct.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from typing_extensions import override

from ..arrays import Array
from ..effects import EFFECTS
from ..envs import DISTRIBUTIONS, Distribution, LogUniform, RandomizeParameter, Uniform
from ..errors import InputError
from ..machine import Machine

EXPECTED_EFFECTS = 2.0  # mean number of effects in an episode
SMALLEST_SIZE = 0.2  # of the full size
NO_SLACK_N = 1e5  # N, a pretension that no belt force reaches


@DISTRIBUTIONS.register("sometimes")
@dataclass(frozen=True)
class Sometimes(Distribution):
    """Distribution of a number, log-uniform on [low, high] with a probability, otherwise a constant.

    Args:
        probability: Probability of the log-uniform number, above 0 and at most 1.
        low: Lower end of the log-uniform distribution, positive.
        high: Its upper end, finite, not below `low`.
        otherwise: The constant, at most `low` or at least `high`.
        signed: Whether the log-uniform number gets a negative sign with probability 1/2; `otherwise` must
            then be 0.

    Raises:
        InputError: If an argument is invalid.
    """

    probability: float
    low: float
    high: float
    otherwise: float = 0.0
    signed: bool = False
    bounded = True

    def __post_init__(self) -> None:
        LogUniform(self.low, self.high)  # checks the ends
        outside = not self.low < self.otherwise < self.high
        if not (0.0 < self.probability <= 1.0 and outside and (self.otherwise == 0.0 or not self.signed)):
            raise InputError(
                f"randomize: the distribution {self} has an invalid probability, constant or sign"
            )

    @override
    def quantile(self, u: Array) -> Array:
        """Compute quantiles, in their unit, shape (k,): the fraction `u` of all samples lies below.

        A constant of at most `low` is the smallest number, one of at least `high` the largest. With `signed`,
        the constant 0 lies between the negative and the positive numbers.
        """
        size = LogUniform(self.low, self.high)
        below = self.probability if self.otherwise >= self.high else 0.5 * self.probability * self.signed
        above = self.probability - below
        values = np.full(np.shape(u), float(self.otherwise))
        smaller, larger = u < below, u > 1.0 - above
        if self.signed:
            values[smaller] = -size.quantile(1.0 - u[smaller] / below)
        elif below:
            values[smaller] = size.quantile(u[smaller] / below)
        if above:
            values[larger] = size.quantile((u[larger] - (1.0 - above)) / above)
        return values


@dataclass(frozen=True)
class EffectFamily:
    """An effect of the library that may act at some sites, and the distributions of its parameters.

    Attributes:
        name: Name of the effect in the library.
        size: Name of the parameter that sets the strength of the effect, for example an amplitude or a limit.
        ranges: Smallest and largest absolute value of this parameter, SI, where the effect is on, by site.
        signed: Whether it is negative in half of the cases.
        absent: Value of this parameter without the effect, SI, such as 0 (`current_limit`: 12 A).
        others: Distributions of the other parameters, by name; `rotary` has those of the sites phi1 and phi2.
        rotary: Distributions of the other parameters at the sites phi1 and phi2, if they differ.
        fixed: Values of parameters that do not vary, SI, by name.
    """

    name: str
    size: str
    ranges: Mapping[str, tuple[float, float]]
    signed: bool = False
    absent: float = 0.0
    others: Mapping[str, Distribution] = field(default_factory=dict)
    rotary: Mapping[str, Distribution] = field(default_factory=dict)
    fixed: Mapping[str, float] = field(default_factory=dict)

    def distributions(self, site: str) -> Mapping[str, Distribution]:
        """Return the distributions of the effect's random parameters but its size, by name, SI, at a site.

        For a pulley angle (its name begins with "phi"), they are the attribute `rotary` if it is not empty;
        else `others`.
        """
        return self.rotary if self.rotary and site.startswith("phi") else self.others


def _up_to(**full: float) -> dict[str, tuple[float, float]]:
    """Return the ranges of sizes by site, from the full sizes."""
    return {site: (SMALLEST_SIZE * size, size) for site, size in full.items()}


_PHASE = Uniform(0.0, 2.0 * math.pi)
# Full sizes in the units of docs/effects.md: forces in N at x and y, torques in Nm at pulleys and motors.
EFFECT_FAMILIES: tuple[EffectFamily, ...] = (
    EffectFamily(
        "stribeck_friction",
        "dF",
        _up_to(x=3.0, y=0.8, phi1=0.03, phi2=0.03),
        others={"vs": LogUniform(0.02, 0.08)},
        rotary={"vs": LogUniform(1.5, 4.0)},
    ),
    EffectFamily("asymmetric_viscous", "a", _up_to(x=0.3, y=0.3, phi1=0.3, phi2=0.3), signed=True),
    EffectFamily(
        "position_friction",
        "A",
        _up_to(x=1.2, y=0.3, phi1=0.03, phi2=0.03),
        others={"L": LogUniform(0.02, 0.15), "p": _PHASE},
        rotary={"L": LogUniform(1.0, 6.28), "p": _PHASE},
    ),
    EffectFamily("friction_slope", "s", _up_to(x=5.0, y=1.5), signed=True),
    EffectFamily("dahl_hysteresis", "F", _up_to(x=4.0, y=1.2), others={"L": LogUniform(2e-3, 1e-2)}),
    EffectFamily("constant_force", "size", _up_to(x=0.8, y=0.8), signed=True),
    EffectFamily("quadratic_drag", "c", _up_to(x=40.0, y=40.0)),
    EffectFamily("cable_spring", "k", _up_to(x=20.0, y=20.0), others={"q0": Uniform(-0.1, 0.1)}),
    EffectFamily(
        "cogging", "A", _up_to(motor1=0.03, motor2=0.03), others={"n": LogUniform(4.0, 40.0), "p": _PHASE}
    ),
    EffectFamily("eccentric_pulley", "e", _up_to(motor1=0.2e-3, motor2=0.2e-3), others={"p": _PHASE}),
    EffectFamily("voltage_offset", "V0", _up_to(motor1=0.35, motor2=0.35), signed=True),
    EffectFamily("gain_mismatch", "g", _up_to(motor1=0.1, motor2=0.1), signed=True),
    EffectFamily("dead_band", "Vd", _up_to(drives=0.4), fixed={"drop": 1.0}),
    # In A; the value without the effect is that of the drives "rig".
    EffectFamily("current_limit", "I", {"motor1": (5.0, 11.0), "motor2": (5.0, 11.0)}, absent=12.0),
    EffectFamily("electrical_lag", "tau", _up_to(drives=1.5e-3)),
    EffectFamily("input_delay", "d", _up_to(drives=2e-3)),
    EffectFamily("belt_play", "d", _up_to(belts=0.2e-3)),
    EffectFamily("belt_damping", "c", _up_to(belts=1e-3)),
    # In N; a motor pulls with 79 N at 8 V.
    EffectFamily("belt_slack", "T0", {"belts": (12.0, 36.0)}, absent=NO_SLACK_N),
    EffectFamily("belt_hardening", "h", _up_to(belts=5e4)),
    EffectFamily("sensor_delay", "d", _up_to(x_m=2e-3, y_m=2e-3)),
)


def with_absent_effects(machine: Machine) -> Machine:
    """Add the effects of `EFFECT_FAMILIES` (friction, drives, belts, ...) to the H-frame, all switched off.

    An effect that is switched off has parameter values with which it has no influence, for example an
    amplitude of 0. Randomization rules (`effect_rules`) can change these values and thus switch it on. One
    effect is never off: `current_limit` limits the motor currents, here to 12 A. The machine must not have
    the effects.
    """
    effects = []
    for family in EFFECT_FAMILIES:
        for site in family.ranges:
            middle = {
                name: round(float(distribution.quantile(np.array([0.5]))[0]), 6)
                for name, distribution in family.distributions(site).items()
            }
            effects.append(
                EFFECTS[family.name].at(site, **{family.size: family.absent}, **middle, **family.fixed)
            )
    return machine.with_effects(*effects)


def effect_rules() -> tuple[RandomizeParameter, ...]:
    """Return the randomization rules that switch on effects at random in every episode, two on average.

    The rules are for a machine that `with_absent_effects` returned. For each effect on each of its
    components, there is one rule for its size, which leaves it off in most episodes (`Sometimes`), and one
    for each other parameter that varies, such as a phase or a period.
    """
    rules = []
    for family in EFFECT_FAMILIES:
        probability = EXPECTED_EFFECTS / (len(EFFECT_FAMILIES) * len(family.ranges))
        for site, (low, high) in family.ranges.items():
            label = f"{family.name}@{site}"
            size = Sometimes(probability, low, high, family.absent, family.signed)
            rules.append(RandomizeParameter(f"{label}.{family.size}", size, how="set"))
            for name, distribution in family.distributions(site).items():
                rules.append(RandomizeParameter(f"{label}.{name}", distribution, how="set"))
    return tuple(rules)


def acting_effects(machine: Machine, parameters: Array) -> Machine:
    """Return the machine of one episode, with its sampled parameters and without the effects that are off.

    It keeps the effect `current_limit`, which is never off, with the sampled limit or 12 A.

    Args:
        machine: Machine of the environment, with all effects that an episode may switch on.
        parameters: Values of the P `Machine.parameters` in the episode, SI, shape (P,).
    """
    values = dict(zip(machine.parameters, np.asarray(parameters, np.float64).tolist(), strict=True))
    sampled = machine.replace(values)
    off = {
        f"{family.name}@{site}"
        for family in EFFECT_FAMILIES
        for site in family.ranges
        if family.name != "current_limit"  # which acts in every episode
        and values.get(f"{family.name}@{site}.{family.size}") == family.absent
    }
    return sampled.replace(effects=tuple(e for e in sampled.effects if e.label not in off))
