"""Controller interface and registry.

A controller commands a batch of B simulated machines at once. To add one, subclass `Controller`, or
`FullStateController` for a controller of states and goals, in a new module and register it:

    @CONTROLLERS.register("my-controller")
    class MyController(Controller):
        def act(self, observation): ...

It is then available by name to `make_controller`, `evaluate` and `hframe evaluate`; from a module outside the package
as `my_package.my_module:my-controller`.
"""

from __future__ import annotations

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal, Protocol

import numpy as np
from typing_extensions import override

from ..arrays import Actions, Array, KeyedObservation, Mask, PreviewedGoals, TravelStates, Volts
from ..errors import InputError
from ..machine import Machine
from ..registry import Registry
from .models.motion_model import MotionModel

Feedback = Literal["state", "estimated_state", "observation"]


# s. The preview and the horizon of the controllers last a fixed time, so that a shorter period costs time and memory.
SHORTEST_PERIOD, LONGEST_PERIOD = 1e-5, 10.0
# s, largest step of the simulations in estimators and plans: that of the environments, short against the belt modes.
SIMULATION_STEP_S = 5e-4


def check_period(period: float) -> float:
    """Return the control `period`, s; an InputError refuses one outside 1e-5 s to 10 s, the limits of the design."""
    if not SHORTEST_PERIOD <= period <= LONGEST_PERIOD:
        limits = f"{SHORTEST_PERIOD:g} to {LONGEST_PERIOD:g} s"
        raise InputError(f"period is {period!r}, it must be a positive number of seconds from {limits}")
    return float(period)


class Controller(ABC):
    """Discrete-time controller of a batch of B simulated copies of one machine, one per environment.

    A controller may keep a memory of each machine (integrators, estimates, voltages sent within the dead time); `reset`
    clears it. B is the number of rows of the observation.

    Attributes:
        feedback: What the controller needs to measure (class attribute). "state": the true full state; such a
            controller cannot run from sensors. "estimated_state": the full state, which `StateEstimator` supplies where
            the environment observes sensors only. "observation": whatever the environment observes.
        knowledge: For what it uses the machine from which it is designed, a few words for the leaderboard (class
            attribute). A planner with the true parameters of a draw says so.
        files: Files besides its source that determine what it does, such as weights. They count as learned.
        set_points: Whether it commands drives that follow set points, which no other controller does (class attribute).

    Raises:
        InputError: If the period is not between 1e-5 s and 10 s.
    """

    feedback: ClassVar[Feedback] = "state"
    knowledge: ClassVar[str] = "not stated"
    files: Sequence[str | Path] = ()
    set_points: ClassVar[bool] = False

    def __init__(self, machine: Machine, period: float = 0.01) -> None:
        self.machine = machine
        self.period = check_period(period)

    @abstractmethod
    def act(self, observation: KeyedObservation) -> Actions:
        """Compute the actions for the control period that starts now; call it once per period."""

    def reset(self, mask: Mask | None = None) -> None:  # noqa: B027  (optional)
        """Clear the memory of machines that start a new episode next; None: of all, whose number may then change."""

    def concern(self) -> str | None:
        """Return a sentence for a warning if this controller cannot be expected to work on its machine."""
        return None

    def replace_last_action(self, actions: Actions) -> None:  # noqa: B027  (optional)
        """Replace the stored actions of this control period with the actions that were actually applied.

        Call it after `act` if something changes the actions, for example a learned policy that corrects them: observers
        and the compensation of a dead time need the applied voltages.
        """


CONTROLLERS: Registry[type[Controller]] = Registry("controller")


def suited_controllers(machine: Machine) -> tuple[str, ...]:
    """Return the names of the controllers whose commands the drives of a machine take, the first one to try first."""
    return tuple(n for n in CONTROLLERS if CONTROLLERS.get(n).set_points == bool(machine.drive_laws))


# m. In motion the belts of the stages here stretch by some mm, and end stops yield by less than this.
LARGEST_STRETCH = 0.05
# rad. With `normalize=True` an angle is at most 1.5, its bound over its scale; such an angle moves a belt by 1 or 2 cm.
LARGEST_NORMALIZED = 1.5
_ADVICE = (
    "controllers and agents need SI units by key; make them for the environment, make_controller(name, env), which "
    "undoes normalize and flat, or make the environment without normalize, flat and wrappers that scale observations"
)


def check_keys(observation: Any) -> None:
    """Raise an InputError if an observation is one array, as with the option `flat`, or lacks the batch axis."""
    if not isinstance(observation, Mapping):
        raise InputError(f"observation is one array of shape {np.shape(observation)}, not a dict: {_ADVICE}")
    if observation["observation"].ndim == 1:
        raise InputError(
            "observation is that of one machine, without batch axis; make the controller for the environment, "
            "make_controller(name, env), or give arrays of shape (1, entries)"
        )


def check_state_units(observation: KeyedObservation, model: MotionModel) -> None:
    """Check that a full-state observation is not normalized: its angles fit the tool position.

    Where the tool is more than `LARGEST_STRETCH` of belt travel away from the place where all angles are zero, at least
    one pulley has turned by more than `LARGEST_NORMALIZED`, unless angles and positions are fractions of their ranges.

    Only observations of environments, which have `achieved_goal`, are checked.

    Raises:
        InputError: If they do not fit; the message names the values.
    """
    if "achieved_goal" not in observation:
        return
    count = len(model.observed)
    values = np.asarray(observation["observation"], np.float64)
    achieved = np.asarray(observation["achieved_goal"], np.float64)
    rotary = [i for i, name in enumerate(model.observed) if model.machine.coordinate(name).kind == "rotary"]
    rotary = [i for i in rotary if model.observed[i] not in model.axes]
    # no angle shows the scale: the size of the workspace has to
    if not rotary or values.shape[1] != 2 * count:
        check_goal_units(observation, model.machine)
        return
    radii = np.array([model.machine.coordinate(model.observed[i]).travel_per_unit for i in rotary])
    rows = [model.machine.coordinate_names.index(model.observed[i]) for i in rotary]
    expected = model.axis_travel(achieved) @ model.rigid[rows].T
    angles = values[:, rotary]
    far = np.abs(angles * radii - expected).max(axis=1) > LARGEST_STRETCH
    scaled = far & (np.abs(angles).max(axis=1) <= LARGEST_NORMALIZED)
    if scaled.any():
        b = int(np.flatnonzero(scaled)[0])
        position = ", ".join(f"{value:.3g}" for value in achieved[b])
        turned = ", ".join(f"{value:.3g}" for value in angles[b])
        raise InputError(
            f"observation is not in SI units: at the position ({position}) m the pulleys cannot be at ({turned}) rad, "
            f"as if the environment had normalize=True; {_ADVICE}"
        )


def check_goal_units(observation: KeyedObservation, machine: Machine) -> None:
    """Check that the goals of an environment's observation lie in a machine's workspace, as those in meters do.

    Only observations of environments, which have `achieved_goal`, are checked.

    Raises:
        InputError: If a goal is outside.
    """
    for key in ("achieved_goal", "desired_goal") if "achieved_goal" in observation else ():
        columns = np.asarray(observation[key]).T
        margin = LARGEST_STRETCH * machine.axis_unit.per_meter + 1e-6
        for axis, limits, values in zip(machine.tool_axes, machine.axis_ranges, columns, strict=False):
            low, high = limits or (-np.inf, np.inf)
            outside = (values < low - margin) | (values > high + margin)
            if outside.any():
                raise InputError(
                    f"observation is not in SI units: {key} has {axis} = {values[outside][0]:.3g}, and the workspace is"
                    f" {low:g} to {high:g} {machine.axis_unit.name}, as if the environment had normalize=True; "
                    f"{_ADVICE}"
                )


class UnitCheck:
    """Check that observations are arrays by key in SI units, for controllers that use them as they are.

    Args:
        full_state: Whether the full state is observed instead of sensors.
    """

    def __init__(self, machine: Machine, full_state: bool) -> None:
        self._machine = machine
        self._model: MotionModel | None = None
        if full_state:
            # A machine with coordinates that nobody observes has no such model; its goals are checked.
            with contextlib.suppress(InputError):
                self._model = MotionModel(machine)

    def __call__(self, observation: KeyedObservation) -> None:
        """Raise an InputError if an observation is one array, lacks the batch axis or is normalized."""
        check_keys(observation)
        if self._model is None:
            check_goal_units(observation, self._machine)
        else:
            check_state_units(observation, self._model)


class EpisodeStarts:
    """Record by `mask`, empty before the first `resize`, which machines start a new episode next."""

    def __init__(self) -> None:
        self.mask: Mask = np.zeros(0, np.bool_)

    def reset(self, mask: Mask | None = None) -> None:
        """Mark machines, or all if None, as starting a new episode next; those marked earlier stay marked."""
        if mask is None:
            self.mask = np.zeros(0, np.bool_)  # so that the next `resize` marks all machines
        elif len(self.mask):
            self.mask = self.mask | mask

    def resize(self, count: int) -> bool:
        """Set the number of machines; if it changes, mark all as starting a new episode, and return True."""
        if len(self.mask) == count:
            return False
        self.mask = np.ones(count, np.bool_)
        return True

    def clear(self) -> None:
        """Unmark all machines; call it after the first observations of their new episodes have been processed."""
        self.mask = np.zeros(len(self.mask), np.bool_)


class FullStateController(Controller):
    """Controller that needs the full state of a machine with one drive per axis; subclasses implement `act_on_state`.

    This class converts observations to states and goals, and records which machines start a new episode.

    Raises:
        InputError: If the machine does not have one drive per axis of its tool, or the period is invalid.
    """

    def __init__(self, machine: Machine, period: float = 0.01) -> None:
        super().__init__(machine, period)
        self.model = MotionModel(machine)
        self._starts = EpisodeStarts()

    @override
    def reset(self, mask: Mask | None = None) -> None:
        self._starts.reset(mask)

    @override
    def act(self, observation: KeyedObservation) -> Actions:
        check_keys(observation)
        state = self.model.state(observation)
        check_state_units(observation, self.model)
        goals = [np.asarray(observation["desired_goal"], np.float64)[:, None]]
        if "preview" in observation:
            goals.append(
                np.asarray(observation["preview"], np.float64).reshape(len(state), -1, len(self.model.axes))
            )
        return self.act_on_state(state, self.model.axis_travel(np.concatenate(goals, axis=1)))

    @abstractmethod
    def act_on_state(self, state: TravelStates, goals: PreviewedGoals) -> Actions:
        """Compute the actions for the period that starts now; an InputError if the preview is too short."""


class Estimator(Protocol):
    """Interface of a state estimator for a batch of machines; `StateEstimator` implements it.

    In every control period, call `update` with the measurements, then `send` with the voltages.

    Attributes:
        period: Control period, s.
        channels: Number of measurements per machine.
    """

    model: MotionModel
    period: float
    channels: int

    def reset(self, mask: Mask | None = None) -> None:
        """Discard the estimates of the machines in the mask (None: all), which start a new episode."""

    def update(self, measurements: Array) -> TravelStates:
        """Estimate the state at the time of new `measurements`, one per sensor, m or rad, shape (B, channels)."""

    def send(self, volts: Volts) -> None:
        """Record the commanded voltages of the period that starts now, from which `update` predicts."""

    def replace_last(self, volts: Volts) -> None:
        """Replace the voltages that `send` stored last with the voltages that were actually applied."""


class OutputFeedbackController(Controller):
    """Full-state controller combined with a state estimator, so that it runs from sensor measurements.

    Args:
        controller: Full-state controller (`feedback` is "state" or "estimated_state").
        estimator: State estimator of the same machine and control period. Its measurements are the first
            `estimator.channels` columns of the array `observation` that the environment returns.

    Raises:
        InputError: If the estimator's period is invalid.
    """

    feedback: ClassVar[Feedback] = "observation"

    def __init__(self, controller: Controller, estimator: Estimator) -> None:
        super().__init__(estimator.model.machine, estimator.period)
        self.controller, self.estimator = controller, estimator

    @override
    def reset(self, mask: Mask | None = None) -> None:
        self.controller.reset(mask)
        self.estimator.reset(mask)

    @override
    def act(self, observation: KeyedObservation) -> Actions:
        """Estimate the state from the measurements, then compute the actions.

        Columns of `observation` beyond the estimator's channels are ignored.
        """
        check_keys(observation)
        model = self.estimator.model
        check_goal_units(observation, model.machine)
        measurements = observation["observation"][:, : self.estimator.channels]
        state = self.estimator.update(measurements)
        # The controller receives the same arrays, with the estimated full state in place of the measurements.
        actions = self.controller.act({**observation, "observation": model.observation(state)})
        self.estimator.send(np.clip(actions, -1.0, 1.0) * model.rated)
        return actions

    @override
    def replace_last_action(self, actions: Actions) -> None:
        self.controller.replace_last_action(actions)
        self.estimator.replace_last(actions * self.estimator.model.rated)
