"""Controller interface and registry.

A controller commands a batch of B simulated machines at once. To add one, subclass `Controller`, or
`FullStateController` for a controller of states and goals, in a new module and register it:

    @CONTROLLERS.register("my-controller")
    class MyController(Controller):
        def act(self, observation): ...

It is then available by name to `make_controller`, `evaluate` and `hframe evaluate`; from a module outside the
package as `my_package.my_module:my-controller`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from typing_extensions import override

from ..arrays import Actions, KeyedObservation, Mask, PreviewedGoals, TravelStates
from ..machine import Machine
from ..registry import Registry
from .control_period import check_period
from .models.motion_model import MotionModel
from .observation_checks import check_keys, check_state_units

Feedback = Literal["state", "estimated_state", "observation"]
# s, largest step of the simulations in estimators and plans: that of the environments, short against the belt
# modes.
SIMULATION_STEP_S = 5e-4


class Controller(ABC):
    """Discrete-time controller of a batch of B simulated copies of one machine, one per environment.

    A controller may keep a memory of each machine (integrators, estimates, voltages sent within the dead
    time); `reset` clears it. B is the number of rows of the observation.

    Attributes:
        feedback: What the controller needs to measure (class attribute). "state": the true full state; such a
            controller cannot run from sensors. "estimated_state": the full state, which `StateEstimator`
            supplies where the environment observes sensors only. "observation": whatever the environment
            observes.
        knowledge: What the controller knows of the machine, in a few words for the leaderboard (class
            attribute), for example that a planner has the true parameters of an episode.
        files: Files besides its source that determine its actions, such as trained weights.
        set_points: Whether its actions are set points of drives that follow these, not voltages (class
            attribute).

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
        """Clear the memory of the machines in `mask`, which start an episode next.

        If `mask` is None, clear all memory; the number of machines may then change.
        """

    def concern(self) -> str | None:
        """Return a warning if the controller cannot be expected to work on its machine, else None.

        This default returns None.
        """
        return None

    def replace_last_action(self, actions: Actions) -> None:  # noqa: B027  (optional)
        """Replace the stored actions of this control period with the actions that were actually applied.

        Call it after `act` if something changes the actions, for example a learned policy that corrects them:
        observers and the compensation of a dead time need the applied voltages.
        """


CONTROLLERS: Registry[type[Controller]] = Registry("controller")


def suited_controllers(machine: Machine) -> tuple[str, ...]:
    """Return the names of controllers that can command a machine's drives, the recommended one first.

    They are those for set points if a drive has a law, such as a servo, else those for voltages. The
    controllers may still refuse the machine.
    """
    return tuple(n for n in CONTROLLERS if CONTROLLERS.get(n).set_points == bool(machine.drive_laws))


class EpisodeStarts:
    """Record of the machines that start a new episode next.

    Attributes:
        mask: True for these machines, shape (B,); empty before `resize`, and after a `reset` of all machines.
    """

    def __init__(self) -> None:
        self.mask: Mask = np.zeros(0, np.bool_)

    def reset(self, mask: Mask | None = None) -> None:
        """Mark machines (None: all) as starting a new episode next, in addition to those marked before."""
        if mask is None:
            self.mask = np.zeros(0, np.bool_)  # so that the next `resize` marks all machines
        elif len(self.mask):
            self.mask = self.mask | mask

    def resize(self, count: int) -> bool:
        """Set the number of machines; if it changes, mark all as starting a new episode.

        Returns:
            Whether it has changed; if not, the marks stay.
        """
        if len(self.mask) == count:
            return False
        self.mask = np.ones(count, np.bool_)
        return True

    def clear(self) -> None:
        """Unmark all machines; call it after the first observations of new episodes have been processed."""
        self.mask = np.zeros(len(self.mask), np.bool_)


class FullStateController(Controller):
    """Controller that needs the full state of a machine with one drive per axis; implement `act_on_state`.

    This class converts observations to states and goals, and records which machines start a new episode.

    Attributes:
        model: Model of the machine for the design.

    Raises:
        InputError: If the machine does not have one drive per axis of its tool, an axis has no range where
            the design needs it, or the period is invalid.
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
        """Convert the observation, which must have the full state, and call `act_on_state`."""
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
        """Compute the actions for the period that starts now.

        Raises:
            InputError: If the controller needs more previewed goals than `goals` has.
        """
