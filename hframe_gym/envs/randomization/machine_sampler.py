"""Samples the parameters of a batch of environments by randomization rules, at startup and at every reset."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from gymnasium.utils import seeding
from numpy.typing import NDArray

from ...arrays import Array, EnvironmentParameters, Index
from ...errors import InputError, example_names
from ...machine import Machine
from ..workspace import effect_and_belt_limits
from .domain_randomization import (
    RandomizationLike,
    RandomizeIdentified,
    RandomizeParameter,
    Rule,
    When,
    as_rules,
    matching,
)
from .random_numbers import LARGEST_UNIFORM, SMALLEST_UNIFORM, CorrelatedSampler, episode_keys, reset_uniforms

Keys = NDArray[np.uint64]
Range = tuple[Array, Array]  # smallest and largest values
ParameterValues = Mapping[str, float]
# Smallest fraction of its nominal value to which a parameter that must stay positive can be randomized.
SMALLEST_FRACTION = 0.05
MAXIMUM_CONVERTER_BITS = 32.0


@dataclass(frozen=True)
class ParameterSpace:
    """List an environment's N parameters that can be randomized, with limits. Arrays have shape (N,).

    The order is: `Machine.parameters`, `Machine.device_parameters`, parameters of the task (`task.*`).
    """

    machine_name: str  # for messages
    names: tuple[str, ...]  # full names, for example "x.mass"
    nominal: Array  # values without randomization, SI
    lower: Array  # smallest value that each can be randomized to, SI
    upper: Array  # largest value that each can be randomized to, SI
    clipped: frozenset[int]  # indices of parameters whose samples are clipped to the limits without an error

    @classmethod
    def of(cls, machine: Machine, task_parameters: ParameterValues | None = None) -> ParameterSpace:
        """Collect the parameters of a machine and a task that can be randomized, with their limits.

        The limits follow from the nominal value v. There is no upper limit unless one is stated:

        - parameters of an effect: the bounds in its definition; `converter_bits`: 0 (not quantized) to 32;
        - friction (`viscous`, `coulomb`), sensor `noise` and `resolution`: at least 0;
        - `rest_length`, the unstretched length of a belt at position 0: so large that the unstretched length
          is at least 0.05 v at every position in the workspace;
        - all others, also those of the task: at least 0.05 v; no limits if v is negative.

        Arrays of the result have shape (N,).

        Args:
            task_parameters: Nominal values of the task's parameters, SI, by name without "task.", e.g.
                "speed".
        """
        task = {f"task.{name}": value for name, value in (task_parameters or {}).items()}
        values = {**machine.parameters, **machine.device_parameters, **task}
        bounds = effect_and_belt_limits(machine, SMALLEST_FRACTION)
        bounds |= {name: (0.0, MAXIMUM_CONVERTER_BITS) for name in values if name.endswith(".converter_bits")}
        defaults = {
            name: SMALLEST_FRACTION * value if value >= 0.0 else -math.inf for name, value in values.items()
        }
        defaults |= {
            name: 0.0 for name in values if name.endswith((".viscous", ".coulomb", ".noise", ".resolution"))
        }
        lower, upper = np.array(
            [bounds.get(name, (low, math.inf)) for name, low in defaults.items()], np.float64
        ).T
        # Idler pulleys divide a belt into sections whose lengths are tied to one of them. The shortest
        # section can need a longer belt than a rule for all belts yields. This is no mistake of the user, so
        # the samples are clipped.
        names = tuple(values)
        clipped = {
            names.index(free) for tied, (free, _) in machine.ties.items() if tied.endswith(".rest_length")
        }
        return cls(
            machine.name, names, np.array(list(values.values()), np.float64), lower, upper, frozenset(clipped)
        )


class _RuleStep(NamedTuple):
    """A rule, or a joint distribution, with the n parameters it changes and uniform numbers it uses."""

    parameters: list[int]  # indices in the parameter space, length n
    columns: list[int]  # of the uniform numbers, length n; all equal if the rule shares one number
    rule: RandomizeParameter | CorrelatedSampler


class RuleSampler:
    """Sample parameters by rules that apply once per seed ("startup"), or those that apply at every reset.

    The rules are applied in their order: each changes the values that the earlier ones yielded.

    Args:
        space: Names, nominal values and limits of all N parameters.
        rules: Randomization rules.
        when: Rules to apply, "reset" (every episode) or "startup" (once per seed); the others are ignored.
        before: Smallest and largest values before the rules, SI, shape (N,) each. Default: nominal values for
            both.

    Attributes:
        names: Full names of the parameters that the rules change; a parameter that is 0 and only scaled is
            not among them.
        draws: Number of uniform random numbers per environment that `sample` needs.
        low: Smallest possible value of every parameter after sampling, SI, shape (N,).
        high: Largest possible value of every parameter after sampling, SI, shape (N,).

    Raises:
        InputError: If a rule matches no parameter, or can leave the limits of one.
    """

    def __init__(
        self,
        space: ParameterSpace,
        rules: Sequence[Rule],
        machine: Machine,
        when: When,
        before: Range | None = None,
    ) -> None:
        self._space = space
        self.low, self.high = (edge.copy() for edge in (before or (space.nominal, space.nominal)))
        self.draws = 0
        self._steps: list[_RuleStep] = []
        self._changed: set[int] = set()
        for rule in (rule for rule in rules if rule.when == when):
            if isinstance(rule, RandomizeParameter):
                self._add_parameter_rule(rule)
            else:
                self._add_identified_rule(rule, machine)
        self.names = tuple(space.names[i] for i in sorted(self._changed))

    def _add_step(self, parameters: list[int], rule: RandomizeParameter | CorrelatedSampler) -> None:
        """Add a step for parameters (n,) and reserve its uniform numbers."""
        shared = isinstance(rule, RandomizeParameter) and rule.shared
        columns = [self.draws + (0 if shared else position) for position in range(len(parameters))]
        self._steps.append(_RuleStep(parameters, columns, rule))
        self.draws = columns[-1] + 1

    def _add_parameter_rule(self, rule: RandomizeParameter) -> None:
        """Add a rule for single parameters; raise InputError if it matches none or can leave the limits."""
        indices = matching(self._space.names, rule)
        if not indices:
            effect = (
                "; parameters of an effect vary only if the machine has the effect: "
                "add it by machine.with_effects or in machine.json"
            )
            raise InputError(
                f"randomize: machine {self._space.machine_name!r} "
                f"and its task have no parameter {rule.parameter!r}; "
                f"{example_names(rule.parameter, self._space.names)}{effect if '@' in rule.parameter else ''}"
            )
        self._add_step(indices, rule)
        # 0 remains 0
        self._changed |= {i for i in indices if rule.how != "scale" or self.low[i] or self.high[i]}
        for i in indices:
            self._update_range(i, rule)

    def _update_range(self, i: int, rule: RandomizeParameter) -> None:
        """Set `low` and `high` of parameter i to a rule's extreme results for values in the present range."""
        samples = rule.quantile(np.array([SMALLEST_UNIFORM, LARGEST_UNIFORM]))
        before = np.array([self.low[i], self.high[i]])
        # Both samples with both ends: a negative scale turns the smallest value into the largest.
        results = np.concatenate([rule.apply(before, np.full(2, sample)) for sample in samples])
        if rule.bounded and i not in self._space.clipped:
            self._check_limits(rule, i, results, "can yield")
        lower, upper = self._space.lower[i], self._space.upper[i]
        self.low[i], self.high[i] = np.clip([results.min(), results.max()], lower, upper)

    def _check_limits(self, rule: RandomizeParameter, i: int, values: Array, verb: str) -> None:
        """Raise InputError if values (k,) of parameter i are outside its limits; the message has `verb`."""
        lower, upper = self._space.lower[i], self._space.upper[i]
        for value in (float(values.min()), float(values.max())):
            tolerance = 1e-12 * max(abs(lower), abs(value))  # room for two roundings
            if not lower - tolerance <= value <= upper + tolerance:
                advice = "" if rule.bounded else "; choose a bounded distribution"
                name = self._space.names[i]
                raise InputError(
                    f"randomize: the rule {rule} {verb} {name} = {value:g}, "
                    f"outside [{lower:g}, {upper:g}]{advice}"
                )

    def _add_identified_rule(self, rule: RandomizeIdentified, machine: Machine) -> None:
        """Add joint samples of identified parameters; raise InputError if the machine has no covariance."""
        uncertainty, space = machine.uncertainty, self._space
        if uncertainty is None or not uncertainty.names:
            raise InputError(
                f"randomize: machine {machine.name!r} has no covariance; "
                "'identified' needs a machine.json written by `hframe identify`"
            )
        indices = [space.names.index(name) for name in uncertainty.names]
        nominal, lower, upper = space.nominal[indices], space.lower[indices], space.upper[indices]
        joint = CorrelatedSampler(uncertainty.covariance * rule.widen**2, nominal, lower, upper)
        self._add_step(indices, joint)
        self._changed.update(indices)
        self.low[indices] = np.maximum(self.low[indices] - joint.reach, lower)
        self.high[indices] = np.minimum(self.high[indices] + joint.reach, upper)

    def sample(self, base: Array, uniforms: Array) -> EnvironmentParameters:
        """Sample the parameters of k environments by the rules.

        Args:
            base: Parameters before sampling, SI, shape (k, N), or (1, N) if they are the same in all
                environments.
            uniforms: Uniform random numbers in (0, 1), shape (k, draws).

        Returns:
            Parameters after sampling. Some are clipped to their limits: those that `RandomizeIdentified`
            samples, the belt lengths in `ParameterSpace.clipped`, and, at 0, those with the lower limit 0
            (such as friction or noise) for which an unbounded distribution yields a negative value.

        Raises:
            InputError: If an unbounded distribution yields a value beyond a limit to which the parameter is
                not clipped, such as the upper limit of one that is clipped at 0.
        """
        values = np.empty((len(uniforms), base.shape[1]))
        values[:] = base
        for parameters, columns, rule in self._steps:
            if isinstance(rule, CorrelatedSampler):
                moved = values[:, parameters] + rule.deviations(uniforms[:, columns])
                values[:, parameters] = np.clip(
                    moved, self._space.lower[parameters], self._space.upper[parameters]
                )
                continue
            samples = {column: rule.quantile(uniforms[:, column]) for column in set(columns)}
            for i, column in zip(parameters, columns, strict=True):
                values[:, i] = self._limited(rule, i, rule.apply(values[:, i], samples[column]))
        return values

    def _limited(self, rule: RandomizeParameter, i: int, values: Array) -> Array:
        """Return samples (k,) of parameter i, clipped where allowed; raise InputError for others."""
        if i in self._space.clipped:
            return np.clip(values, self._space.lower[i], self._space.upper[i])
        if not rule.bounded and len(values):  # bounded rules were checked when they were added
            if self._space.lower[i] == 0.0:
                values = np.maximum(values, 0.0)
            self._check_limits(rule, i, values, "yielded")
        return values


class MachineSampler:
    """Sample the parameters of `count` environments, and the keys (seeds) of their episodes.

    Each environment takes one random number from its generator when it is seeded. The key of an episode is
    derived from this number and the count of episodes since then. Rules with `when="startup"` change the
    nominal values once per seed. Rules with `when="reset"` change the resulting values in every episode.

    Args:
        randomize: Name of a preset such as "default", or a list of rules.
        count: Number of environments.
        task_parameters: Nominal values of the task's parameters, SI, by name without "task.", e.g. "speed".

    Attributes:
        space: Names, nominal values and limits of all N parameters.
        names: Full names of the randomized parameters, in the order of `space.names`.
        columns: Indices of the randomized parameters in `space.names`.
        low: Smallest possible value of every parameter, SI, shape (N,).
        high: Largest possible value of every parameter, SI, shape (N,).
    """

    def __init__(
        self,
        machine: Machine,
        randomize: RandomizationLike,
        count: int,
        task_parameters: ParameterValues | None = None,
    ) -> None:
        self.space = ParameterSpace.of(machine, task_parameters)
        rules = as_rules(randomize, self.space.names)
        self._startup = RuleSampler(self.space, rules, machine, "startup")
        self._reset = RuleSampler(
            self.space, rules, machine, "reset", (self._startup.low, self._startup.high)
        )
        self.low, self.high = self._reset.low, self._reset.high
        self._check_order(machine, rules)
        self.columns = [
            i for i, n in enumerate(self.space.names) if n in self._startup.names + self._reset.names
        ]
        self.names = [self.space.names[i] for i in self.columns]
        self._integers = [i for i in self.columns if self.space.names[i].endswith(".converter_bits")]
        for edge in (self.low, self.high):
            edge[self._integers] = np.rint(edge[self._integers])
        self._base = np.tile(self.space.nominal, (count if self._startup.names else 1, 1))
        # An environment needs startup samples from its seeding to the next reset.
        self._seeded, self._needs_startup = np.zeros(count, np.bool_), np.ones(count, np.bool_)
        self._keys, self._episodes = np.zeros(count, np.uint64), np.zeros(count, np.int64)

    def _check_order(self, machine: Machine, rules: Sequence[Rule]) -> None:
        """Raise InputError if a parameter of an effect can fall below the one in its `above`, as of a range.

        A rule with one number for both (`shared`) keeps their order.
        """
        names = self.space.names
        shared = [set(matching(names, r)) for r in rules if isinstance(r, RandomizeParameter) and r.shared]
        pairs = [(e.label, p) for e in machine.effects for p in e.definition.parameters if p.above]
        for label, p in pairs:
            below, above = names.index(f"{label}.{p.above}"), names.index(f"{label}.{p.name}")
            if self.high[below] > self.low[above] and not any(
                {below, above} <= indices for indices in shared
            ):
                raise InputError(
                    f"randomize: the rules can yield {names[above]} = {self.low[above]:g}, below "
                    f"{names[below]} = {self.high[below]:g}; choose ranges of the two that do not overlap"
                )

    def seed(self, b: int, generator: np.random.Generator) -> None:
        """Seed environment b. Its next reset also samples the parameters whose rules have `when="startup"`.

        One 64-bit number is taken from the generator as the key of the environment.
        """
        self._keys[b] = generator.bit_generator.random_raw()
        self._episodes[b] = 0
        self._seeded[b] = self._needs_startup[b] = True

    def normalized(self, values: EnvironmentParameters) -> Array:
        """Divide the randomized parameters by their nominal values; one of nominal value 0 is not divided.

        Returns:
            Randomized parameters in the order of the attribute `names`, dimensionless (SI if the nominal
            value is 0), shape (k, len(names)).
        """
        nominal = self.space.nominal[self.columns]
        return values[:, self.columns] / np.where(nominal == 0.0, 1.0, nominal)

    def normalized_bounds(self) -> dict[str, tuple[float, float]]:
        """Compute the smallest and the largest values of the randomized parameters, as `normalized` has them.

        Returns:
            Both as fractions of the nominal value, dimensionless (SI if the nominal value is 0), by full name
            of the parameter, in the order of `names`. They are always finite, because the uniform numbers
            exclude 0 and 1.
        """
        edges = np.sort(self.normalized(np.stack([self.low, self.high])), axis=0)
        return {name: (low, high) for name, (low, high) in zip(self.names, edges.T.tolist(), strict=True)}

    def sample(self, index: Index, task_draws: int) -> tuple[Keys, Array, Array]:
        """Sample the parameters of k new episodes, and the random numbers that their task needs.

        An environment that was never seeded is now seeded at random.

        Returns:
            Keys of the episodes (`EpisodeKeys`), uniform random numbers in (0, 1), shape (k, task_draws), and
            parameters (`EnvironmentParameters`), shape (k, N).

        Raises:
            InputError: If an unbounded distribution yields a value outside the limits of a parameter.
        """
        # Gymnasium seeds an environment that was reset without a seed from the operating system.
        for b in index[~self._seeded[index]].tolist():
            self.seed(b, seeding.np_random()[0])
        if self._startup.names:
            fresh = index[self._needs_startup[index]]
            keys = episode_keys(self._keys[fresh], np.full(len(fresh), -1))
            uniforms = reset_uniforms(keys, self._startup.draws)
            self._base[fresh] = self._startup.sample(self.space.nominal[None], uniforms)
            self._needs_startup[fresh] = False
        keys = episode_keys(self._keys[index], self._episodes[index])
        self._episodes[index] += 1
        uniforms = reset_uniforms(keys, task_draws + self._reset.draws)
        values = self._reset.sample(
            self._base[index] if self._startup.names else self._base, uniforms[:, task_draws:]
        )
        if self._integers:
            values[:, self._integers] = np.rint(values[:, self._integers])
        return keys, uniforms[:, :task_draws], values
