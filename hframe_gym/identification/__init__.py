"""Identify a machine from recordings: initial states, fit, selection of effects, evaluation, report."""

from ..preparation.dataset import MIN_ROWS, Dataset, PreparedRecording
from ..preparation.runs.held_out import hold_out
from ..preparation.session import prepare
from ..preparation.start.measured_state import InitialState, estimate_initial_state
from .evidence.tried_effects import SelectedEffect
from .fit.estimation import Fit, fit
from .identify import identify
from .judge.criteria import SelectionCriteria
from .predict.free_parameters import FreeParameter, default_free_parameters
from .propose.candidates import STRATEGIES, Candidate, SearchState
from .propose.screening import screen
from .report.content.result import IdentificationResult
from .report.content.written_result import write_result
from .search.forward_selection import EffectSearch
from .validate.recording_simulation import SimulatedRecording, simulate_recording

__all__ = [
    "MIN_ROWS",
    "STRATEGIES",
    "Candidate",
    "Dataset",
    "EffectSearch",
    "Fit",
    "FreeParameter",
    "IdentificationResult",
    "InitialState",
    "PreparedRecording",
    "SearchState",
    "SelectedEffect",
    "SelectionCriteria",
    "SimulatedRecording",
    "default_free_parameters",
    "estimate_initial_state",
    "fit",
    "hold_out",
    "identify",
    "prepare",
    "screen",
    "simulate_recording",
    "write_result",
]
