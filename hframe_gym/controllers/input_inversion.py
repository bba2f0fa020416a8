"""What the drives' amplifiers make of a voltage, and which voltage makes them give the one that is wanted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine

Array = NDArray[np.float64]
POINTS = 8001  # of a drive's table, from one end of its voltage to the other; at 24 V 6 mV apart
# Where an amplifier gives the same for a range of voltages, the table still rises by this share: it can be inverted,
# and 0 V comes from the middle of a dead band.
RISE = 1e-9


class InputInversion:
    """The drives' effects on their voltage (dead band, offset, gain) as tables.  Nothing changes without such effects.

    Raises ValueError for an effect by which a higher voltage gives less.
    """

    def __init__(self, machine: Machine) -> None:
        self.rated = np.array([d.rated_voltage for d in machine.drives])
        self._tables: dict[int, tuple[Array, Array]] = {}  # by drive: asked for and given, V
        for j, drive in enumerate(machine.drives):
            effects = [e for e in machine.effects if e.site == drive.name and e.definition.voltage is not None]
            if effects:
                asked = np.linspace(-drive.rated_voltage, drive.rated_voltage, POINTS)
                given = asked
                for e in effects:
                    given = np.asarray(e("voltage", V=given), np.float64)
                if np.any(np.diff(given) < 0.0):
                    raise ValueError(f"machine {machine.name!r}: drive {drive.name} gives less for a higher voltage")
                self._tables[j] = (asked, given + RISE * asked)

    def given(self, volts: Array) -> Array:
        """Voltages (B, drives) at the motors, V, for those asked for."""
        return self._read(volts, 0, 1)

    def asked(self, volts: Array) -> Array:
        """Voltages (B, drives) to ask for, V, within the rated ones, that give the motors these."""
        return np.clip(self._read(volts, 1, 0), -self.rated, self.rated)

    def _read(self, volts: Array, by: int, column: int) -> Array:
        out = volts.copy()
        for j, table in self._tables.items():
            out[:, j] = np.interp(volts[:, j], table[by], table[column])
        return out
