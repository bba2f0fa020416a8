"""The command import: logs of controllers and data loggers become recordings."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from ..errors import InputError
from .app import MachineOption, app, log
from .support import reading_progress


class RunFormats(StrEnum):
    """File formats of recordings."""

    CSV_GZ = "csv.gz"
    CSV = "csv"
    PARQUET = "parquet"


@app.command("import")
def import_logs(
    logs: Annotated[Path, typer.Argument(help="A log, or a folder of logs: text, MATLAB .mat or Parquet.")],
    out: Annotated[Path, typer.Option(help="Folder for the recordings; existing runs are never replaced.")],
    machine: MachineOption = "hframe",
    map: Annotated[
        list[str] | None, typer.Option(help="CHANNEL=COLUMN, e.g. v1_V=U1, x_m='#4' (fourth column) or y_m=none.")
    ] = None,
    unit: Annotated[list[str] | None, typer.Option(help="CHANNEL=UNIT, e.g. phi1_rad=deg, v1_V=%, time_s=ms.")] = None,
    scale: Annotated[list[str] | None, typer.Option(help="CHANNEL=FACTOR to the channel's unit, e.g. x_m=0.001.")] = None,
    mapping: Annotated[
        Path | None, typer.Option(help="TOML or JSON file with the tables map, unit and scale; options override it.")
    ] = None,
    split_at_rests: Annotated[
        bool, typer.Option("--split-at-rests", help="Cut each log into runs where the machine rests.")
    ] = False,
    min_rest: Annotated[float, typer.Option(min=0.01, help="Shortest rest at which a log is cut, s.")] = 0.5,
    format: Annotated[RunFormats, typer.Option(help="Format of the recordings.")] = RunFormats.CSV_GZ,
) -> None:
    """Convert logs to recordings: any separator, decimal mark and encoding, other names and units, several rates.

    Columns are assigned by --map, or if their name without unit is that of a channel ("X [mm]" for x_m); nothing else
    is guessed. Everything that is converted, assumed or left out is printed. docs/import.md lists what is handled.

    Example:  hframe import log.txt --map v1_V=U1 --map v2_V=U2 --unit phi1_rad=deg --out runs --split-at-rests
    """
    from ..recordings import ImportSettings, MappingOptions, load_machine, parse_factor, read_mapping_file
    from ..recordings import import_logs as run_import

    from_file = read_mapping_file(mapping) if mapping is not None else MappingOptions()
    scales = {channel: parse_factor(f"--scale {channel}={value}", value) for channel, value in _pairs("scale", scale)}
    options = MappingOptions(
        {**from_file.columns, **dict(_pairs("map", map))},
        {**from_file.units, **dict(_pairs("unit", unit))},
        {**from_file.scales, **scales},
    )
    declared = load_machine(machine)
    settings = ImportSettings(options, split_at_rests, min_rest, format.value)
    with reading_progress("reading") as progress:
        files = run_import(logs, out, declared, settings, log, progress)
    log(f"wrote {len(files)} run{'s' if len(files) > 1 else ''} to {out}. Next: hframe check {out} --machine {machine}")


def _pairs(option: str, values: Sequence[str] | None) -> list[tuple[str, str]]:
    """Split the values CHANNEL=VALUE of a repeated option."""
    pairs = []
    for text in values or ():
        channel, sign, value = text.partition("=")
        if not sign or not channel.strip():
            raise InputError(f"--{option} {text}: must be CHANNEL={'COLUMN' if option == 'map' else option.upper()}")
        pairs.append((channel.strip(), value.strip()))
    return pairs
