"""Does identification name what is there, and nothing else?  Rigs of the independent simulator, unknown to the fit.

    python -m benchmarks.identification                       # the shipped examples and all rigs (an hour or two)
    python -m benchmarks.identification examples none pairs   # some sets
    python -m benchmarks.identification library-full --only 'cogging@motor1 full' --only ...
    python -m benchmarks.identification plots                 # the overview and the figures from the results

Sets: examples, library-full, library-small, pairs, triples, four-runs, order20, none, outside; all is all but examples.
`tests.rigs.rigs` says what each rig hides and `benchmarks.scoring` what counts as right. Errors are of a free run on
held-out recordings. Answers are kept in out/identification and taken from there while the identification's source is
the same (--resume: whatever they came from), so that a run that was stopped goes on.
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
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

import hframe_gym
from benchmarks.results_file import RESULTS, write_results
from benchmarks.scoring import SCORES, scored
from hframe_gym.atomic_files import write_text
from hframe_gym.identification import identify
from hframe_gym.recordings import load_machine, load_recordings
from tests.rigs.rigs import Case, cases, chosen
from tests.rigs.sessions import DEFAULT_FOLDER, record

ANSWERS = Path("out/identification")
TO_NOISE, WITHIN = 1.1, 0.02  # what is asked of the error after, over the noise, and of parameters
Row = dict[str, Any]


def examples(console: Console) -> None:
    """The shipped recordings: error by channel, before and after."""
    machine = load_machine("hframe")
    results = {}
    for rig in ("rig_a", "rig_b"):
        answer = identify(load_recordings(f"examples/{rig}", machine), machine)
        results[rig] = answer.as_json()
        table = Table(f"{rig}: {answer.verdict}", "declared", "before", "after")
        for channel in machine.output_channels:
            ratios = [results[rig][s]["held_out"][channel]["noise_ratio"] for s in ("declared", "before", "after")]
            table.add_row(channel, *(f"{r:.3g}" for r in ratios))
        found = " + ".join(f.effect.label for f in answer.found)
        console.print(table, f"effects: {found or 'none'}; {answer.seconds:.1f} s")
    write_results("identify_examples", results, seed=None)


def source_key() -> str:
    """Hash of everything in the package that an answer can depend on."""
    folder, text = Path(hframe_gym.__file__).parent, hashlib.sha256()
    for part in ("effects", "files", "identify", "machine"):
        for source in sorted((folder / part).rglob("*.py")):
            text.update(source.read_bytes())
    return text.hexdigest()


def answered(case: Case, folder: str, key: str, resume: bool) -> Row:
    """The row of one rig, from the last answer if that still holds; {"rig", "failed"} where identification crashed."""
    session = record(case, Path(folder))
    kept = ANSWERS / f"{session.folder.name}.json"
    key = hashlib.sha256((key + (session.folder / "session.json").read_text()).encode()).hexdigest()
    if kept.is_file():
        old: dict[str, Any] = json.loads(kept.read_text())
        if resume or old["key"] == key:
            row: Row = old["row"]
            return row
    recordings, machine = session.recordings(), session.machine()
    began = time.process_time()
    try:
        row = scored(session, identify(recordings, machine))
    except Exception as error:  # whatever it is, hours of other rigs must not be lost with it
        return {"rig": case.name, "failed": "".join(traceback.format_exception(error))}
    row["cpu_seconds"] = round(time.process_time() - began, 2)  # of all threads: what other load does not change
    write_text(kept, json.dumps({"key": key, "row": row}, indent=1) + "\n")
    return row


def rows_of(some: list[Case], folder: str, jobs: int, resume: bool) -> Iterator[Row]:
    """The rigs' rows as they come, in order."""
    key = source_key()
    if jobs < 2:
        yield from (answered(case, folder, key, resume) for case in some)
        return
    count = len(some)
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        yield from pool.map(answered, some, [folder] * count, [key] * count, [resume] * count)


def line(row: Row) -> str:
    """One rig on one line, as it is done."""
    if "failed" in row:
        return f"{'CRASHED':12} {row['rig']}\n{row['failed']}"
    named = row["found"] or row["verdict"]
    errors = f"{row['before']:.3g} -> {row['after']:.3g}"
    return f"{row['score']:12} {row['rig']}: {named}; {errors}; {row['seconds']:.0f} s"


def show(console: Console, rows: list[Row]) -> None:
    """Every rig, and the count by set."""
    table = Table("rig", "found", "", "noise ratio", "tool, um", "worst parameter", "s", "cpu s")
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
            f"{s['median'][k]:.3g}" for k in ("before", "after", "um_before", "um_after", "seconds", "cpu_seconds")
        ]
        counts.add_row(group, str(s["rigs"]), *(str(s["scores"][score]) for score in SCORES), *medians)
    console.print(table, counts)


def summary(rows: list[Row]) -> dict[str, Any]:
    """Counts by score, medians over the rigs, and how many keep to what is asked of them."""

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
        "to_noise": sum(r["after"] <= TO_NOISE for r in rows),
        "parameters": {"rigs": len(worst), "within": sum(error <= WITHIN for error in worst)},
        "most_seconds": max(r["seconds"] for r in rows),
    }


def write(rows: list[Row]) -> None:
    """results/identification_SET.json of every set that is complete."""
    known = cases().values()
    for group in dict.fromkeys(r["group"] for r in rows):
        some = [r for r in rows if r["group"] == group]
        if len(some) == sum(case.group == group for case in known):
            name = f"identification_{group.replace('-', '_')}"
            write_results(name, {"summary": summary(some), "rigs": some}, seed=None)


def overview() -> None:
    """results/identification.json, a line for every set, and docs/figures/identification_*.png, from the results."""
    from benchmarks.identification_plots import draw  # matplotlib, which only this needs

    known = dict.fromkeys(case.group for case in cases().values())
    files = {group: RESULTS / f"identification_{group.replace('-', '_')}.json" for group in known}
    rows = {group: json.loads(file.read_text())["rigs"] for group, file in files.items() if file.is_file()}
    write_results("identification", {"sets": {group: summary(some) for group, some in rows.items()}}, seed=None)
    draw([row for some in rows.values() for row in some])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", nargs="*", metavar="SET")
    parser.add_argument("--only", action="append", default=[], metavar="NAME", help="of these sets, only this rig")
    parser.add_argument("--jobs", type=int, default=1, help="rigs at once")
    parser.add_argument("--resume", action="store_true", help="take earlier answers although the source has changed")
    parser.add_argument(
        "--rigs", default=DEFAULT_FOLDER, metavar="DIR", help="recordings (made where they are missing)"
    )
    arguments = parser.parse_args()
    sets = arguments.sets or (["all"] if arguments.only else ["examples", "all"])
    try:
        some = chosen([name for name in sets if name not in ("examples", "plots")])
        if arguments.only:
            only = {case.name for case in chosen(arguments.only)}
            some = [case for case in some if case.name in only]
    except ValueError as error:
        parser.error(str(error))
    console = Console(width=170)
    if "examples" in sets:
        examples(console)
    rows = []
    for row in rows_of(some, arguments.rigs, arguments.jobs, arguments.resume):
        console.print(line(row), highlight=False, markup=False, soft_wrap=True)
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
