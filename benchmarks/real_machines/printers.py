"""CoreXY printers: number, frequency and damping of the resonances at the tool, from accelerometer spectra.

There are no motor signals, so nothing is identified. The spectra test the structure of the belt model. With
motors at standstill (steppers), a rigid bridge on belts has one mode along x and one along y, both with the
same belt stiffness, so (f_x / f_y)^2 is the ratio of the mass moving in y to that moving in x. A second peak
in one direction is a degree of freedom that the model does not have. Not used: raw accelerations of moves
(they have no inputs), and belt plucks (a tone gives the tension only with the belt's mass and free length,
which are unknown).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy import signal

from benchmarks.real_machines.study import data_folder, picture
from benchmarks.results_file import write_results
from hframe_gym.arrays import Array

_BAND = (12.0, 130.0)  # Hz; below is the motion itself, above the mount of the accelerometer
_HEIGHT = 0.3  # of the highest peak; lower peaks do not count
_DIP = 0.25  # of the highest peak; minimum prominence of a peak
# Column of the accelerometer along the printer's axis. According to the source, x and z of "eddie" are
# swapped.
_EDDIE = {
    "vib-x.csv": ("x", "z"),
    "vib-y.csv": ("y", "y"),
    "update_vib-x2.csv": ("x", "z"),
    "update_vib-y2.csv": ("y", "y"),
}


def peaks(frequency: Array, power: Array) -> list[tuple[float, float]]:
    """Find the clear peaks of a power spectrum.

    Args:
        frequency: Frequencies, Hz, shape (n,).
        power: Power, shape (n,).

    Returns:
        Frequency, Hz, and damping ratio by the half-power bandwidth of each peak, ascending.
    """
    inside = (frequency >= _BAND[0]) & (frequency <= _BAND[1])
    f, p = frequency[inside], power[inside] / power[inside].max()
    indices, _ = signal.find_peaks(p, height=_HEIGHT, prominence=_DIP)
    widths = signal.peak_widths(p, indices, rel_height=0.5)[0]
    spacing = float(np.median(np.diff(f)))
    return [(float(f[i]), float(w * spacing / (2 * f[i]))) for i, w in zip(indices, widths, strict=True)]


def spectra(folder: Path) -> dict[str, dict[str, list[tuple[str, Array, Array]]]]:
    """Load the spectra by machine and direction: name, frequency, Hz, power along the excited direction."""
    by_machine: dict[str, dict[str, list[tuple[str, Array, Array]]]] = {}
    for name, (axis, column) in _EDDIE.items():
        table = np.genfromtxt(folder / "eddie_v2_vib" / name, delimiter=",", names=True)
        machine = "CoreXY, after an update" if name.startswith("update") else "CoreXY, before"
        by_machine.setdefault(machine, {}).setdefault(axis, []).append(
            (name, table["freq"], table[column] ** 2)
        )
    for path in sorted((folder / "voron24_250_psd").glob("resonances_*.csv")):
        axis = path.name.split("_")[1]
        table = np.genfromtxt(path, delimiter=",", names=True)
        by_machine.setdefault("Voron 2.4, 250 mm", {}).setdefault(axis, []).append(
            (path.name, table["freq"], table[f"psd_{axis}"])
        )
    return by_machine


def run(console: Console) -> None:
    """Report the resonances by direction, and the mass ratio that equal belt stiffness would imply."""
    folder = data_folder("corexy_printers", console)
    if folder is None:
        return
    table = Table(
        "printer", "direction", "spectra", "lowest peak, Hz", "damping ratio", "other peaks, Hz", "(fx/fy)^2"
    )
    results: dict[str, dict[str, object]] = {}
    panels = []
    for machine, by_axis in spectra(folder).items():
        lowest: dict[str, float] = {}
        for axis, measured in sorted(by_axis.items()):
            resonances = [p for p in (peaks(f, power) for _, f, power in measured) if p]
            first = np.array([p[0] for p in resonances])
            others = [f for p in resonances for f, _ in p[1:]]
            low, lowest[axis], high = (float(f) for f in np.percentile(first[:, 0], [0, 50, 100]))
            result: dict[str, object] = {
                "spectra": len(resonances),
                "lowest_Hz": {"median": lowest[axis], "from": low, "to": high},
                "damping_ratio": float(np.median(first[:, 1])),
                "with_more_peaks": sum(len(p) > 1 for p in resonances),
                "other_Hz": None if not others else {"from": min(others), "to": max(others)},
            }
            ratio = (lowest["x"] / lowest["y"]) ** 2 if axis == "y" else None
            table.add_row(
                *(machine, axis, str(len(resonances)), f"{lowest[axis]:.1f} ({low:.1f} to {high:.1f})"),
                f"{result['damping_ratio']:.3f}",
                f"{min(others):.1f} to {max(others):.1f} in {result['with_more_peaks']}"
                if others
                else "none",
                "" if ratio is None else f"{ratio:.2f}",
            )
            results[f"{machine}, {axis}"] = result | ({} if ratio is None else {"mass_ratio_y_over_x": ratio})
            panels.append(
                (f"{machine}, {axis}", measured[0][1], {"power": measured[0][2] / measured[0][2].max()})
            )
    console.print(table)
    picture(
        "printers",
        "CoreXY printers: power at the tool over frequency (first spectrum of each)",
        panels,
        console,
        "frequency, Hz",
    )
    write_results("real_machines_printers", {"resonances": results}, seed=None)
