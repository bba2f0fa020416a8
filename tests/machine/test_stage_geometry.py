"""The preset corexy, and the recognition and the plan views of stages."""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import Any

import numpy as np
import pytest

from hframe_gym.dynamics import mode_frequencies, simulate
from hframe_gym.machine import (
    BUILTIN_MACHINES,
    BeltGeometry,
    CoreXYGeometry,
    Machine,
    StageGeometry,
    motion_limits,
    rest_state,
    rigid_motions,
    stage_geometry,
)

COREXY = BUILTIN_MACHINES["corexy"]()


def with_bridge_along_x(machine: Machine) -> Machine:
    """Exchange the masses of x and y."""
    x, y, *others = machine.coordinates
    masses = (dataclasses.replace(x, mass=y.mass), dataclasses.replace(y, mass=x.mass))
    return machine.replace(coordinates=(*masses, *others))


def with_two_belts(machine: Machine) -> Machine:
    """Leave only the short sections, under other names."""
    belts = [
        dataclasses.replace(b, name=f"b{i}") for i, b in enumerate(machine.belts) if b.name.endswith("short")
    ]
    return machine.replace(belts=tuple(belts), ties={})


def test_kinematics_of_corexy() -> None:
    """x = (p1 + p2) / 2 and y = (p1 - p2) / 2 with p = radius * phi."""
    radius = COREXY.coordinate("phi1").radius
    motions = rigid_motions(COREXY)
    np.testing.assert_allclose(motions["x"] * [1, 1, radius, radius], [1, 0, 1, 1], atol=1e-12)
    np.testing.assert_allclose(motions["y"] * [1, 1, radius, radius], [0, 1, 1, -1], atol=1e-12)
    np.testing.assert_allclose(COREXY.belt_matrix @ rest_state(COREXY, [0.1, -0.07])[:4], 0.0, atol=1e-15)


def test_modes_of_corexy_follow_from_two_masses_and_two_sections_in_parallel() -> None:
    short, long = (b for b in COREXY.belts if b.name.startswith("belt1"))
    stiffness = 2 * (short.EA / short.rest_length + long.EA / long.rest_length)  # N/m, of both belts
    rotors = 2 * COREXY.coordinate("phi1").mass / COREXY.coordinate("phi1").radius ** 2  # kg
    expected = [
        math.sqrt(stiffness * (1 / COREXY.coordinate(axis).mass + 1 / rotors)) / math.tau
        for axis in ("y", "x")
    ]
    np.testing.assert_allclose(mode_frequencies(COREXY)[2:], expected, rtol=1e-9)


@pytest.mark.parametrize(("volts", "axis"), [((3.0, 3.0), 0), ((3.0, -3.0), 1)])
def test_corexy_moves_along_one_axis_at_the_speed_that_the_balance_of_forces_gives(
    volts: tuple[float, float], axis: int
) -> None:
    time = np.arange(300) * 1e-3
    motion = simulate(COREXY, time, np.tile(volts, (300, 1)))
    name = ("x", "y")[axis]
    assert abs(motion.positions[-1, 1 - axis]) < 1e-9
    slow = COREXY.replace(drives=tuple(dataclasses.replace(d, rated_voltage=3.0) for d in COREXY.drives))
    limit = motion_limits(slow)[name]
    time_constant = limit.inertia * limit.speed / limit.force
    expected = limit.speed * (1 - math.exp(-time[-1] / time_constant))
    assert motion.velocities[-1, axis] == pytest.approx(expected, rel=0.02)


def test_motion_limits_of_a_single_axis() -> None:
    """Check 50 rad/m: 12 V * 50 * 0.05 / 1 - 1 N, and a damping of 5 + 50^2 * 0.05^2 Ns/m."""
    limit = motion_limits(BUILTIN_MACHINES["axis"]())["x"]
    assert (limit.inertia, limit.force) == pytest.approx((1.0, 29.0))
    assert limit.speed == pytest.approx(29.0 / 11.25)


def test_motion_limits_of_a_servo_are_those_of_its_set_points() -> None:
    """Its friction alone, 1 mNms, would permit 190 rad/s."""
    servo = BUILTIN_MACHINES["servo"]()
    assert motion_limits(servo)["horn"].speed == 10.0
    (drive,) = servo.drives
    gains = {name: drive.law_parameters[name] for name in ("speed_gain", "torque_limit")}
    of_speed = dataclasses.replace(drive, kind="speed", rated_voltage=6.0, law_parameters=gains)
    assert motion_limits(servo.replace(drives=(of_speed,)))["horn"].speed == 6.0


@pytest.mark.parametrize(
    ("machine", "kind"),
    [
        (BUILTIN_MACHINES["hframe"](), BeltGeometry),
        (BUILTIN_MACHINES["hframe-order20"](), BeltGeometry),
        (COREXY, CoreXYGeometry),
        (with_bridge_along_x(COREXY), CoreXYGeometry),
        (with_two_belts(COREXY), CoreXYGeometry),
        (COREXY.replace(belts=(), ties={}), StageGeometry),
    ],
    ids=["hframe", "order20", "corexy", "bridge along x", "two belts", "no belts"],
)
def test_the_kinematics_choose_the_plan_view(machine: Machine, kind: type) -> None:
    assert type(stage_geometry(machine)) is kind


def test_motors_that_pull_one_axis_each_are_neither() -> None:
    short1, _, short2, _ = COREXY.belts
    belts = (
        dataclasses.replace(short1, extension={"x": 1.0, "phi1": -1.0}, length={}),
        dataclasses.replace(short2, extension={"y": 1.0, "phi2": -1.0}, length={}),
    )
    geometry = stage_geometry(COREXY.replace(belts=belts, ties={}))
    assert type(geometry) is StageGeometry
    assert geometry.sections(0.0, 0.0) == {}


@pytest.mark.parametrize("machine", [COREXY, with_bridge_along_x(COREXY), with_two_belts(COREXY)])
def test_drawn_sections_become_longer_as_their_belts_do(machine: Machine) -> None:
    geometry = stage_geometry(machine)
    start = {name: _length(points) for name, points in geometry.sections(0.0, 0.0).items()}
    moved = {name: _length(points) for name, points in geometry.sections(0.05, 0.02).items()}
    position = {"x": 0.05, "y": 0.02}
    seen = set()
    for section, belt in geometry.belts.items():
        declared = machine.belt(belt)
        change = sum(factor * position[name] for name, factor in declared.length.items())
        sign = 1.0 if machine.belts[0].name == "belt1_short" or section.startswith("front") else -1.0
        assert moved[section] - start[section] == pytest.approx(sign * change, abs=1e-9), section
        seen.add(belt)
    assert seen == {b.name for b in machine.belts}


def test_an_h_frame_whose_bridge_moves_along_y_is_drawn_with_x_and_y_exchanged() -> None:
    hframe = BUILTIN_MACHINES["hframe"]()
    ranges = [(-0.2, 0.3), (-0.1, 0.15)]
    x, y, *others = hframe.coordinates

    def geometry_of(
        x_mass: float, y_mass: float, x_range: tuple[float, float], y_range: tuple[float, float]
    ) -> Any:
        axes = (
            dataclasses.replace(x, mass=x_mass, range=x_range),
            dataclasses.replace(y, mass=y_mass, range=y_range),
        )
        return stage_geometry(hframe.replace(coordinates=(*axes, *others)))

    along_x, along_y = geometry_of(4.0, 2.0, *ranges), geometry_of(2.0, 4.0, *ranges[::-1])
    assert type(along_y) is BeltGeometry
    # a mirror image turns inversely
    assert (along_y.belts, along_y.motors) == (along_x.belts, ((1, -1.0), (3, -1.0)))
    assert along_y.pulleys(-0.04, 0.07) == [point[::-1] for point in along_x.pulleys(0.07, -0.04)]
    for name, points in along_y.sections(-0.04, 0.07).items():
        assert points == [point[::-1] for point in along_x.sections(0.07, -0.04)[name]]
    for method, arguments in (("bridge", ((-0.04, 0.07), (0.07, -0.04))), ("rails", ((), ()))):
        drawn, expected = (getattr(g, method)(*a) for g, a in zip((along_y, along_x), arguments, strict=True))
        assert drawn == [(b, a, d, c) for a, b, c, d in expected]


def test_both_belts_of_corexy_end_at_the_carriage_and_meet_at_their_motors() -> None:
    geometry = stage_geometry(COREXY)
    sections = geometry.sections(0.03, -0.04)
    for number in "12":
        front, rear = sections[f"front{number}"], sections[f"rear{number}"]
        assert front[0] == pytest.approx(rear[0])  # below the motor
        assert {front[-1][0], rear[-1][0]} == {0.03}
    for a, b in itertools.combinations(geometry.pulleys(0.03, -0.04), 2):
        assert math.dist(a, b) > 2 * geometry.radius


def _length(points: list[tuple[float, float]]) -> float:
    """Return the length of a line, m."""
    return sum(math.dist(a, b) for a, b in itertools.pairwise(points))
