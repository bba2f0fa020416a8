"""Does any damaged file make a command fail with more than one line, hang, execute code or fill the memory?

    python -m benchmarks.fuzzing [--count 5000] [--seed 0] [--reader NAME ...] [--save FOLDER]

Every reader of files gets mutations of valid files (tests/bad_inputs/readers.py), each in a new folder, by
the command that reads it. `--reader options` gives valid files and options of any value instead. A case fails
if the command ends with a traceback, more than one line, another exit code than 0 or 2, leaves files although
it refused, executes what a file says, or takes more than 30 s of processor time (or ten minutes on the
clock). `--save` keeps the failing cases. The readers run one after the other, each in its process, whose peak
memory is measured.
"""

from __future__ import annotations

import faulthandler
import multiprocessing
import os
import pickle
import tempfile
import time
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, Phase, given, seed, settings

from benchmarks.results_file import write_results
from tests.bad_inputs.commands import run_command
from tests.bad_inputs.options import command_with_options
from tests.bad_inputs.readers import READERS, WEIGHTS, Case, save_case
from tools.command_line import command_line
from tools.posix import peak_megabytes, require_posix

SUBJECTS = READERS | {"options": command_with_options}
HANG_S = 30.0  # of processor time
MAX_ADDRESS_SPACE = 16 << 30  # bytes, so that a failing case does not take the computer with it


def fuzz_reader(reader: str, count: int, number: int, folder: Path) -> None:
    """Run one reader on mutated files; write the results to `folder`, also after every failure.

    Args:
        reader: Key of `SUBJECTS`.
        count: Number of mutated files.
        number: Seed.
        folder: Folder for result.pkl, and case.pkl with the case that is running.
    """
    import resource

    resource.setrlimit(resource.RLIMIT_AS, (MAX_ADDRESS_SPACE, MAX_ADDRESS_SPACE))
    result: dict[str, Any] = {"cases": 0, "refused": 0, "failures": [], "slowest_cpu_s": 0.0, "peak_MB": 0.0}

    @seed(number)
    @settings(
        max_examples=count,
        deadline=None,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(SUBJECTS[reader]())
    def run(case: Case) -> None:
        (folder / "case.pkl").write_bytes(pickle.dumps(case))
        with tempfile.TemporaryDirectory() as temporary:
            case.write(Path(temporary))
            faulthandler.dump_traceback_later(20 * HANG_S, exit=True)
            start = time.process_time()  # on a computer with other work, the clock says little
            outcome = run_command(case.words, Path(temporary))
            seconds = time.process_time() - start
            faulthandler.cancel_dump_traceback_later()
        problem = outcome.problem or (f"took {seconds:.0f} s" if seconds > HANG_S else "")
        result["cases"] += 1
        result["refused"] += outcome.code == 2
        if result["cases"] > 1:  # the first one compiles
            result["slowest_cpu_s"] = max(result["slowest_cpu_s"], seconds)
        result["peak_MB"] = peak_megabytes()
        if problem:
            result["failures"].append((problem, case))
        (folder / "result.pkl").write_bytes(pickle.dumps(result))

    run()


def summarize(reader: str, count: int, number: int, save: Path | None) -> dict[str, Any]:
    """Run one reader in a new process and return its results.

    Args:
        reader: Key of `SUBJECTS`.
        count: Number of mutated files.
        number: Seed.
        save: Folder for the failing cases, or None.

    Returns:
        Numbers of cases, refused ones, tracebacks and hangs; longest processor time, s, and peak memory, MB.
    """
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        process = multiprocessing.get_context("spawn").Process(
            target=fuzz_reader, args=(reader, count, number, folder)
        )
        process.start()
        process.join()
        result = pickle.loads((folder / "result.pkl").read_bytes())
        if process.exitcode:
            problem = f"process ended with exit code {process.exitcode}"
            result["failures"].append((problem, pickle.loads((folder / "case.pkl").read_bytes())))
    seen: dict[str, int] = {}
    for problem, case in result["failures"]:
        kind = " <- ".join(reversed(problem.strip().splitlines()[-3:]))
        seen[kind] = seen.get(kind, 0) + 1
        if seen[kind] == 1:
            print(f"  {' '.join(case.words)}\n    {kind}", flush=True)
            if save is not None:
                save_case(case, save / f"{reader.replace(' ', '_')}-{len(seen)}")
    if seen:
        print("\n".join(f"  {times:5d} x {kind}" for kind, times in seen.items()))
    failures = result.pop("failures")
    hangs = sum(problem.startswith(("took", "process")) for problem, _ in failures)
    return result | {"failures": len(failures) - hangs, "hangs_or_crashes": hangs}


def main() -> None:
    """Run all readers, print a table and write the results."""
    require_posix("benchmarks.fuzzing")
    parser = command_line(__doc__)
    parser.add_argument("--count", type=int, default=5000, help="mutated files in all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--reader", action="append", choices=[*SUBJECTS], help="only this one; repeat for more"
    )
    parser.add_argument("--save", type=Path, help="folder for the failing cases")
    arguments = parser.parse_args()
    os.environ.setdefault("HFRAME_THREADS", "1")
    readers = arguments.reader or list(READERS)
    total = sum(WEIGHTS.get(reader, 1.0) for reader in readers)
    results = {}
    for reader in readers:
        count = -int(-arguments.count * WEIGHTS.get(reader, 1.0) // total)
        results[reader] = summarize(reader, count, arguments.seed, arguments.save)
        print(f"{reader}: {results[reader]}", flush=True)
    cases, failures, hangs = (
        sum(r[key] for r in results.values()) for key in ("cases", "failures", "hangs_or_crashes")
    )
    print(f"{cases} mutated files: {failures} failures, {hangs} hangs or crashes")
    if arguments.reader is None:
        write_results("fuzzing", {"cases": cases, "readers": results}, seed=arguments.seed)


if __name__ == "__main__":
    main()
