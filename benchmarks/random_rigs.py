"""Does identification hold on random rigs? Names, errors, standard deviations, detection, time.

    python -m benchmarks.random_rigs --seed 1 --only 3 17 40 --log      # some rigs of the development set
    python -m benchmarks.random_rigs --seed 1 --count 300 --jobs 2      # all of them
    python -m benchmarks.random_rigs --seed 20271168 --count 30  # the set that is run once, for RESULTS.md
    python -m benchmarks.random_rigs --closed-loop --seed 20271167 --count 60  # the same in closed loop

With --closed-loop, a position controller follows machine programs, and the log has 100 Hz to 1 kHz of its
rows; the unseen runs have all of them, and two of three are in open loop. The results are
random_rigs_closed_SEED.json. Identifications have the default budget of processor time, as those of users
have: on a slower computer, the search in a rig may end earlier. With --repeat, every rig is identified twice,
the second time in a new process. Only the first identification has to compile simulation code; the second one
must give the same report. The rigs come from `tests.rigs.random_rigs` and two independent simulators;
`benchmarks.scoring` compares names. Seed 1 is for development. Nothing may be changed after a look at the
final seeds, which are run once, for published results. Results of single rigs are cached in out/random_rigs
as long as package, rigs and simulators are the same (with --resume: always), so that an interrupted run
continues. With --ray, the workers of a cluster import `benchmarks` and `tests` from the checkout in which the
command runs, or from their PYTHONPATH.
"""

from __future__ import annotations

import json
import sys
import traceback
from functools import partial
from pathlib import Path

from rich.console import Console

from benchmarks.random_rigs_summary import show, summary
from benchmarks.results_file import write_results
from benchmarks.rig_score import score_rig
from benchmarks.row_cache import Row, RowCache, source_key
from benchmarks.timed_identification import TimedResult, timed_identification
from hframe_gym.identification import IdentificationResult
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.parallel import LOCAL_RAY
from tests.rigs.fresh_process import in_fresh_process
from tests.rigs.random_rigs import RandomSession, draw_rig
from tools.command_line import command_line

CACHE = Path("out/random_rigs")
DEVELOPMENT_SEED = 1
COUNT = 300
# What recordings and scores depend on.
RIG_SOURCES = (
    *("tests/rigs", "tests/reference_simulator", "tests/euler_simulator"),
    *("benchmarks/rig_score.py", "benchmarks/scoring.py"),
)


def repeated_identification(session: RandomSession) -> tuple[Row, dict[str, float]]:
    """Identify a rig; return the report without its duration, and the duration, s, by "wall" and "cpu"."""
    result, seconds = _identified(session)
    return _without_duration(result), seconds


def _identified(session: RandomSession, *, log: bool = False) -> TimedResult:
    """Identify a rig."""
    return timed_identification(session.recordings, BUILTIN_MACHINES["hframe"](), log=log)


def _without_duration(result: IdentificationResult) -> Row:
    """Return the report as it is written to report.json, without the time that the identification took."""
    report: Row = json.loads(json.dumps(result.as_json()))
    del report["seconds"]
    return report


def run_rig(index: int, *, seed: int, closed_loop: bool, repeat: bool, log: bool = False) -> Row:
    """Record, identify and score a rig.

    Args:
        index: Number of the rig in the set.
        closed_loop: Whether a position controller drives the rig.
        repeat: Whether to identify it a second time, with simulation code that was compiled before.
        log: Whether to print the progress of the identification.

    Returns:
        The row; with the entry "failed" if identification raised an exception.
    """
    rig = draw_rig(seed, index, closed_loop=closed_loop)
    session = rig.record()
    try:
        result, seconds = _identified(session, log=log)
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
    return (
        f"{marks or 'right '}{row['rig']} {row['truth']}\n"
        f"    -> {named}; unseen {errors}; {seconds}{warnings}"
    )


def main() -> None:
    """Identify the rigs that the command line names, and print and write the results."""
    parser = command_line(__doc__)
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
    options = {"seed": arguments.seed, "closed_loop": arguments.closed_loop}
    rigs = {draw_rig(index=index, **options).name: index for index in indices}
    cache = RowCache(CACHE, source_key(*RIG_SOURCES) + arguments.repeat * " repeated", arguments.resume)
    run = partial(run_rig, **options, repeat=arguments.repeat, log=arguments.log)
    for row in cache.complete(run, rigs, jobs=arguments.jobs, ray=arguments.ray):
        print(line(row), flush=True)
        rows.append(row)
    done = [row for row in rows if "failed" not in row]
    if done:
        name = f"random_rigs{'_closed' if arguments.closed_loop else ''}_{arguments.seed}"
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
