"""How fast is the kernel? Steps per second against MuJoCo and SciPy, scaling, first use, memory, roofline.

    python -m benchmarks.throughput

Compared: the generated kernel, MuJoCo's multi-threaded rollout with its fastest and its most accurate
settings, and SciPy's LSODA. All of them run in this process, in turn, with the same random voltages (held for
10 ms) and the same integration step. A ratio is the median over the repetitions; the spread gives their
extremes. Seed and versions are written to results/throughput.json.
"""

from __future__ import annotations

import ctypes
import functools
import inspect
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.integrate import solve_ivp

from benchmarks.kernel_batch import (
    HOLD,
    PERIODS,
    REPEATS,
    SEED,
    STEP,
    VOLTS,
    KernelBatch,
    interleaved,
    random_voltages,
)
from benchmarks.mujoco_stage import Choice, MujocoStage, constant_at_center
from benchmarks.results_file import write_results
from hframe_gym.arrays import Array
from hframe_gym.dynamics import LANES, kernel_source_text, linearize, simulate
from hframe_gym.dynamics.codegen.lane_program import FORMULAS, LaneProgram
from hframe_gym.dynamics.simulation import threads
from hframe_gym.machine import BUILTIN_MACHINES, Machine

STAGES = 4096
# Formulas of a step without a stop.
FRICTION = ("direction", "static_friction", "friction_force", "update_speed")
BAR, AIM = 300.0, 800.0  # ratio of the kernel's rate to MuJoCo's: required and desired
# MuJoCo's fastest integrator and solver on this stage with its driest friction; `fastest_choice` measures
# them all.
FASTEST = Choice("Euler", "PGS", "stiff")
MOST_ACCURATE = Choice("RK4", "Newton", "stiff")


class MujocoBatch:
    """The same batch on MuJoCo's rollout.

    Args:
        machine: Machine of all stages; its belts get constant stiffness.
        batch: Number of stages.
        choice: Integrator, solver and friction.
        count: Number of threads.
    """

    def __init__(self, machine: Machine, batch: int, choice: Choice, count: int) -> None:
        self.stage = MujocoStage(constant_at_center(machine), STEP, choice, threads=count)
        self.start = np.zeros((batch, self.stage.size))
        self.controls = np.ascontiguousarray(
            np.repeat(random_voltages(batch).transpose(1, 0, 2), HOLD, axis=1)
        )

    def rate(self) -> float:
        """Return the integrator steps per second, from rest."""
        begin = time.perf_counter()
        self.stage.run(self.start, self.controls)
        return self.controls.shape[0] * self.controls.shape[1] / (time.perf_counter() - begin)


def fastest_choice(machine: Machine) -> dict[str, float]:
    """Return MuJoCo's steps per second on one core by integrator and solver, with its driest friction."""
    from benchmarks.mujoco_stage import INTEGRATORS, SOLVERS

    rates = {}
    for integrator in INTEGRATORS:
        for solver in SOLVERS:
            choice = Choice(integrator, solver)
            batch = MujocoBatch(machine, 128, choice, 1)
            rates[str(choice)] = max(batch.rate() for _ in range(3))
    return rates


def compare_with_mujoco(console: Console, machine: Machine) -> dict[str, Any]:
    """Measure the rates of kernel and MuJoCo in turn, print them, and return the results."""
    table = Table(
        title=f"Steps per second, step {STEP * 1e3:g} ms, {STAGES} stages, "
        f"medians of {REPEATS} alternating runs"
    )
    for column in ("stage", "MuJoCo", "cores", "kernel M/s", "MuJoCo M/s", "ratio", "spread"):
        table.add_column(column)
    results: dict[str, Any] = {"mujoco_one_core_by_choice": fastest_choice(machine)}
    constant = constant_at_center(machine)
    cases = [
        ("belts follow the carriage", machine, FASTEST, threads()),
        ("belts follow the carriage", machine, FASTEST, 1),
        ("belts of constant stiffness", constant, FASTEST, threads()),
        ("belts follow the carriage", machine, MOST_ACCURATE, threads()),
    ]
    for name, stage, choice, cores in cases:
        ours, theirs = KernelBatch(stage, STAGES), MujocoBatch(stage, STAGES, choice, cores)
        ratio = interleaved(
            functools.partial(ours.rate, parallel=cores > 1, least=0.5),
            theirs.rate,
            REPEATS if cores > 1 else 5,
        )
        theirs.stage.close()
        r = ratio.report()
        results[f"{name}; {choice}; {cores} cores"] = r
        low, high = r["spread"]
        row = (r["ours_steps_per_s"] / 1e6, r["theirs_steps_per_s"] / 1e6, r["ratio"])
        table.add_row(
            name,
            str(choice),
            str(cores),
            f"{row[0]:.1f}",
            f"{row[1]:.3f}",
            f"{row[2]:.0f}",
            f"{low:.0f} - {high:.0f}",
        )
    console.print(table)
    console.print(
        f"required {BAR:g}, desired {AIM:g}, on all cores with belts that "
        "follow the carriage (MuJoCo's do not)"
    )
    return results


def scipy_rate(machine: Machine, creep: float = 1e-4) -> float:
    """Return the equivalent steps of 0.25 ms per second of LSODA with rtol 1e-6.

    Args:
        machine: Machine to simulate; its belts get constant stiffness.
        creep: Speed over which tanh smooths the Coulomb friction, m/s.

    Returns:
        Simulated time per second over 0.25 ms, 1/s.
    """
    stage = constant_at_center(machine)
    system = linearize(stage)
    mass = np.array([c.mass for c in stage.coordinates])
    coulomb = np.array([c.coulomb for c in stage.coordinates]) / mass
    scale = stage.travel_per_unit / creep
    begin = time.perf_counter()
    z = np.zeros(8)
    for u in random_voltages(1)[:, 0]:
        forced = system.B @ u

        def rhs(_: float, z: Array, forced: Array = forced) -> Array:
            dz = system.A @ z + forced
            dz[4:] -= coulomb * np.tanh(z[4:] * scale)
            return dz

        z = solve_ivp(rhs, (0.0, HOLD * STEP), z, method="LSODA", rtol=1e-6, atol=1e-9).y[:, -1]
    return PERIODS * HOLD / (time.perf_counter() - begin)


def growth(console: Console) -> dict[str, Any]:
    """Measure the kernel's rate by batch size, threads and machine."""
    table = Table(title="Million steps per second by batch size")
    for column in ("machine", "threads", *(str(4**i) for i in range(8)), "bytes per stage"):
        table.add_column(column, justify="right")
    results: dict[str, Any] = {}
    for name in ("hframe", "hframe-order20"):
        batches = {4**i: KernelBatch(BUILTIN_MACHINES[name](), 4**i) for i in range(8)}
        memory = batches[4**7].bytes_per_stage()
        for count in sorted({1, threads()}):
            rates = {b: batch.rate(parallel=count > 1) for b, batch in batches.items()}
            results[f"{name}, {count} threads"] = {str(b): r for b, r in rates.items()}
            table.add_row(name, str(count), *(f"{r / 1e6:.2f}" for r in rates.values()), f"{memory:.0f}")
        results[f"{name}, bytes per stage"] = memory
    console.print(table)
    return results


_FIRST = """
import time
begin = time.perf_counter()
import numpy as np
import hframe_gym
machine = hframe_gym.load_machine("hframe")
machine.simulate(np.arange(2001) * 1e-3, np.zeros((2001, 2)))
print(time.perf_counter() - begin)
"""


def first_use() -> dict[str, float]:
    """Measure the time from the first import to the end of the first simulation in a new process, s.

    Returns:
        The time with an empty kernel cache (cold_s) and with a filled one (warm_s).
    """
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"HFRAME_CACHE": folder, "NUMBA_CACHE_DIR": folder}

        def once() -> float:
            command = [sys.executable, "-c", _FIRST]
            answer = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
            return float(answer.stdout)

        cold = once()
        return {"cold_s": cold, "warm_s": min(once() for _ in range(3))}


def one_recording(machine: Machine) -> dict[str, float]:
    """Measure the time of one simulation of 2 s at 1 kHz with a warm cache: median and minimum of 200, ms."""
    grid = np.arange(2001) * 1e-3
    inputs = np.repeat(np.random.default_rng(SEED).uniform(-VOLTS, VOLTS, (201, 2)), 10, axis=0)[:2001]
    spent = []
    for _ in range(200):
        begin = time.perf_counter()
        simulate(machine, grid, inputs)
        spent.append((time.perf_counter() - begin) * 1e3)
    return {"median_ms": statistics.median(spent[10:]), "best_ms": min(spent)}


# -- roofline ------------------------------------------------------------------------------------------------


class Counted:
    """Value that counts the operations in which it takes part."""

    tally: ClassVar[Counter[str]] = Counter()

    def __init__(self, *_: object) -> None:
        pass

    @classmethod
    def of(cls, kind: str, *_: object) -> Counted:
        """Count an operation and return its result."""
        cls.tally[kind] += 1
        return cls()


def _binary(kind: str) -> Callable[..., Counted]:
    return lambda a, b: Counted.of(kind)


for _name, _kind in {
    "add": "add",
    "radd": "add",
    "sub": "add",
    "rsub": "add",
    "mul": "multiply",
    "rmul": "multiply",
    "truediv": "divide",
    "rtruediv": "divide",
    "lt": "compare",
    "le": "compare",
    "gt": "compare",
    "ge": "compare",
    "eq": "compare",
    "ne": "compare",
    "and": "mask",
    "or": "mask",
}.items():
    setattr(Counted, f"__{_name}__", _binary(_kind))
Counted.__neg__ = lambda self: Counted.of("bits")  # type: ignore[attr-defined]


def operations(machine: Machine) -> Counter[str]:
    """Count the vector operations of one step of a block in which no coordinate stops, from its source."""
    text = kernel_source_text(machine)
    body = text[text.index("def advance(") : text.index("def read_sensors(")]
    kinds = {"fma": "fma", "where": "select", "copysign": "bits", "absolute": "bits", "minimum": "compare"}
    kinds |= {"load": "load", "store": "store"}
    space: dict[str, Any] = {n: functools.partial(Counted.of, k) for n, k in kinds.items()}
    space |= {"any_of": lambda _: False, "align_stack": lambda: None, "Any": Any}
    for name in FRICTION:
        exec(inspect.getsource(FORMULAS[name]), space)
    exec(body, space)
    totals = []
    for steps in (1, 2):
        Counted.tally = Counter()
        space["advance"](None, None, None, None, None, Counted(), steps)
        totals.append(Counted.tally)
    return Counter({k: totals[1][k] - totals[0][k] for k in totals[1] if totals[1][k] != totals[0][k]})


def fma_peak(chains: int) -> float:
    """Measure the vector fused multiply-adds per second on one core, in independent chains."""
    count = 2_000_000
    starts = [f"x_{i} = a" for i in range(chains)]
    steps = [f"    x_{i} = fma(x_{i}, a, b)" for i in range(chains)]
    total = " + ".join(f"x_{i}" for i in range(chains))
    head = "def chain(rows, count: int):"
    lines = [head, "a = load(rows, 0)", "b = load(rows, 1)", *starts, "for step in range(count):", *steps]
    program = LaneProgram("\n    ".join([*lines, f"store(rows, 0, {total})"]) + "\n", ("chain",))
    chain = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int64)(program.addresses["chain"])
    rows = np.full((2, LANES), 0.5)
    chain(rows.ctypes.data, 10)
    best = np.inf
    for _ in range(7):
        begin = time.perf_counter()
        chain(rows.ctypes.data, count)
        best = min(best, time.perf_counter() - begin)
    return chains * count / best


def roofline(console: Console, machine: Machine) -> dict[str, Any]:
    """Measure which limit applies: arithmetic, latency or memory; print and return operations and rates."""
    kinds = operations(machine)
    flops = sum(kinds[k] * n for k, n in {"fma": 2, "add": 1, "multiply": 1, "divide": 1}.items())
    arithmetic = sum(n for k, n in kinds.items() if k not in ("load", "store"))
    peak, latency = fma_peak(8), fma_peak(1)
    small = KernelBatch(machine, LANES * 16)
    rate = max(small.rate(parallel=False) for _ in range(7))
    large = max(KernelBatch(machine, 16384).rate(parallel=False) for _ in range(3))
    single = max(KernelBatch(machine, 1).rate(parallel=False) for _ in range(5))
    smooth = KernelBatch(machine, LANES * 16)
    # Constant voltage: no coordinate ever stops.
    smooth.inputs = [np.full_like(u, 12.0) for u in smooth.inputs]
    steady = max(smooth.rate(parallel=False) for _ in range(7))
    blocks = rate / LANES
    results: dict[str, Any] = {
        "lanes": LANES,
        "vector_operations_per_step": dict(kinds),
        "flops_per_step_and_stage": flops,
        "vector_operations_per_step_total": arithmetic,
        "fma_peak_per_s": peak,
        "fma_latency_s": 1 / latency,
        "peak_gflops": peak * 2 * LANES / 1e9,
        "reached_gflops": rate * flops / 1e9,
        "share_of_fma_peak": rate * flops / (peak * 2 * LANES),
        "vector_operations_per_s": blocks * arithmetic,
        "share_of_issue_at_one_fma_port": blocks * arithmetic / peak,
        "step_in_fma_latencies": latency / blocks,
        "rate_in_cache_over_16384_stages": rate / large,
        "one_stage_steps_per_s": single,
        "rate_without_stops": steady,
        "share_of_time_in_stops": 1.0 - rate / steady,
    }
    table = Table(title="Roofline of one core")
    table.add_column("quantity")
    table.add_column("value", justify="right")
    listed = ", ".join(f"{n} {k}" for k, n in sorted(kinds.items()))
    for name, value in (
        ("lanes", f"{LANES}"),
        ("vector operations per step (no coordinate stops)", f"{arithmetic}: {listed}"),
        ("floating-point operations per step and stage", f"{flops}"),
        ("measured FMA peak", f"{results['peak_gflops']:.1f} GFLOP/s ({peak / 1e9:.2f} G vector FMA/s)"),
        (
            "reached",
            f"{results['reached_gflops']:.1f} GFLOP/s, {100 * results['share_of_fma_peak']:.0f} % of peak",
        ),
        (
            "vector operations issued",
            f"{blocks * arithmetic / 1e9:.2f} G/s, {blocks * arithmetic / peak:.2f} per peak FMA",
        ),
        ("time of one step of a block", f"{1e9 / blocks:.1f} ns = {latency / blocks:.0f} dependent FMAs"),
        ("of which friction events (a coordinate stops)", f"{100 * results['share_of_time_in_stops']:.0f} %"),
        ("without them", f"{LANES * 1e9 / steady:.1f} ns = {latency / steady * LANES:.0f} dependent FMAs"),
        ("cache: rate of 16 blocks over rate of 16384 stages", f"{rate / large:.2f}"),
    ):
        table.add_row(name, value)
    console.print(table)
    console.print(
        "The limit is the chain of dependent operations of one step (midpoint, belt lengths, division, "
        "forces, friction, forces, friction, travel) and of the stops, not memory (docs/decisions/0015)."
    )
    return results


def main() -> None:
    """Run all measurements and write the results."""
    console = Console(width=150)
    machine = BUILTIN_MACHINES["hframe"]()
    content: dict[str, Any] = {"step_s": STEP, "stages": STAGES}
    content["first_use"] = first_use()
    console.print(
        "first simulation in a new process: "
        + ", ".join(f"{k} {v:.2f}" for k, v in content["first_use"].items())
    )
    content["one_recording"] = one_recording(machine)
    console.print("2 s at 1 kHz: " + ", ".join(f"{k} {v:.3f}" for k, v in content["one_recording"].items()))
    content["roofline"] = roofline(console, machine)
    content["growth"] = growth(console)
    content["mujoco"] = compare_with_mujoco(console, machine)
    content["scipy_lsoda_steps_per_s"] = scipy_rate(machine)
    ours = KernelBatch(machine, STAGES).rate(parallel=False)
    console.print(
        f"SciPy LSODA, one stage: {content['scipy_lsoda_steps_per_s']:.0f} steps/s; "
        f"one core of the kernel is {ours / content['scipy_lsoda_steps_per_s']:.0f} times that"
    )
    write_results("throughput", content, seed=SEED)


if __name__ == "__main__":
    main()
