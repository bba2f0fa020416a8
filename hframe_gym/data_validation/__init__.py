"""Validation of recordings before identification (`hframe check`)."""

from .checks import check_recordings, recording_warnings
from .findings import Finding, print_findings, write_findings
from .identifiability import CramerRaoBound, cramer_rao_bounds

__all__ = [
    "CramerRaoBound",
    "Finding",
    "check_recordings",
    "cramer_rao_bounds",
    "print_findings",
    "recording_warnings",
    "write_findings",
]

# Aliases until all packages use the new names.
warnings_of = recording_warnings
