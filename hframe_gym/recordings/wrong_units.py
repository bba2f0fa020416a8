"""Error for values that are probably in another unit than that of their channel."""

from __future__ import annotations

from ..errors import InputError

# Units that recordings do not use, in words.
UNIT_WORDS = {
    "mm": "millimeters",
    "um": "micrometers",
    "deg": "degrees",
    "ms": "milliseconds",
    "%": "percent",
}


class WrongUnitError(InputError):
    """Values of channels are probably in another unit than that of the channel.

    Attributes:
        problem: File, columns and values, in words.
        unit: Unit that the values probably have.
    """

    def __init__(self, problem: str, channels: tuple[str, ...], unit: str) -> None:
        """Create the error; its message ends with a question about the unit.

        Args:
            problem: File, columns and values, in words.
            unit: Unit that the values probably have: "mm", "um", "deg", "ms" or "%".
        """
        question = "is the column" if len(channels) == 1 else "are they"
        super().__init__(f"{problem}; {question} in {UNIT_WORDS[unit]}?")
        self.problem, self.channels, self.unit = problem, channels, unit

    def __reduce__(self) -> tuple[type[WrongUnitError], tuple[str, tuple[str, ...], str]]:
        """Return the arguments of the constructor for pickle, which would pass the message alone."""
        return type(self), (self.problem, self.channels, self.unit)
