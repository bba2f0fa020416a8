"""Sentences for the scorecard: the assumptions of an evaluation, and the next steps."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from typing import Any

from ..envs import ACTUATOR_PRESETS, RANDOMIZATION_PRESETS, SENSOR_PRESETS
from ..operating_system import quoted
from ..web_page import NextStep, number
from .episodes import Command, Episodes
from .metrics import ranked_episodes
from .reported_scores import ratio_to_bounds, task_name
from .scenario import Scenario

_SENSORS = {
    "state": "exact positions and velocities, without noise, rounding or delay, which no sensor measures",
    "rig": "encoders at the motors and lasers on the tool's axes, with noise, rounding and limited range",
    "machine": "the sensors of the machine file, with their noise and resolution",
}
_DRIVES = {
    "ideal": "{0}s act at once, without rounding; only the rated {0} limits them",
    "rig": "12-bit converters, and amplifiers that limit the current to 12 A",
    "machine": "as the machine file declares them",
}
_MACHINES = {
    "none": "the parameters of the machine file in every episode",
    "default": "masses, friction, belts and motors vary from episode to episode",
    "wide": "masses, friction, belts and motors vary much from episode to episode",
    "identified": "parameters vary as far as the recordings leave them uncertain",
}
# Of a scenario, as of the options of `hframe evaluate`.
_DEFAULTS = {field.name: field.default for field in dataclasses.fields(Scenario)}
# Ratio to the shortest possible time above which another controller may be clearly faster.
_CLEAR_GAIN = 1.15


def assumptions(scores: Mapping[str, Any]) -> dict[str, str]:
    """Describe the assumptions of an evaluation, for example what the sensors measure.

    Args:
        scores: Content of scores.json (`Evaluation.scores`).

    Returns:
        Sentences without a full stop by their subject: "Sensors", "Control period", "Drives", "Machines".
    """
    sensors, drives, machines = (str(scores.get(key, "")) for key in ("sensors", "drives", "randomize"))
    period_ms, command = 1e3 * scores["period_s"], Command(**scores.get("command", {})).name
    return {
        "Sensors": f"{sensors}: {_SENSORS[sensors]}" if sensors in _SENSORS else sensors,
        "Control period": (
            f"{number(period_ms)} ms ({number(1e3 / period_ms)} Hz); {command}s are held in between"
        ),
        "Drives": f"{drives}: {_DRIVES[drives].format(command)}"
        if drives in ACTUATOR_PRESETS
        else drives or "not stated",
        "Machines": f"{machines}: {_MACHINES[machines]}" if machines in RANDOMIZATION_PRESETS else machines,
    }


def next_steps(
    scores: Mapping[str, Any],
    best: str | None,
    second: str | None,
    worst: str,
    warnings: Sequence[str],
    machine: str,
) -> list[NextStep]:
    """Return proposals for what to do after an evaluation, the most important one first.

    Args:
        scores: Content of scores.json (`Evaluation.scores`).
        best: Name of the best controller; None if none succeeds.
        second: Name of a controller that is not significantly worse, None if there is none.
        worst: The worst episode of the best controller, in words; "" if it is not known.
        warnings: Sentences about results that cannot be trusted.
        machine: Name or file of the machine in the commands.

    Returns:
        Steps: sentences with the key "text", and "command", a command line or "".
    """
    steps = []
    period = scores["period_s"]
    if warnings:
        steps.append(NextStep("Remove what the warnings at the top name, and evaluate again."))
    if best is None:
        shorter = 0.2 * period
        text = (
            "Evaluate with a shorter control period, for example "
            f"{number(1e3 * shorter)} ms, or other controllers."
        )
        names = list(scores["controllers"])
        return [*steps, NextStep(text, _evaluation(scores, names, machine, period=shorter))]
    if scores["sensors"] == "state":
        text = (
            f"Evaluate {best} with the sensors of the machine: "
            "these scores assume exact positions and velocities."
        )
        steps.append(NextStep(text, _evaluation(scores, [best], machine, sensors="machine")))
    if second is not None:
        text = f"If you must choose between {best} and {second}, compare them in more episodes."
        count = 4 * scores["episodes"]
        steps.append(NextStep(text, _evaluation(scores, [best, second], machine, episodes=count)))
    if worst:
        text = (
            f"Record the hardest move on the machine under {best}: {worst}. "
            "If the record differs from its plot on this page, identify again with it."
        )
        steps.append(NextStep(text))
    ratio = ratio_to_bounds(scores["controllers"][best])
    if ratio is not None and ratio["mean"] > _CLEAR_GAIN:
        text = (
            f"{best} needs {number(100.0 * (ratio['mean'] - 1.0))} % more than the shortest possible time. "
            "If that matters, evaluate the controller predictive, or train an agent."
        )
        steps.append(NextStep(text, _evaluation(scores, [best, "predictive"], machine)))
    text = f"Use {best} with a control period of {number(1e3 * period)} ms."
    if best in ("pid", "textbook-pid"):
        command = f"hframe export gains --machine {quoted(machine)} --period {period:g} --out gains"
        return [*steps, NextStep(f"{text} Its gains, as they are typed into a drive:", command)]
    return [*steps, NextStep(text)]


def worst_move(episodes: Episodes) -> str:
    """Describe a controller's worst episode, such as "from (-80, 12) mm to (40, 0) mm".

    For motion along a path it is the number of the episode, counted from 1, such as "episode 7".
    `ranked_episodes` says which one is the worst.
    """
    episode = int(ranked_episodes(episodes)[-1])
    if episodes.contour is not None:
        return f"episode {episode + 1}"
    places = episodes.position[episode, 0], episodes.goal[episode, -1]
    start, goal = (", ".join(f"{1e3 * value:.0f}" for value in place) for place in places)
    small = episodes.unit.small
    return f"from ({start}) {small} to ({goal}) {small}"


def _evaluation(scores: Mapping[str, Any], names: Sequence[str], machine: str, **changes: Any) -> str:
    """Return the command that evaluates controllers as before but for some options; "" if none does."""
    if str(scores["randomize"]) not in RANDOMIZATION_PRESETS or str(scores["sensors"]) not in SENSOR_PRESETS:
        return ""
    path = re.search(r"path='([^']*)'", str(scores["task"]))
    options = {"task": task_name(scores), "path": path[1] if path else None}
    options |= {"randomize": scores["randomize"], "sensors": scores["sensors"]}
    options |= {"period": scores["period_s"], "episodes": scores["episodes"]} | changes
    words = [
        f" --{key} {quoted(f'{value:g}' if isinstance(value, float) else str(value))}"
        for key, value in options.items()
        if value != _DEFAULTS.get(key)
    ]
    chosen = " ".join(map(quoted, names))
    return f"hframe evaluate {chosen} --machine {quoted(machine)}{''.join(words)} --html --out out/again"
