"""Randomised machines: a field of the machine x a distribution x scale, add or set x reset or startup.

    Vary("*.coulomb", Uniform(0.5, 2.0))                          each Coulomb level on its own, every episode
    Vary("*.EA", Uniform(0.7, 1.3), shared=True)                  one draw for all belts
    Vary("x.mass", Normal(0.0, 0.1), how="add", when="startup")   once a seed

Random numbers come from the environment's own generator (`draws`), so a seed fixes them; what they made is in the
reset's info.  `sampler` draws by these rules.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine
from .distributions import Distribution, LogUniform, Uniform

Array = NDArray[np.float64]
How = Literal["scale", "add", "set"]
When = Literal["reset", "startup"]


@dataclass(frozen=True)
class RandomizeParameter:
    """One rule.  parameter: a name of `Machine.parameters`, or a pattern of such with * and ?.

    shared: one draw for all that match, instead of one each.
    """

    parameter: str
    distribution: Distribution
    how: How = "scale"
    when: When = "reset"
    shared: bool = False

    def apply(self, value: Array, drawn: Array) -> Array:
        """The parameter's values from what they were and what was drawn, (k,) each."""
        if self.how == "scale":
            return value * drawn
        return value + drawn if self.how == "add" else drawn


@dataclass(frozen=True)
class RandomizeIdentified:
    """Joint normal draws around the machine's own values from its identified covariance, times `widen` (in std).

    A draw ends at the parameter's limits: what is known badly may have a tail that no machine has.
    """

    widen: float = 1.0
    when: When = "reset"


Rule: TypeAlias = RandomizeParameter | RandomizeIdentified

DEFAULT: tuple[Rule, ...] = (
    RandomizeParameter("*.EA", Uniform(0.7, 1.3), shared=True),  # one belt, one material
    RandomizeParameter("*.rest_length", Uniform(0.85, 1.2)),
    RandomizeParameter("*.coulomb", Uniform(0.5, 2.0)),
    RandomizeParameter("*.mass", Uniform(0.9, 1.2)),
)
WIDE: tuple[Rule, ...] = (
    RandomizeParameter("*.EA", LogUniform(0.5, 2.0), shared=True),
    RandomizeParameter("*.rest_length", Uniform(0.75, 1.3)),
    RandomizeParameter("*.coulomb", LogUniform(0.25, 4.0)),
    RandomizeParameter("*.viscous", LogUniform(0.5, 2.0)),
    RandomizeParameter("*.mass", Uniform(0.7, 1.5)),
    RandomizeParameter("*.K[te]", Uniform(0.85, 1.15)),
    RandomizeParameter("*.resistance", Uniform(0.9, 1.2)),
)
PRESETS: dict[str, tuple[Rule, ...]] = {
    "none": (),
    "default": DEFAULT,
    "wide": WIDE,
    "identified": (RandomizeIdentified(),),
}
RandomizationLike: TypeAlias = Literal["none", "default", "wide", "identified"] | Sequence[Rule]


def as_rules(randomize: RandomizationLike, machine: Machine) -> tuple[Rule, ...]:
    """The rules of a preset, as far as the machine has what they speak of, or the rules themselves.

    Raises ValueError for an unknown preset or what is no rule.
    """
    if isinstance(randomize, str):
        if randomize not in PRESETS:
            raise ValueError(f"randomize is {randomize!r}, choose one of {', '.join(PRESETS)} or a list of Vary")
        return tuple(r for r in PRESETS[randomize] if isinstance(r, RandomizeIdentified) or matching(machine, r))
    rules = tuple(randomize)
    for rule in rules:
        if not isinstance(rule, RandomizeParameter | RandomizeIdentified):
            raise ValueError(f"randomize: {rule!r} is neither a Vary nor Identified")
        if rule.when not in ("reset", "startup"):
            raise ValueError(f"randomize: {rule!r} has when = {rule.when!r}, choose reset or startup")
        if isinstance(rule, RandomizeParameter) and rule.how not in ("scale", "add", "set"):
            raise ValueError(f"randomize: {rule!r} has how = {rule.how!r}, choose scale, add or set")
    return rules


def matching(machine: Machine, rule: RandomizeParameter) -> list[int]:
    """Places in `Machine.parameters` that a rule speaks of."""
    return [i for i, name in enumerate(machine.parameters) if fnmatchcase(name, rule.parameter)]
