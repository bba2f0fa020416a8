"""Domain randomization: rules that say which parameters an episode changes, and by which distribution.

A rule combines a parameter (or a pattern of names), a distribution, how the sampled number changes the
parameter (`scale`, `add` or `set`) and when it is sampled (`reset` or `startup`):

    RandomizeParameter("*.coulomb", Uniform(0.5, 2.0))                         each Coulomb level, each time
    RandomizeParameter("*.EA", Uniform(0.7, 1.3), shared=True)                 one number for all belts
    RandomizeParameter("x.mass", Normal(0.0, 0.1), how="add", when="startup")  once per seed
    RandomizeParameter("x_m.noise", ("log_uniform", 0.5, 2.0))                 a distribution by its name

`machine_sampler` samples by these rules.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any, Literal, Protocol, TypeAlias, cast, runtime_checkable

import numpy as np
from scipy.special import exp10, ndtri
from typing_extensions import override

from ...arrays import Array
from ...errors import InputError, is_number, suggestion
from ...registry import Registry

How = Literal["scale", "add", "set"]
When = Literal["reset", "startup"]


@runtime_checkable
class Distribution(Protocol):
    """A distribution, given by its quantile function.

    Register a new one with `@DISTRIBUTIONS.register("name")`; rules can then name it.
    """

    @property
    def bounded(self) -> bool:
        """Whether all samples lie between two finite numbers.

        If so, an environment checks once, when it is made, that samples stay within the limits of the
        parameters. Otherwise it checks every sample.
        """

    def quantile(self, u: Array) -> Array:
        """Compute quantiles, in their unit, shape (k,): a sample is below number i with probability u[i].

        If u are uniform random numbers, the quantiles are random samples. Entry i must depend on u[i] only,
        so that an environment gets exactly the same sample in a batch of any size.

        Args:
            u: Probabilities in (0, 1), shape (k,).
        """


DISTRIBUTIONS: Registry[Callable[..., Distribution]] = Registry("distribution")


@DISTRIBUTIONS.register("uniform")
@dataclass(frozen=True)
class Uniform(Distribution):
    """Uniform distribution on [low, high].

    Args:
        low: Lower end, finite.
        high: Upper end, finite, not below `low`.

    Raises:
        InputError: If the ends are not finite or not in order.
    """

    low: float
    high: float
    bounded = True

    def __post_init__(self) -> None:
        _check(self, "low <= high", lambda: self.low <= self.high)

    @override
    def quantile(self, u: Array) -> Array:
        """Compute low + (high - low) `u`, shape (k,)."""
        return self.low + (self.high - self.low) * u


@DISTRIBUTIONS.register("log_uniform")
@dataclass(frozen=True)
class LogUniform(Distribution):
    """Distribution whose logarithm is uniform on [log low, log high].

    Args:
        low: Lower end, positive.
        high: Upper end, finite, not below `low`.

    Raises:
        InputError: If the ends are not positive, not finite or not in order.
    """

    low: float
    high: float
    bounded = True

    def __post_init__(self) -> None:
        _check(self, "0 < low <= high", lambda: 0.0 < self.low <= self.high)

    @override
    def quantile(self, u: Array) -> Array:
        # SciPy's exponential: that of NumPy may round differently for arrays of another size.
        """Compute low (high / low)^`u`, shape (k,)."""
        values: Array = self.low * exp10(math.log10(self.high / self.low) * u)
        return values


@DISTRIBUTIONS.register("normal")
@dataclass(frozen=True)
class Normal(Distribution):
    """Normal distribution.

    Args:
        mean: Mean, finite.
        std: Standard deviation, finite, not negative.

    Raises:
        InputError: If a number is not finite or `std` is negative.
    """

    mean: float
    std: float
    bounded = False

    def __post_init__(self) -> None:
        _check(self, "std >= 0", lambda: self.std >= 0.0)

    @override
    def quantile(self, u: Array) -> Array:
        """Compute mean + std z, shape (k,), with the quantiles z of the standard normal distribution."""
        return self.mean + self.std * np.asarray(ndtri(u))


def _check(distribution: Distribution, condition: str, holds: Callable[[], bool]) -> None:
    """Raise InputError unless the arguments of a distribution are finite numbers that meet a condition."""
    if not (all(map(is_number, vars(distribution).values())) and holds()):
        raise InputError(
            f"randomize: the distribution {distribution} must have finite numbers with {condition}"
        )


@dataclass(frozen=True)
class RandomizeParameter:
    """Randomize the parameters whose name matches a pattern.

    Args:
        parameter: Full name, or a pattern with *, ? and [...]. Names are those of `Machine.parameters`
            (`x.mass`, `sensor_delay@x_m.d`), `Machine.device_parameters` (`x_m.noise`,
            `motor1.converter_bits`) and of the task (`task.speed`).
        distribution: A `Distribution`, or the registered name of one with its arguments, e.g. ("uniform",
            0.9, 1.1).
        how: Whether the sampled number scales the parameter, is added to it or replaces it.
        when: Sample at every reset, or once per seed ("startup").
        shared: Sample one number for all matching parameters instead of one for each.

    Raises:
        InputError: If `distribution` is neither a `Distribution` nor the name and arguments of a registered
            one.
    """

    parameter: str
    distribution: Distribution | Sequence[Any]
    how: How = "scale"
    when: When = "reset"
    shared: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.parameter, str):
            raise InputError(
                f"randomize: parameter is {self.parameter!r}, it must be the name or pattern of a parameter"
            )
        given = self.distribution
        label = f"randomize: the distribution of {self.parameter!r} is {self.distribution!r}"
        if not isinstance(given, str) and isinstance(given, Sequence) and given and isinstance(given[0], str):
            name, *arguments = given
            try:
                distribution = DISTRIBUTIONS.get(name)(*arguments)
            except (TypeError, InputError) as error:
                raise InputError(f"{label}: {str(error).removeprefix('randomize: ')}") from None
            object.__setattr__(self, "distribution", distribution)
        if isinstance(self.distribution, type) or not isinstance(self.distribution, Distribution):
            names = ", ".join(DISTRIBUTIONS)
            raise InputError(
                f"{label}; give a Distribution such as Uniform(0.9, 1.1), "
                f"or a list of a name and its numbers such as ['uniform', 0.9, 1.1], with a name of {names}"
            )

    def quantile(self, u: Array) -> Array:
        """Compute quantiles of the distribution for probabilities `u`, shape (k,), as samples for `apply`."""
        return self._distribution.quantile(u)

    @property
    def bounded(self) -> bool:
        """Whether all samples of the rule's distribution lie between two finite numbers."""
        return self._distribution.bounded

    @property
    def _distribution(self) -> Distribution:
        """The distribution, checked when the rule was made: a check of protocols would be most of a reset."""
        return cast("Distribution", self.distribution)

    def apply(self, value: Array, sample: Array) -> Array:
        """Change parameters (SI) by distribution samples, as the attribute `how` says, shape (k,) each.

        The result is `value` * `sample` for "scale", `value` + `sample` for "add", and the sample itself for
        "set".
        """
        if self.how == "scale":
            return value * sample
        return value + sample if self.how == "add" else sample


@dataclass(frozen=True)
class RandomizeIdentified:
    """Sample the identified parameters from their joint normal distribution around the machine's values.

    The distribution is truncated at the limits of each parameter: if a parameter is poorly identified, the
    normal distribution also contains values that no machine has, such as a negative mass.

    Args:
        widen: Factor on the identified standard deviations.
        when: Sample at every reset, or once per seed ("startup").
    """

    widen: float = 1.0
    when: When = "reset"


Rule: TypeAlias = RandomizeParameter | RandomizeIdentified

# The parameters that Sollmann et al. (2010) determine least accurately.
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
RANDOMIZATION_PRESETS: dict[str, tuple[Rule, ...]] = {
    "none": (),
    "default": DEFAULT,
    "wide": WIDE,
    "identified": (RandomizeIdentified(),),
}
_EXAMPLE = '[{"parameter": "x.mass", "distribution": ["uniform", 0.8, 1.2]}], which scales the declared mass'
RandomizationLike: TypeAlias = (
    Literal["none", "default", "wide", "identified"] | Sequence[Rule | Mapping[str, Any]]
)


def as_rules(randomize: RandomizationLike, names: Sequence[str]) -> tuple[Rule, ...]:
    """Convert the environment option `randomize` to randomization rules.

    Args:
        randomize: Preset name ("default", ...), or a list of `RandomizeParameter` and `RandomizeIdentified`.
            An entry may also be a dict of the arguments of `RandomizeParameter`, as read from a TOML or JSON
            file.
        names: Full names of all parameters that can be randomized, for example "x.mass".

    Returns:
        Rules in the order of the preset or list, without those of a preset that match none of `names`.

    Raises:
        InputError: If the preset or a distribution is unknown, or an entry is not a rule or has an invalid
            argument.
    """
    if isinstance(randomize, Mapping):
        raise InputError(
            f"randomize is {dict(randomize)!r}, one dict; "
            f"write a list with one dict for each rule, such as {_EXAMPLE}"
        )
    if isinstance(randomize, str) or not isinstance(randomize, Iterable):
        if randomize not in RANDOMIZATION_PRESETS:
            presets = ", ".join(RANDOMIZATION_PRESETS)
            raise InputError(
                f"randomize is {randomize!r}; choose one of {presets}, or, in Python, give a list of "
                "RandomizeParameter"
                f"{suggestion(randomize, RANDOMIZATION_PRESETS)}"
            )
        preset = RANDOMIZATION_PRESETS[randomize]
        return tuple(r for r in preset if isinstance(r, RandomizeIdentified) or matching(names, r))
    return tuple(map(_as_rule, randomize))


def _as_rule(entry: object) -> Rule:
    """Convert a dict of arguments to a rule and check a rule; raises InputError for anything else."""
    if isinstance(entry, Mapping):
        arguments = dict(entry)
        try:
            entry = RandomizeParameter(**arguments)
        except TypeError as error:
            raise InputError(f"randomize: {arguments}: {error}; write a list such as {_EXAMPLE}") from None
    if not isinstance(entry, RandomizeParameter | RandomizeIdentified):
        raise InputError(
            f"randomize: {entry!r} is neither a RandomizeParameter nor a RandomizeIdentified; write "
            "for example RandomizeParameter('x.mass', Uniform(0.8, 1.2)), which scales the declared mass"
        )
    if entry.when not in ("reset", "startup"):
        raise InputError(f"randomize: {entry!r} has when = {entry.when!r}; choose 'reset' or 'startup'")
    if isinstance(entry, RandomizeParameter) and entry.how not in ("scale", "add", "set"):
        raise InputError(f"randomize: {entry!r} has how = {entry.how!r}; choose 'scale', 'add' or 'set'")
    return entry


def matching(names: Sequence[str], rule: RandomizeParameter) -> list[int]:
    """Return the ascending indices of the names that match a rule's pattern; case matters."""
    return [i for i, name in enumerate(names) if fnmatchcase(name, rule.parameter)]
