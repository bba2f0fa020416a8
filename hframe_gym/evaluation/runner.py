"""Evaluation of controllers: simulate the episodes of a scenario, score them, and write the scores.

The environment runs at ten times the control rate with the action held over a control period, so that
settling times are resolved to a tenth of a control period.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Array
from ..controllers import Controller, EnvironmentController, period_concern
from ..dynamics import Equations, MotionPoint, NotFiniteError
from ..envs import MachineLike, RandomizationLike, SensorsLike, TaskLike
from ..envs.workspace import unmeasured_workspace
from ..errors import InputError
from ..files import write_text
from ..machine import Machine
from ..recordings import recorded_commands
from .controller_creation import make_controller
from .episodes import Command, Episodes
from .metrics import score_episodes
from .scenario import Scenario, environments_of
from .stored_bounds import stored_bounds

SAMPLES_PER_PERIOD = 10
MAX_SAMPLES = 200_000_000  # of all episodes together; a recorded sample of a planar machine takes 32 bytes
# Control periods of an episode from which a warning says that the evaluation takes long.
MANY_PERIODS = 10_000


class Evaluation(NamedTuple):
    """Scores and recorded episodes of the controllers compared by `evaluate`.

    Attributes:
        scores: Contents of scores.json: the scenario (`schema`, `machine`, `task`, `randomize`, `episodes`,
            `seed`, `sensors`, `drives`, `period_s`) and `controllers`: results of `score_episodes` by name of
            the controller.
        episodes: Recorded episodes by name of the controller.
    """

    scores: dict[str, Any]
    episodes: dict[str, Episodes]


def evaluate(
    controllers: str | Iterable[str] | Mapping[str, str | Controller],
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

    `reach_metrics` and `track_metrics` describe the scores, docs/bound.md the time-optimal bounds.

    Args:
        controllers: Names of controllers (such as "pid"), agents or folders; or a mapping from names in the
            results to controllers or their names. `make_controller(policy, env)` makes a controller of a
            function of observations.
        machine: Machine, built-in name or machine.json; or a `Scenario`, which replaces all further
            arguments.
        task: "reach", "track", the name of another registered task, or a task object.
        randomize: Preset name or list of randomization rules for the machine's parameters.
        sensors: What controllers observe: "state" (true full state), "rig" (encoders and lasers), or a sensor
            suite.
        episodes: Number of episodes.
        seed: Seed of the first episode; episode b has seed + b.
        period: Control period, s.
        duration_s: Length of an episode, s.

    Raises:
        InputError: If an option or a controller's name is wrong or missing, a controller cannot run in this
            scenario, the simulated motion diverges, or the episodes would have more than 2e8 samples (10 per
            control period).
    """
    options = (task, randomize, sensors, episodes, seed, period, duration_s)
    scenario = machine if isinstance(machine, Scenario) else Scenario(machine, *options)
    samples = scenario.episodes * (scenario.periods * SAMPLES_PER_PERIOD + 1)
    if samples > MAX_SAMPLES:
        raise InputError(
            f"{scenario.episodes} episodes of {scenario.periods} control periods have {samples:.2g} samples, "
            f"the limit is {MAX_SAMPLES:.0e}: evaluate fewer episodes or a longer control period"
        )
    if scenario.periods > MANY_PERIODS:
        warnings.warn(f"an episode has {scenario.periods} control periods, which takes minutes", stacklevel=2)
    declared = scenario.declared_machine
    for concern in (period_concern(declared, scenario.period), unmeasured_workspace(declared)):
        if concern:
            warnings.warn(concern, stacklevel=2)
    made = _made(controllers, scenario)
    if not made:
        raise InputError("evaluate needs at least one controller")
    recorded = {name: rollout(controller, scenario) for name, controller in made.items()}
    bounds = stored_bounds(scenario)
    scores = {}
    for name, controller_episodes in recorded.items():
        metrics = score_episodes(
            controller_episodes, bounds.times_s, seed=scenario.seed, metrics=scenario.metrics
        )
        scores[name] = metrics | ({"over_bound_reason": bounds.reason} if "over_bound" in metrics else {})
    return Evaluation(_describe(scenario) | {"controllers": scores}, recorded)


def _made(
    controllers: str | Iterable[str] | Mapping[str, str | Controller], scenario: Scenario
) -> dict[str, Controller]:
    """Return the controllers of `evaluate` by the names in results; raise InputError for what is none."""
    if isinstance(controllers, str) or not isinstance(controllers, Iterable):
        controllers = [controllers]
    if not isinstance(controllers, Mapping):
        controllers = {name: name for name in controllers}
    made = {}
    for name, given in controllers.items():
        controller = make_controller(given, scenario) if isinstance(given, str) else given
        if not isinstance(name, str) or not isinstance(controller, Controller):
            raise InputError(
                f"evaluate: {given!r} is no name of a controller; "
                'give controllers with the names that they have in results, {"mine": controller}; '
                "make_controller(policy, env) makes one of a function of observations"
            )
        made[name] = controller
    return made


def _describe(scenario: Scenario) -> dict[str, Any]:
    """Return a scenario as the plain data at the head of scores.json."""
    machine, task, randomize, sensors = scenario.machine, scenario.task, scenario.randomize, scenario.sensors
    drives = scenario.drives
    return {
        "schema": 1,
        "machine": machine.name if isinstance(machine, Machine) else str(machine),
        "task": task if isinstance(task, str) else repr(task),
        "randomize": randomize if isinstance(randomize, str) else [repr(rule) for rule in randomize],
        "episodes": scenario.episodes,
        "seed": scenario.seed,
        "sensors": sensors if isinstance(sensors, str) else repr(sensors),
        "drives": drives if isinstance(drives, str) else repr(drives),
        "command": Command.of(scenario.declared_machine)._asdict(),
        "period_s": scenario.period,
    }


def rollout(controller: Controller, scenario: Scenario) -> Episodes:
    """Simulate all episodes of a scenario with one controller, all at the same time, and record them.

    Energy and force are computed from motion and voltages by the laws of Ohm and Hooke, without effects on
    currents and tensions. `Episodes` states the shape of each array; there are 10 samples per control period,
    and one more.

    Raises:
        InputError: If the motion diverges, or the controller and the scenario do not fit each other.
    """
    if isinstance(controller, EnvironmentController):  # the recorded environments observe keys in SI units
        controller = controller.controller
    try:
        return _Recorder(scenario).run(controller)
    except NotFiniteError as error:
        name = scenario.declared_machine.name
        raise InputError(
            f"machine {name!r}: the simulated motion diverges under this controller ({error}); check "
            "the parameters of its effects, for example a belt law that loses its stiffness at large stretch"
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
        self.envs = environments_of(scenario, sensors=scenario.sensors, period=self.sample_s)

    def run(self, controller: Controller) -> Episodes:
        """Record the episodes of a controller."""
        scenario, simulator = self.scenario, self.envs.batch.simulator
        count, samples = scenario.episodes, scenario.periods * SAMPLES_PER_PERIOD + 1
        observation, info = self.envs.reset(seed=scenario.seed)
        machine = self.envs.machine
        loads = _Loads(machine, self.envs.parameters)
        rated = np.array([d.rated_voltage for d in machine.drives])
        position, goal = np.empty((2, count, samples, len(machine.tool_axes)))
        contour_key = self.envs.batch.contour_key
        contour = np.empty((count, samples)) if contour_key in info else None
        volts = np.empty((count, scenario.periods, len(rated)))
        energy, peak = np.zeros(count), np.zeros(count)

        def record(sample: int) -> None:
            position[:, sample], goal[:, sample] = simulator.tool_positions(), observation["desired_goal"]
            if contour is not None:
                contour[:, sample] = info[contour_key]

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
        known = energy if all(drive.command == "voltage" for drive in machine.drives) else None
        unit, command = machine.axis_unit, Command.of(machine)
        return Episodes(time_s, position, goal, contour, volts, rated, known, peak, unit, command)


class _Loads:
    """Belt tensions and electrical energy of B machines with their sampled parameters (B, P)."""

    def __init__(self, machine: Machine, parameters: Array) -> None:
        values = dict(zip(machine.parameters, parameters.T, strict=True))
        # Hooke's law and Ohm's law; effects on belts and currents are not included.
        self._equations = Equations(machine.replace(effects=()), machine.with_tied(values))

    def largest_tension(self, travel: Array) -> Array:
        """Return largest differences (B,) of tension and pretension, N, over the travel (k, B, n), m."""
        belts = self._equations.belt_states(_points(travel, np.zeros_like(travel)))
        tensions = np.abs([np.zeros(travel.shape[:2]), *(belt.tension for belt in belts)])  # (belts, k, B)
        return np.asarray(tensions.max(axis=(0, 1)))

    def energy(self, travel: Array, volts: Array, sample_s: float) -> Array:
        """Return the energy (B,) that the drives draw, J, over travel (k, B, n), with volts (B, d)."""
        # The current is linear in the speed, whose mean is distance over time.
        mean = _points(travel[1:], np.diff(travel, axis=0) / sample_s)
        energy = np.zeros(len(volts))
        for j in range(volts.shape[1]):
            energy += (self._equations.ohmic_current(j, mean, volts[:, j]) * volts[:, j]).sum(
                axis=0
            ) * sample_s
        return energy


def _points(travel: Array, speed: Array) -> MotionPoint:
    """Return the points of a motion, travel and speed of shape (k, B, n)."""
    return MotionPoint(list(np.moveaxis(travel, -1, 0)), list(np.moveaxis(speed, -1, 0)))


def write_scores(folder: str | Path, scores: Mapping[str, Any]) -> Path:
    """Write `Evaluation.scores` to scores.json in a folder and return the path.

    The folder is created if necessary. An existing file is replaced, or unchanged if writing fails.
    """
    path = Path(folder) / "scores.json"
    write_text(path, json.dumps(scores, indent=2, allow_nan=False) + "\n")
    return path


def file_labels(controllers: Iterable[str]) -> list[str]:
    """Return a different file name without suffix for each controller of an evaluation.

    The name of a folder is its last part, without colons; equal names get a number from the second on.
    """
    labels: list[str] = []
    for name in controllers:
        label = base = Path(name).name.replace(":", "-")
        number = 1
        while label in labels:  # for example the folder out/ppo and the shipped agent ppo
            number += 1
            label = f"{base}_{number}"
        labels.append(label)
    return labels


def write_motions(path: str | Path, episodes: Episodes, machine: Machine, count: int) -> None:
    """Write the motion in the first episodes of a controller to a CSV file.

    It has a row for each sample, with the columns episode (from 0), time_s, position and goal of each axis
    (x_m, x_goal_m, or in rad) and the command of each drive as in recordings. An existing file is replaced,
    or unchanged if writing fails.

    Args:
        path: File to write; its folder is created if necessary.
        machine: Machine of the episodes, for the names of the columns.
        count: Number of episodes; all if there are fewer.
    """
    axes, unit = machine.tool_axes, machine.axis_unit.name
    names = [f"{axis}_{unit}" for axis in axes] + [f"{axis}_goal_{unit}" for axis in axes]
    names += machine.input_channels
    periods = np.minimum(np.arange(len(episodes.time_s)) // SAMPLES_PER_PERIOD, episodes.volts.shape[1] - 1)
    lines = [",".join(["episode", "time_s", *names])]
    for episode in range(min(count, len(episodes.position))):
        columns = [episodes.time_s[:, None], episodes.position[episode], episodes.goal[episode]]
        table = np.hstack([*columns, recorded_commands(machine, episodes.volts[episode])[periods]])
        lines += [f"{episode}," + ",".join(f"{value:.9g}" for value in row) for row in table.tolist()]
    write_text(Path(path), "\n".join(lines) + "\n")
