"""Evaluation of controllers on identical episodes: scenarios, scores with confidence intervals, plots, data sets."""

from .metrics import (
    BANDS,
    BOOTSTRAP_RESAMPLES,
    BOUND_BAND,
    METRICS,
    StoredBounds,
    condition_digests,
    mean_with_interval,
    ratio_of_means,
    score_episodes,
    settling_times,
    stored_bounds,
)
from .minari_export import ExportedDataset, export_dataset
from .plots import plot_episode, save_plot
from .runner import Evaluation, evaluate, rollout, write_scores
from .scenario import (
    CONTROLLER_SOURCES,
    ControllerSource,
    EpisodeConditions,
    Episodes,
    Scenario,
    episode_conditions,
    make_controller,
    period_concern,
)
from .scorecard import write_scorecard

__all__ = [
    "BANDS",
    "BOOTSTRAP_RESAMPLES",
    "BOUND_BAND",
    "CONTROLLER_SOURCES",
    "METRICS",
    "ControllerSource",
    "EpisodeConditions",
    "Episodes",
    "Evaluation",
    "ExportedDataset",
    "Scenario",
    "StoredBounds",
    "condition_digests",
    "episode_conditions",
    "evaluate",
    "export_dataset",
    "make_controller",
    "mean_with_interval",
    "period_concern",
    "plot_episode",
    "ratio_of_means",
    "rollout",
    "save_plot",
    "score_episodes",
    "settling_times",
    "stored_bounds",
    "write_scorecard",
    "write_scores",
]
