"""Model the stage in MuJoCo as a careful user would, for comparison with the kernel.

The model has four joints with diagonal inertia (the cart rides on the bridge), three fixed tendons as belts,
`frictionloss` as Coulomb friction, joint damping that includes the motors' back-EMF, and motors with the gear's force
per volt. The stiffness of a tendon is constant, so this is the stage with belts of constant stiffness. Everything that
costs time without an effect on this model is switched off: contacts, gravity, limits and sensors.
"""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
from mujoco import mjtIntegrator as Integrators
from mujoco import rollout as _batch
from numpy.typing import NDArray

from hframe_gym.machine import Machine, with_constant_stiffness

Array = NDArray[np.float64]

# MuJoCo's friction is a soft constraint: it brings a velocity to zero within the time constant of `solreffriction` (20
# ms by default) and creeps according to the impedance of `solimpfriction`. `default` uses these defaults. `stiff` is as
# close to dry friction as MuJoCo allows: the smallest permitted time constant, two steps, and an impedance near one.
FRICTION = {
    "default": "",
    "stiff": 'solreffriction="{twice} 1" solimpfriction="0.9999 0.9999 0.001 0.5 2"',
}
INTEGRATORS = (
    "Euler",
    "implicitfast",
    "implicit",
    "RK4",
    *(("discrete",) if hasattr(Integrators, "mjINT_DISCRETE") else ()),
)
SOLVERS = ("Newton", "PGS", "CG")


class Choice(NamedTuple):
    """Settings of MuJoCo: integrator, constraint solver and softness of friction (a key of `FRICTION`)."""

    integrator: str = "Euler"
    solver: str = "PGS"
    friction: str = "stiff"

    def __str__(self) -> str:
        return f"{self.integrator}, {self.solver}, {self.friction} friction"


def constant_at_center(machine: Machine) -> Machine:
    """Return the machine with the stiffness of every belt as at zero travel."""
    return with_constant_stiffness(machine, {b.name: b.EA / b.rest_length for b in machine.belts})


def xml(machine: Machine, step: float, choice: Choice) -> str:
    """Return MuJoCo's model of an H-frame with the coordinates x, y, phi1, phi2.

    Args:
        machine: Machine to model.
        step: Integration step, s.
        choice: Settings of MuJoCo.

    Returns:
        Model as XML.
    """
    x, y, *motors = machine.coordinates

    def joint(name: str, kind: str, axis: str) -> str:
        c = machine.coordinate(name)
        damping = c.viscous + sum(d.back_emf for d in machine.drives if d.coordinate == name)
        soft = FRICTION[choice.friction].format(twice=2 * step) if c.coulomb else ""
        losses = f'damping="{damping!r}" frictionloss="{c.coulomb!r}" {soft}'
        return f'<joint name="{name}" type="{kind}" axis="{axis}" {losses}/>'

    def inertia(mass: float, moment: float) -> str:
        return f'<inertial pos="0 0 0" mass="{mass!r}" diaginertia="{moment!r} {moment!r} {moment!r}"/>'

    # The cart moves with the bridge, so mass(x) is that of both.
    slides = (
        f"<body>{inertia(x.mass - y.mass, 1.0)}{joint('x', 'slide', '1 0 0')}"
        f"<body>{inertia(y.mass, 1.0)}{joint('y', 'slide', '0 1 0')}</body></body>"
    )
    pulleys = "".join(f"<body>{inertia(0.1, c.mass)}{joint(c.name, 'hinge', '0 0 1')}</body>" for c in motors)
    tendons = ""
    for b in machine.belts:
        row = machine.coefficients(b.extension) * machine.travel_per_unit
        ends = "".join(
            f'<joint joint="{n}" coef="{c!r}"/>'
            for n, c in zip(machine.coordinate_names, row.tolist(), strict=True)
            if c
        )
        stiffness = b.EA / b.rest_length
        tendons += f'<fixed name="{b.name}" stiffness="{stiffness!r}" springlength="0">{ends}</fixed>'
    drives = "".join(f'<motor joint="{d.coordinate}" gear="{d.gain!r}"/>' for d in machine.drives)
    return f"""<mujoco>
  <option timestep="{step!r}" integrator="{choice.integrator}" solver="{choice.solver}" gravity="0 0 0"/>
  <option><flag contact="disable" gravity="disable" limit="disable" sensor="disable"/></option>
  <worldbody>{slides}{pulleys}</worldbody>
  <tendon>{tendons}</tendon>
  <actuator>{drives}</actuator>
</mujoco>"""


class MujocoStage:
    """Batch of stages on MuJoCo's multi-threaded rollout.

    Args:
        machine: Machine of all stages.
        step: Integration step, s.
        choice: Settings of MuJoCo.
        threads: Number of threads.
    """

    def __init__(self, machine: Machine, step: float, choice: Choice, *, threads: int = 1) -> None:
        self.model = mujoco.MjModel.from_xml_string(xml(machine, step, choice))
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
            States after every step, shape (batch, steps, size); columns 1 to 4 are positions, 5 to 8 velocities. The
            next call reuses the array.
        """
        shape = (*controls.shape[:2], self.size)
        if self._states.shape != shape:
            self._states = np.zeros(shape)
        self._pool.rollout(
            self.model,
            self._data,
            start,
            controls,
            nstep=shape[1],
            state=self._states,
        )
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
