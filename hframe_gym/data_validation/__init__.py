"""Validation of recordings before identification (`hframe check`).

Each check returns findings (`Finding`): the severity ("fault", "advice" or "note"), the run, the channel and
a message.
"""

from .checks import check_before_fit, check_recordings
from .current_timing import currents_after_their_voltage
from .findings import Finding, group_findings, print_findings, refuse_faults, write_findings
from .identifiability import CramerRaoBound, cramer_rao_bounds

__all__ = [
    "CramerRaoBound",
    "Finding",
    "check_before_fit",
    "check_recordings",
    "cramer_rao_bounds",
    "currents_after_their_voltage",
    "group_findings",
    "print_findings",
    "refuse_faults",
    "write_findings",
]
