"""The machines of a batch: what randomisation makes of one machine, at startup and at every reset."""

from __future__ import annotations

import numpy as np
from gymnasium.utils import seeding
from numpy.typing import NDArray

from ..machine import Machine
from .counter_rng import episode_keys, reset_uniforms
from .domain_randomization import RandomizationLike, as_rules
from .rule_sampler import RuleSampler

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Keys = NDArray[np.uint64]


class MachineSampler:
    """`count` machines drawn by rules, and the random numbers of their episodes.

    Each environment takes one number from its own generator when it is seeded; every episode's key is made of that
    number and of how many episodes came before.

    drawn: the randomised parameters by full name; columns: their places in `Machine.parameters`; low, high (P,):
    between which values all parameters lie.
    """

    def __init__(self, machine: Machine, randomize: RandomizationLike, count: int) -> None:
        rules = as_rules(randomize, machine)
        self._startup = RuleSampler(machine, rules, "startup")
        self._at_reset = RuleSampler(machine, rules, "reset", before=(self._startup.low, self._startup.high))
        self.low, self.high = self._at_reset.low, self._at_reset.high
        self.drawn = sorted({*self._startup.names, *self._at_reset.names})
        self.columns = [list(machine.parameters).index(name) for name in self.drawn]
        self._nominal = np.array(list(machine.parameters.values()))
        self._base = np.tile(self._nominal, (count if self._startup.names else 1, 1))
        self._to_start = np.ones(count, np.bool_)  # not seeded, or its startup draws not made yet
        self._seeded = np.zeros(count, np.bool_)
        self._keys = np.zeros(count, np.uint64)
        self._episodes = np.zeros(count, np.int64)

    def seed(self, b: int, generator: np.random.Generator) -> None:
        """Let environment b draw from a generator; its startup draws are made anew at the next reset."""
        self._keys[b] = generator.bit_generator.random_raw()
        self._episodes[b] = 0
        self._seeded[b] = self._to_start[b] = True

    def shares(self, values: Array) -> Array:
        """The drawn parameters of values (k, P) as shares (k, drawn) of their nominal values; as they are where those
        are zero."""
        nominal = self._nominal[self.columns]
        return values[:, self.columns] / np.where(nominal == 0.0, 1.0, nominal)

    def bounds(self) -> dict[str, tuple[float, float]]:
        """Between which shares each drawn parameter lies, by name."""
        edges = np.sort(self.shares(np.stack([self.low, self.high])), axis=0)
        return {name: (low, high) for name, (low, high) in zip(self.drawn, edges.T.tolist(), strict=True)}

    def draw(self, index: Index, more: int) -> tuple[Keys, Array, Array]:
        """Keys (k,) of new episodes of environments index (k,), `more` uniform numbers (k, more), parameters (k, P)."""
        for b in index[~self._seeded[index]].tolist():
            self.seed(b, seeding.np_random()[0])
        if self._startup.names:
            fresh = index[self._to_start[index]]
            keys = episode_keys(self._keys[fresh], np.full(len(fresh), -1))
            nominal = np.tile(self._nominal, (len(fresh), 1))
            self._base[fresh] = self._startup.draw(nominal, reset_uniforms(keys, self._startup.draws))
            self._to_start[fresh] = False
        keys = episode_keys(self._keys[index], self._episodes[index])
        self._episodes[index] += 1
        uniforms = reset_uniforms(keys, more + self._at_reset.draws)
        base = self._base[index] if self._startup.names else np.repeat(self._base, len(index), axis=0)
        return keys, uniforms[:, :more], self._at_reset.draw(base, uniforms[:, more:])
