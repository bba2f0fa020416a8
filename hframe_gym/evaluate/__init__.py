"""Controllers judged on identical draws: episodes, scores with intervals, pictures."""

from .bounds import known_bounds
from .contenders import contender
from .episodes import Episodes
from .run import evaluate, rollout, write_scores
from .scorecard import BANDS, scores
from .trial import Trial

__all__ = ["BANDS", "Episodes", "Trial", "contender", "evaluate", "known_bounds", "rollout", "scores", "write_scores"]
