"""Evaluation of controllers on identical episodes: scenarios, protocols, scores with intervals, plots, data sets."""

from .controller_creation import CONTROLLER_SOURCES, ControllerFiles, ControllerSource, make_controller
from .episodes import Episodes
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
from .minari_export import ExportedDataset, RandomActions, dataset_controller, export_dataset
from .package_versions import installed_versions, result_versions
from .plots import plot_episode, save_plot
from .protocol_entries import Entry, make_entry, run_protocol
from .protocol_results import (
    Comparison,
    ResultFile,
    checksum,
    compare_draws,
    fill_unsettled,
    paired_ratio,
    protocol_bounds,
    read_result,
    result_content,
    write_result,
)
from .protocols import FIXED_OPTIONS, PROTOCOLS, Protocol, get_protocol
from .reported_scores import (
    PATH_ERRORS,
    ratio_to_bounds,
    settling_in,
    settling_or_none,
    task_name,
    unit_of_scores,
    unknown_bound_reasons,
)
from .runner import Evaluation, evaluate, file_labels, rollout, write_motions, write_scores
from .scenario import EpisodeConditions, Scenario, environments_of, episode_conditions
from .scorecard import write_scorecard
from .timed_controller import TimedController
from .undeclared_effects import EFFECT_FAMILIES, acting_effects, effect_rules, with_absent_effects

__all__ = [
    "BANDS",
    "BOOTSTRAP_RESAMPLES",
    "BOUND_BAND",
    "CONTROLLER_SOURCES",
    "EFFECT_FAMILIES",
    "FIXED_OPTIONS",
    "METRICS",
    "PATH_ERRORS",
    "PROTOCOLS",
    "Comparison",
    "ControllerFiles",
    "ControllerSource",
    "Entry",
    "EpisodeConditions",
    "Episodes",
    "Evaluation",
    "ExportedDataset",
    "Protocol",
    "RandomActions",
    "ResultFile",
    "Scenario",
    "StoredBounds",
    "TimedController",
    "acting_effects",
    "checksum",
    "compare_draws",
    "condition_digests",
    "dataset_controller",
    "effect_rules",
    "environments_of",
    "episode_conditions",
    "evaluate",
    "export_dataset",
    "file_labels",
    "fill_unsettled",
    "get_protocol",
    "installed_versions",
    "make_controller",
    "make_entry",
    "mean_with_interval",
    "paired_ratio",
    "plot_episode",
    "protocol_bounds",
    "ratio_of_means",
    "ratio_to_bounds",
    "read_result",
    "result_content",
    "result_versions",
    "rollout",
    "run_protocol",
    "save_plot",
    "score_episodes",
    "settling_in",
    "settling_or_none",
    "settling_times",
    "stored_bounds",
    "task_name",
    "unit_of_scores",
    "unknown_bound_reasons",
    "with_absent_effects",
    "write_motions",
    "write_result",
    "write_scorecard",
    "write_scores",
]
