"""Kinematics of unstretched belts against eq. 1-3."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.controllers import MotionModel
from hframe_gym.effects import EFFECTS
from hframe_gym.machine import (
    BUILTIN_MACHINES,
    Belt,
    Machine,
    Uncertainty,
    effects_left_out,
    rest_positions_per_axis,
    rest_state,
    rigid_counterpart,
    rigid_motions,
    slow_loads,
)

pytestmark = pytest.mark.oracle


def test_angles_at_rest_follow_from_unstretched_belts(hframe: Machine) -> None:
    """Compare with eq. 1-2, r phi1 = -x - y and r phi2 = x - y, and their inverse, eq. 3."""
    x, y = 0.12, -0.07
    state = rest_state(hframe, (x, y))
    np.testing.assert_allclose(state[2:4] * 0.0194, [-x - y, x - y], rtol=1e-12)
    inverse = 0.5 * 0.0194 * np.array([[-1, 1], [-1, -1]])
    np.testing.assert_allclose(inverse @ state[2:4], [x, y], rtol=1e-12)


def test_positions_at_rest_are_linear_in_the_tool_position(hframe: Machine) -> None:
    """Compare with eq. 1-2, also for a machine whose pulleys come first, and for one with a single axis."""
    expected = [[1.0, 0.0], [0.0, 1.0], [-1 / 0.0194, -1 / 0.0194], [1 / 0.0194, -1 / 0.0194]]
    reordered = hframe.replace(coordinates=hframe.coordinates[::-1])
    np.testing.assert_allclose(rest_positions_per_axis(hframe), expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(
        rest_positions_per_axis(reordered), np.array(expected)[::-1, ::-1], rtol=1e-12, atol=1e-12
    )
    np.testing.assert_array_equal(rest_positions_per_axis(BUILTIN_MACHINES["axis"]()), [[1.0]])


def test_carriages_coupled_by_a_spring_have_one_rigid_motion() -> None:
    axis = BUILTIN_MACHINES["axis"]()
    first = axis.coordinate("x")
    carriages = (first, dataclasses.replace(first, name="load"))
    machine = axis.replace(
        coordinates=carriages, belts=(Belt("spring", 70.0, 0.1, {"x": -1.0, "load": 1.0}, {}),)
    )
    [(name, motion)] = rigid_motions(machine).items()
    assert name == "x"
    np.testing.assert_allclose(motion, [1.0, 1.0])


def test_rigid_motions_of_the_h_frame_are_those_of_equations_1_and_2(hframe: Machine) -> None:
    motions = rigid_motions(hframe)
    radius = 0.0194
    assert list(motions) == ["x", "y"]
    np.testing.assert_allclose(motions["x"], [1.0, 0.0, -1 / radius, 1 / radius], rtol=1e-12)
    np.testing.assert_allclose(motions["y"], [0.0, 1.0, -1 / radius, -1 / radius], rtol=1e-12)
    for motion in motions.values():
        np.testing.assert_allclose(hframe.belt_matrix @ motion, 0.0, atol=1e-12)


def test_without_belts_every_coordinate_moves_independently() -> None:
    [(name, motion)] = rigid_motions(BUILTIN_MACHINES["axis"]()).items()
    assert name == "x"
    np.testing.assert_array_equal(motion, [1.0])


def test_a_spring_loaded_coordinate_is_zero_at_rest(hframe: Machine) -> None:
    yawing = hframe.with_effects(EFFECTS["bridge_yaw"].at("machine", J=0.1, k=2e3, c=1.0, w=0.25))
    assert yawing.spring_loaded == ("yaw",)
    assert rest_state(yawing, (0.1, -0.05))[yawing.coordinate_names.index("yaw")] == 0.0


def test_a_spring_loaded_coordinate_has_no_part_in_rigid_motions(hframe: Machine) -> None:
    """With the yaw of a bridge, the motions along x and y remain those of the pulleys."""
    yawing = hframe.with_effects(EFFECTS["bridge_yaw"].at("machine", J=0.1, k=2e3, c=1.0, w=0.25))
    motions = rigid_motions(yawing)
    assert list(motions) == ["x", "y"]
    for name, motion in rigid_motions(hframe).items():
        np.testing.assert_allclose(motions[name], [*motion, 0.0], rtol=1e-12)


@pytest.mark.parametrize(
    ("name", "site", "values"),
    [
        ("bridge_yaw", "machine", {"J": 0.1, "k": 2e3, "c": 1.0, "w": 0.25}),
        ("frame_resonance", "x", {"f0": 20.0, "zeta": 0.03, "r": 0.1, "s": 0.0}),
        ("payload_swing", "y", {"f0": 8.0, "zeta": 0.05, "r": 0.3}),
        ("gear_backlash", "motor2", {"d": 2e-3, "J": 4e-5, "F": 0.02, "B": 1e-4, "K": 300.0, "Z": 0.1}),
        ("idler_inertia", "machine", {"J_left": 2e-5, "J_right": 3e-5, "B_left": 1e-4, "B_right": 2e-4}),
    ],
)
def test_controllers_know_the_machine_whose_added_parts_do_not_move(hframe, name, site, values):
    uncertainty = Uncertainty(("x.mass", f"{name}@{site}.{min(values)}"), np.diag([1e-4, 2e-4]))
    machine = hframe.with_effects(EFFECTS["bouc_wen_hysteresis"].at("x", F=1.0, L=1e-3))
    flexible = machine.with_effects(EFFECTS[name].at(site, **values))
    rigid = rigid_counterpart(dataclasses.replace(flexible, uncertainty=uncertainty))
    assert rigid.uncertainty.names == ("x.mass",)
    assert rigid.uncertainty.covariance == pytest.approx(np.array([[1e-4]]))
    assert rigid.parameters == pytest.approx(machine.parameters)
    assert dataclasses.replace(rigid, uncertainty=None).shape == machine.shape
    np.testing.assert_allclose(MotionModel(flexible).mass, MotionModel(machine).mass)
    assert rigid_counterpart(machine) is machine
    assert [effect.name for effect in effects_left_out(flexible)] == [name]


def test_structures_within_structures_are_left_out_as_well(hframe: Machine) -> None:
    """The belts of a machine with idlers run on the pulleys behind the gaps of both gears."""
    gap = {"d": 2e-3, "J": 4e-5, "F": 0.02, "B": 1e-4, "K": 300.0, "Z": 0.1}
    idlers = EFFECTS["idler_inertia"].at("machine", J_left=2e-5, J_right=3e-5, B_left=1e-4, B_right=2e-4)
    gaps = [EFFECTS["gear_backlash"].at(motor, **gap) for motor in ("motor1", "motor2")]
    rigid = rigid_counterpart(hframe.with_effects(idlers, *gaps))
    assert rigid.parameters == pytest.approx(hframe.parameters)
    assert rigid.shape == hframe.shape


def test_controllers_know_the_carriage_alone_under_a_slow_load(hframe):
    swinging = hframe.with_effects(EFFECTS["payload_swing"].at("y", f0=2.0, zeta=0.05, r=0.3))
    assert [load.label for load in slow_loads(swinging)] == ["payload_swing@y"]
    alone = rigid_counterpart(swinging)
    assert alone.parameters["y.mass"] == pytest.approx(hframe.parameters["y.mass"] / 1.3)
    assert alone.coordinate_names == hframe.coordinate_names
    assert rigid_counterpart(swinging, with_slow_loads=True) == swinging
