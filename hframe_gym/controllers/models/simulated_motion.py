"""Simulation of the machine of a controller's model, including the states that no sensor measures.

A state of `MotionModel` holds travel and velocity of the coordinates of tool and drives. The motion also
depends on states that are not measured, here called the memory of the machine: the states of effects, such as
a hysteresis, the heat of a winding, or the rotation of an eccentric pulley since the episode started, and the
deflection of a load that swings slowly on its carriage. If each control period were simulated without the
memory of the one before, the controller would take the travel that an eccentric pulley adds for a stretched
belt, and thus for a force of tens of newtons.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...arrays import Array, ParameterRows, Times, TravelStates
from ...dynamics import instances_with_state, simulate_batch
from .motion_model import MotionModel


class SimulatedMotion:
    """Simulations of B machines, each from a state of the controller's model and a memory.

    A row of the memories, shape (B, M), holds the deflections of slow loads (m or rad), their rates (m/s or
    rad/s), and the states of effects (SI). All are zero at the start of an episode, where the machine rests.

    Attributes:
        memory_size: Number M of entries of a memory.
    """

    def __init__(self, model: MotionModel) -> None:
        self._machine = machine = model.simulated
        names, modeled = machine.coordinate_names, model.machine.coordinate_names
        n, effects = len(names), len(instances_with_state(machine))
        in_model = np.array([names.index(name) for name in modeled], np.intp)
        loads = np.array([i for i, name in enumerate(names) if name not in modeled], np.intp)
        self._state_columns = np.concatenate([in_model, n + in_model])
        self._memory_columns = np.concatenate([loads, n + loads, 2 * n + np.arange(effects)]).astype(np.intp)
        self.memory_size = len(self._memory_columns)
        self._travel_per_unit = np.tile(model.machine.travel_per_unit, 2)
        parameters = list(machine.parameters)
        self._parameter_columns = [parameters.index(name) for name in model.machine.parameters]
        self._parameters = np.array(list(machine.parameters.values()))
        # Deflection and rate of each load in the memory, and travel and velocity of its carriage in the
        # state.
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
        """Simulate machines from given states and memories.

        Args:
            memory: Memories, shape (B, M).
            volts: Commanded voltages, held from each time until the next, V, shape (B, N, drives).
            parameters: Parameters of the model's machine, shape (B, parameters). Default: its own.
            **options: Keyword arguments of `simulate_batch`: `longest_step`, `parallel`.

        Returns:
            States of the model, shape (B, N, 2 n), and memories, shape (B, N, M), at all times.
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
        """Correct the deflections of slow loads in simulated memories by measured states.

        Where the carriage of a load is measured ahead of its simulation, the load itself is assumed to be
        where the simulation has it: its deflection from the carriage is smaller by the difference, and so is
        its rate. States of effects stay as simulated.

        Args:
            memory: Memories at the end of the simulation, shape (B, M).
            simulated: States at the end of the simulation.
            measured: Measured states at that time.

        Returns:
            Memories, shape (B, M), new.
        """
        result = memory.copy()
        ahead = (measured - simulated) / self._travel_per_unit
        result[:, self._load_columns] -= ahead[:, self._carriage_columns]
        return result
