"""Identification whose duration is measured, and whose progress can be printed with the processor time."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import NamedTuple

from hframe_gym.identification import IdentificationResult, identify
from hframe_gym.machine import Machine
from hframe_gym.recordings import Recording


class TimedResult(NamedTuple):
    """Result of an identification, and its duration, s, by "wall" and "cpu" (processor time)."""

    result: IdentificationResult
    seconds: dict[str, float]


def timed_identification(
    recordings: Sequence[Recording], machine: Machine, *, log: bool = False, held_out: Sequence[str] = ()
) -> TimedResult:
    """Identify a machine.

    Args:
        machine: The machine as declared.
        log: Whether to print the progress.
        held_out: Names of the runs to evaluate on; empty for the default.
    """
    wall, cpu = time.perf_counter(), time.process_time()

    def print_line(line: str) -> None:
        print(f"{time.process_time() - cpu:7.1f} {line}", flush=True)

    result = identify(recordings, machine, held_out=held_out, log=print_line if log else None)
    return TimedResult(result, {"wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu})
