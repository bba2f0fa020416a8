"""How accurate is the kernel? Its error and that of MuJoCo's model against an event-driven reference.

    python -m benchmarks.accuracy

The reference is `tests.reference_simulator`, an adaptive Runge-Kutta pair between friction events, which
shares no code with the package. Histories are 0.4 s of random voltages that change every 10 ms. The error is
the distance of two tool positions, sqrt(dx^2 + dy^2). The stiffness of MuJoCo's belts cannot depend on the
carriage's position, so for that comparison all simulators run the stage with belts of constant stiffness.
Seed and versions are in results/accuracy.json.
"""

from __future__ import annotations

import dataclasses
import itertools
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.results_file import write_results
from hframe_gym.arrays import Array
from hframe_gym.dynamics import rollout
from hframe_gym.dynamics.simulation import threads
from hframe_gym.machine import BUILTIN_MACHINES, Drive, Machine, rest_state
from tests import reference_simulator as reference
from tests.reference_simulator import Rig

SEED = 20240
HISTORIES, ROWS, HOLD = 64, 40, 10e-3  # histories of ROWS voltages, each held for HOLD s
AMPLITUDES = (6.0, 12.0)  # V
STEPS = (2e-3, 1e-3, 0.5e-3, 0.25e-3, 0.1e-3)  # s
BAR, AIM = 3e-6, 0.5e-6  # m, required and desired median error at a step of 0.5 ms
GRID: Array = np.arange(ROWS + 1) * HOLD
Results = dict[str, Any]


def rig_of(machine: Machine) -> Rig:
    """Convert an H-frame machine with four coordinates and without effects to the reference's parameters."""
    c, d = machine.coordinates, machine.drives
    return Rig(
        mass=tuple(i.mass for i in c),
        viscous=tuple(i.viscous for i in c),
        coulomb=tuple(i.coulomb for i in c),
        pulley_radius_m=c[2].radius,
        belt_EA_N=tuple(b.EA for b in machine.belts),
        belt_length_m=tuple(b.rest_length for b in machine.belts),
        length_follows=any(b.length for b in machine.belts),
        gear_ratio=d[0].gear_ratio,
        torque_constant=tuple(i.Kt for i in d),
        emf_constant=tuple(i.Ke for i in d),
        resistance_ohm=tuple(i.resistance for i in d),
    )


def histories(amplitude: float, count: int = HISTORIES, seed: int = SEED) -> Array:
    """Return random voltage histories.

    Args:
        amplitude: Voltages are uniform in +-amplitude, V.

    Returns:
        Voltages, V, shape (count, ROWS + 1, 2); the last row repeats the one before it.
    """
    values = np.random.default_rng(seed).uniform(-amplitude, amplitude, (count, ROWS, 2))
    return np.concatenate([values, values[:, -1:]], axis=1)


def _reference(job: tuple[Rig, Array, float]) -> Array:
    """Simulate one history by the reference."""
    rig, inputs, rtol = job
    return reference.simulate(rig, GRID, inputs, rtol=rtol, atol=rtol * 1e-3)[0]


def reference_positions(machine: Machine, inputs: Array, *, rtol: float = 1e-10) -> Array:
    """Simulate histories by the reference on all cores.

    Args:
        inputs: Voltages, V, shape (batch, ROWS + 1, 2).
        rtol: Relative tolerance.

    Returns:
        Positions x, y, phi1, phi2, shape (batch, ROWS + 1, 4).
    """
    jobs = [(rig_of(machine), row, rtol) for row in inputs]
    with ProcessPoolExecutor(threads(), mp_context=get_context("spawn")) as pool:
        return np.array(list(pool.map(_reference, jobs, chunksize=4)))


def distance(a: Array, b: Array) -> Array:
    """Return the distance of two tool positions, m, shape (batch, rows), from positions (batch, rows, 4)."""
    return np.hypot(a[..., 0] - b[..., 0], a[..., 1] - b[..., 1])


def summary(positions: Array, exact: Array) -> dict[str, float]:
    """Return median, 95th percentile and maximum over the histories of largest and final tool error, m."""
    error = distance(positions, exact)
    worst, last = error.max(axis=1), error[:, -1]
    return {
        "median": float(np.median(worst)),
        "p95": float(np.quantile(worst, 0.95)),
        "max": float(worst.max()),
        "end_median": float(np.median(last)),
        "end_p95": float(np.quantile(last, 0.95)),
        "end_max": float(last.max()),
    }


def order(errors: dict[float, float]) -> float:
    """Return the order of convergence: the slope of the logarithm of the error over that of the step."""
    return float(np.polyfit(np.log(list(errors)), np.log(list(errors.values())), 1)[0])


# -- energy --------------------------------------------------------------------------------------------------


def stored_energy(machine: Machine, out: Array) -> Array:
    """Return the kinetic energy plus that of the belts.

    Args:
        machine: Machine without effects.
        out: Positions and velocities of n coordinates, shape (..., 2 n).

    Returns:
        Energy, J, shape (...).
    """
    n = len(machine.coordinates)
    travel, velocity = out[..., :n] * machine.travel_per_unit, out[..., n:]
    energy = 0.5 * (np.array([c.mass for c in machine.coordinates]) * velocity**2).sum(-1)
    for b in machine.belts:
        k = b.EA / (b.rest_length + travel @ machine.coefficients(b.length))
        energy = energy + 0.5 * k * (travel @ machine.coefficients(b.extension)) ** 2
    return energy


def conservative(machine: Machine) -> Machine:
    """Return the machine without friction and back-EMF."""
    bare = tuple(dataclasses.replace(c, viscous=0.0, coulomb=0.0) for c in machine.coordinates)
    drives: tuple[Drive, ...] = tuple(dataclasses.replace(d, Ke=0.0) for d in machine.drives)
    return machine.replace(coordinates=bare, drives=drives)


def energy_drift(machine: Machine, step: float, duration: float = 10.0) -> tuple[float, float]:
    """Measure the energy error of a free vibration without losses.

    Args:
        machine: Machine; its losses are removed.
        step: Integration step, s.
        duration: Simulated time, s.

    Returns:
        Largest relative deviation of the energy, and its relative change between the first and the last
        second.
    """
    free = conservative(machine)
    time = np.arange(round(duration / 5e-3) + 1) * 5e-3
    start = rest_state(free, (0.05, 0.03))
    start[:2] += (1.5e-3, -1e-3)
    out = rollout(free, time, np.zeros((len(time), 2)), start=start, longest_step=step, velocities=True)[0]
    relative = stored_energy(free, out) / stored_energy(free, out)[0] - 1.0
    second = round(1 / 5e-3)
    return float(np.abs(relative).max()), float(relative[-second:].mean() - relative[:second].mean())


def energy_balance(machine: Machine, inputs: Array, step: float) -> Array:
    """Return the relative error of the energy balance of driven runs.

    The work of the voltages equals the change of the stored energy plus the viscous, back-EMF and Coulomb
    losses. The losses are integrated over the kernel's steps.

    Args:
        machine: Machine without effects.
        inputs: Voltages, V, shape (batch, ROWS + 1, 2).
        step: Integration step, s.

    Returns:
        Missing work relative to losses and stored energy, shape (batch,).
    """
    time = np.arange(round(ROWS * HOLD / step) + 1) * step
    fine = np.repeat(inputs[:, :ROWS], round(HOLD / step), axis=1)
    fine = np.concatenate([fine, fine[:, -1:]], axis=1)
    out = rollout(machine, time, fine, longest_step=step, velocities=True)
    n = len(machine.coordinates)
    q, v = out[..., :n], out[..., n:]
    moved, before, after = np.diff(q, axis=1), v[:, :-1], v[:, 1:]
    work, lost = np.zeros(len(out)), np.zeros(len(out))
    for i, c in enumerate(machine.coordinates):
        damping = c.viscous + sum(d.back_emf for d in machine.drives if d.coordinate == c.name)
        squares = (before**2 + before * after + after**2)[..., i] / 3.0
        lost += damping * step * squares.sum(axis=1) + c.coulomb * np.abs(moved[..., i]).sum(axis=1)
    for j, d in enumerate(machine.drives):
        work += d.gain * (fine[:, :-1, j] * moved[..., machine.coordinate_names.index(d.coordinate)]).sum(
            axis=1
        )
    stored = stored_energy(machine, out[:, -1]) - stored_energy(machine, out[:, 0])
    scale = lost + np.abs(stored)
    return (work - lost - stored) / scale


# -- sticking ------------------------------------------------------------------------------------------------

# 0.3 s of motion, 1 s to come to rest on stretched belts under a small voltage, then 10 s at that voltage.
HOLD_VOLTAGE = (0.2, -0.15)  # V: 0.038 Nm and 0.029 Nm, below the pulleys' 0.05 Nm


def hold_inputs() -> Array:
    """Return voltages in rows of 10 ms, V, shape (1131, 2)."""
    return np.concatenate([np.tile((4.0, -2.5), (30, 1)), np.tile(HOLD_VOLTAGE, (1101, 1))])


def creep(positions: Array) -> float:
    """Return the largest motion of a coordinate over the last 10 s, m of travel, from positions (1131, 4)."""
    travel = positions * np.array([1.0, 1.0, 0.0194, 0.0194])
    return float(np.ptp(travel[-1001:], axis=0).max())


def kernel_creep(machine: Machine, step: float) -> float:
    """Return the creep of the kernel below the breakaway level at an integration step, m."""
    inputs = hold_inputs()
    return creep(rollout(machine, np.arange(len(inputs)) * HOLD, inputs, longest_step=step)[0])


# -- the report ----------------------------------------------------------------------------------------------


def micro(value: float) -> str:
    """Format a length in um."""
    return f"{value * 1e6:.3g}"


def against_reference(console: Console, machine: Machine) -> tuple[Results, dict[float, Array]]:
    """Measure the kernel's error at every step and amplitude.

    Returns:
        The results, and the reference's positions by amplitude.
    """
    results: Results = {}
    exact: dict[float, Array] = {}
    table = Table(title=f"Kernel against the reference: tool error over {HISTORIES} histories of 0.4 s, um")
    for column in ("volts", "step ms", "median", "p95", "max", "final error: median", "p95", "max"):
        table.add_column(column, justify="right")
    for volts in AMPLITUDES:
        inputs = histories(volts)
        exact[volts] = reference_positions(machine, inputs)
        reference_error = distance(
            reference_positions(machine, inputs[:4], rtol=1e-12), exact[volts][:4]
        ).max()
        rows = {h: summary(rollout(machine, GRID, inputs, longest_step=h), exact[volts]) for h in STEPS}
        for h, row in rows.items():
            table.add_row(f"{volts:g}", f"{h * 1e3:g}", *(micro(v) for v in row.values()))
        results[f"{volts:g} V"] = {
            "errors_m": {f"{h * 1e3:g} ms": row for h, row in rows.items()},
            "order_median": order({h: row["median"] for h, row in rows.items()}),
            "order_end_median": order({h: row["end_median"] for h, row in rows.items()}),
            "reference_own_error_m": float(reference_error),
        }
    console.print(table)
    for name, result in results.items():
        console.print(
            f"{name}: order of convergence {result['order_median']:.2f} (largest error), "
            f"{result['order_end_median']:.2f} (final error); the reference changes by "
            f"{result['reference_own_error_m'] * 1e9:.2g} nm at tolerances 100 times tighter"
        )
    return results, exact


def compare_with_mujoco(console: Console, machine: Machine) -> Results:
    """Compare kernel, MuJoCo and reference on the stage of constant stiffness, at equal steps, by pairs."""
    from benchmarks.mujoco_stage import FRICTION, INTEGRATORS, Choice, MujocoStage, constant_at_center

    stage = constant_at_center(machine)
    results: Results = {}
    for volts in AMPLITUDES:
        inputs = histories(volts)
        exact = reference_positions(stage, inputs)
        table = Table(
            title=f"The same stage (constant stiffness), +-{volts:g} V: median of the largest tool error, um"
        )
        table.add_column("simulator")
        for h in STEPS:
            table.add_column(f"{h * 1e3:g} ms", justify="right")
        ours = {h: summary(rollout(stage, GRID, inputs, longest_step=h), exact)["median"] for h in STEPS}
        errors: dict[str, dict[float, float]] = {"this kernel": ours}
        finest: Array | None = None
        for integrator, friction in itertools.product(INTEGRATORS, FRICTION):
            choice = Choice(integrator, "Newton", friction)
            errors[str(choice)] = {}
            for h in STEPS:
                model = MujocoStage(stage, h, choice)
                positions = model.positions(inputs[:, :ROWS], round(HOLD / h))
                model.close()
                errors[str(choice)][h] = summary(positions, exact)["median"]
                if choice == Choice("RK4", "Newton", "stiff") and h == STEPS[-1]:
                    finest = positions.copy()
        for name, row in errors.items():
            table.add_row(name, *(micro(v) if np.isfinite(v) and v < 1 else "unstable" for v in row.values()))
        console.print(table)
        others = {name: row for name, row in errors.items() if name != "this kernel"}
        best = {
            h: min(others, key=lambda name, h=h: np.nan_to_num(others[name][h], nan=np.inf)) for h in STEPS
        }
        factors = {h: others[best[h]][h] / ours[h] for h in STEPS}
        for h in STEPS:
            console.print(f"{h * 1e3:g} ms: MuJoCo's best ({best[h]}) has {factors[h]:.1f} times the error")
        assert finest is not None
        fine = rollout(stage, GRID, inputs, longest_step=0.025e-3)
        crossed = {
            "kernel at 0.025 ms to reference": float(np.median(distance(fine, exact).max(axis=1))),
            "MuJoCo RK4, stiff, 0.1 ms to reference": float(np.median(distance(finest, exact).max(axis=1))),
            "MuJoCo RK4, stiff, 0.1 ms to kernel": float(np.median(distance(finest, fine).max(axis=1))),
        }
        for name, value in crossed.items():
            console.print(f"{name}: {micro(value)} um")
        results[f"{volts:g} V"] = {
            "median_errors_m": {
                n: {f"{h * 1e3:g} ms": v for h, v in row.items()} for n, row in errors.items()
            },
            "best_mujoco": {f"{h * 1e3:g} ms": best[h] for h in STEPS},
            "mujoco_over_kernel": {f"{h * 1e3:g} ms": factors[h] for h in STEPS},
            "three_ways_m": crossed,
        }
    creeps = {"this kernel": kernel_creep(stage, 0.25e-3)}
    for friction in FRICTION:
        choice = Choice("implicitfast", "Newton", friction)
        model = MujocoStage(stage, 0.25e-3, choice)
        creeps[str(choice)] = creep(model.positions(hold_inputs()[None, :-1], 40)[0])
        model.close()
    for name, value in creeps.items():
        console.print(f"10 s below the breakaway level: {name} moves by {value:.3g} m")
    results["creep_m"] = creeps
    return results


def main() -> None:
    """Run all comparisons and write the results."""
    console = Console(width=140)
    machine = BUILTIN_MACHINES["hframe"]()
    errors, _ = against_reference(console, machine)
    drift = {f"{h * 1e3:g} ms": energy_drift(machine, h) for h in STEPS}
    balance = {
        f"{h * 1e3:g} ms": float(np.median(np.abs(energy_balance(machine, histories(12.0), h))))
        for h in STEPS
    }
    table = Table(
        title="Energy: 10 s of free vibration without losses; and balance of a driven run with friction"
    )
    for column in ("step", "largest deviation", "drift over 9 s", "energy error of a driven run (median)"):
        table.add_column(column, justify="right")
    for h in drift:
        table.add_row(h, f"{drift[h][0]:.2e}", f"{drift[h][1]:.1e}", f"{balance[h]:.1e}")
    console.print(table)
    held = {f"{h * 1e3:g} ms": kernel_creep(machine, h) for h in STEPS}
    console.print(
        "motion in 10 s below the breakaway level: " + ", ".join(f"{v:g} m at {h}" for h, v in held.items())
    )
    median = errors["12 V"]["errors_m"]["0.5 ms"]["median"]
    console.print(
        f"median at 0.5 ms, +-12 V: {micro(median)} um (required {micro(BAR)}, desired {micro(AIM)})"
    )
    content = {
        "histories": HISTORIES,
        "against_reference": errors,
        "energy_drift": {h: {"largest": a, "drift": b} for h, (a, b) in drift.items()},
        "energy_missing_median": balance,
        "creep_m": held,
        "constant_stiffness": compare_with_mujoco(console, machine),
    }
    write_results("accuracy", content, seed=SEED)


if __name__ == "__main__":
    main()
