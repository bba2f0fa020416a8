"""MuJoCo model (MJCF) of a stage."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from typing_extensions import override

from ..errors import InputError
from ..machine import Machine
from .base import EXPORTERS, Files, MachineExporter, indented, operating_point, option, xml_comment
from .models.mujoco_model import MujocoSettings, model_xml

_STEP_LIMITS = (1e-6, 0.1)  # s


@EXPORTERS.register("mjcf")
@dataclass(frozen=True, kw_only=True)
class MjcfExporter(MachineExporter):
    """Write a MuJoCo model of a stage with voltages as controls and the machine's sensors.

    Belts have the constant stiffness of the operating point, Coulomb friction is MuJoCo's soft constraint,
    and effects are not modeled; docs/export.md has the deviations from the simulator of this package.

    Example:  hframe export mjcf --machine hframe --out stage.xml
    """

    at: list[str] | None = option(
        None, "Operating point of the belt stiffness as AXIS=POSITION; repeat for more axes."
    )
    step: float = option(0.0005, "Integration step in seconds.")
    integrator: Literal["Euler", "implicitfast", "implicit", "RK4"] = option("Euler", "Integrator of MuJoCo.")
    friction: Literal["stiff", "default"] = option(
        "stiff", "stiff: as close to dry friction as MuJoCo allows; default: MuJoCo's defaults, which creep."
    )

    @override
    def files(self, machine: Machine) -> Files:
        """Write stage.xml, the model of MuJoCo.

        Raises:
            InputError: If the step is out of range, or `model_xml` cannot describe the machine.
        """
        if not _STEP_LIMITS[0] <= self.step <= _STEP_LIMITS[1]:
            raise InputError(
                f"--step {self.step:g}: must be from {_STEP_LIMITS[0]:g} s to {_STEP_LIMITS[1]:g} s"
            )
        settings = MujocoSettings(self.integrator, "PGS", self.friction)
        text = model_xml(machine, self.step, settings, operating_point(machine, self.at), drawn=True)
        pretty = indented(text)
        header = self.header(
            machine,
            "Units: SI; controls are drive voltages, V. "
            "Sensors read joint positions without noise and rounding.",
            "Not modeled: effects of the machine, the change of belt stiffness with the position, end stops.",
        )
        return {"stage.xml": xml_comment(header) + pretty}
