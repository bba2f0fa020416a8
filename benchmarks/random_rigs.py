"""Does identification hold on rigs that were drawn at random? Names, errors, standard deviations, detection, time.

    python -m benchmarks.random_rigs --seed 1 --only 3 17 40 --log      # some rigs of the development set
    python -m benchmarks.random_rigs --seed 1 --count 300 --jobs 2      # all of them
    python -m benchmarks.random_rigs --seed 20271133 --count 30  # the set that is run once, for RESULTS.md
    python -m benchmarks.random_rigs --closed-loop --seed 20271132 --count 40  # the same in closed loop

With --closed-loop, a position controller follows machine programs, and the log has 100 Hz to 1 kHz of its rows; the
unseen runs have all of them, and two of three are in open loop. The results are random_rigs_closed_SEED.json.
Identifications have the default budget of processor time, as those of users have: on a slower computer, the search in a
rig may end earlier. With --repeat, every rig is identified twice, the second time in a new process. Only the first
identification has to compile simulation code; the second one must give the same report.
The rigs come from `tests.rigs.random_rigs` and two independent simulators; `benchmarks.scoring` compares names. Seed 1
is for development. Nothing may be changed after a look at the final seeds, which are run once, for published results.
Results of single rigs are cached in out/random_rigs as long as package, rigs and simulators are the same (with
--resume: always), so that an interrupted run continues. With --ray, the workers of a cluster import `benchmarks` and
`tests` from the checkout in which the command runs, or from their PYTHONPATH.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time
import traceback
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from benchmarks.identification import source_key
from benchmarks.random_rigs_summary import show, summary
from benchmarks.results_file import write_results
from benchmarks.rig_score import score_rig
from hframe_gym.files import write_text
from hframe_gym.identification import IdentificationResult, identify
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.parallel import LOCAL_RAY, map_tasks
from tests.rigs.fresh_process import in_fresh_process
from tests.rigs.random_rigs import RandomSession, draw_rig
from tools.repository import ROOT

CACHE = Path("out/random_rigs")
DEVELOPMENT_SEED = 1
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


def timed_identification(
    session: RandomSession, *, log: bool = False
) -> tuple[IdentificationResult, dict[str, float]]:
    """Identify a rig; return the result and the duration, s, by "wall" and "cpu" (processor time).

    Args:
        session: The recorded rig.
        log: Whether to print the progress.
    """
    wall, cpu = time.perf_counter(), time.process_time()
    machine, print_line = BUILTIN_MACHINES["hframe"](), partial(print, flush=True) if log else None
    result = identify(session.recordings, machine, log=print_line)
    return result, {"wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu}


def repeated_identification(session: RandomSession) -> tuple[Row, dict[str, float]]:
    """Identify a rig; return the report without its duration, and the duration, s, by "wall" and "cpu".

    Args:
        session: The recorded rig.
    """
    result, seconds = timed_identification(session)
    return _without_duration(result), seconds


def _without_duration(result: IdentificationResult) -> Row:
    """Return the report as it is written to report.json, without the time that the identification took."""
    report: Row = json.loads(json.dumps(result.as_json()))
    del report["seconds"]
    return report


def run_rig(index: int, *, seed: int, closed_loop: bool, repeat: bool, log: bool = False) -> Row:
    """Record, identify and score a rig.

    Args:
        index: Number of the rig in the set.
        seed: Seed of the set.
        closed_loop: Whether a position controller drives the rig.
        repeat: Whether to identify it a second time, with simulation code that was compiled before.
        log: Whether to print the progress of the identification.

    Returns:
        The row; with the entry "failed" if identification raised an exception.
    """
    rig = draw_rig(seed, index, closed_loop=closed_loop)
    session = rig.record()
    try:
        result, seconds = timed_identification(session, log=log)
        row = in_fresh_process(score_rig, session, result, seconds)
        if repeat:
            report, row["repeated_seconds"] = in_fresh_process(repeated_identification, session)
            row["repeatable"] = report == _without_duration(result)
        return row
    except Exception as error:  # an error on one rig must not lose the hours of the others
        return {
            "rig": rig.name,
            "truth": rig.describe(),
            "failed": "".join(traceback.format_exception(error)),
        }


def run_rigs(
    indices: list[int],
    seed: int,
    jobs: int,
    ray: str | None,
    resume: bool,
    *,
    closed_loop: bool,
    repeat: bool,
    log: bool,
) -> Iterator[Row]:
    """Yield the rows of some rigs, in order, from the cache where that is valid.

    Args:
        indices: Numbers of the rigs in the set.
        seed: Seed of the set.
        jobs: Number of parallel processes.
        ray: Address of a Ray cluster; None for local processes.
        resume: Whether to use the cache in spite of changed sources.
        closed_loop: Whether position controllers drive the rigs.
        repeat: Whether to identify each rig a second time, with simulation code that was compiled before.
        log: Whether to print the progress of each identification.
    """
    key = hashlib.sha256((source_key() + rig_key() + repeat * "repeated").encode()).hexdigest()
    names = {index: draw_rig(seed, index, closed_loop=closed_loop).name for index in indices}
    files = {index: CACHE / f"{name}.json" for index, name in names.items()}
    stored = {index: json.loads(file.read_text()) for index, file in files.items() if file.is_file()}
    cached = {index: old["row"] for index, old in stored.items() if resume or old["key"] == key}
    missing = [index for index in indices if index not in cached]

    def write(position: int, row: Row) -> None:
        if "failed" not in row:
            CACHE.mkdir(parents=True, exist_ok=True)
            write_text(files[missing[position]], json.dumps({"key": key, "row": row}, indent=1) + "\n")

    run = partial(run_rig, seed=seed, closed_loop=closed_loop, repeat=repeat, log=log)
    computed = map_tasks(run, missing, jobs=jobs, ray=ray, completed=write)
    yield from (cached[index] if index in cached else next(computed) for index in indices)


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
    if "repeated_seconds" in row:
        seconds += f", again {row['repeated_seconds']['cpu']:.0f} s"
    warnings = "" if row["stable"] else "; UNSTABLE"
    warnings += "" if row.get("repeatable", True) else "; ANOTHER REPORT THE SECOND TIME"
    warnings += f"; simulate differs by {row['consistency']:.0%}" if row["consistency"] > 0.05 else ""
    return f"{marks or 'right '}{row['rig']} {row['truth']}\n    -> {named}; unseen {errors}; {seconds}{warnings}"


def main() -> None:
    """Identify the rigs that the command line names, and print and write the results."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=DEVELOPMENT_SEED)
    parser.add_argument("--count", type=int, default=COUNT, help="number of rigs of the set")
    parser.add_argument("--closed-loop", action="store_true", help="rigs that a position controller drives")
    parser.add_argument(
        "--only", type=int, nargs="+", metavar="INDEX", help="only these rigs; nothing is written"
    )
    parser.add_argument("--jobs", type=int, default=1, help="number of parallel processes")
    parser.add_argument(
        "--ray", nargs="?", const=LOCAL_RAY, metavar="ADDRESS", help="run on Ray; default: a local one"
    )
    parser.add_argument(
        "--resume", action="store_true", help="use cached results although the source has changed"
    )
    parser.add_argument(
        "--repeat", action="store_true", help="identify each rig twice: again with compiled code"
    )
    parser.add_argument("--log", action="store_true", help="print the progress of each identification")
    arguments = parser.parse_args()
    indices = arguments.only or list(range(arguments.count))
    console = Console(width=170)
    rows = []
    options = {"closed_loop": arguments.closed_loop, "repeat": arguments.repeat, "log": arguments.log}
    name = f"random_rigs{'_closed' if arguments.closed_loop else ''}_{arguments.seed}"
    for row in run_rigs(indices, arguments.seed, arguments.jobs, arguments.ray, arguments.resume, **options):
        console.print(line(row), highlight=False, markup=False, soft_wrap=True)
        rows.append(row)
    done = [row for row in rows if "failed" not in row]
    if done:
        content = summary(done)
        show(console, content)
        if not arguments.only:
            from benchmarks.random_rigs_plots import draw  # matplotlib, which only this needs

            write_results(name, {"summary": content, "rigs": rows}, seed=arguments.seed)
            draw(done, content, name)
    if len(done) < len(rows):
        sys.exit(f"identification crashed on {len(rows) - len(done)} of {len(rows)} rigs")


if __name__ == "__main__":
    main()
