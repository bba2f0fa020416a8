"""Run groups of faults and write their rows: python -m benchmarks.faults [GROUP ...]."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from pathlib import Path

from benchmarks.faults import determinism, disks, kills, load
from benchmarks.faults.commands import Row, Stage
from benchmarks.results_file import write_results
from tools.command_line import command_line
from tools.posix import require_posix
from tools.repository import RESULTS

Log = Callable[[str], None]
STAGED: dict[str, Callable[[Stage, Log], list[Row]]] = {
    "kills": kills.kills,
    "signals": kills.signals,
    "collisions": kills.collisions,
    "disks": disks.disks,
}
OTHERS: dict[str, Callable[[Log], list[Row]]] = {
    "determinism": determinism.determinism,
    "load": load.load,
    "large": load.large_data,
}


def save(group: str, rows: list[Row]) -> None:
    """Replace the rows of a group in results/faults.json."""
    path = RESULTS / "faults.json"
    groups = json.loads(path.read_text("utf-8"))["groups"] if path.is_file() else {}
    write_results("faults", {"groups": {**groups, group: rows}}, seed=kills.SEED)


def main() -> None:
    """Run the groups that the command line names; by default all but `large`."""
    require_posix("benchmarks.faults")
    parser = command_line(__doc__)
    names = [*STAGED, *OTHERS]
    parser.add_argument("groups", nargs="*", metavar="GROUP", help=f"any of {', '.join(names)}")
    groups = parser.parse_args().groups or [name for name in names if name != "large"]
    if unknown := [name for name in groups if name not in names]:
        parser.error(f"unknown group {', '.join(unknown)}; choose from {', '.join(names)}")

    def log(line: str) -> None:
        print(line, flush=True)

    with tempfile.TemporaryDirectory(prefix="hframe-faults-") as temporary:
        stage = Stage(Path(temporary), log) if any(name in STAGED for name in groups) else None
        for name in groups:
            if name in STAGED and stage is not None:
                save(name, STAGED[name](stage, log))
            else:
                save(name, OTHERS[name](log))


if __name__ == "__main__":
    main()
