"""Re-export the former names of this module until all tests use the new modules."""

from tests.reference_simulator import Rig
from tests.rigs.cases import Case, cases

__all__ = ["Case", "Rig", "cases"]
