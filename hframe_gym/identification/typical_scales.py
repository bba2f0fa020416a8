"""Re-export until all packages use the new names."""

from .dataset import TypicalScales, scales_of_motion

references = scales_of_motion

__all__ = ["TypicalScales", "references", "scales_of_motion"]
