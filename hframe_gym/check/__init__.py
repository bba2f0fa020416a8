"""What recordings can tell, and what is odd about them, before anything is fitted."""

from .finding import Finding
from .run import check, warnings_of

__all__ = ["Finding", "check", "warnings_of"]
