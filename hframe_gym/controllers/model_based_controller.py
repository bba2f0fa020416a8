"""Model-based controller: finite-horizon state feedback with feedforward, disturbance observer and preview.

For a fixed goal (point-to-point motion):

State feedback     The first voltage of the shortest minimum-energy transfer to rest that stays near the rated
                   voltage (`MinimumEnergyTransfers`), planned anew from the measured state every period. Far
                   from the goal it acts as a nearly time-optimal reference that cannot wind up behind
                   saturated motors; near the goal, where the shortest transfer is admissible, it is a
                   constant (deadbeat) gain.
Feedforward        The voltage against Coulomb friction and the forces of the machine's effects at the present
                   motion.
Disturbance        Once the shortest transfer is admissible, the feedforward uses the force that the momentum
observer           balance of the last period measured, within limits. While static friction holds the
                   stage, the measured force equals minus the drive force, so that the feedback voltages
                   accumulate until the stage moves, as with an integrator.
Motor reference    Motor positions deviate from those of unstretched belts, because modeled forces on the
                   carriage stretch the belts; at rest the reference follows the measured stretch. A wrong
                   reference would leave a steady-state error of the tool.
Swinging loads     The motion of a carriage tells how a slow load on it swings (`SwingingLoads`). The
                   feedforward holds its force, and the motor reference moves with the stretch that it causes.
Gain reduction     A stage that keeps moving near its goal rings because the model is inaccurate; transfers of
                   more periods, that is, lower gains, end the ringing.

A moving goal, which the observation previews, is tracked by `PreviewTracker`. A dead time of the drives is
bridged by a state prediction, and their static nonlinearities are inverted (input_compensation.py).
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from ..arrays import Actions, Array, PreviewedGoals, TravelStates
from ..machine import Machine
from .base import CONTROLLERS, Feedback, FullStateController
from .models.input_compensation import DeadTime, InputInversion
from .models.swinging_loads import SwingingLoads
from .planning.finite_horizon_control import MinimumEnergyTransfers, PreviewTracker

# The following constants are tuned on randomized H-frames ("default").
# Largest difference between observed and modeled force, in multiples of the nominal Coulomb friction; larger
# values are errors of the momentum balance during hard braking.
DISTURBANCE_LIMIT = 6.0
# Settling from full speed takes three to four times the shortest transfer. Each further SETTLING_ALLOWANCE
# shortest transfers of motion near the goal lengthen the transfers by one period.
SETTLING_ALLOWANCE = 6
# In shortest transfers: a stage with more than this to go beyond the shortest admissible transfer is on its
# way, and is not ringing around its goal.
APPROACH_MARGIN = 2
# Planned voltage limit over rated voltage. The command is cut to the rated voltage and planned again a period
# later: that stays closer to full voltage, and later full braking, than a transfer that respects the rated
# voltage throughout.
VOLTAGE_HEADROOM = 1.6
REST_TRAVEL_M = 3e-5  # m, travel per period below which a stage is at rest
LONGEST_HOLD = 2.0  # longest transfer of a ringing stage, in shortest transfers
# Fraction of the measured stretch error by which the motor reference changes per period.
STRETCH_FILTER_GAIN = 0.2


@CONTROLLERS.register("pid")
class ModelBasedController(FullStateController):
    """Finite-horizon state feedback with disturbance observer and preview, designed from the machine model.

    The registered name `pid` is historical and serves as its short name: like a PID it needs no training and
    has proportional, derivative and integrating action, but it is not a PID.

    Attributes:
        transfers: Feedback gains of the motions to rest at a fixed goal (point-to-point motion).
    """

    feedback: ClassVar[Feedback] = "estimated_state"
    knowledge: ClassVar[str] = "feedback laws"

    def __init__(self, machine: Machine, period: float = 0.01) -> None:
        super().__init__(machine, period)
        self.transfers = MinimumEnergyTransfers(self.model, period)
        self._dead_time = DeadTime(self.model.machine, period)
        self._loads = SwingingLoads(machine, period)
        self._inversion = InputInversion(machine)
        self._tracker: PreviewTracker | None = None  # created when the length of the preview is known
        # N, shape (2,)
        self._disturbance_limit = DISTURBANCE_LIMIT * np.abs(self.model.rigid.T) @ self.model.coulomb
        self._longest_hold = int(np.ceil(LONGEST_HOLD * self.transfers.shortest))
        self._state = np.zeros((0, 0))  # at the last observation
        self._stretch = np.zeros((0, 0))  # m, motor reference minus that of unstretched belts
        # Periods since the shortest transfer became admissible, periods of motion near the goal, and periods
        # of the episode.
        self._settling = self._moving = self._elapsed = np.zeros(0, np.intp)

    @override
    def act_on_state(self, state: TravelStates, goals: PreviewedGoals) -> Actions:
        """Compute the actions that bring the tool to a fixed goal or along the preview of a moving one.

        They are limited to [-1, 1].
        """
        self._begin_period(state)
        goal_moves = goals.shape[1] > 1
        motor_voltage = self._track(state, goals) if goal_moves else self._reach(state, goals[:, 0])
        volts = self._inversion.command(motor_voltage)
        self._dead_time.send(volts)
        self._elapsed = self._elapsed + 1
        self._state = state
        self._starts.clear()
        return volts / self.model.rated

    @override
    def replace_last_action(self, actions: Actions) -> None:
        self._dead_time.replace_last(actions * self.model.rated)

    def _begin_period(self, state: Array) -> None:
        """Clear the memory of machines whose episode starts with `state` (B, 2 n)."""
        if self._starts.resize(len(state)):
            self._state = state
            self._stretch = np.zeros((len(state), len(self.model.mass)))
            self._settling, self._moving, self._elapsed = (np.zeros(len(state), np.intp) for _ in range(3))
        starts = self._starts.mask
        self._dead_time.reset(starts)
        self._loads.follow(self._state, state, starts)
        self._settling, self._moving, self._elapsed = (
            np.where(starts, 0, count) for count in (self._settling, self._moving, self._elapsed)
        )

    def _track(self, state: Array, goals: Array) -> Array:
        """Return motor voltages (B, drives) for goals (B, 1 + P, axes), m, now and at each period's end."""
        goals = self._dead_time.delayed_goals(goals)
        if self._tracker is None or self._tracker.horizon > goals.shape[1] - 1:
            self._tracker = PreviewTracker(self.model, self.transfers.grid, self.period, goals.shape[1] - 1)
        arrived = self._inversion.motor_voltage(self._dead_time.mean_arrived())
        self._tracker.update_disturbance(self._state, state, arrived, self._starts.mask)
        elapsed_s = self._elapsed.astype(np.float64) * self.period + self._dead_time.delay_s
        last = self._inversion.motor_voltage(self._dead_time.last_sent)
        loads = self._loads.forces(self.model.path_velocities(state, goals, self.period))
        return self._tracker.command(self._dead_time.predict(state), goals, last, elapsed_s, loads)

    def _reach(self, measured: Array, goal: Array) -> Array:
        """Return motor voltages (B, drives) for measured states (B, 2 n) and constant goals (B, axes), m."""
        model = self.model
        state = self._dead_time.predict(measured)
        load_force = self._loads.coming_force(state)
        feedforward, effect_force = self._feedforward(state, measured, load_force)
        error = state - model.goal_state(goal)
        load_stretch = model.static_stretch(load_force, goal)
        stretching = load_stretch - model.static_stretch(self._loads.last_force, goal)  # m per period
        moved = (measured - self._state)[:, : len(model.mass)] - stretching
        at_rest = np.abs(moved).max(axis=1) <= REST_TRAVEL_M
        measured_stretch = model.elastic_travel(error) - load_stretch
        self._update_stretch(measured_stretch, model.static_stretch(effect_force, goal), at_rest)
        error[:, : len(model.mass)] -= self._stretch + load_stretch
        error[:, len(model.mass) :] -= stretching / self.period
        shortest = self.transfers.shortest
        at_least = np.minimum(shortest + self._moving // (SETTLING_ALLOWANCE * shortest), self._longest_hold)
        # The feedforward shifts the admissible range: friction helps to brake.
        limit = VOLTAGE_HEADROOM * model.rated
        transfer = self.transfers.select(error, goal, (-limit - feedforward, limit - feedforward), at_least)
        # A correction may need one period more than the minimum and still counts as settling.
        settling = transfer.periods <= at_least + 1
        self._settling = np.where(settling, self._settling + 1, 0)
        approaching = transfer.periods > at_least + APPROACH_MARGIN * shortest
        self._moving = np.where(approaching, 0, self._moving + ~at_rest)
        return np.clip(transfer.volts + feedforward, -model.rated, model.rated)

    def _feedforward(self, state: Array, measured: Array, load_force: Array) -> tuple[Array, Array]:
        """Return the feedforward voltage (B, drives) and the force of the machine's effects (B, n), N."""
        model = self.model
        elapsed_s = self._elapsed.astype(np.float64) * self.period
        effect_force = model.effect_force(state, elapsed_s)
        modeled = (effect_force + model.friction_force(state, elapsed_s)) @ model.rigid
        load, last_load = (force @ model.rigid for force in (load_force, self._loads.last_force))
        arrived = self._inversion.motor_voltage(self._dead_time.mean_arrived())
        # Stages that start an episode have no last period; they are not settling either, so it is not used.
        residual = model.disturbance_force(self._state, measured, arrived, self.period) - last_load - modeled
        observed = modeled + np.clip(residual, -self._disturbance_limit, self._disturbance_limit)
        return -model.voltage(np.where(self._settling[:, None] > 0, observed, modeled) + load), effect_force

    def _update_stretch(self, measured: Array, modeled: Array, at_rest: NDArray[np.bool_]) -> None:
        """Update the motor reference from the measured stretch (B, n) while settling, else from the model."""
        filtered = self._stretch + STRETCH_FILTER_GAIN * at_rest[:, None] * (measured - self._stretch)
        self._stretch = np.where(self._settling[:, None] > 0, filtered, modeled)
