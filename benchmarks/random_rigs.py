"""Does identification hold on rigs that were drawn at random? Names, errors, standard deviations, detection, time.

    python -m benchmarks.random_rigs --seed 1 --only 3 17 40 --log      # some rigs of the development set
    python -m benchmarks.random_rigs --seed 1 --count 300 --jobs 2      # all of them
    python -m benchmarks.random_rigs --seed 20261124 --count 300        # the set that is run once, for RESULTS.md

The rigs come from `tests.rigs.random_rigs` and two independent simulators; `benchmarks.scoring` compares names. Seed 1
is for development. Nothing may be changed after a look at seed 20261124: it is run once, for the published results.
Results of single rigs are cached in out/random_rigs as long as package, rigs and simulators are the same (with
--resume: always), so that an interrupted run continues.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time
import traceback
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from rich.console import Console

from benchmarks.identification import source_key
from benchmarks.random_rigs_summary import show, summary
from benchmarks.results_file import ROOT, write_results
from benchmarks.rig_score import score_rig
from hframe_gym.atomic_files import write_text
from hframe_gym.identification import identify
from hframe_gym.machine import BUILTIN_MACHINES
from tests.rigs.random_rigs import draw_rig

CACHE = Path("out/random_rigs")
DEVELOPMENT_SEED = 1
FINAL_SEED = 20261124  # run once, for the published results
COUNT = 300
_RIG_SOURCES = ("tests/rigs", "tests/reference_simulator", "tests/euler_simulator")
_SCORE_SOURCES = ("benchmarks/rig_score.py", "benchmarks/scoring.py")
Row = dict[str, Any]


def rig_key() -> str:
    """Return a hash of all sources on which the recordings and their scores depend."""
    text = hashlib.sha256()
    for folder in _RIG_SOURCES:
        for source in sorted((ROOT / folder).glob("*.py")):
            if not source.name.startswith("test_"):
                text.update(source.read_bytes())
    for name in _SCORE_SOURCES:
        text.update((ROOT / name).read_bytes())
    return text.hexdigest()


def run_rig(index: int, *, seed: int, key: str, resume: bool, log: bool = False) -> Row:
    """Record, identify and score a rig, or return its row from the cache if that is valid.

    Args:
        index: Number of the rig in the set.
        seed: Seed of the set.
        key: Hash of the sources.
        resume: Whether to use the cache in spite of changed sources.
        log: Whether to print the progress of the identification.

    Returns:
        The row; with the entry "failed" if identification raised an exception.
    """
    rig = draw_rig(seed, index)
    cached = CACHE / f"{rig.name}.json"
    if cached.is_file():
        old: dict[str, Any] = json.loads(cached.read_text())
        if resume or old["key"] == key:
            row: Row = old["row"]
            return row
    session = rig.record()
    wall, cpu = time.perf_counter(), time.process_time()
    try:
        result = identify(
            session.recordings, BUILTIN_MACHINES["hframe"](), log=partial(print, flush=True) if log else None
        )
        seconds = {"wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu}
        row = score_rig(session, result, seconds)
    except Exception as error:  # an error on one rig must not lose the hours of the others
        return {"rig": rig.name, "truth": rig.describe(), "failed": "".join(traceback.format_exception(error))}
    CACHE.mkdir(parents=True, exist_ok=True)
    write_text(cached, json.dumps({"key": key, "row": row}, indent=1) + "\n")
    return row


def run_rigs(indices: list[int], seed: int, jobs: int, resume: bool, log: bool) -> Iterator[Row]:
    """Yield the rows of some rigs, in order."""
    key = hashlib.sha256((source_key() + rig_key()).encode()).hexdigest()
    run = partial(run_rig, seed=seed, key=key, resume=resume, log=log)
    if jobs < 2:
        yield from map(run, indices)
        return
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        yield from pool.map(run, indices)


def line(row: Row) -> str:
    """Format the row of a rig in one or two lines."""
    if "failed" in row:
        return f"CRASHED {row['rig']} {row['truth']}\n{row['failed']}"
    marks = ("MISSED " if not row["complete"] else "") + ("EXTRA " if row["extra"] else "")
    named = " + ".join(e["label"] for e in row["named"]) or row["verdict"]
    if row["named"] and row["verdict"] != "effect_found":
        named += f" ({row['verdict']})"
    unseen = row["unseen"]
    errors = f"{unseen['before']['mean']:.3g} -> {unseen['after']['mean']:.3g}"
    if unseen["true"]:
        errors += f" (true machine {unseen['true']['mean']:.3g})"
    seconds = f"{row['seconds']['wall']:.0f} s, cpu {row['seconds']['cpu']:.0f} s"
    warnings = "" if row["stable"] else "; UNSTABLE"
    warnings += f"; simulate differs by {row['consistency']:.0%}" if row["consistency"] > 0.05 else ""
    return f"{marks or 'right '}{row['rig']} {row['truth']}\n    -> {named}; unseen {errors}; {seconds}{warnings}"


def main() -> None:
    """Identify the rigs that the command line names, and print and write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=DEVELOPMENT_SEED)
    parser.add_argument("--count", type=int, default=COUNT, help="number of rigs of the set")
    parser.add_argument("--only", type=int, nargs="+", metavar="INDEX", help="only these rigs; nothing is written")
    parser.add_argument("--jobs", type=int, default=1, help="number of parallel processes")
    parser.add_argument("--resume", action="store_true", help="use cached results although the source has changed")
    parser.add_argument("--log", action="store_true", help="print the progress of each identification")
    arguments = parser.parse_args()
    indices = arguments.only or list(range(arguments.count))
    console = Console(width=170)
    rows = []
    for row in run_rigs(indices, arguments.seed, arguments.jobs, arguments.resume, arguments.log):
        console.print(line(row), highlight=False, markup=False, soft_wrap=True)
        rows.append(row)
    done = [row for row in rows if "failed" not in row]
    if done:
        content = summary(done)
        show(console, content)
        if not arguments.only:
            from benchmarks.random_rigs_plots import draw  # matplotlib, which only this needs

            write_results(f"random_rigs_{arguments.seed}", {"summary": content, "rigs": rows}, seed=arguments.seed)
            draw(done, content, arguments.seed)
    if len(done) < len(rows):
        sys.exit(f"identification crashed on {len(rows) - len(done)} of {len(rows)} rigs")


if __name__ == "__main__":
    main()
