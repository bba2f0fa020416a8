"""Validation of recordings before identification (`hframe check`)."""

from .checks import check_recordings, recording_warnings
from .excitation import CramerRaoBound, cramer_rao_bounds
from .findings import Finding, print_findings, write_findings

__all__ = [
    "CramerRaoBound",
    "Finding",
    "check_recordings",
    "cramer_rao_bounds",
    "print_findings",
    "recording_warnings",
    "write_findings",
]
