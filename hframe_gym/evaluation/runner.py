"""Evaluation of controllers: simulate the episodes of a scenario, score them, and write scores and plots.

The environment runs at ten times the control rate with the action held over a control period, so that settling times
are resolved to a tenth of a control period.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..atomic_files import atomic_file, write_text
from ..controllers import Controller
from ..dynamics import Equations, MotionPoint, NotFiniteError
from ..envs import HFrameVectorEnv, MachineLike, RandomizationLike, SensorsLike, TaskLike
from ..errors import InputError
from ..machine import Machine
from .metrics import BANDS, score_episodes, stored_bounds
from .scenario import Episodes, Scenario, make_controller, period_concern

Array = NDArray[np.float64]
SAMPLES_PER_PERIOD = 10
SMALLEST_ERROR_MM = 1e-3  # mm, lower end of the logarithmic error axis of a plot


class Evaluation(NamedTuple):
    """Scores and recorded episodes of the controllers compared by `evaluate`.

    Attributes:
        scores: Contents of scores.json: the scenario (`schema`, `machine`, `task`, `randomize`, `episodes`, `seed`,
            `sensors`, `period_s`) and `controllers`, the result of `score_episodes` by name of the controller.
        episodes: Recorded episodes by name of the controller.
    """

    scores: dict[str, Any]
    episodes: dict[str, Episodes]


def evaluate(
    controllers: str | Iterable[str] | Mapping[str, Controller],
    machine: MachineLike | Scenario = "hframe",
    *,
    task: TaskLike = "reach",
    randomize: RandomizationLike = "default",
    sensors: SensorsLike = "state",
    episodes: int = 512,
    seed: int = 0,
    period: float = 0.01,
    duration_s: float = 1.5,
) -> Evaluation:
    """Simulate controllers on identical episodes and score them.

    Args:
        controllers: One name or several names as for `make_controller`, or controllers by the name in the scores.
        machine: Machine, preset name or path of a machine.json; or a `Scenario`, which replaces all further arguments.
        task: "reach", "track", the name of another registered task, or a task object.
        randomize: Preset name or list of randomization rules for the machine's parameters.
        sensors: What controllers observe: "state" (true full state), "rig" (encoders and lasers), or a sensor suite.
        episodes: Number of episodes.
        seed: Seed of the first episode; episode b has seed + b.
        period: Control period, s.
        duration_s: Length of an episode, s.

    Returns:
        scores: Contents of scores.json: description of the scenario, and the scores by name of the controller.
        episodes: Recorded episodes by name of the controller.

    Raises:
        InputError: If an option or a controller's name is wrong, a controller cannot run in this scenario, or the
            simulated motion diverges.

    References:
        Metrics: hframe_gym/evaluation/metrics.py; bounds: docs/bound.md.
    """
    scenario = machine
    if not isinstance(scenario, Scenario):
        scenario = Scenario(scenario, task, randomize, sensors, episodes, seed, period, duration_s)
    concern = period_concern(scenario.declared_machine, scenario.period)
    if concern:
        warnings.warn(concern, stacklevel=2)
    if not isinstance(controllers, Mapping):
        names = [controllers] if isinstance(controllers, str) else list(controllers)
        controllers = {name: make_controller(name, scenario) for name in dict.fromkeys(names)}
    recorded = {name: rollout(controller, scenario) for name, controller in controllers.items()}
    bounds = stored_bounds(scenario)
    scores = {}
    for name, controller_episodes in recorded.items():
        metrics = score_episodes(controller_episodes, bounds.times_s, seed=scenario.seed, metrics=scenario.metrics)
        scores[name] = metrics | ({"over_bound_reason": bounds.reason} if "over_bound" in metrics else {})
    return Evaluation(_describe(scenario) | {"controllers": scores}, recorded)


def _describe(scenario: Scenario) -> dict[str, Any]:
    """Return a scenario as the plain data at the head of scores.json."""
    machine, task, randomize, sensors = scenario.machine, scenario.task, scenario.randomize, scenario.sensors
    return {
        "schema": 1,
        "machine": machine.name if isinstance(machine, Machine) else str(machine),
        "task": task if isinstance(task, str) else repr(task),
        "randomize": randomize if isinstance(randomize, str) else [repr(rule) for rule in randomize],
        "episodes": scenario.episodes,
        "seed": scenario.seed,
        "sensors": sensors if isinstance(sensors, str) else repr(sensors),
        "period_s": scenario.period,
    }


def rollout(controller: Controller, scenario: Scenario) -> Episodes:
    """Simulate all episodes of a scenario with one controller, in parallel.

    Args:
        controller: Controller designed for the scenario's control period. Its memory is cleared first.
        scenario: Machine, task, randomization, sensors and number of episodes.

    Returns:
        Positions, goals, voltages, energy and belt forces of the episodes. Positions and goals have ten samples per
        control period.

    Raises:
        InputError: If the environment rejects the scenario's options, or the simulated motion diverges.
    """
    try:
        return _Recorder(scenario).run(controller)
    except NotFiniteError as error:
        name = scenario.declared_machine.name
        raise InputError(
            f"machine {name!r}: the simulated motion diverges under this controller ({error}); check the parameters of "
            "its effects, for example a belt law that loses its stiffness at large stretch"
        ) from None
    except InputError:
        raise
    except ValueError as error:
        raise InputError(str(error)) from None


class _Recorder:
    """The environment of a scenario, sampled ten times per control period."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.sample_s = scenario.period / SAMPLES_PER_PERIOD
        self.envs = HFrameVectorEnv(
            scenario.episodes,
            max_episode_steps=None,
            machine=scenario.machine,
            task=scenario.controller_task,
            randomize=scenario.randomize,
            sensors=scenario.sensors,
            period=self.sample_s,
        )

    def run(self, controller: Controller) -> Episodes:
        """Record the episodes of a controller."""
        scenario, simulator = self.scenario, self.envs.batch.simulator
        count, samples = scenario.episodes, scenario.periods * SAMPLES_PER_PERIOD + 1
        observation, info = self.envs.reset(seed=scenario.seed)
        machine = self.envs.machine
        loads = _Loads(machine, self.envs.parameters)
        rated = np.array([d.rated_voltage for d in machine.drives])
        position, goal = np.empty((2, count, samples, len(machine.tool_axes)))
        contour = np.empty((count, samples)) if "contour_m" in info else None
        volts = np.empty((count, scenario.periods, len(rated)))
        energy, peak = np.zeros(count), np.zeros(count)

        def record(sample: int) -> None:
            position[:, sample], goal[:, sample] = simulator.tools(), observation["desired_goal"]
            if contour is not None:
                contour[:, sample] = info["contour_m"]

        controller.reset()
        record(0)
        travel = [self.envs.travel]
        for k in range(scenario.periods):
            actions = np.clip(controller.act(observation), -1.0, 1.0)
            volts[:, k] = actions * rated
            for sample in range(k * SAMPLES_PER_PERIOD + 1, (k + 1) * SAMPLES_PER_PERIOD + 1):
                observation, _, _, _, info = self.envs.step(actions)
                record(sample)
                travel.append(self.envs.travel)
            in_period = np.stack(travel)
            energy += loads.energy(in_period, volts[:, k], self.sample_s)
            peak = np.maximum(peak, loads.largest_tension(in_period))
            travel = travel[-1:]
        time_s = self.sample_s * np.arange(samples, dtype=np.float64)
        return Episodes(time_s, position, goal, contour, volts, rated, energy, peak)


class _Loads:
    """Belt tensions and electrical energy of B machines with their sampled parameters (B, P)."""

    def __init__(self, machine: Machine, parameters: Array) -> None:
        values = dict(zip(machine.parameters, parameters.T, strict=True))
        # Hooke's law and Ohm's law; effects on belts and currents are not included.
        self._equations = Equations(machine.replace(effects=()), values)

    def largest_tension(self, travel: Array) -> Array:
        """Return the largest tension (B,) beyond pretension, N, over samples of the travel (k, B, n), m."""
        belts = self._equations.belt_states(_points(travel, np.zeros_like(travel)))
        tensions = np.abs([np.zeros(travel.shape[:2]), *(belt.tension for belt in belts)])  # (belts, k, B)
        return np.asarray(tensions.max(axis=(0, 1)))

    def energy(self, travel: Array, volts: Array, sample_s: float) -> Array:
        """Return the energy (B,) that the drives draw, J, over samples of the travel (k, B, n), with volts (B, d)."""
        # The current is linear in the speed, whose mean is distance over time.
        mean = _points(travel[1:], np.diff(travel, axis=0) / sample_s)
        energy = np.zeros(len(volts))
        for j in range(volts.shape[1]):
            energy += (self._equations.ohmic_current(j, mean, volts[:, j]) * volts[:, j]).sum(axis=0) * sample_s
        return energy


def _points(travel: Array, speed: Array) -> MotionPoint:
    """Return the points of a motion, travel and speed of shape (k, B, n)."""
    return MotionPoint(list(np.moveaxis(travel, -1, 0)), list(np.moveaxis(speed, -1, 0)))


def write_scores(folder: str | Path, scores: Mapping[str, Any]) -> Path:
    """Write the scores of an evaluation to scores.json; if this fails, an existing file stays unchanged.

    Args:
        folder: Folder, which is created if necessary.
        scores: `scores` of an `Evaluation`.

    Returns:
        Path of the written file.

    Raises:
        ValueError: If a value is not finite, which JSON cannot hold.
        OSError: If the file cannot be written.
    """
    path = Path(folder) / "scores.json"
    write_text(path, json.dumps(scores, indent=2, allow_nan=False) + "\n")
    return path


def plot_episode(episodes: Episodes, episode: int = 0, *, title: str = "") -> Any:
    """Plot one episode in three panels: tool path, distance to the goal (and to the path) over time, and voltages.

    Args:
        episodes: Recorded episodes of one controller, as `rollout` returns them.
        episode: Index of the episode, from 0 to the number of episodes - 1.
        title: Title of the figure; empty for none.

    Returns:
        Figure of matplotlib (`matplotlib.figure.Figure`).

    Raises:
        ImportError: If matplotlib is not installed; the message names the extra.
        IndexError: If `episode` is out of range.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ImportError("plots need matplotlib: pip install 'hframe_gym[report]'") from error
    if not 0 <= episode < len(episodes.position):
        raise IndexError(f"episode {episode} of {len(episodes.position)}")
    figure = Figure(figsize=(11, 3.6), layout="constrained")
    path_axes, error_axes, voltage_axes = figure.subplots(1, 3)
    _plot_path(path_axes, episodes, episode)
    _plot_error(error_axes, episodes, episode)
    _plot_voltages(voltage_axes, episodes, episode)
    if title:
        figure.suptitle(title)
    return figure


def _plot_path(axes: Any, episodes: Episodes, episode: int) -> None:
    """Plot the path of the tool, with its start and its goal or the goal's path; one axis over time."""
    position, goal = 1e3 * episodes.position[episode], 1e3 * episodes.goal[episode]
    if position.shape[1] == 1:
        axes.plot(episodes.time_s, position[:, 0], lw=1.2)
        axes.axhline(goal[-1, 0], color="0.6", lw=0.7, ls="--", label="goal")
        axes.set(xlabel="time (s)", ylabel="position (mm)")
        axes.legend(frameon=False)
        return
    if episodes.contour is not None:
        axes.plot(*goal.T, color="0.6", lw=2.5, label="path")
    axes.plot(*position.T, lw=1.2)
    axes.plot(*position[0], "o", ms=4, label="start")
    if episodes.contour is None:
        axes.plot(*goal[-1], "x", ms=7, label="goal")
    axes.set(xlabel="x (mm)", ylabel="y (mm)", aspect="equal", adjustable="datalim")
    axes.legend(frameon=False)


def _plot_error(axes: Any, episodes: Episodes, episode: int) -> None:
    """Plot the distance to the goal, and to the path if there is one, with the settling bands."""
    time_s, error_mm = episodes.time_s, 1e3 * episodes.goal_error[episode]
    axes.semilogy(time_s, np.maximum(error_mm, SMALLEST_ERROR_MM), lw=1.2, label="to the goal")
    if episodes.contour is not None:
        contour_mm = 1e3 * episodes.contour[episode]
        axes.semilogy(time_s, np.maximum(contour_mm, SMALLEST_ERROR_MM), lw=1.2, label="to the path")
        axes.legend(frameon=False, ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    for name, band in BANDS.items():
        axes.axhline(1e3 * band, color="0.6", lw=0.7, ls="--")
        axes.annotate(name, (time_s[-1], 1e3 * band), ha="right", va="bottom", fontsize=7, color="0.4")
    axes.set(xlabel="time (s)", ylabel="distance to the goal (mm)" if episodes.contour is None else "distance (mm)")


def _plot_voltages(axes: Any, episodes: Episodes, episode: int) -> None:
    """Plot the voltages of the drives and their rated values."""
    time_s, volts = episodes.time_s, episodes.volts[episode]
    period = (time_s[-1] - time_s[0]) / len(volts)
    edges = time_s[0] + period * np.arange(len(volts) + 1)
    for j in range(volts.shape[1]):
        axes.stairs(volts[:, j], edges, baseline=None, lw=1.2, label=f"drive {j + 1}")
    for limit in {float(v) for v in episodes.rated}:
        axes.axhline(limit, color="0.6", lw=0.7, ls="--")
        axes.axhline(-limit, color="0.6", lw=0.7, ls="--")
    axes.set(xlabel="time (s)", ylabel="voltage (V)")
    axes.legend(frameon=False)


def save_plot(path: str | Path, episodes: Episodes, episode: int = 0, *, title: str = "") -> None:
    """Plot one episode (tool path, error, voltages) to a file; if this fails, an existing file stays unchanged.

    Args:
        path: File to write; the suffix is .png, .svg or .pdf.
        episodes: Recorded episodes of one controller, as `rollout` returns them.
        episode: Index of the episode, from 0 to the number of episodes - 1.
        title: Title of the figure; empty for none.

    Raises:
        ImportError: If matplotlib is not installed; the message names the extra.
        IndexError: If `episode` is out of range.
        OSError: If the file cannot be written.
    """
    figure = plot_episode(episodes, episode, title=title)
    with atomic_file(path) as temporary:
        figure.savefig(temporary, dpi=150)
