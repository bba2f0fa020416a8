"""Run a controller on a plant: a task's episodes, side by side, with its sensors, converters and loads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from benchmarks.gap.plants import GapPlant, declared_machine
from hframe_gym.controllers import Controller
from hframe_gym.envs import Task
from tests.reference_simulator import Array, Stage
from tests.reference_simulator.parameter_arrays import parameter_arrays
from tests.reference_simulator.sensors import LASER_STEP_M, Sensors, noisy

PERIOD_S, DURATION_S = 0.01, 1.5
SAMPLES = 10  # per control period
CLOCK_S = 400.0  # of the session, at which the episodes begin: after the recordings, and with a warm plant
RESTING_S = 0.1  # without voltage, before an episode: the belts' forces come to rest
OBSERVED = (2, 3, 0, 1)  # channels phi1, phi2, x, y in the order of the observation: x, y, phi1, phi2


class Starts(NamedTuple):
    """Starts and plans of the episodes of a task.

    Attributes:
        start: Positions of the tool at which the plant is set up, m, shape (B, 2).
        plan: Plans of the task, shape (B, plan size).
    """

    start: Array
    plan: Array


@dataclass(frozen=True)
class GapEpisodes:
    """Episodes of one controller on one plant: B episodes of n samples and m control periods.

    Attributes:
        time_s: Sample times, s, shape (n,).
        position: True position of the tool, m, shape (B, n, 2).
        goal: Goal, m, shape (B, n, 2).
        contour: Distance of the tool to its path, m, shape (B, n); None if the task has no path.
        actions: Commands, fractions of the rated voltage, shape (B, m, 2).
        observed: Measurements x, y, m, phi1, phi2, rad, at the beginning of each period, shape (B, m, 4).
        belt_force_N: Largest belt force by Hooke's law of each episode, N, shape (B,).
    """

    time_s: Array
    position: Array
    goal: Array
    contour: Array | None
    actions: Array
    observed: Array
    belt_force_N: Array


def starts_of(task: Task, seed: int, count: int) -> Starts:
    """Draw the starts and goals of `count` episodes; the same seed gives the same."""
    machine = declared_machine()
    workspace = np.array([machine.coordinate(axis).range for axis in machine.tool_axes])
    return Starts(*task.begin(workspace, np.random.default_rng(seed).random((count, task.draws))))


def control(controller: Controller, plant: GapPlant, task: Task, starts: Starts, seed: int) -> GapEpisodes:
    """Run a controller on a plant.

    Args:
        controller: Controller on the measurements `observation` (x, y, m, phi1, phi2, rad, shape (B, 4)),
            `achieved_goal` (measured x and y), `desired_goal` and, for a moving goal, `preview`.
        task: Task, with one previewed goal per control period.
        seed: Seed of the sensors' noise.
    """
    rng = np.random.default_rng([plant.seed, plant.index, seed])
    machine, count = declared_machine(), len(starts.start)
    rated = np.array([drive.rated_voltage for drive in machine.drives])
    steps = 2.0 * rated / 2.0 ** np.array([drive.converter_bits for drive in machine.drives])
    stages = [plant.at_rest(start, CLOCK_S - RESTING_S) for start in starts.start]
    for stage in stages:
        stage.step(np.zeros(2), CLOCK_S)
    measure = _Measurement(plant, count, rng)
    loads = _BeltForces(plant)
    periods = round(DURATION_S / PERIOD_S)
    time_s = np.linspace(0.0, DURATION_S, periods * SAMPLES + 1)
    position, goal = np.empty((2, count, len(time_s), 2))
    contour = np.empty((count, len(time_s)))
    actions, observed, force = np.empty((count, periods, 2)), np.empty((count, periods, 4)), np.zeros(count)
    before, volts = _positions(stages), np.zeros((count, 2))
    controller.reset()
    for k, now in enumerate(time_s):
        exact = _positions(stages)
        tool, elapsed = exact[:, :2], np.full(count, now)
        position[:, k], goal[:, k] = tool, task.goal(starts.plan, elapsed)
        distance = task.contour(starts.plan, tool, elapsed)
        contour[:, k] = np.nan if distance is None else distance
        force = np.maximum(force, loads(stages))
        if k == len(time_s) - 1:
            break
        if k % SAMPLES == 0:
            period = k // SAMPLES
            measured = measure(before, exact, time_s[1])
            observed[:, period] = measured
            observation = {
                "observation": measured,
                "achieved_goal": measured[:, :2],
                "desired_goal": task.goal(starts.plan, elapsed),
            }
            if task.ahead_s:
                observation["preview"] = np.hstack(
                    [task.goal(starts.plan, elapsed + ahead) for ahead in task.ahead_s]
                )
            actions[:, period] = np.clip(controller.act(observation), -1.0, 1.0)
            volts = np.round(actions[:, period] * rated / steps) * steps
        before = exact
        for stage, held in zip(stages, volts, strict=True):
            stage.step(held, CLOCK_S + time_s[k + 1])
    path = None if np.isnan(contour).all() else contour
    return GapEpisodes(time_s, position, goal, path, actions, observed, force)


def _positions(stages: list[Stage]) -> Array:
    """Return x, y, phi1, phi2 of all stages, m and rad, shape (B, 4)."""
    return np.array([stage.position for stage in stages])


class _Measurement:
    """Sensors of a plant in control: graduation, delay, noise, quantization and residual colored noise."""

    def __init__(self, plant: GapPlant, count: int, rng: np.random.Generator) -> None:
        self._sensors: Sensors = plant.stage[1]
        self._colored, self._rng = plant.residue.colored, rng
        self._channel, self._size, self._pole = 0, 0.0, 0.0
        if self._colored:
            channel, self._size, tau = self._colored
            self._channel, self._pole = ("x_m", "y_m").index(channel), float(np.exp(-PERIOD_S / tau))
        self._value = self._size * rng.standard_normal(count)

    def __call__(self, before: Array, now: Array, sample_s: float) -> Array:
        """Return the measurements x, y, phi1, phi2 (B, 4) from the positions now and a sample before."""
        late = np.array(self._sensors.delay_s) / sample_s  # in samples, of the channels phi1, phi2, x, y
        exact = (now + (before - now) * late[[OBSERVED.index(i) for i in range(4)]])[:, OBSERVED]
        measured = noisy(self._sensors.graduated(exact), self._rng)[:, OBSERVED]
        if self._colored:
            kick = self._size * np.sqrt(1.0 - self._pole**2) * self._rng.standard_normal(len(now))
            self._value = self._pole * self._value + kick
            measured[:, self._channel] += np.round(self._value / LASER_STEP_M) * LASER_STEP_M
        return measured


class _BeltForces:
    """Belt forces of a plant by Hooke's law."""

    def __init__(self, plant: GapPlant) -> None:
        self._arrays, _ = parameter_arrays(plant.stage[0])

    def __call__(self, stages: list[Stage]) -> Array:
        """Return the largest force of each stage's belts, N, shape (B,)."""
        belts, coordinates = self._arrays.belts, self._arrays.coordinates
        q = np.array([stage.coordinates for stage in stages])
        travel = coordinates["radius"] * q
        travel += coordinates["eccentricity_m"] * np.sin(q + coordinates["eccentricity_phase"])
        stiffness = belts[:, 0] / (belts[:, 1] + q[:, :2] @ self._arrays.length_gradient.T)
        return np.asarray(np.abs(stiffness * (travel @ self._arrays.rows.T)).max(axis=1))
