"""From recordings to a corrected machine: load, fit, residual, trace, verdict, report."""

from .dataset import Dataset, PreparedRecording, prepare
from .estimation import Fit, FreeParameter, default_free_parameters, fit
from .forward_selection import SelectedEffect, trace
from .initial_state import estimate_initial_state
from .pipeline import hold_out, identify
from .result import IdentificationResult
from .screening import screen

__all__ = [
    "Dataset",
    "Fit",
    "FreeParameter",
    "IdentificationResult",
    "PreparedRecording",
    "SelectedEffect",
    "default_free_parameters",
    "estimate_initial_state",
    "fit",
    "hold_out",
    "identify",
    "prepare",
    "screen",
    "trace",
]
