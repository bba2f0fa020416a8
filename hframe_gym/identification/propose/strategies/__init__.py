"""Strategies that propose effects to the search: found in this folder (`candidates.STRATEGIES`)."""

from ....registry import import_modules

import_modules(__name__, __path__)
