"""Re-export until all packages use the new names."""

from .result import write_result as write_answer
from .result import write_result as write_result

__all__ = ["write_answer", "write_result"]
