"""Measurements of Klipper's accelerometers: raw_data_*.csv and the like, with accelerations in mm/s^2."""

from __future__ import annotations

from pathlib import Path

from typing_extensions import override

from ....errors import InputError
from ..log import Log
from .base import KNOWN_TEXT, LOG_FORMATS, START_BYTES, LogFormat
from .text import open_text_table

_HEADER = "#time,accel_x,accel_y,accel_z"
_SPECTRUM = ("freq,psd_x,psd_y,psd_z", "#freq,psd_x,psd_y,psd_z")
_UNITS = {"time": "s", **dict.fromkeys(("accel_x", "accel_y", "accel_z"), "mm/s^2")}


@LOG_FORMATS.register("klipper_accelerometer")
class KlipperAccelerometerLogs(LogFormat):
    """Text files of ACCELEROMETER_MEASURE and of TEST_RESONANCES OUTPUT=raw_data; spectra are refused."""

    precedence = KNOWN_TEXT

    @override
    def recognizes(self, path: Path, start: bytes) -> bool:
        """Recognize the header of a measurement, or of a spectrum, which `open` refuses."""
        return start.startswith((b"#", b"freq,")) and _header(start) != ""

    @override
    def open(self, path: Path) -> list[Log]:
        """Open the table of a measurement and assign units to its columns.

        Raises:
            InputError: If the file is damaged, or is a spectrum, which has no times.
        """
        with open(path, "rb") as file:
            header = _header(file.read(START_BYTES))
        if header != _HEADER:
            advice = "measure again with OUTPUT=raw_data and import raw_data_*.csv"
            raise InputError(f"{path}: is a spectrum of Klipper's TEST_RESONANCES, without times; {advice}")
        return [open_text_table(path, ("it is a measurement of Klipper's accelerometer",), _unit)]


def _unit(name: str) -> str:
    """Return the unit of a column by its name."""
    return _UNITS.get(name, "")


def _header(start: bytes) -> str:
    """Return the header line of a measurement, or of a spectrum; "" if the file is neither."""
    lines = start.decode("ascii", errors="replace").lower().splitlines()
    for line in lines[:3]:  # a line about lost samples may precede the header
        if line.strip() == _HEADER:
            return _HEADER
        for spectrum in _SPECTRUM:
            if line.replace(" ", "").startswith(spectrum):
                return spectrum
    return ""
