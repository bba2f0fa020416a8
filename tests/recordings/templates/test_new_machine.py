"""New machines from templates: options, comments, and what is refused."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hframe_gym.dynamics import mode_frequencies, simulate
from hframe_gym.errors import InputError
from hframe_gym.evaluation import evaluate
from hframe_gym.machine import BUILTIN_MACHINES, SENSOR_KINDS, SensorKind, motion_limits, rigid_motions
from hframe_gym.recordings import (
    TEMPLATES,
    MachineOptions,
    load_machine,
    new_machine,
    template_questions,
    write_machine_template,
)


@pytest.mark.parametrize("like", TEMPLATES)
def test_a_template_without_options_is_the_built_in_machine_with_comments(like: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.json"
    write_machine_template(like, new_machine(like, "mine", MachineOptions()), path)
    machine, preset = load_machine(path), BUILTIN_MACHINES[like]()
    assert machine.name == "mine"
    assert machine.parameters == preset.parameters
    assert machine.sensors == preset.sensors
    content = json.loads(path.read_text())
    assert "SI units" in content["comment"][0]
    for key in ("coordinates", "drives", "sensors"):
        assert content[key][0]["comment"]
    assert (
        max(len(line) for line in path.read_text().splitlines() if "comment" not in line and "    " in line)
        <= 120
    )


@pytest.mark.parametrize(
    ("kind", "channels", "values"),
    [
        ("duty-cycle", ["duty1", "duty2"], (0.05, 0.05, 2.0, 24.0)),
        ("current", ["i1_A", "i2_A"], (0.05, 0.0, 1.0, 12.0)),
        ("torque", ["torque1_Nm", "torque2_Nm"], (1.0, 0.0, 1.0, 0.6)),
    ],
)
def test_a_motor_with_another_command_keeps_its_largest_force(
    kind: str, channels: list[str], values: tuple[float, ...], tmp_path: Path
) -> None:
    options = MachineOptions(Kt=0.05, resistance=2.0, rated_voltage=24.0)
    voltage = new_machine("corexy", "mine", options)
    write_machine_template(
        "corexy", new_machine("corexy", "mine", dataclasses.replace(options, drive=kind)), tmp_path / "m.json"
    )
    machine = load_machine(tmp_path / "m.json")
    assert [d.channel for d in machine.drives] == channels
    drive = machine.drives[0]
    assert (drive.Kt, drive.Ke, drive.resistance, drive.rated_voltage) == values
    assert motion_limits(machine)["x"].force == pytest.approx(motion_limits(voltage)["x"].force)


@pytest.mark.parametrize(("like", "torque"), [("printer", 0.48), ("corexy", 0.48), ("axis", 0.6)])
def test_steppers_take_the_place_of_other_motors_and_vibrate_less_than_without_damping(
    like: str, torque: float, tmp_path: Path
) -> None:
    write_machine_template(like, new_machine(like, "m", MachineOptions(drive="stepper")), tmp_path / "m.json")
    machine = load_machine(tmp_path / "m.json")
    drive = machine.drives[0]
    assert (drive.kind, drive.law_parameters["holding_torque"]) == ("stepper", torque)
    assert drive.channel.startswith("command")
    before = load_machine(like).coordinate(drive.coordinate).viscous
    assert machine.coordinate(drive.coordinate).viscous > 1.5 * before
    time_s = np.arange(400) * 1e-3
    command = np.minimum(time_s, 0.2)[:, None] * np.full(len(machine.drives), 0.1 / drive.gear_ratio)
    motion = simulate(machine, time_s, command).outputs
    assert np.ptp(motion[-50:], axis=0).max() < 0.05 * np.ptp(motion, axis=0).max()


FURTHER_SENSORS = [  # template, option, channel, unit
    ("corexy", "speed@x", "x_m_s", "m/s"),
    ("corexy", "unsigned-speed@phi1", "phi1_rad_s", "rad/s"),
    ("corexy", "acceleration@y", "y_m_s2", "m/s^2"),
    ("corexy", "current@motor1", "motor1_A", "A"),
    ("corexy", "belt-force@belt1_short", "belt1_short_N", "N"),
    ("corexy", "laser@phi1", "phi1_laser_rad", "rad"),  # phi1_rad exists
    ("motor", "absolute-angle@shaft", "shaft_absolute_angle_rad", "rad"),
    ("servo", "encoder@horn", "horn_encoder_rad", "rad"),
]


@pytest.mark.parametrize(("like", "sensor", "channel", "unit"), FURTHER_SENSORS)
def test_a_sensor_of_each_kind_can_be_added(
    like: str, sensor: str, channel: str, unit: str, tmp_path: Path
) -> None:
    options = MachineOptions(sensor=(sensor,), values={f"{channel}.noise": 0.01})
    write_machine_template(like, new_machine(like, "mine", options), tmp_path / "m.json")
    machine = load_machine(tmp_path / "m.json")
    added = machine.sensor(channel)
    kind, _, part = sensor.partition("@")
    assert (added.kind, added.row, added.noise) == (kind, {part: 1.0}, 0.01)
    assert machine.sensor_unit(added) == unit
    assert machine.output_channels[:-1] == new_machine(like, "mine", MachineOptions()).output_channels


def test_the_further_sensors_are_of_all_kinds_of_this_package() -> None:
    assert {sensor.partition("@")[0] for _, sensor, *_ in FURTHER_SENSORS} == {
        name for name in SENSOR_KINDS if SENSOR_KINDS.get(name).__module__.startswith("hframe_gym.")
    }


def test_options_of_a_corexy_machine() -> None:
    options = MachineOptions(
        travel=(0.4, 0.2),
        mass=(0.5, 1.5),
        pulley_radius=0.008,
        gear_ratio=3.0,
        rotor_inertia=1e-6,
        Kt=0.05,
        resistance=1.5,
        rated_voltage=36.0,
        encoder_lines=500,
        values={"x.coulomb": 2.5, "belt1_short.EA": 2e4},
    )
    machine, preset = new_machine("corexy", "mine", options), BUILTIN_MACHINES["corexy"]()
    assert machine.coordinate("x").range == (-0.2, 0.2)
    assert machine.coordinate("y").range == (-0.1, 0.1)
    assert (machine.coordinate("x").mass, machine.coordinate("y").mass) == (0.5, 1.5)
    assert machine.coordinate("phi2").mass == pytest.approx(9e-6)
    assert [(d.Kt, d.Ke, d.resistance, d.rated_voltage, d.gear_ratio) for d in machine.drives] == [
        (0.05, 0.05, 1.5, 36.0, 3.0)
    ] * 2
    assert machine.sensor("phi1_rad").resolution == pytest.approx(2 * math.pi / (2000 * 3.0))
    assert machine.parameters["x.coulomb"] == 2.5
    assert {b.EA for b in machine.belts if b.name.startswith("belt1")} == {2e4}  # tied
    # x is 0.1 m longer and y 0.1 m shorter: what the belt gains along x, it loses along y.
    assert [b.rest_length for b in machine.belts] == pytest.approx([b.rest_length for b in preset.belts])
    assert set(rigid_motions(machine)) == {"x", "y"}


def test_the_belt_of_an_axis_connects_the_pulley_and_the_carriage() -> None:
    machine = new_machine("belt-axis", "mine", MachineOptions(travel=(0.8,), mass=(2.0,), rotor_inertia=1e-5))
    assert [b.rest_length for b in machine.belts] == pytest.approx([0.36 + 0.15, 1.08 + 0.45])
    assert set(rigid_motions(machine)) == {"x"}
    radius = machine.coordinate("phi").radius
    reduced_mass = 1.0 / (1.0 / 2.0 + radius**2 / 1e-5)
    stiffness = sum(b.EA / b.rest_length for b in machine.belts)
    frequency = math.sqrt(stiffness / reduced_mass) / (2.0 * math.pi)
    assert mode_frequencies(machine)[-1] == pytest.approx(frequency, rel=1e-3)


def test_a_longer_frame_has_longer_belts_in_proportion_to_its_sides() -> None:
    machine = new_machine("corexy", "mine", MachineOptions(travel=(0.5, 0.3)))
    preset = BUILTIN_MACHINES["corexy"]()
    gain = {b.name: b.rest_length - p.rest_length for b, p in zip(machine.belts, preset.belts, strict=True)}
    # The short section ends at the middle of the bridge; the long one runs along the rear and half of the
    # bridge.
    assert gain == pytest.approx(
        {"belt1_short": 0.1, "belt1_long": 0.3, "belt2_short": 0.1, "belt2_long": 0.3}
    )


def test_a_gear_changes_the_resolution_of_the_encoders_on_the_motor_shafts() -> None:
    machine = new_machine("hframe", "mine", MachineOptions(gear_ratio=11.8))
    before = BUILTIN_MACHINES["hframe"]().sensor("phi1_rad").resolution
    assert machine.sensor("phi1_rad").resolution == pytest.approx(before / 2)


@pytest.mark.parametrize("like", ["axis", "xy-table"])
def test_a_screw_with_its_lead_and_a_gear(like: str) -> None:
    axes = len(BUILTIN_MACHINES[like]().tool_axes)
    masses = (20.0,) * axes
    options = MachineOptions(mass=masses, travel_per_turn=0.005, gear_ratio=2.0, rotor_inertia=1e-4)
    machine = new_machine(like, "screw", options)
    ratio = 2.0 * 2.0 * math.pi / 0.005  # rad of the motor per m
    assert [drive.gear_ratio for drive in machine.drives] == pytest.approx([ratio] * axes)
    assert [machine.coordinate(name).mass for name in machine.tool_axes] == pytest.approx(
        [20.0 + 1e-4 * ratio**2] * axes
    )


def test_an_axis_with_a_pulley_a_rotor_and_an_encoder_only() -> None:
    options = MachineOptions(
        travel=(0.6,),
        mass=(2.5,),
        pulley_radius=0.012,
        rotor_inertia=1e-5,
        encoder_lines=500,
        linear_sensor=False,
    )
    machine = new_machine("axis", "rig", options)
    (drive,), (sensor,) = machine.drives, machine.sensors
    assert drive.gear_ratio == pytest.approx(1 / 0.012)
    assert machine.unit("motor.gear_ratio") == "rad/m"
    assert machine.coordinate("x").mass == pytest.approx(2.5 + 1e-5 / 0.012**2)
    assert (sensor.channel, sensor.kind) == ("x_m", "encoder")
    assert sensor.resolution == pytest.approx(2 * math.pi * 0.012 / 2000)
    included = new_machine("axis", "rig", MachineOptions(mass=(2.5,), rotor_inertia=0.0))
    assert included.coordinate("x").mass == 2.5
    both = new_machine("axis", "rig", MachineOptions(encoder_lines=500))
    assert both.output_channels == ("x_encoder_m", "x_m")


@pytest.mark.parametrize(
    ("like", "kind", "channel", "largest"),
    # Largest position: half of the travel, of a pulley in the corner; speed: rated voltage / (Ke gear_ratio).
    [
        ("axis", "position", "command_m", 0.25),
        ("xy-table", "position", "command_x_m", 0.25),
        ("xy-table", "speed", "command_x_m_s", 24.0 / (0.05 * 50.0)),
        (
            "corexy",
            "position",
            "command1_rad",
            math.ceil(0.3 / BUILTIN_MACHINES["corexy"]().coordinate("phi1").radius),
        ),
        ("motor", "speed", "command_rad_s", 12.0 / 0.05),
    ],
)
def test_a_motor_behind_a_drive_that_follows_set_points_reaches_its_goals(
    like: str, kind: str, channel: str, largest: float, tmp_path: Path
) -> None:
    voltage = new_machine(like, "mine", MachineOptions()).drives[0]
    write_machine_template(like, new_machine(like, "mine", MachineOptions(drive=kind)), tmp_path / "m.json")
    machine = load_machine(tmp_path / "m.json")
    drive = machine.drives[0]
    assert (drive.kind, drive.channel) == (kind, channel)
    assert drive.rated_voltage == pytest.approx(largest, rel=1e-3)
    stall_torque = voltage.Kt * voltage.rated_voltage / voltage.resistance
    assert drive.law_parameters["torque_limit"] == pytest.approx(stall_torque, rel=1e-3)
    period = 0.002 if machine.belts else 0.01
    result = evaluate("set-point", machine, randomize="none", episodes=4, period=period)
    assert next(iter(result.scores["controllers"]["set-point"]["success"].values())) == 1.0


def test_the_loop_of_a_speed_is_as_fast_whatever_its_motor_moves() -> None:
    """Of a CoreXY, a motor that turns alone moves x and y by half of its belt."""
    machine = new_machine("corexy", "mine", MachineOptions(drive="speed", mass=(0.5, 1.5)))
    pulley = machine.coordinate("phi1")
    inertia = pulley.mass + (0.5 + 1.5) * (pulley.radius / 2.0) ** 2
    assert machine.drives[0].law_parameters["speed_gain"] == pytest.approx(100.0 * inertia, rel=1e-3)


def test_an_xy_table_has_an_encoder_on_each_motor() -> None:
    both = new_machine("xy-table", "mine", MachineOptions(encoder_lines=500))
    assert both.output_channels == ("x_encoder_m", "y_encoder_m", "x_m", "y_m")
    alone = new_machine("xy-table", "mine", MachineOptions(encoder_lines=500, linear_sensor=False))
    assert [(s.channel, s.kind) for s in alone.sensors] == [("x_m", "encoder"), ("y_m", "encoder")]


def test_a_printer_may_have_accelerometers_only() -> None:
    sensors = ("acceleration@x", "acceleration@y")
    machine = new_machine("printer", "mine", MachineOptions(linear_sensor=False, sensor=sensors))
    assert machine.output_channels == ("x_m_s2", "y_m_s2")


def test_options_of_a_motor_with_a_gear_and_of_a_wheel() -> None:
    machine = new_machine("motor", "mine", MachineOptions(mass=(3e-4,), gear_ratio=10.0, rotor_inertia=1e-6))
    assert machine.coordinate("shaft").mass == pytest.approx(4e-4)
    assert machine.sensor("shaft_rad").resolution == pytest.approx(2 * math.pi / (2000 * 10))
    wheel = new_machine("wheel", "mine", MachineOptions(encoder_lines=12, rated_voltage=12.0))
    assert wheel.drives[0].kind == "duty-cycle"
    assert wheel.sensor("wheel_rad").resolution == pytest.approx(2 * math.pi / (48 * 30))


def test_the_drives_of_a_printer_reach_the_corners_of_its_travel_and_those_of_a_belt_axis_its_ends() -> None:
    printer = new_machine("printer", "mine", MachineOptions(travel=(0.2, 0.2), pulley_radius=0.01))
    assert [d.rated_voltage for d in printer.drives] == [20.0, 20.0]  # rad; 0.1 m + 0.1 m of belt
    axis = new_machine("belt-axis", "mine", MachineOptions(travel=(1.0,), mass=(2.0,), rotor_inertia=3e-5))
    assert axis.coordinate("x").range == (-0.5, 0.5)
    assert (axis.coordinate("x").mass, axis.coordinate("phi").mass) == (2.0, 3e-5)
    assert [b.rest_length for b in axis.belts] == pytest.approx([0.61, 1.83])
    assert set(rigid_motions(axis)) == {"x"}


@pytest.mark.parametrize("name", ["belt-axis", "xy-table", "printer", "motor", "pendulum", "wheel", "servo"])
def test_a_preset_reaches_its_goals_with_the_controller_for_its_drives(name: str) -> None:
    controller = "set-point" if name in ("printer", "servo") else "pid"
    period = 0.01 if name in ("xy-table", "motor", "pendulum", "wheel", "servo") else 0.002  # belts vibrate
    result = evaluate(controller, name, randomize="none", episodes=8, period=period)
    scores = result.scores["controllers"][controller]
    widest = next(iter(scores["success"]))
    # A servo without integral action stops up to 25 mrad from its goal: friction over its stiffness, 0.01 /
    # 0.4 rad.
    errors = scores.get("final_error_mrad", scores.get("final_error_mm"))
    assert scores["success"][widest] == 1.0 or (name == "servo" and errors["mean"] < 25.0)


@pytest.mark.parametrize(
    ("like", "options", "message"),
    [
        (
            "delta",
            {},
            "choose one of hframe, corexy, printer, axis, belt-axis, xy-table, motor, pendulum, wheel, servo",
        ),
        ("corxy", {}, "did you mean 'corexy'?"),
        ("motor", {"travel": (1.0,)}, "--travel: motor has none"),
        ("servo", {"Kt": 0.1}, "--Kt: servo has none"),
        ("wheel", {"mass": (1e-3, 1e-3)}, "--mass: wheel needs 1 value,"),
        ("printer", {"encoder_lines": 100}, "--encoder-lines: printer has none"),
        ("corexy", {"travel": (0.3,)}, "--travel: corexy needs 2 values"),
        ("axis", {"mass": (1.0, 2.0)}, "--mass: axis needs 1 value,"),
        ("corexy", {"Kt": -1.0}, "--Kt -1: must be positive"),
        ("corexy", {"pulley_radius": 0.0}, "--pulley-radius 0: must be positive"),
        ("corexy", {"travel_per_turn": 0.04}, "--travel-per-turn: corexy has none"),
        ("axis", {"travel_per_turn": 5.0}, "--travel-per-turn 5: is it in millimeters"),
        (
            "xy-table",
            {"travel_per_turn": 0.005, "pulley_radius": 0.01},
            "--travel-per-turn: --pulley-radius states the same; give one of both",
        ),
        ("corexy", {"rated_voltage": math.inf}, "--rated-voltage inf"),
        ("corexy", {"travel": (300.0, 200.0)}, "--travel 300: is it in millimeters"),
        ("corexy", {"encoder_lines": 0, "linear_sensor": False}, "no sensor is left"),
        ("corexy", {"drive": "curent"}, "did you mean 'current'?"),
        (
            "servo",
            {"drive": "current"},
            "--drive: servo has none; leave it out, or begin from one that has it: --like hframe, ",
        ),
        (
            "printer",
            {"drive": "current"},
            "follow a position; choose one of position, stepper, or a template",
        ),
        ("axis", {"sensor": ("speed",)}, "--sensor speed: write KIND@PART, for example speed@x"),
        (
            "axis",
            {"sensor": ("absolute-angle@x",)},
            "absolute-angle is measured at a rotary coordinate, and 'x' is none; the machine has none",
        ),
        ("axis", {"sensor": ("sped@x",)}, "--sensor sped@x: sensor kind 'sped' is unknown"),
        (
            "corexy",
            {"sensor": ("current@x",)},
            "is measured at a drive, and 'x' is none; choose one of motor1",
        ),
        ("axis", {"sensor": ("belt-force@left",)}, "'left' is none; the machine has none"),
        ("corexy", {"values": {"x.mas": 1.0}}, "--set x.mas: there is no such parameter; there are x.mass"),
        ("corexy", {"values": {"belt1_long.EA": 1.0}}, "tied to belt1_short.EA"),
    ],
)
def test_a_wrong_option_is_named(like: str, options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as error:
        new_machine(like, "mine", MachineOptions(**options))
    assert message in str(error.value)


@pytest.mark.parametrize("like", TEMPLATES)
def test_every_sensor_to_choose_from_is_simulated(like: str, tmp_path: Path) -> None:
    (question,) = (q for q in template_questions(like) if q.option == "sensor")
    machine = new_machine(like, "mine", MachineOptions(sensor=tuple(question.choices)))
    assert len(machine.sensors) == len(BUILTIN_MACHINES[like]().sensors) + len(question.choices)
    write_machine_template(like, machine, tmp_path / "m.json")
    time_s = np.arange(5) * 1e-3
    moved = simulate(load_machine(tmp_path / "m.json"), time_s, np.ones((5, len(machine.drives))))
    assert np.all(np.isfinite(moved.outputs))


def test_the_sensors_to_choose_from_follow_from_the_registered_kinds() -> None:
    """Without those that the template has; a kind that a program registers is one of them."""

    def choices() -> dict[str, str]:
        (question,) = (q for q in template_questions("axis") if q.option == "sensor")
        return dict(question.choices)

    @SENSOR_KINDS.register("generator")
    class Generator(SensorKind):
        unit = "V"

        @staticmethod
        def signal(speed: Any) -> Any:
            return speed

    try:
        offered = choices()
    finally:
        SENSOR_KINDS.unregister("generator")
    assert offered.pop("generator@x") == "generator of x, V"
    assert offered == choices()
    assert {"speed@x": "speed of x, m/s", "current@motor": "current of motor, A"}.items() <= offered.items()
    assert not offered.keys() & {"laser@x", "absolute-angle@x"}


def test_a_value_that_the_reader_refuses_is_not_written(tmp_path: Path) -> None:
    machine = new_machine("corexy", "mine", MachineOptions(values={"x.mass": -1.0}))
    with pytest.raises(InputError, match=r"coordinates\.x\.mass: -1 must be positive"):
        write_machine_template("corexy", machine, tmp_path / "m.json")
    assert list(tmp_path.iterdir()) == []
