"""Controllers of batches of machines, designed from a machine model; independent of Gymnasium.

base                    interface, registry, full-state and output-feedback controllers
control_period          control periods at which a controller can damp the vibrations on the belts
environment_controller  controller on observations as an environment with `normalize` or `flat` returns them
motion_model            machine model for controller design, and the operating points of its linearizations
finite_horizon_control  point-to-point transfers, and tracking of a previewed goal
linear_motion           linear models of different machines, and transfers planned with them and simulated
input_compensation      dead time and static nonlinearities of the drives
model_based_controller  controller that combines the three modules above (`pid`)
adaptive_controller     gain scheduling on estimates of friction, masses and belt stiffness (`adaptive-pid`)
parameter_estimators    estimators that compare measured with simulated states
predictive_controller   model-predictive control with parameters identified in the episode (`predictive`)
predictive_plans        computation and simulation of its plans
textbook_pid            the baseline (`textbook-pid`)
set_point               trajectories streamed to drives that follow a set point (`set-point`)
state_estimator         full state and parameters from sensors
estimation_model        parameters and measurement equation of the state estimator
time_optimal            lower bound of the settling time, also for voltages held over control periods (extra: bound)
casadi_model            equations of motion for this bound (extra: bound)
"""

from ..registry import import_modules
from .adaptive_controller import AdaptiveController, MomentumFilter, scaled_machine
from .base import (
    CONTROLLERS,
    Controller,
    EpisodeStarts,
    Estimator,
    FullStateController,
    OutputFeedbackController,
    UnitCheck,
    check_period,
    suited_controllers,
)
from .control_period import period_concern, shorter_period
from .environment_controller import EnvironmentController
from .estimation_model import ParameterRatios
from .finite_horizon_control import MinimumEnergyTransfers, PreviewGains, PreviewTracker, TransferDesign
from .input_compensation import DeadTime, InputInversion
from .linear_motion import SimulatedTransfers
from .model_based_controller import ModelBasedController
from .motion_model import MotionModel, OperatingPointGrid
from .parameter_estimators import ParameterFilter, ParameterWindow
from .predictive_controller import PredictiveController
from .set_point import SetPointController
from .state_estimator import StateEstimator
from .textbook_pid import TextbookPID

__all__ = [
    "CONTROLLERS",
    "AdaptiveController",
    "Controller",
    "DeadTime",
    "EnvironmentController",
    "EpisodeStarts",
    "Estimator",
    "FullStateController",
    "InputInversion",
    "MinimumEnergyTransfers",
    "ModelBasedController",
    "MomentumFilter",
    "MotionModel",
    "OperatingPointGrid",
    "OutputFeedbackController",
    "ParameterFilter",
    "ParameterRatios",
    "ParameterWindow",
    "PredictiveController",
    "PreviewGains",
    "PreviewTracker",
    "SetPointController",
    "SimulatedTransfers",
    "StateEstimator",
    "TextbookPID",
    "TransferDesign",
    "UnitCheck",
    "check_period",
    "period_concern",
    "scaled_machine",
    "shorter_period",
    "suited_controllers",
]

# A new controller in this folder registers itself. The time-optimal bound needs the extra `bound`.
import_modules(__name__, __path__, skip=("casadi_model", "time_optimal"))
