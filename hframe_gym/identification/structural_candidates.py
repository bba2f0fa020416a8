"""Former place of structural screening, until all packages use `screening`."""

from .screening import has_no_small_version as replaces
from .screening import screen_structures as structural

__all__ = ["replaces", "structural"]
