"""Simulate the stage in MuJoCo as a careful user would, for comparison with the kernel.

The model is that of `hframe export mjcf` without names, geometries and sensors, which would cost time: four
joints, three fixed tendons as belts of constant stiffness, `frictionloss` as Coulomb friction.
"""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco import mjtIntegrator as Integrators
from mujoco import rollout as _batch

from hframe_gym.arrays import Array
from hframe_gym.exporters.models.mujoco_model import FRICTION, model_xml
from hframe_gym.exporters.models.mujoco_model import MujocoSettings as Choice
from hframe_gym.machine import Machine, with_constant_stiffness

__all__ = ["FRICTION", "INTEGRATORS", "SOLVERS", "Choice", "MujocoStage", "constant_at_center"]

INTEGRATORS = (
    "Euler",
    "implicitfast",
    "implicit",
    "RK4",
    *(("discrete",) if hasattr(Integrators, "mjINT_DISCRETE") else ()),
)
SOLVERS = ("Newton", "PGS", "CG")


def constant_at_center(machine: Machine) -> Machine:
    """Return the machine with the stiffness of every belt as at zero travel."""
    return with_constant_stiffness(machine, {b.name: b.EA / b.rest_length for b in machine.belts})


class MujocoStage:
    """Batch of stages on MuJoCo's multi-threaded rollout.

    Args:
        machine: Machine of all stages.
        step: Integration step, s.
        choice: Settings of MuJoCo.
        threads: Number of threads.
    """

    def __init__(self, machine: Machine, step: float, choice: Choice, *, threads: int = 1) -> None:
        self.model = mujoco.MjModel.from_xml_string(model_xml(machine, step, choice))
        # MuJoCo needs one data object per thread; with nthread = 0 it works in the caller's thread.
        self._data = [mujoco.MjData(self.model) for _ in range(threads)]
        self._pool = _batch.Rollout(nthread=threads if threads > 1 else 0)
        self.size = mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        self._states: Array = np.zeros((0, 0, 0))

    def close(self) -> None:
        """Stop the threads."""
        self._pool.close()

    def run(self, start: Array, controls: Array) -> Array:
        """Simulate all stages.

        Args:
            start: Initial states, shape (batch, size).
            controls: Voltages, V, shape (batch, steps, 2).

        Returns:
            States after every step, shape (batch, steps, size); columns 1 to 4 are positions, 5 to 8
            velocities. The next call reuses the array.
        """
        shape = (*controls.shape[:2], self.size)
        if self._states.shape != shape:
            self._states = np.zeros(shape)
        self._pool.rollout(self.model, self._data, start, controls, nstep=shape[1], state=self._states)
        return self._states

    def positions(self, inputs: Array, steps: int) -> Array:
        """Simulate voltage histories from rest at the origin.

        Args:
            inputs: Voltages, V, shape (batch, n, 2).
            steps: Number of integration steps for which each voltage is held.

        Returns:
            Positions x, y, phi1, phi2, shape (batch, n + 1, 4).
        """
        start = np.zeros((len(inputs), self.size))
        states = self.run(start, np.repeat(inputs, steps, axis=1))[:, steps - 1 :: steps, 1:5]
        return np.concatenate([start[:, None, 1:5], states], axis=1)
