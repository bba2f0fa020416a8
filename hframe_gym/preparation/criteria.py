"""Thresholds by which the preparation of recordings recognizes a sensor at the end of its range."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass


@dataclass(frozen=True)
class SaturationCriteria:
    """Thresholds by which saturated measurements are recognized; those of `identify` extend them.

    Attributes:
        min_saturated_fraction: Smallest fraction of all rows near a sensor's largest (or smallest)
            measurement at which the sensor may have reached the end of its range there.
        second_end_factor: If a sensor saturates at one end, factor that reduces `min_saturated_fraction` and
            `min_saturated_travel` for its other end.
        saturation_band: Distance from the largest (or smallest) measurement that counts as near it, in
            standard deviations of the noise.
        min_saturated_travel: Smallest distance that the encoders must measure in these rows for the sensor to
            be saturated, in standard deviations of its noise. It is more than belts can stretch.
    """

    min_saturated_fraction: float = 0.01
    second_end_factor: float = 0.2
    saturation_band: float = 8.0
    min_saturated_travel: float = 300.0

    def __post_init__(self) -> None:
        """Check the thresholds.

        Raises:
            ValueError: If a threshold is negative or not finite.
        """
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not 0.0 <= value < float("inf"):
                raise ValueError(f"criterion {field.name} is {value}; it must be finite and not negative")

    def __str__(self) -> str:
        """Return all thresholds as text, one "name = value" per line."""
        return "\n".join(f"{name} = {value:g}" for name, value in self.as_json().items())

    def as_json(self) -> dict[str, float]:
        """Convert the thresholds to a dictionary, which report.json contains as `criteria`.

        Returns:
            Value of each threshold by its attribute name, for example "min_gain_simulation"; all are
            dimensionless.
        """
        return dataclasses.asdict(self)
