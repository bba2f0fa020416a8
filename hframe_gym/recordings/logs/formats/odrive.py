"""Tables of ODrive's properties, which have the names of its interface and its documentation's units."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

from typing_extensions import override

from ..log import Log
from .base import KNOWN_TEXT, LOG_FORMATS, LogFormat
from .text import open_text_table

# Units since firmware 0.5.1; before, positions and speeds were in counts.
_UNITS = {
    **dict.fromkeys(
        ("pos_estimate", "pos_rel", "pos_abs", "pos_setpoint", "input_pos", "pos_circular"), "rev"
    ),
    **dict.fromkeys(("vel_estimate", "vel_setpoint", "input_vel"), "rev/s"),
    **dict.fromkeys(("iq_measured", "iq_setpoint", "id_measured", "id_setpoint", "ibus"), "A"),
    **dict.fromkeys(
        ("torque_setpoint", "torque_estimate", "effective_torque_setpoint", "input_torque"), "Nm"
    ),
    **dict.fromkeys(("vbus_voltage", "vq_setpoint", "vd_setpoint"), "V"),
}
# Names that no other controller has.
_OWN = re.compile(
    rb"(?<![a-z_])"
    rb"(?:pos_estimate|vel_estimate|iq_measured|iq_setpoint|torque_estimate|input_torque|vbus_voltage)"
    rb"(?![a-z_])",
    re.IGNORECASE,
)


@LOG_FORMATS.register("odrive")
class ODriveLogs(LogFormat):
    """Tables in text with properties of ODrive, as scripts with odrivetool write them."""

    precedence = KNOWN_TEXT

    @override
    def recognizes(self, path: Path, start: bytes) -> bool:
        """Recognize a text file by names of ODrive properties in its first lines."""
        return _OWN.search(start) is not None

    @override
    def open(self, path: Path) -> list[Log]:
        """Open the table, and assign units to the columns whose header has none."""
        log = open_text_table(path, unit_of=_unit)
        assumed = [column.header for column in log.columns if _unit(column.header)]
        if not assumed:
            return [log]
        remark = f"units of ODrive since its firmware 0.5.1 for {', '.join(assumed)}"
        return [dataclasses.replace(log, remarks=(remark, *log.remarks))]


def _unit(header: str) -> str:
    """Return the unit of a property, named alone or as "odrv0.axis0.pos_estimate"; "" if it is not known."""
    return _UNITS.get(re.split(r"[./\s]", header.strip())[-1].lower(), "")
