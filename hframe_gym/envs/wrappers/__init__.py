"""Wrappers for single and vector environments: quantities of a step as reward, cost, observation; forces."""

from .disturbance_wrappers import DisturbanceWrapper, VectorDisturbanceWrapper, machine_for_disturbances
from .disturbances import DISTURBANCES, Disturbance
from .quantities import QUANTITIES, Quantity, StepRecord, quantity
from .quantity_wrappers import (
    CostWrapper,
    ObserveQuantities,
    PenaltyWrapper,
    VectorCostWrapper,
    VectorObserveQuantities,
    VectorPenaltyWrapper,
)

__all__ = [
    "DISTURBANCES",
    "QUANTITIES",
    "CostWrapper",
    "Disturbance",
    "DisturbanceWrapper",
    "ObserveQuantities",
    "PenaltyWrapper",
    "Quantity",
    "StepRecord",
    "VectorCostWrapper",
    "VectorDisturbanceWrapper",
    "VectorObserveQuantities",
    "VectorPenaltyWrapper",
    "machine_for_disturbances",
    "quantity",
]
