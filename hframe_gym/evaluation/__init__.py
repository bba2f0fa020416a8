"""Controllers judged on identical draws: episodes, scores with intervals, pictures."""

from .bound_times import known_bounds
from .controller_factory import make_controller
from .episodes import Episodes
from .metrics import BANDS, scores
from .runner import evaluate, rollout, write_scores
from .scenario import Scenario

__all__ = [
    "BANDS",
    "Episodes",
    "Scenario",
    "evaluate",
    "known_bounds",
    "make_controller",
    "rollout",
    "scores",
    "write_scores",
]
