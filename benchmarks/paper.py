"""Do the models agree with the paper? Every statement of its text beside the models, and its figures anew.

    python -m benchmarks.paper

Sollmann, Jouaneh and Lavender print parameters and describe their figures; the measured curves are not in the
text. The table compares the statements with the models. docs/figures/ contains our versions of Figures 4 to 7
and 10. There is no randomness; versions are in results/paper.json.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from benchmarks.results_file import write_results
from hframe_gym.arrays import Array
from hframe_gym.dynamics import belt_modes, simulate
from hframe_gym.files import atomic_file
from hframe_gym.machine import BUILTIN_MACHINES, Machine, with_constant_stiffness
from hframe_gym.machine.presets import STIFFNESS
from tools.repository import FIGURES

CENTER = {"x": -0.2227, "y": -0.1163}  # m, where Table 1's stiffness holds
LASER_RANGE = 0.1  # m


class Row(NamedTuple):
    """Statement of the paper: where it is, what it says, what the models give, and whether they agree."""

    where: str
    says: str
    ours: str
    agrees: str


def step(machine: Machine, volts: tuple[float, float], seconds: float) -> tuple[Array, Array]:
    """Simulate a voltage step from rest at the origin.

    Args:
        volts: Voltages of motor 1 and 2, V.
        seconds: Duration, s.

    Returns:
        Times, s, shape (n,), and outputs phi1, phi2, x, y, shape (n, 4).
    """
    time = np.arange(round(seconds * 1e4) + 1) * 1e-4
    outputs = simulate(machine, time, np.tile(volts, (len(time), 1)), longest_step=0.1e-3).outputs
    return time, outputs


def nonlinear() -> Machine:
    """Return the machine with the friction of Table 3 and the stiffness of Table 1, as in Section IV."""
    return with_constant_stiffness(BUILTIN_MACHINES["hframe"](), STIFFNESS)


def stiffness(machine: Machine, position: dict[str, float]) -> dict[str, float]:
    """Return k = EA / length of each belt, N/m, with the carriage at a position, m."""
    return {
        b.name: b.EA / (b.rest_length + sum(f * position[c] for c, f in b.length.items()))
        for b in machine.belts
    }


def peak_to_peak(position: Array) -> float:
    """Return the peak-to-peak value of a position in m, mm."""
    return 1e3 * float(np.ptp(position))


def rows() -> list[Row]:
    """Compare every statement of the text that a model can verify."""
    declared = BUILTIN_MACHINES["hframe"]()
    linear = BUILTIN_MACHINES["hframe-linear"]()
    full = BUILTIN_MACHINES["hframe-order20"]()
    friction, literal = nonlinear(), with_constant_stiffness(BUILTIN_MACHINES["hframe-literal"](), STIFFNESS)
    statements: list[Row] = []

    def add(where: str, says: str, ours: str, agrees: bool | str) -> None:
        statements.append(
            Row(where, says, ours, agrees if isinstance(agrees, str) else "yes" if agrees else "no")
        )

    at_center = stiffness(declared, CENTER)
    for name, printed in STIFFNESS.items():
        value = at_center[name]
        add(
            f"Table 1 from Table 4, k {name}",
            f"{printed:.5g} N/m",
            f"{value:.5g} N/m",
            abs(value / printed - 1) < 5e-4,
        )
    modes = ["  ".join(f"{f:.2f}" for f in belt_modes(m)) for m in (linear, full)]
    add("belt modes, 8th order", "-", f"{modes[0]} Hz", "not stated")
    add("belt modes, 20th order", "-", f"{modes[1]} Hz", "not stated")
    for volts, axis, name in (((-4.0, -4.0), 3, "y"), ((-4.0, 4.0), 2, "x")):
        small, large = (step(m, volts, 0.3)[1][:, axis] for m in (linear, full))
        worst = 1e3 * float(np.abs(small - large).max())
        says = "8th and 20th order almost exactly the same"
        add(
            f"Fig. 4, {name}-move at 4 V",
            says,
            f"differ by {worst:.2f} mm of {1e3 * small[-1]:.1f}",
            worst < 0.5,
        )
        rough = step(friction, volts, 0.3)[1][:, axis]
        difference = 100 * (rough[-1] / small[-1] - 1)
        add(
            f"Figs. 5-7, {name} at 4 V",
            "linear and nonlinear match",
            f"nonlinear {difference:+.1f} % after 0.3 s",
            abs(difference) < 3,
        )
    for volt in (2.0, 6.0):
        smooth, rough = (step(m, (-volt, -volt), 0.3)[1][-1, 3] for m in (linear, friction))
        difference = 100 * (rough / smooth - 1)
        add(
            f"Figs. 5, 7 at {volt:.0f} V",
            "the linear model deviates",
            f"nonlinear {difference:+.1f} %",
            abs(difference) > 1,
        )
    crept = 1e3 * abs(step(literal, (-2.0, 2.0), 0.5)[1][-1, 2])
    moved = 1e3 * abs(step(friction, (-2.0, 2.0), 0.5)[1][-1, 2])
    add(
        "eq. 17, x at 2 V (Fig. 7 moves)",
        "no gear ratio",
        f"without {crept:.2f} mm, with 5.9:1 {moved:.0f} mm",
        "erratum",
    )
    k = STIFFNESS
    skewed = with_constant_stiffness(declared, k | {"left": 0.75 * k["left"], "right": 1.25 * k["right"]})
    stiff = with_constant_stiffness(declared, k | {"bottom": 2 * k["bottom"]})
    along_y = 1e3 * (
        step(skewed, (-6.0, -6.0), 0.25)[1][-1, 3] - step(friction, (-6.0, -6.0), 0.25)[1][-1, 3]
    )
    along_x = 1e3 * (step(stiff, (-6.0, 6.0), 0.25)[1][-1, 2] - step(friction, (-6.0, 6.0), 0.25)[1][-1, 2])
    add("Sec. V, k_l -25 %, k_r +25 %", "y(0.25 s) falls by 0.1 mm", f"{along_y:+.2f} mm", "sign; smaller")
    add(
        "Sec. V, k_b doubled",
        "x changes by a similar amount",
        f"{along_x:+.2f} mm",
        abs(abs(along_x) - 0.1) < 0.05,
    )
    ends = {axis: declared.coordinate(axis).range or (0.0, 0.0) for axis in ("x", "y")}
    for name, axis, says in (("bottom", "x", 3.0), ("left", "y", 1.5)):
        values = [stiffness(declared, {"x": 0.0, "y": 0.0} | {axis: end})[name] for end in ends[axis]]
        ratio = max(values) / min(values)
        add(
            f"Fig. 10, k {name} along {axis}",
            f"a factor of about {says}",
            f"{ratio:.2f}",
            "yes" if abs(ratio / says - 1) < 0.1 else "roughly",
        )
    across = peak_to_peak(step(friction, (-4.0, -4.0), 0.3)[1][:, 2])
    add(
        "Fig. 4a, x in a y-move",
        "about 0.2 mm, does not return",
        f"{across:.3f} mm",
        "not modeled: an effect of that rig",
    )
    slight = peak_to_peak(step(friction, (-2.0, 2.0), 0.5)[1][:, 3])
    add(
        "Fig. 7a, y in an x-move",
        "slight, below 1 mm",
        f"{slight:.3f} mm",
        "not modeled: an effect of that rig",
    )
    add(
        "Figs. 4-6, laser",
        "sticks at the end of its 100 mm",
        "no such sensor declared",
        "not modeled: the sensor's range",
    )
    return statements


def figure_step(
    number: int, volts: tuple[float, float], seconds: float, models: dict[str, Machine]
) -> Figure:
    """Draw displacement and motor angles of a voltage step, as in Figures 4 to 7."""
    figure = Figure(figsize=(9, 5), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True)
    labels = ("phi1 (rad)", "phi2 (rad)", "x (mm)", "y (mm)")
    for (name, machine), style in zip(models.items(), ("-", "--", ":"), strict=False):
        time, outputs = step(machine, volts, seconds)
        for panel, channel in ((axes[0, 0], 2), (axes[0, 1], 3), (axes[1, 0], 0), (axes[1, 1], 1)):
            panel.plot(time, outputs[:, channel] * (1e3 if channel > 1 else 1.0), style, lw=1.3, label=name)
            panel.set_ylabel(labels[channel])
            panel.grid(alpha=0.3)
    if number == 4:
        axes[0, 1].axhline(1e3 * LASER_RANGE, color="0.5", lw=0.8)
        axes[0, 1].annotate("end of the laser's range", (0.0, 1e3 * LASER_RANGE), va="bottom", fontsize=8)
    axes[0, 0].legend(frameon=False)
    for panel in axes[1]:
        panel.set_xlabel("time (s)")
    figure.suptitle(f"as Figure {number}: {volts[0]:g} V / {volts[1]:g} V")
    return figure


def figure_stiffness() -> Figure:
    """Draw the stiffness of the belts over the workspace, as in Figure 10."""
    machine = BUILTIN_MACHINES["hframe"]()
    figure = Figure(figsize=(9, 3.4), layout="constrained")
    for panel, axis in zip(figure.subplots(1, 2, sharey=True), ("x", "y"), strict=True):
        low, high = machine.coordinate(axis).range or (0.0, 0.0)
        positions = np.linspace(low, high, 101)
        curves = [stiffness(machine, {"x": 0.0, "y": 0.0} | {axis: float(p)}) for p in positions]
        for name, style in zip(STIFFNESS, ("-", "--", "-"), strict=True):  # left and right are equal along x
            panel.plot(1e3 * positions, [1e-3 * c[name] for c in curves], style, label=name)
        panel.set(xlabel=f"{axis} (mm), the other at 0", ylabel="stiffness (N/mm)")
        panel.grid(alpha=0.3)
        panel.legend(frameon=False)
    figure.suptitle("as Figure 10: stiffness and position")
    return figure


def main() -> None:
    """Print the table, draw the figures and write the results."""
    console = Console(width=140)
    table = Table("where", "the paper says", "the models give", "agrees")
    statements = rows()
    for row in statements:
        table.add_row(*row)
    console.print(table)
    linear = BUILTIN_MACHINES["hframe-linear"]()
    full = BUILTIN_MACHINES["hframe-order20"]()
    friction = nonlinear()
    orders = {"8th order": linear, "20th order": full}
    kinds = {"linear": linear, "nonlinear": friction}
    figures: dict[str, Callable[[], Figure]] = {
        "figure_4": lambda: figure_step(4, (-4.0, -4.0), 0.3, orders),
        "figure_5": lambda: figure_step(5, (-6.0, -6.0), 0.25, kinds),
        "figure_6": lambda: figure_step(6, (-4.0, -4.0), 0.3, kinds),
        "figure_7": lambda: figure_step(7, (-2.0, 2.0), 0.5, kinds),
        "figure_10": figure_stiffness,
    }
    for name, draw in figures.items():
        with atomic_file(FIGURES / f"{name}.png") as file:
            draw().savefig(file, dpi=110)
        console.print(f"docs/figures/{name}.png")
    write_results("paper", {"statements": [row._asdict() for row in statements]}, seed=None)


if __name__ == "__main__":
    main()
