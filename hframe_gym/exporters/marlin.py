"""Input shaping settings for Marlin (M593 and Configuration_adv.h) from the first mode of each axis."""

from __future__ import annotations

from dataclasses import dataclass

from typing_extensions import override

from ..machine import Machine
from .base import EXPORTERS, Files, commented
from .models.input_shapers import InputShaperExporter


@EXPORTERS.register("marlin")
@dataclass(frozen=True, kw_only=True)
class MarlinExporter(InputShaperExporter):
    """Write Marlin's input shaping settings (its shaper is zv) as G-code and as lines of Configuration_adv.h.

    Frequency and damping ratio are those of the first mode of the carriage along each axis, with the motors
    held.

    Example:  hframe export marlin --machine corexy --out out/marlin
    """

    @override
    def files(self, machine: Machine) -> Files:
        """Write input_shaping.gcode (M593 for each axis) and input_shaping.h (lines of Configuration_adv.h).

        Raises:
            InputError: If the carriage does not vibrate along an axis.
        """
        found = self.axis_modes(machine)
        header = self.header(machine, *self.notes(machine), *(mode.described for mode in found))
        gcode = [f"M593 {mode.letter} F{mode.frequency:.2f} D{mode.damping:.4f}" for mode in found]
        configuration = []
        for mode in found:
            configuration += [
                f"#define INPUT_SHAPING_{mode.letter}",
                f"#define SHAPING_FREQ_{mode.letter} {mode.frequency:.2f}f",
                f"#define SHAPING_ZETA_{mode.letter} {mode.damping:.4f}f",
            ]
        return {
            "input_shaping.gcode": commented(header, ";")
            + "\n".join([*gcode, "M500 ; store the settings"])
            + "\n",
            "input_shaping.h": commented(header, "//") + "\n".join(configuration) + "\n",
        }
