"""All runs of a session, prepared for a fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from ..errors import merge_run_warnings
from ..machine import Machine
from ..recordings import Recording
from .criteria import SaturationCriteria
from .dataset import Dataset, prepare
from .sensor_properties import Range
from .usable import usable_run, without_saturated


class Session(NamedTuple):
    """Runs of a session as they can be fitted.

    Attributes:
        usable: The runs without measurements that are not usable, but with those at the end of a sensor's range.
        data: The runs prepared for a fit, without these.
        ranges: Ranges of the sensors that saturate, m or rad, by channel.
    """

    usable: list[Recording]
    data: Dataset
    ranges: dict[str, Range]


def prepare_session(
    recordings: Sequence[Recording],
    machine: Machine,
    criteria: SaturationCriteria,
    log: Callable[[str], object],
) -> Session:
    """Prepare all runs of a session for a fit, and log what is not used.

    Args:
        recordings: Runs as logged (times, s; voltages, V; measurements, m or rad).
        machine: Machine as declared.
        criteria: Thresholds by which a sensor at the end of its range is recognized.
        log: Called with a line of text.
    """
    usable = [usable_run(recording, machine, log).usable for recording in recordings]
    data = prepare(usable, machine)
    inside, ranges = without_saturated(usable, machine, data.noise, criteria)
    if ranges:
        log(f"saturated at the end of the range: {', '.join(ranges)}")
        data = prepare(inside, machine)
    if data.jitter:
        log(f"the clock {data.describe_jitter()}")
    for warning in merge_run_warnings((run.name, w) for run in data.runs for w in run.initial.warnings):
        log(f"warning: {warning}")
    return Session(usable, data, ranges)
