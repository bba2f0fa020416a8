"""Command lines of the scripts in benchmarks/ and tools/: the docstring of the module is the help."""

from __future__ import annotations

import argparse


def command_line(docstring: str | None) -> argparse.ArgumentParser:
    """Return a parser whose help is the docstring of a module, with its line breaks."""
    return argparse.ArgumentParser(
        description=docstring, formatter_class=argparse.RawDescriptionHelpFormatter
    )


def add_rig_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of a benchmark that identifies one rig after the other: `--jobs` and `--log`."""
    parser.add_argument("--jobs", type=int, default=1, help="number of parallel processes")
    parser.add_argument("--log", action="store_true", help="print the progress of each identification")
