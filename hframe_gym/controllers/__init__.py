"""Controllers built from a machine's tables, for batches of stages; no gym.

model.py, places.py    the machine as controllers see it; where in the workspace gains are worked out
trajectory.py          transfers to rest         tracking.py    plans along a path
pid.py                 both as one controller    delay.py       dead time
amplifiers.py          dead bands and offsets of the drives, undone
observer.py            the full state from encoders and lasers, and how far the stage is off its machine file
unknowns.py            what is learnt of a stage      divided_differences.py    a normal distribution through kinks
adaptive_pid.py        the PID that learns the stage as it goes      momentum_filter.py    how it does
textbook_pid.py        the baseline
bound.py, equations.py the least possible times (extra: bound)
"""

from .adaptive_pid import AdaptivePID
from .base import CONTROLLERS, Controller
from .minimum_energy import MinimumEnergyTransfers
from .model_pid import ModelBasedController
from .motion_model import MotionModel
from .state_estimator import Channel, OutputFeedbackController, StateEstimator
from .textbook_pid import TextbookPID

__all__ = [
    "CONTROLLERS",
    "AdaptivePID",
    "Channel",
    "Controller",
    "MinimumEnergyTransfers",
    "ModelBasedController",
    "MotionModel",
    "OutputFeedbackController",
    "StateEstimator",
    "TextbookPID",
]
