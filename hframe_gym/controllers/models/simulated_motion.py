"""Simulation of a controller's machine, period after period, with the states that no sensor measures.

A state of `MotionModel` holds travel and velocity of the coordinates of tool and drives. The motion also
depends on states that are not measured, here called the memory of the machine: the states of effects, such as
a hysteresis, the heat of a winding, or the rotation of an eccentric pulley since the episode started, and the
deflection of a load that swings slowly on its carriage. Each control period is simulated from the memory at
the end of the one before. Without it, the travel that an eccentric pulley adds to the belt would look like a
stretched belt, and thus like a force of tens of newtons.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...arrays import Array, ParameterRows, Times, TravelStates
from ...dynamics import instances_with_state, simulate_batch
from .motion_model import MotionModel


class SimulatedMotion:
    """Simulates a batch of B machines, each from its own state and memory.

    A row of the memories, shape (B, M), holds the deflections of slow loads from their carriages (m or rad),
    their rates (m/s or rad/s), and the states of effects (SI). All are zero at the start of an episode, where
    the machine rests.

    Args:
        model: Model with n coordinates, in whose states, belt travel, the machines start and end. Its machine
            with slow loads (`MotionModel.simulated`) is simulated.

    Attributes:
        memory_size: Number M of entries of a memory.
    """

    def __init__(self, model: MotionModel) -> None:
        self._machine = machine = model.simulated
        names, modeled = machine.coordinate_names, model.machine.coordinate_names
        n, effects = len(names), len(instances_with_state(machine))
        # Columns of a simulated state, which is: positions, then velocities of all coordinates, then effects.
        in_model = np.array([names.index(name) for name in modeled], np.intp)
        loads = np.array([i for i, name in enumerate(names) if name not in modeled], np.intp)
        self._state_columns = np.concatenate([in_model, n + in_model])
        self._memory_columns = np.concatenate([loads, n + loads, 2 * n + np.arange(effects)]).astype(np.intp)
        self.memory_size = len(self._memory_columns)
        self._travel_per_unit = np.tile(model.machine.travel_per_unit, 2)
        parameters = list(machine.parameters)
        self._parameter_columns = [parameters.index(name) for name in model.machine.parameters]
        self._parameters = np.array(list(machine.parameters.values()))
        # Columns of the deflections and rates of all loads in a memory; of the travel and velocity of their
        # carriages in a state of the model.
        sites = {e.coordinate: e.site for e in machine.effects if e.definition.reaction}
        carriages = np.array([modeled.index(sites[names[i]]) for i in loads], np.intp)
        self._load_columns = np.arange(2 * len(loads))
        self._carriage_columns = np.concatenate([carriages, len(modeled) + carriages])

    def simulate(
        self,
        state: TravelStates,
        memory: Array,
        time_s: Times,
        volts: Array,
        parameters: ParameterRows | None = None,
        **options: Any,
    ) -> tuple[Array, Array]:
        """Simulate the machines from given states and memories.

        A memory holds what a state of the model lacks: deflections of slow loads, m or rad, their rates, and
        the states of effects, SI.

        Args:
            state: States at the first time.
            memory: Memories at the first time, shape (B, M).
            volts: Commanded voltages, held from each time until the next, V, shape (B, N, drives).
            parameters: Parameters of the model's machine, shape (B, parameters). Default: its own.
            **options: Keyword arguments of `simulate_batch`: `longest_step`, `parallel`.

        Returns:
            states: States of the model at all times, travel, m, then velocity, m/s, shape (B, N, 2 n).
            memories: Memories at all times, shape (B, N, M).
        """
        start = np.empty((len(state), len(self._state_columns) + self.memory_size))
        start[:, self._state_columns] = state / self._travel_per_unit
        start[:, self._memory_columns] = memory
        rows = parameters
        if parameters is not None and len(self._parameters) > parameters.shape[1]:
            rows = np.tile(self._parameters, (len(parameters), 1))
            rows[:, self._parameter_columns] = parameters
        motion = simulate_batch(
            self._machine,
            time_s,
            volts,
            parameters=rows,
            start=start,
            readings=False,
            effects=self.memory_size > 0,
            **options,
        )
        whole = np.concatenate([motion.positions, motion.velocities, motion.effects], axis=2)
        return whole[:, :, self._state_columns] * self._travel_per_unit, whole[:, :, self._memory_columns]

    def corrected(self, memory: Array, simulated: TravelStates, measured: TravelStates) -> Array:
        """Correct the deflections of slow loads in simulated memories by the measured motion of carriages.

        A measurement corrects the position of the carriage alone; the load is assumed to be where it was
        simulated. If the carriage is ahead of its simulation, the deflection of the load, relative to the
        carriage, is therefore smaller by the difference, and so is its rate. States of effects stay as
        simulated.

        Args:
            memory: Memories (see `simulate`) at the end of the simulation, shape (B, M).
            simulated: States at the end of the simulation.
            measured: States at that time according to the sensors, from a state estimator.

        Returns:
            Memories, shape (B, M), new.
        """
        result = memory.copy()
        ahead = (measured - simulated) / self._travel_per_unit
        result[:, self._load_columns] -= ahead[:, self._carriage_columns]
        return result
