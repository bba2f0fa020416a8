"""From recordings to a corrected machine: load, fit, residual, trace, verdict, report."""

from .answer import Answer
from .data import Data, Run, prepare
from .fit import Fit, Free, fit, own_parameters
from .pipeline import hold_out, identify
from .screening import screen
from .start import start_of
from .trace import Found, trace

__all__ = [
    "Answer",
    "Data",
    "Fit",
    "Found",
    "Free",
    "Run",
    "fit",
    "hold_out",
    "identify",
    "own_parameters",
    "prepare",
    "screen",
    "start_of",
    "trace",
]
