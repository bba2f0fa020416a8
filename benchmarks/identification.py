"""Does identification name a rig's hidden effects, and nothing else? On rigs of the independent simulator.

    python -m benchmarks.identification                       # the shipped examples and all rigs: 1 to 2 h
    python -m benchmarks.identification examples none pairs   # some sets
    python -m benchmarks.identification library-full --only 'cogging@motor1 full' --only ...
    python -m benchmarks.identification plots                 # the overview and the figures from the results

Sets: examples, library-full, library-small, pairs, triples, four-runs, order20, none, outside; all: all but
examples. `tests.rigs.cases` lists what each rig hides (its seed is its name) and `benchmarks.scoring` defines
the scores. Errors are those of open-loop simulations of held-out recordings. Results are cached in
out/identification as long as the package's source is the same (with --resume: always), so that an interrupted
run continues. Versions are in the results.
"""

from __future__ import annotations

import hashlib
import json
import math
import sys
import time
import traceback
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.results_file import write_results
from benchmarks.row_cache import Row, RowCache, source_key
from benchmarks.scoring import SCORES, score_session
from hframe_gym.identification import identify
from hframe_gym.parallel import map_tasks
from hframe_gym.recordings import load_machine, load_recordings
from tests.rigs.cases import Case, cases, select_cases
from tests.rigs.recording_sessions import DEFAULT_FOLDER, record
from tools.command_line import command_line
from tools.repository import RESULTS

CACHE = Path("out/identification")
MAX_NOISE_RATIO = 1.1  # required error with the effects, in multiples of the sensor noise
MAX_PARAMETER_ERROR = 0.02  # required relative error of the effects' parameters


def examples(console: Console) -> None:
    """Identify the shipped recordings, and print and write the errors by channel."""
    machine = load_machine("hframe")
    results = {}
    for rig in ("rig_a", "rig_b"):
        result = identify(load_recordings(f"examples/{rig}", machine), machine)
        results[rig] = result.as_json()
        table = Table(f"{rig}: {result.verdict}", "declared", "before", "after")
        for channel in machine.output_channels:
            ratios = [
                results[rig][s]["held_out"][channel]["noise_ratio"] for s in ("declared", "before", "after")
            ]
            table.add_row(channel, *(f"{r:.3g}" for r in ratios))
        effects = " + ".join(f.effect.label for f in result.effects)
        console.print(table, f"effects: {effects or 'none'}; {result.seconds:.1f} s")
    write_results("identify_examples", results, seed=None)


def identify_case(case: Case, folder: str, key: str, resume: bool) -> Row:
    """Return the row of one rig, from the cache if it is valid.

    Args:
        folder: Folder of the recorded sessions.
        key: Hash of the sources.
        resume: Whether to use the cache in spite of changed sources.

    Returns:
        The row; {"rig", "failed"} if identification raised an exception.
    """
    session = record(case, Path(folder))
    of_session = hashlib.sha256((key + (session.folder / "session.json").read_text()).encode())
    cache, name = RowCache(CACHE, of_session.hexdigest(), resume), session.folder.name
    if (kept := cache.row(name)) is not None:
        return kept
    recordings, machine = session.recordings(), session.machine()
    began = time.process_time()
    try:
        row = score_session(session, identify(recordings, machine, budget=math.inf))
    except Exception as error:  # an error on one rig must not lose the hours of the others
        return {"rig": case.name, "failed": "".join(traceback.format_exception(error))}
    # of all threads; other load does not change it
    row["cpu_seconds"] = round(time.process_time() - began, 2)
    cache.keep(name, row)
    return row


def line(row: Row) -> str:
    """Format the row of a rig in one line."""
    if "failed" in row:
        return f"{'CRASHED':12} {row['rig']}\n{row['failed']}"
    named = row["found"] or row["verdict"]
    errors = f"{row['before']:.3g} -> {row['after']:.3g}"
    return f"{row['score']:12} {row['rig']}: {named}; {errors}; {row['seconds']:.0f} s"


def show(console: Console, rows: list[Row]) -> None:
    """Print a table of all rigs and one of all sets."""
    table = Table("rig", "identified", "", "noise ratio", "tool, um", "largest parameter error", "s", "cpu s")
    for r in rows:
        worst = max(r["parameter_error"].values(), default=None)
        table.add_row(
            r["rig"],
            r["found"] or r["verdict"],
            r["score"],
            f"{r['before']:.3g} -> {r['after']:.3g}",
            f"{r['truth_um']['before']:.3g} -> {r['truth_um']['after']:.3g}",
            "" if worst is None else f"{100 * worst:.2g} %",
            f"{r['seconds']:.0f}",
            f"{r['cpu_seconds']:.0f}",
        )
    counts = Table("set", "rigs", *SCORES, "before", "after", "um before", "um after", "s", "cpu s")
    for group in dict.fromkeys(r["group"] for r in rows):
        s = summary([r for r in rows if r["group"] == group])
        medians = [
            f"{s['median'][k]:.3g}"
            for k in ("before", "after", "um_before", "um_after", "seconds", "cpu_seconds")
        ]
        counts.add_row(group, str(s["rigs"]), *(str(s["scores"][score]) for score in SCORES), *medians)
    console.print(table, counts)


def summary(rows: list[Row]) -> dict[str, Any]:
    """Summarize rows: counts by score, medians, and the number of rigs that meet the requirements."""

    def median(values: list[float]) -> float:
        return float(np.median(values))

    worst = [max(r["parameter_error"].values()) for r in rows if r["parameter_error"]]

    return {
        "rigs": len(rows),
        "scores": {score: sum(r["score"] == score for r in rows) for score in SCORES},
        "median": {
            "before": median([r["before"] for r in rows]),
            "after": median([r["after"] for r in rows]),
            "um_before": median([r["truth_um"]["before"] for r in rows]),
            "um_after": median([r["truth_um"]["after"] for r in rows]),
            "seconds": median([r["seconds"] for r in rows]),
            "cpu_seconds": median([r["cpu_seconds"] for r in rows]),
        },
        "named_not_there": sum(r["score"] in ("extra", "wrong", "false alarm") for r in rows),
        "to_noise": sum(r["after"] <= MAX_NOISE_RATIO for r in rows),
        "parameters": {"rigs": len(worst), "within": sum(error <= MAX_PARAMETER_ERROR for error in worst)},
        "most_seconds": max(r["seconds"] for r in rows),
    }


def write(rows: list[Row]) -> None:
    """Write results/identification_SET.json for every complete set."""
    every_case = cases().values()
    for group in dict.fromkeys(r["group"] for r in rows):
        of_group = [r for r in rows if r["group"] == group]
        if len(of_group) == sum(case.group == group for case in every_case):
            name = f"identification_{group.replace('-', '_')}"
            write_results(name, {"summary": summary(of_group), "rigs": of_group}, seed=None)


def overview() -> None:
    """Write results/identification.json and docs/figures/identification_*.png from all sets' results."""
    from benchmarks.identification_plots import draw  # matplotlib, which only this needs

    groups = dict.fromkeys(case.group for case in cases().values())
    files = {group: RESULTS / f"identification_{group.replace('-', '_')}.json" for group in groups}
    rows = {group: json.loads(file.read_text())["rigs"] for group, file in files.items() if file.is_file()}
    write_results(
        "identification", {"sets": {group: summary(of_group) for group, of_group in rows.items()}}, seed=None
    )
    draw([row for of_group in rows.values() for row in of_group])


def main() -> None:
    """Identify the rigs that the command line names, and print and write the results."""
    parser = command_line(__doc__)
    parser.add_argument("sets", nargs="*", metavar="SET")
    parser.add_argument(
        "--only", action="append", default=[], metavar="NAME", help="only this rig of the sets"
    )
    parser.add_argument("--jobs", type=int, default=1, help="number of parallel processes")
    parser.add_argument(
        "--resume", action="store_true", help="use cached results although the source has changed"
    )
    parser.add_argument(
        "--rigs", default=DEFAULT_FOLDER, metavar="DIR", help="folder of the recordings (recorded if missing)"
    )
    arguments = parser.parse_args()
    sets = arguments.sets or (["all"] if arguments.only else ["examples", "all"])
    try:
        selection = select_cases([name for name in sets if name not in ("examples", "plots")])
        if arguments.only:
            only = {case.name for case in select_cases(arguments.only)}
            selection = [case for case in selection if case.name in only]
    except ValueError as error:
        parser.error(str(error))
    console = Console(width=170)
    if "examples" in sets:
        examples(console)
    rows = []
    identify_one = partial(identify_case, folder=arguments.rigs, key=source_key(), resume=arguments.resume)
    for row in map_tasks(identify_one, selection, jobs=arguments.jobs):
        print(line(row), flush=True)
        rows.append(row)
    done = [row for row in rows if "failed" not in row]
    if done:
        show(console, done)
        write(done)
    if "plots" in sets or (done and not arguments.only):
        overview()
    if len(done) < len(rows):
        sys.exit(f"identification crashed on {len(rows) - len(done)} of {len(rows)} rigs")


if __name__ == "__main__":
    main()
