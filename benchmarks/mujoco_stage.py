"""The stage as a careful MuJoCo user would write it: what the kernel is compared with.

Four joints with diagonal inertia (the cart rides on the bridge), three fixed tendons as belts, `frictionloss` as
Coulomb friction, joint damping with the motors' back-EMF in it, motors with the gear's force per volt.  A tendon's
stiffness is constant, so it is the stage with belts of constant stiffness.  Nothing that costs time and does nothing
here is left on: no contacts, gravity, limits or sensors.
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

# MuJoCo's friction is a soft constraint that brings a speed to zero within the time constant of `solreffriction` (20 ms
# by default) and creeps by the impedance of `solimpfriction`.  `default` is what a model gets who does not know;
# `stiff` is as close to dry friction as MuJoCo allows: stopped within one step (its lower bound, two steps, is one over
# the damping it stands for), impedance next to one.
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
    """A way to run MuJoCo: integrator, constraint solver and friction softness (a key of FRICTION)."""

    integrator: str = "Euler"
    solver: str = "PGS"
    friction: str = "stiff"

    def __str__(self) -> str:
        return f"{self.integrator}, {self.solver}, {self.friction} friction"


def constant_at_centre(machine: Machine) -> Machine:
    """The machine with every belt's stiffness as at zero travel, N/m."""
    return with_constant_stiffness(machine, {b.name: b.EA / b.rest_length for b in machine.belts})


def xml(machine: Machine, step: float, choice: Choice) -> str:
    """MuJoCo's model of an H-frame with four coordinates x, y, phi1, phi2; step in s."""
    x, y, *motors = machine.coordinates

    def joint(name: str, kind: str, axis: str) -> str:
        c = machine.coordinate(name)
        damping = c.viscous + sum(d.back_emf for d in machine.drives if d.coordinate == name)
        soft = FRICTION[choice.friction].format(twice=2 * step) if c.coulomb else ""
        losses = f'damping="{damping!r}" frictionloss="{c.coulomb!r}" {soft}'
        return f'<joint name="{name}" type="{kind}" axis="{axis}" {losses}/>'

    def inertia(mass: float, moment: float) -> str:
        return f'<inertial pos="0 0 0" mass="{mass!r}" diaginertia="{moment!r} {moment!r} {moment!r}"/>'

    # The cart's mass moves with the bridge too: mass(x) is of both.
    slides = (
        f"<body>{inertia(x.mass - y.mass, 1.0)}{joint('x', 'slide', '1 0 0')}"
        f"<body>{inertia(y.mass, 1.0)}{joint('y', 'slide', '0 1 0')}</body></body>"
    )
    pulleys = "".join(f"<body>{inertia(0.1, c.mass)}{joint(c.name, 'hinge', '0 0 1')}</body>" for c in motors)
    tendons = ""
    for b in machine.belts:
        row = machine.row(b.extension) * machine.radii
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
    """A batch of stages on MuJoCo's own multi-threaded rollout."""

    def __init__(self, machine: Machine, step: float, choice: Choice, *, threads: int = 1) -> None:
        self.model = mujoco.MjModel.from_xml_string(xml(machine, step, choice))
        # MuJoCo takes one data object a thread; with nthread = 0 it works in the caller's.
        self._data = [mujoco.MjData(self.model) for _ in range(threads)]
        self._pool = _batch.Rollout(nthread=threads if threads > 1 else 0)
        self.size = mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        self._states: Array = np.zeros((0, 0, 0))

    def close(self) -> None:
        self._pool.close()

    def run(self, start: Array, controls: Array) -> Array:
        """Full states (B, steps, size) after every step, from start (B, size) under controls (B, steps, 2) V.

        Columns 1-4 are positions, 5-8 velocities.  The array is reused by the next call.
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
        """Positions (B, n + 1, 4) from rest at the origin, inputs (B, n, 2) V each held for `steps` steps."""
        start = np.zeros((len(inputs), self.size))
        states = self.run(start, np.repeat(inputs, steps, axis=1))[:, steps - 1 :: steps, 1:5]
        return np.concatenate([start[:, None, 1:5], states], axis=1)
