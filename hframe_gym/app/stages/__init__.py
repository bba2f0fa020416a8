"""Stages of the work, one module each; `STAGES` has their order."""

from ..page import Stage
from .check import CheckStage
from .control import ControlStage
from .export import ExportStage
from .identify import IdentifyStage
from .logs import LogsStage
from .machine import MachineStage
from .results import ResultsStage

STAGES: tuple[type[Stage], ...] = (
    MachineStage,
    LogsStage,
    CheckStage,
    IdentifyStage,
    ResultsStage,
    ControlStage,
    ExportStage,
)
