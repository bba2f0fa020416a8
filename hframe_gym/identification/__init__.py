"""Identification of a machine from recordings: initial states, fit, selection of effects, evaluation and report."""

from .criteria import SelectionCriteria
from .dataset import Dataset, PreparedRecording, prepare
from .estimation import Fit, FreeParameter, default_free_parameters, fit
from .forward_selection import SelectedEffect, select_effects
from .initial_state import initial_state_of_recording
from .pipeline import hold_out, identify
from .rest_measurement import InitialState, estimate_initial_state
from .result import IdentificationResult, write_result
from .screening import screen

__all__ = [
    "Dataset",
    "Fit",
    "FreeParameter",
    "IdentificationResult",
    "InitialState",
    "PreparedRecording",
    "SelectedEffect",
    "SelectionCriteria",
    "default_free_parameters",
    "estimate_initial_state",
    "fit",
    "hold_out",
    "identify",
    "initial_state_of_recording",
    "prepare",
    "screen",
    "select_effects",
    "write_result",
]
