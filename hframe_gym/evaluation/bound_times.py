"""Alias of the functions on bounds until all packages use their new places."""

from .metrics import BOUNDS_FILE as FILE
from .metrics import condition_digests as digests
from .metrics import known_bounds
from .scenario import EpisodeConditions as EpisodeDraws
from .scenario import episode_conditions as drawn

__all__ = ["FILE", "EpisodeDraws", "digests", "drawn", "known_bounds"]
