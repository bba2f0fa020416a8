"""python -m benchmarks.real_machines all"""

from __future__ import annotations

import argparse

from rich.console import Console

from benchmarks.real_machines import ced, emps, printers, xl330

STUDIES = {"emps": emps.run, "ced": ced.run, "xl330": xl330.run, "printers": printers.run}


def main() -> None:
    parser = argparse.ArgumentParser(description="Recordings of real machines through the identification loop.")
    parser.add_argument("machine", choices=["all", *STUDIES])
    chosen = parser.parse_args().machine
    console = Console(width=110)
    for name, run in STUDIES.items():
        if chosen in ("all", name):
            console.rule(name)
            run(console)


if __name__ == "__main__":
    main()
