"""Input shaper settings for Klipper (printer.cfg) from the first mode of each axis."""

from __future__ import annotations

from dataclasses import dataclass

from typing_extensions import override

from ..machine import Machine
from .base import EXPORTERS, Files, commented, option
from .models.input_shapers import InputShaperExporter, Shaper, impulse_table


@EXPORTERS.register("klipper")
@dataclass(frozen=True, kw_only=True)
class KlipperExporter(InputShaperExporter):
    """Write the section input_shaper of Klipper's printer.cfg, and the impulses of the shapers as a table.

    Frequency and damping ratio are those of the first mode of the carriage along each axis, with the motors
    held.

    Example:  hframe export klipper --machine corexy --out out/klipper
    """

    shaper: Shaper = option(
        "mzv", "Shaper: zv (shortest), mzv, or ei (tolerates the largest error of the frequency)."
    )

    @override
    def files(self, machine: Machine) -> Files:
        """Write input_shaper.cfg, a section of printer.cfg, and input_shaper.csv, impulses of all shapers.

        The section states, for each axis, the type `shaper`, the frequency in Hz and the damping ratio, with
        the tool at the position `at` (default: the center). The columns of the table are axis, shaper, time_s
        and amplitude (fraction of the move).

        Raises:
            InputError: If the carriage does not vibrate along an axis.
        """
        found = self.axis_modes(machine)
        header = self.header(machine, *self.notes(machine), *(mode.described for mode in found))
        lines = ["[input_shaper]"]
        for mode in found:
            axis = mode.letter.lower()
            lines += [f"shaper_type_{axis}: {self.shaper}", f"shaper_freq_{axis}: {mode.frequency:.2f}"]
            lines += [f"damping_ratio_{axis}: {mode.damping:.4f}"]
        comment = commented(header, "#")
        return {
            "input_shaper.cfg": comment + "\n".join(lines) + "\n",
            "input_shaper.csv": comment + impulse_table(found),
        }
