"""Which parameters are free: one torque constant of each group of coordinates sets the unit of force."""

import dataclasses

import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.identification.predict.free_parameters import default_free_parameters
from hframe_gym.machine import BUILTIN_MACHINES, Machine, Sensor

TENSION = Sensor("left_N", {"left": 1.0}, 0.1, 0.0, "belt-force")


def built_in(name: str, *sensors: Sensor) -> Machine:
    machine = BUILTIN_MACHINES[name]()
    return machine.replace(sensors=(*machine.sensors, *sensors))


@pytest.mark.parametrize(
    ("machine", "free"),
    [
        (built_in("hframe"), ["motor2.Kt"]),
        (built_in("hframe", TENSION), ["motor1.Kt", "motor2.Kt"]),
        (built_in("xy-table"), []),  # nothing connects its axes
        (built_in("xy-table").with_effects(EFFECTS["payload_swing"].at("y", f0=2.0, zeta=0.01, r=0.2)), []),
        (built_in("printer"), ["motor2.speed_gain"]),
    ],
)
def test_one_drive_of_each_group_of_coordinates_sets_the_unit_of_force(
    machine: Machine, free: list[str]
) -> None:
    names = [p.name for p in default_free_parameters(machine)]
    assert [name for name in names if name.endswith((".Kt", ".speed_gain"))] == free


@pytest.mark.parametrize(
    ("kind", "free"),
    [
        ("voltage", ["motor.resistance"]),
        ("duty-cycle", ["motor.resistance"]),
        ("current", []),
        ("torque", []),
    ],
)
def test_a_measured_current_frees_the_resistance_of_drives_that_do_not_control_it(
    kind: str, free: list[str]
) -> None:
    machine = built_in("motor", Sensor("motor_A", {"motor": 1.0}, 0.02, 0.0, "current"))
    [drive] = machine.drives
    if kind in ("current", "torque"):
        drive = dataclasses.replace(drive, kind=kind, Ke=0.0, resistance=1.0)
    machine = machine.replace(drives=(dataclasses.replace(drive, kind=kind),))
    names = [p.name for p in default_free_parameters(machine)]
    assert [name for name in names if name.endswith(".resistance")] == free
    assert set(names) <= set(machine.parameters)


def test_idlers_free_the_lengths_of_the_belts_that_they_divide() -> None:
    """Sections beside the motors keep their length, those tied to them do not: EA had compensated for it."""
    values = {"J_left": 5e-5, "J_right": 5e-5, "B_left": 1e-3, "B_right": 1e-3}
    stage = built_in("hframe")
    divided = stage.with_effects(EFFECTS["idler_inertia"].at("machine", **values))
    lengths = [
        {p.name for p in default_free_parameters(m, effects=False) if p.name.endswith(".rest_length")}
        for m in (stage, divided)
    ]
    assert lengths[0] == lengths[1] == {f"{belt}.rest_length" for belt in ("left", "right", "bottom")}
