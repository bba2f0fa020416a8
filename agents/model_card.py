"""Scores of an agent on fixed episodes (rows of its learning curve), and its card: card.json and README.md.

The card records how the agent was trained and how well it performs; README.md is made from card.json.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Array
from ..controllers import Controller
from ..envs import EnvConfig
from ..evaluation import (
    PATH_ERRORS,
    Episodes,
    Scenario,
    rollout,
    settling_in,
    settling_or_none,
    settling_times,
    unit_of_scores,
)
from ..files import write_text
from ..machine import AXIS_UNITS

EVALUATION_EPISODES = 256  # of every row of a learning curve
# Cost of one millimeter of final error in seconds of settling time. Agents that settle in no band differ only
# in their final error; for agents that settle, 0.01 mm costs as little as 0.1 ms, far below the noise of the
# episodes.
SECONDS_PER_MM = 0.01


class AgentScores(NamedTuple):
    """Result of the evaluation of an agent.

    Attributes:
        row: Row of the learning curve: scores by name, such as `success` (fraction, 0 to 1) and
            `final_error_mm`.
        costs: Cost of every episode (settling times and errors), s or mm, shape (B,).
    """

    row: dict[str, float]
    costs: Array


def score_agent(controller: Controller, scenario: Scenario) -> AgentScores:
    """Simulate a controller in a scenario's episodes and compute its scores, one row of a learning curve.

    Returns:
        `costs`: `episode_costs`, shape (B,). `row`: scores by name.
        With a fixed goal (an episode settles in a band if the tool stays within this distance of the goal to
        the end):
            `success`: fraction of episodes that settle in the band that the task defines, 0 to 1.
            `success_BAND`: fraction of episodes that settle, 0 to 1, with BAND 1mm, 0.2mm and 0.05mm; 10mrad,
            2mrad and 0.5mrad for rotary axes, whose errors are in mrad. `settling_s_BAND`: mean settling
            time, s; an episode that does not settle counts with its full length. `final_error_mm`: median
            distance to the goal at the end, mm.
        With a moving goal, means over the episodes:
            `contour_rms_mm`: root mean square distance to the path, mm.
            `tracking_rms_mm`, `tracking_max_mm`: root mean square and largest distance to the moving goal,
            mm.
    """
    episodes = rollout(controller, scenario)
    error = episodes.goal_error  # (episodes, samples)
    if episodes.contour is not None:
        row = _tracking_scores(error, episodes.contour, episodes.unit.small)
    else:
        row = _reaching_scores(error, episodes, scenario.controller_task.band)
    return AgentScores(row, episode_costs(episodes))


def _reaching_scores(error: Array, episodes: Episodes, task_band: float) -> dict[str, float]:
    """Return the scores of a task with a fixed goal from the distance to it, m, shape (episodes, samples)."""
    row = {"success": float(settling_times(error, episodes.time_s, task_band)[1].mean())}
    for name, band in episodes.unit.bands.items():
        times, success = settling_times(error, episodes.time_s, band)
        row |= {f"success_{name}": float(success.mean()), f"settling_s_{name}": float(times.mean())}
    return {**row, f"final_error_{episodes.unit.small}": float(1e3 * np.median(error[:, -1]))}


def _tracking_scores(error: Array, contour: Array, small: str) -> dict[str, float]:
    """Return the scores of a task with a moving goal from tracking and contour errors, m, (episodes, n)."""
    return {
        f"contour_rms_{small}": float(1e3 * np.sqrt(np.mean(contour**2, axis=1)).mean()),
        f"tracking_rms_{small}": float(1e3 * np.sqrt(np.mean(error**2, axis=1)).mean()),
        f"tracking_max_{small}": float(1e3 * error.max(axis=1).mean()),
    }


def episode_costs(episodes: Episodes) -> Array:
    """Compute the cost of every evaluation episode, shape (B,), which compares the agents of a training run.

    With a fixed goal it is the sum of the settling times within 1, 0.2 and 0.05 mm, s, plus 0.01 s per
    millimeter of final error. Along a path it is the sum of the rms contour error and the rms tracking error,
    mm; the contour error alone would be zero for a tool that never leaves its start. Angles count as ways at
    the end of an arm of 0.1 m.
    """
    error, unit = episodes.goal_error, episodes.unit
    if episodes.contour is not None:
        errors = sum(np.sqrt(np.mean(e**2, axis=1)) for e in (episodes.contour, error))
        return np.asarray(1e3 * errors / unit.per_meter)
    settling_s = sum(settling_times(error, episodes.time_s, band)[0] for band in unit.bands.values())
    return np.asarray(settling_s + SECONDS_PER_MM * 1e3 * error[:, -1] / unit.per_meter)


def improves(costs: Array, kept: Array | None) -> bool:
    """Decide whether a new agent replaces the best one so far: whether its mean cost is significantly lower.

    Both agents run in the same B episodes. The mean reduction of the cost per episode must exceed its
    standard error. A large reduction in a single episode alone does not suffice.

    Args:
        costs: Costs of the new agent, one per episode, s or mm, shape (B,), B at least 2.
        kept: Costs of the kept agent in the same episodes, in the same unit, shape (B,). None if there is
            none; the result is then True.
    """
    if kept is None:
        return True
    saved = kept - costs
    return bool(saved.mean() > saved.std(ddof=1) / np.sqrt(len(saved)))


def progress_line(row: Mapping[str, Any]) -> str:
    """Format a row of a learning curve as one line for the terminal.

    Args:
        row: Scores by name, as `score_agent` returns them, with `steps` (environment steps so far) and
            `seconds` (duration of the training so far, s).
    """
    prefix = f"{row['steps']:>9d} steps  {row['seconds']:6.0f} s"
    for small in (unit.small for unit in AXIS_UNITS.values()):
        if f"contour_rms_{small}" in row:
            contour, tracking = row[f"contour_rms_{small}"], row[f"tracking_rms_{small}"]
            return f"{prefix}  contour {contour:.3f} {small} rms  tracking {tracking:.3f} {small} rms"
    unit = unit_of_scores(row)
    fractions = ", ".join(f"{100 * row[f'success_{band}']:.1f} % within {band}" for band in unit.bands)
    bound = unit.bound_band
    mean_s = settling_or_none(row[f"success_{bound}"], row[f"settling_s_{bound}"])
    settling = f"none settles to {bound}" if mean_s is None else f"settles to {bound} in {mean_s:.3f} s"
    return f"{prefix}  {fractions}; {settling}"


def write_card(folder: str | Path, card: Mapping[str, Any]) -> None:
    """Write the card of an agent, on its training and its performance, to card.json and README.md.

    Each file is replaced only when its new version is complete.

    Args:
        folder: Folder of the agent; created if it does not exist.
        card: Content of card.json, see `render_card`.

    Raises:
        ValueError: If a number in the card is not finite.
    """
    write_text(Path(folder) / "card.json", json.dumps(card, indent=1, allow_nan=False) + "\n")
    write_text(Path(folder) / "README.md", render_card(card))


def render_card(card: Mapping[str, Any]) -> str:
    """Format the card of an agent, the record of its training and scores, as a Markdown page.

    Args:
        card: Contents of card.json as `train` returns them: name, task, seed, machine, settings (the recipe),
            package versions and learning curve. Optional: `kept` (training steps of the saved agent),
            `scores`, `failures`.
    """
    last = card["curve"][-1]
    settings = card["settings"]
    randomize = settings["env"].get("randomize", EnvConfig.randomize)
    sections = [
        f"# {card['name']} on {card['task']}, seed {card['seed']}",
        f"Trained by `hframe train {card['name']} --task {card['task']} --seed {card['seed']} "
        f"--steps {last['steps']}` in {last['seconds']:.0f} s ({last['cpu_s']:.0f} s of processor time).",
        f"Machine: `{card['machine']}` (machine.json). Randomization: `{randomize}`. "
        f"Versions: {', '.join(f'{name} {version}' for name, version in card['versions'].items())}.",
    ]
    if "scores" in card:
        sections += ["## Scores", _score_tables(card["scores"]), "## Known failures", _failure_list(card)]
    kept = f" The folder holds the agent after {card['kept']} steps." if "kept" in card else ""
    sections += [
        "## Learning curve",
        f"Scores on {EVALUATION_EPISODES} evaluation episodes that no training run uses.{kept}",
        _curve_table(card["curve"]),
        "## Recipe",
        "```json\n" + json.dumps(settings, indent=1) + "\n```",
    ]
    return "\n\n".join(sections) + "\n"


def _score_tables(scores_by_scenario: Mapping[str, Mapping[str, Any]]) -> str:
    """Format scores: settling times for a fixed goal, errors for a moving one."""
    sections = []
    for name, scores in scores_by_scenario.items():
        sections.append(
            f"`{name}`, {scores['episodes']} episodes of seed {scores['seed']}, none used in training:"
        )
        sections.append(_settling_table(scores) if "settling_s" in scores else _error_table(scores))
    return "\n\n".join(sections)


def _error_table(scores: Mapping[str, Any]) -> str:
    """Format contour and tracking errors, means over the episodes."""
    small = unit_of_scores(scores["success"]).small
    rows = [f"| error, {small} | rms | maximum |", "| --- | ---: | ---: |"]
    for name in PATH_ERRORS:
        score = scores[f"{name}_{small}"]
        rows.append(f"| {name} | {score['rms']['mean']:.3f} | {score['max']['mean']:.3f} |")
    return "\n".join(rows)


def _settling_table(scores: Mapping[str, Any]) -> str:
    """Format success and settling times by band."""
    rows = ["| band | success | mean settling, s | median | 95 % |", "| --- | ---: | ---: | ---: | ---: |"]
    for band in scores["success"]:
        settling_s = settling_in(scores, band)
        times = " | ".join(
            f"{settling_s[key]:.3f}" if settling_s else "-" for key in ("mean", "median", "p95")
        )
        rows.append(f"| {band} | {100 * scores['success'][band]:.1f} % | {times} |")
    return "\n".join(rows)


def _failure_list(card: Mapping[str, Any]) -> str:
    """List how many episodes fail in each band, with the environment seeds of the first ones."""
    lines = []
    for name, failures_by_band in card["failures"].items():
        for band, failures in failures_by_band.items():
            seeds = (
                f", environment seeds {', '.join(map(str, failures['seeds']))}" if failures["seeds"] else ""
            )
            more = ", ..." if failures["episodes"] > len(failures["seeds"]) else ""
            total = card["scores"][name]["episodes"]
            lines.append(f"- `{name}`, {band}: {failures['episodes']} of {total} episodes{seeds}{more}")
    return "\n".join(lines)


def _curve_table(curve: Sequence[Mapping[str, Any]]) -> str:
    """Format the learning curve, one row per evaluation."""
    columns = [key for key in curve[0] if key != "cpu_s"]
    rows = ["| " + " | ".join(columns) + " |", "|" + " ---: |" * len(columns)]
    for row in curve:
        rows.append(
            "| "
            + " | ".join(f"{row[key]:.4g}" if key != "steps" else str(row[key]) for key in columns)
            + " |"
        )
    return "\n".join(rows)
