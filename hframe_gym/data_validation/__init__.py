"""What recordings can tell, and what is odd about them, before anything is fitted."""

from .checks import check_recordings, warnings_of
from .findings import Finding

__all__ = [
    "Finding",
    "check_recordings",
    "warnings_of",
]
