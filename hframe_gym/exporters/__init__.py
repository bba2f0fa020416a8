"""Exporters: a machine, a controller or an agent in the files of other tools; one exporter per file here.

base      interface, registry, options, provenance and text for generated files
source/   formulas of a machine, traced from the equations of motion, and the languages in which they are
          written
models/   linear models and modes, input shapers of printers, bodies of MuJoCo

All other modules are exporters: each registers one kind of `hframe export KIND`.
"""

from ..registry import import_modules
from .base import EXPORTERS, Exporter, MachineExporter, argument, option

__all__ = ["EXPORTERS", "Exporter", "MachineExporter", "argument", "option"]

import_modules(__name__, __path__)  # an exporter in this folder registers itself
