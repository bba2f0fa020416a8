"""Controllers judged on identical draws: episodes, scores with intervals, pictures."""

from .run import Episodes, evaluate, rollout, write_scores
from .scorecard import BANDS, scores

__all__ = ["BANDS", "Episodes", "evaluate", "rollout", "scores", "write_scores"]
