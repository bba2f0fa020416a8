"""Identification of a machine from recordings: initial states, fit, selection of effects, evaluation and report."""

from .criteria import SelectionCriteria
from .dataset import MIN_ROWS, Dataset, PreparedRecording, prepare
from .estimation import Fit, fit
from .forward_selection import EffectSearch, SelectedEffect
from .free_parameters import FreeParameter, default_free_parameters
from .held_out import hold_out
from .pipeline import identify
from .recording_simulation import SimulatedRecording, initial_state_of_recording, simulate_recording
from .rest_measurement import InitialState, estimate_initial_state
from .result import IdentificationResult, write_result
from .screening import screen

__all__ = [
    "MIN_ROWS",
    "Dataset",
    "EffectSearch",
    "Fit",
    "FreeParameter",
    "IdentificationResult",
    "InitialState",
    "PreparedRecording",
    "SelectedEffect",
    "SelectionCriteria",
    "SimulatedRecording",
    "default_free_parameters",
    "estimate_initial_state",
    "fit",
    "hold_out",
    "identify",
    "initial_state_of_recording",
    "prepare",
    "screen",
    "simulate_recording",
    "write_result",
]
