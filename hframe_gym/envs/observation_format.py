"""The options `normalize` and `flat`: observations in SI units divided by their scales, and joined into one array."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from .spaces import SignalSpec, bounds_of, box


class ObservationFormat:
    """Convert observations in SI units to the form that the options `normalize` and `flat` select.

    Normalized entries are (value - center) / scale, computed in float32; `SignalSpec` documents center and scale. A
    flat observation is one array that holds the keys in alphabetical order, as Gymnasium's `FlattenObservation` does.

    Args:
        signals: Specification of every entry, by key in alphabetical order.
        normalize: Whether to normalize.
        flat: Whether to join the keys into one array.

    Attributes:
        active: Whether observations change at all.
        normalize: As given.
        entries: Specifications of all entries of a flat observation, in order; None if observations have keys.
        space: Observation space of one environment.
    """

    def __init__(self, signals: Mapping[str, Sequence[SignalSpec]], *, normalize: bool, flat: bool) -> None:
        self.active, self.normalize = normalize or flat, normalize
        self._center = {k: np.array([s.center for s in specs], np.float32) for k, specs in signals.items()}
        self._scale = {k: np.array([s.scale for s in specs], np.float32) for k, specs in signals.items()}
        boxes = {}
        for key, specs in signals.items():
            low, high = (edge.astype(np.float32) for edge in bounds_of(specs))
            # The bounds are converted by the same operations as the values, which therefore stay inside them.
            boxes[key] = (self._normalized(key, low), self._normalized(key, high)) if normalize else (low, high)
        self.entries = tuple(spec for specs in signals.values() for spec in specs) if flat else None
        self.space: spaces.Space[Any] = (
            box(*(np.concatenate(edges) for edges in zip(*boxes.values(), strict=True)))
            if flat
            else spaces.Dict({key: box(*edges) for key, edges in boxes.items()})
        )

    def _normalized(self, key: str, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return (values - center) / scale of the entries of a key, values (..., n)."""
        return (values - self._center[key]) / self._scale[key]

    def apply(self, observation: dict[str, NDArray[np.float32]]) -> Any:
        """Convert observations to the format that the environment's options `normalize` and `flat` select.

        Args:
            observation: Arrays by key, SI, float32, shape (n, entries of the key).

        Returns:
            Arrays by key of the same shapes, or one array of shape (n, all entries), float32; dimensionless if
            normalized, else SI.
        """
        if not self.active:
            return observation
        values = {k: self._normalized(k, observation[k]) if self.normalize else observation[k] for k in self._center}
        return values if self.entries is None else np.concatenate(list(values.values()), axis=1)

    def goal_in_meters(self, goal: ArrayLike) -> NDArray[np.float32]:
        """Convert goals of observations to positions.

        Args:
            goal: Achieved or desired goals as observed (m, or dimensionless if normalized), shape (axes,) or (n, axes).

        Returns:
            Positions, m, float32, the same shape.
        """
        values = np.asarray(goal, np.float32)
        return values * self._scale["desired_goal"] + self._center["desired_goal"] if self.normalize else values

    def goal_as_observed(self, goal: NDArray[np.float32]) -> NDArray[np.float32]:
        """Convert positions to goals of observations; the inverse of `goal_in_meters`, but for rounding.

        Args:
            goal: Positions, m, float32, shape (n, axes).

        Returns:
            Goals, m, or dimensionless if observations are normalized, float32, shape (n, axes).
        """
        return self._normalized("desired_goal", goal) if self.normalize else goal
