"""Does identification name what is there, and nothing else?  Rigs of the independent simulator, unknown to the fit.

    python -m benchmarks.identification            # the shipped examples and a set of rigs (some minutes)
    python -m benchmarks.identification examples   # the shipped examples alone

Every rig has the parameters of `make_examples.TRUTH` changed at random by up to 10 %, recordings of its own, and at
most one effect.  A hit is the effect at its site, and nothing else; errors are of a free run on held-out recordings.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.excitation import runs
from benchmarks.make_examples import DURATION_S, RUNS, TRUTH, measure
from benchmarks.results_file import write_results
from benchmarks.rigs import Rig
from hframe_gym.files import Recording, load_machine, read_recordings
from hframe_gym.identify import Answer, identify

SEED = 100
SETTLING_S = 0.3


class Case(NamedTuple):
    """A rig: its name, what it hides (effect@site, or nothing), and how it differs from TRUTH."""

    name: str
    hides: str
    change: dict[str, Any]


def cases() -> Iterator[Case]:
    """Six rigs without an effect, and every effect of the library at two sites."""
    yield from (Case(f"none {i}", "", {}) for i in range(1, 7))
    yield Case("stribeck, bridge", "stribeck_friction@x", {"stribeck_force": (2.0, 0, 0, 0)})
    yield Case("stribeck, motor 1", "stribeck_friction@phi1", {"stribeck_force": (0, 0, 0.03, 0)})
    yield Case("tilt along y", "constant_force@y", {"constant_force": (0, 0.8, 0, 0)})
    yield Case("offset, motor 2", "constant_force@phi2", {"constant_force": (0, 0, 0, 0.02)})
    yield Case("one-sided seal, bridge", "asymmetric_viscous@x", {"viscous_asymmetry": (0.2, 0, 0, 0)})
    yield Case("one-sided seal, motor 1", "asymmetric_viscous@phi1", {"viscous_asymmetry": (0, 0, 0.3, 0)})
    yield Case("late voltage, 2 ms", "input_delay@drives", {"input_delay_s": (2e-3, 2e-3)})
    yield Case("late voltage, 0.3 ms", "input_delay@drives", {"input_delay_s": (3e-4, 3e-4)})


def record(case: Case, seed: int) -> list[Recording]:
    """Eight runs of the case's rig with the examples' sensors."""
    rng = np.random.default_rng(seed)

    def near(values: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(float(v * rng.uniform(0.9, 1.1)) for v in values)

    varied = {key: near(getattr(TRUTH, key)) for key in ("mass", "viscous", "coulomb", "belt_EA_N")}
    rig: Rig = dataclasses.replace(TRUTH, **varied, **case.change)
    # A rig has come to rest when its recording begins: the simulated one starts with unstretched belts and gets time.
    made = runs(seed, RUNS, duration_s=DURATION_S + SETTLING_S, rest_s=SETTLING_S + 0.1, rig=rig)
    first = round(SETTLING_S * 1000)
    return [
        Recording(f"run_{i:02}", run.time_s[first:], run.inputs[first:], measure(run.positions, rng)[first:])
        for i, run in enumerate(made, start=1)
    ]


def found(answer: Answer) -> str:
    return " + ".join(f.effect.label for f in answer.found)


def noise_ratio(answer: Answer, stage: str) -> float:
    """Mean over channels of the held-out rmse over the sensor's noise."""
    channels = getattr(answer, stage).held_out.channels
    return float(np.mean([e.noise_ratio for e in channels.values() if e.noise_ratio is not None]))


def examples(console: Console) -> None:
    """The shipped recordings: error by channel, before and after."""
    machine = load_machine("hframe")
    results = {}
    for rig in ("rig_a", "rig_b"):
        answer = identify(read_recordings(f"examples/{rig}", machine), machine)
        results[rig] = answer.as_json()
        table = Table(f"{rig}: {answer.verdict}", "declared", "before", "after")
        for channel in machine.output_channels:
            ratios = [results[rig][s]["held_out"][channel]["noise_ratio"] for s in ("declared", "before", "after")]
            table.add_row(channel, *(f"{r:.3g}" for r in ratios))
        console.print(table, f"effects: {found(answer) or 'none'}; {answer.seconds:.1f} s")
    write_results("identify_examples", results, seed=None)


def rigs(console: Console) -> None:
    """The set of rigs: hits, false alarms, errors, time."""
    machine = load_machine("hframe")
    table = Table("rig", "hides", "found", "hit", "before", "after", "seconds")
    rows = []
    for i, case in enumerate(track(list(cases()), description="rigs", console=console, transient=True)):
        recordings = record(case, SEED + i)
        began = time.perf_counter()
        answer = identify(recordings, machine)
        seconds = time.perf_counter() - began
        before, after = noise_ratio(answer, "before"), noise_ratio(answer, "after")
        hit = found(answer) == case.hides
        rows.append(
            {"rig": case.name, "hides": case.hides, "found": found(answer), "verdict": answer.verdict, "hit": hit}
            | {"before": before, "after": after, "seconds": round(seconds, 2)}
        )
        shown = (case.hides or "-", found(answer) or answer.verdict, "yes" if hit else "NO")
        table.add_row(case.name, *shown, f"{before:.3g}", f"{after:.3g}", f"{seconds:.1f}")
    console.print(table, f"{sum(r['hit'] for r in rows)} of {len(rows)} rigs right")
    write_results("identification", {"rigs": rows}, seed=SEED)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", choices=["examples", "rigs", "all"], default="all")
    what = parser.parse_args().what
    console = Console(width=130)
    if what in ("examples", "all"):
        examples(console)
    if what in ("rigs", "all"):
        rigs(console)


if __name__ == "__main__":
    main()
