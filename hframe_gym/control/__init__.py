"""Controllers built from a machine's tables: a model-based PID and a textbook one.  Batches of stages, no gym."""

from .controller import CONTROLLERS, Controller
from .model import MotionModel
from .pid import ModelPID
from .textbook_pid import TextbookPID
from .trajectory import Transfers

__all__ = ["CONTROLLERS", "Controller", "ModelPID", "MotionModel", "TextbookPID", "Transfers"]
