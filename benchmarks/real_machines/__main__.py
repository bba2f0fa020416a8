"""Recordings of real machines through the identification loop.

python -m benchmarks.real_machines all
"""

from __future__ import annotations

from rich.console import Console

from benchmarks.real_machines import ced, emps, printers, xl330
from tools.command_line import command_line

STUDIES = {"emps": emps.run, "ced": ced.run, "xl330": xl330.run, "printers": printers.run}


def main() -> None:
    """Run the study that the command line names, or all of them."""
    parser = command_line(__doc__)
    parser.add_argument("machine", choices=["all", *STUDIES])
    machine = parser.parse_args().machine
    console = Console(width=110)
    for name, run in STUDIES.items():
        if machine in ("all", name):
            console.rule(name)
            run(console)


if __name__ == "__main__":
    main()
