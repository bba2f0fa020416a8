"""Controllers of batches of machines, designed from a machine model; independent of Gymnasium.

One file for each control law, and rooms for what they share:

base                    interface, registry, full-state and output-feedback controllers
environment_controller  controller on observations as an environment with `normalize` or `flat` returns them
policy_controller       function of observations, such as a policy of any library, as a controller
control_period          control periods at which a controller can damp the vibrations on the belts

textbook_pid            the baseline (`textbook-pid`)
model_based_controller  finite-horizon feedback with feedforward and disturbance observer (`pid`)
adaptive_controller     gain scheduling on estimates of friction, masses and belt stiffness (`adaptive-pid`)
predictive_controller   model-predictive control with parameters identified in the episode (`predictive`)
set_point               trajectories streamed to drives that follow a set point (`set-point`)

models/                 motion of a machine, linear models of different machines, drives; CasADi (extra:
                        bound)
planning/               point-to-point transfers, previewed goals, predictive plans; shortest times (extra:
                        bound)
estimation/             state and parameters from sensors; parameters from measured against simulated states
"""

from ..registry import import_modules
from .adaptive_controller import AdaptiveController, scaled_machine
from .base import CONTROLLERS, Controller, EpisodeStarts, FullStateController, suited_controllers
from .control_period import check_period, period_concern, shorter_period
from .environment_controller import EnvironmentController
from .estimation.encoder_drift import encoders_drift
from .estimation.estimation_model import ParameterRatios
from .estimation.momentum_filter import MomentumFilter
from .estimation.parameter_estimators import ParameterFilter, ParameterWindow
from .estimation.state_estimator import StateEstimator
from .model_based_controller import ModelBasedController
from .models.input_compensation import DeadTime, InputInversion
from .models.motion_model import MotionModel, OperatingPointGrid
from .observation_checks import UnitCheck
from .output_feedback import Estimator, OutputFeedbackController
from .planning.finite_horizon_control import (
    MinimumEnergyTransfers,
    PreviewGains,
    PreviewTracker,
    TransferDesign,
)
from .planning.simulated_transfers import SimulatedTransfers
from .policy_controller import Policy, PolicyController
from .predictive_controller import PredictiveController
from .set_point import SetPointController
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
    "Policy",
    "PolicyController",
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
    "encoders_drift",
    "period_concern",
    "scaled_machine",
    "shorter_period",
    "suited_controllers",
]

import_modules(__name__, __path__)  # a new controller in this folder registers itself
