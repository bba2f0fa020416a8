"""Declarations of components: what follows from one line in a class and one in its docstring."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from hframe_gym.machine import BUILTIN_MACHINES, Coordinate, Drive, Number


@dataclass(frozen=True)
class Wound(Drive):
    """A drive whose winding is described.

    Attributes:
        inductance: Inductance of the winding, H.
        turns: Number of turns.
    """

    inductance: Annotated[float, Number("H", lower=0.0, role="parameter", presence="omitted")] = 0.0
    turns: Annotated[int, Number("1", 1, 1000, role="device")] = 100


def test_a_declared_number_is_a_parameter_with_unit_and_description() -> None:
    drive = Wound("motor", "v_V", "shaft", 0.05, 0.05, 1.0, 1.0, 12.0, inductance=1e-3)
    machine = BUILTIN_MACHINES["motor"]().replace(drives=(drive,))
    assert machine.parameters["motor.inductance"] == 1e-3
    assert machine.unit("motor.inductance") == "H"
    assert machine.device_parameters["motor.turns"] == 100
    assert Wound.attributes()["inductance"].description == "Inductance of the winding, H."
    changed = machine.replace({"motor.inductance": 2e-3, "motor.turns": 80.4})
    assert changed.drives[0] == Wound(
        "motor", "v_V", "shaft", 0.05, 0.05, 1.0, 1.0, 12.0, inductance=2e-3, turns=80
    )


def test_a_file_has_names_first_and_numbers_in_the_order_of_the_class() -> None:
    assert list(Coordinate.attributes()) == ["name", "kind", "mass", "viscous", "coulomb", "radius", "range"]


def test_a_kind_says_which_attributes_a_component_lacks_and_in_which_unit_the_others_are() -> None:
    torque = Drive.variant("linear", "torque")
    assert {"Ke", "resistance", "supply", "law_parameters"} == set(torque.absent)
    assert (torque.units["Kt"], torque.units["command"], torque.field("rated_voltage")) == (
        "1",
        "Nm",
        "rated_torque",
    )
    assert Drive.variant("linear", "position").units["speed_limit"] == "m/s"
    assert set(Coordinate.variant("linear").absent) == {"radius"}
