"""Exporters: a machine, a controller or an agent in the files of other tools; one exporter per file of this folder.

base                interface, registry, options, provenance and text for generated files
linear_model        linear model of a machine with its linear effects, modes, and modes with the motors held
uncertainty         standard deviations of quantities that follow from identified parameters
formula_source      source text in C and Structured Text of traced formulas
inverse_dynamics    drive voltages that a motion of the tool needs
motion_formulas     formulas and test vectors of the source for controllers
input_shapers       input shapers of the firmware of printers
mujoco_model        a stage as a model of MuJoCo

All other modules are exporters: each registers one kind of `hframe export KIND`.
"""

from ..registry import import_modules
from .base import EXPORTERS, Exporter, MachineExporter, argument, option

__all__ = ["EXPORTERS", "Exporter", "MachineExporter", "argument", "option"]

import_modules(__name__, __path__)  # an exporter in this folder registers itself
