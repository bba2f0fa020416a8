"""Controllers of batches of stages, designed from a machine model; independent of Gymnasium.

base                    interface, registry
motion_model            the machine as controllers see it, and the operating points of their gains
minimum_energy          point-to-point transfers
preview_control         tracking of a previewed goal
input_compensation      dead time and static nonlinearities of the drives
model_based_controller  all of these as one controller (`pid`)
momentum_filter         online estimation of friction, masses and belt stiffness
adaptive_controller     gain scheduling on these estimates (`adaptive-pid`)
state_estimator         full state and parameters from sensors
textbook_pid            the baseline (`textbook-pid`)
time_optimal            lower bound of the settling time (extra: bound)
"""

from ..registry import import_modules
from .adaptive_controller import AdaptiveController
from .base import CONTROLLERS, Controller, EpisodeStarts, Estimator, OutputFeedbackController, check_period
from .input_compensation import DeadTime, InputInversion
from .minimum_energy import MinimumEnergyTransfers
from .model_based_controller import ModelBasedController
from .momentum_filter import MomentumFilter
from .motion_model import MotionModel, OperatingPointGrid
from .preview_control import PreviewGains, PreviewTracker
from .state_estimator import StateEstimator
from .textbook_pid import TextbookPID

__all__ = [
    "CONTROLLERS",
    "AdaptiveController",
    "Controller",
    "DeadTime",
    "EpisodeStarts",
    "Estimator",
    "InputInversion",
    "MinimumEnergyTransfers",
    "ModelBasedController",
    "MomentumFilter",
    "MotionModel",
    "OperatingPointGrid",
    "OutputFeedbackController",
    "PreviewGains",
    "PreviewTracker",
    "StateEstimator",
    "TextbookPID",
    "check_period",
]

# A new controller in this folder registers itself. The time-optimal bound needs the extra `bound`.
import_modules(__name__, __path__, skip=("time_optimal",))
