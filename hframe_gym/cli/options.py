"""Options and arguments that several commands have, and their values."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from .. import option_texts
from ..option_texts import MAX_EPISODES

MachineOption = Annotated[str, Option(help=option_texts.MACHINE)]
MachineArgument = Annotated[str, Argument(help=option_texts.MACHINE)]
OutOption = Annotated[Path, Option(help="Folder for the results; created if it does not exist.")]
MaxRowsOption = Annotated[
    int,
    Option(
        "--max-rows",
        min=1000,
        help="Largest number of rows of all runs together. "
        "Of each of N runs, the first max-rows / N rows are used, but at least 20,000.",
    ),
]
TaskOption = Annotated[str, Option(help=option_texts.TASK)]
PathOption = Annotated[
    str | None,
    Option(help="Path to follow, for the task track: circle, square, lissajous or a CSV of x_m,y_m."),
]
RandomizeOption = Annotated[str, Option(help=option_texts.RANDOMIZE)]
EpisodesOption = Annotated[int, Option(min=1, max=MAX_EPISODES, help=option_texts.EPISODES)]
ControllersArgument = Annotated[
    list[str],
    Argument(
        help="Controllers: {controllers}, a shipped agent ({agents}), the folder of a trained agent, "
        "a model of stable-baselines3 (NAME.zip), or module:name."
    ),
]
SensorsOption = Annotated[str, Option(help=option_texts.SENSORS)]
CONTROL_PERIOD = 0.01  # s, as in EnvConfig, which is not imported because it would delay every command
PeriodOption = Annotated[float, Option(help=option_texts.PERIOD)]
RecordingsArgument = Annotated[Path, Argument(help="A folder of recordings, one run per file.")]
RayOption = Annotated[
    str | None,
    Option(
        metavar="[ADDRESS]",
        help="Run on a Ray cluster at HOST:PORT, or auto to find it; "
        "with --ray alone, Ray starts on this machine.",
    ),
]


class RunFormats(StrEnum):
    """File formats of recordings."""

    CSV_GZ = "csv.gz"
    CSV = "csv"
    PARQUET = "parquet"
