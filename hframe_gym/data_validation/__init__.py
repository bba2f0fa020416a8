"""Validation of recordings before identification (`hframe check`)."""

from .checks import check_before_fit, check_recordings
from .excitation import CramerRaoBound, cramer_rao_bounds
from .findings import Finding, group_findings, print_findings, refuse_faults, write_findings

__all__ = [
    "CramerRaoBound",
    "Finding",
    "check_before_fit",
    "check_recordings",
    "cramer_rao_bounds",
    "group_findings",
    "print_findings",
    "refuse_faults",
    "write_findings",
]
