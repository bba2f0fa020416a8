"""Re-export until all packages use the new names."""

from .dataset import TypicalScales as TypicalScales
from .dataset import scales_of_motion as references
from .dataset import scales_of_motion as scales_of_motion
