"""One thing to say about recordings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Severity = Literal["fault", "advice", "note"]


@dataclass(frozen=True)
class Finding:
    """fault: probably a mistake in the data; advice: costs identification something; note: how the data are.

    run: the recording's name, or "" where it is about all of them.  channel: a column, coordinate or parameter, or "".
    """

    severity: Severity
    run: str
    channel: str
    message: str

    def __str__(self) -> str:
        where = ", ".join(part for part in (self.run, self.channel) if part)
        return f"{self.severity}: {where}: {self.message}" if where else f"{self.severity}: {self.message}"
