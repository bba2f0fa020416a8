"""The MJCF and URDF exports load in MuJoCo, which moves them like the simulator."""

from __future__ import annotations

import dataclasses
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.errors import InputError
from hframe_gym.exporters import EXPORTERS
from hframe_gym.machine import Machine, Sensor, motion_limits, with_constant_stiffness
from hframe_gym.recordings import load_machine


def exported(kind: str, machine: Machine, **options: object) -> str:
    [text] = EXPORTERS.get(kind)(machine=machine, **options).files(machine).values()  # type: ignore[call-arg, attr-defined]
    return str(text)


def as_mjcf_describes(machine: Machine) -> Machine:
    """Return the machine of constant belt stiffness and without dry friction, a soft constraint in MuJoCo."""
    constant = with_constant_stiffness(machine, {b.name: b.EA / b.rest_length for b in machine.belts})
    return dataclasses.replace(
        constant, coordinates=tuple(dataclasses.replace(c, coulomb=0.0) for c in machine.coordinates)
    )


@pytest.mark.parametrize("name", ["hframe", "corexy", "axis", "hframe-order20", "equal masses"])
def test_mujoco_moves_the_model_like_the_simulator(name: str) -> None:
    mujoco = pytest.importorskip("mujoco", reason="needs mujoco: pip install '.[mujoco]'")
    machine = load_machine("hframe" if name == "equal masses" else name)
    if name == "equal masses":
        machine = machine.replace({"y.mass": machine.parameters["x.mass"]})
    machine = as_mjcf_describes(machine)
    model = mujoco.MjModel.from_xml_string(exported("mjcf", machine, integrator="RK4", step=1e-4))
    data = mujoco.MjData(model)
    time_s = np.arange(201) * 1e-3
    rated = np.array([d.rated_voltage for d in machine.drives])
    levels = np.random.default_rng(0).uniform(-0.25, 0.25, (5, len(rated))) * rated
    inputs = np.repeat(levels, 50, axis=0)[:201]
    expected = simulate(machine, time_s, inputs)
    order = [model.joint(c).qposadr[0] for c in machine.coordinate_names]
    positions = np.zeros((201, len(order)))
    for row in range(1, 201):
        data.ctrl[:] = inputs[row - 1]
        mujoco.mj_step(model, data, 10)
        positions[row] = data.qpos[order]
    scale = np.abs(expected.positions).max(axis=0)
    assert np.abs(positions - expected.positions).max() <= 1e-5 * scale.max()
    assert model.nu == len(machine.drives)


def test_the_sensors_have_the_names_of_the_channels(hframe: Machine) -> None:
    others = Sensor("vx_m_s", {"x": 1.0}, kind="speed"), Sensor("i1_A", {"motor1": 1.0}, kind="current")
    root = ElementTree.fromstring(exported("mjcf", hframe.replace(sensors=(*hframe.sensors, *others))))
    assert [s.get("name") for s in root.iter("jointpos")] == list(hframe.output_channels)  # of positions
    assert [m.get("name") for m in root.iter("motor")] == list(hframe.input_channels)


def test_the_stiffness_is_that_of_the_operating_point(hframe: Machine) -> None:
    root = ElementTree.fromstring(exported("mjcf", hframe, at=["x=0.1", "y=0.05"]))
    left = next(f for f in root.iter("fixed") if f.get("name") == "left")
    belt = hframe.belts[0]
    assert float(str(left.get("stiffness"))) == pytest.approx(belt.EA / (belt.rest_length + 0.15))


@pytest.mark.parametrize("name", ["hframe", "corexy"])
def test_a_urdf_has_masses_and_limits(name: str) -> None:
    machine = load_machine(name)
    text = exported("urdf", machine)
    root = ElementTree.fromstring(text)
    masses = sorted(float(str(m.get("value"))) for m in root.iter("mass"))
    assert sum(masses) == pytest.approx(max(c.mass for c in machine.coordinates))
    assert masses[0] == pytest.approx(min(machine.coordinate(a).mass for a in machine.tool_axes))
    for joint in root.iter("joint"):
        axis, limit = str(joint.get("name")), joint.find("limit")
        assert limit is not None
        assert (float(str(limit.get("lower"))), float(str(limit.get("upper")))) == machine.coordinate(
            axis
        ).range
        assert float(str(limit.get("velocity"))) == pytest.approx(motion_limits(machine)[axis].speed)
        friction = sum(
            c.coulomb / (c.radius if c.kind == "rotary" else 1.0)
            for c in machine.coordinates
            if c.kind == "rotary"
        )
        friction += machine.coordinate(axis).coulomb
        assert float(str(limit.get("effort"))) == pytest.approx(motion_limits(machine)[axis].force + friction)
    mujoco = pytest.importorskip("mujoco", reason="needs mujoco: pip install '.[mujoco]'")
    assert mujoco.MjModel.from_xml_string(text).nv == 2


def test_other_machines_are_refused_by_name(hframe: Machine) -> None:
    resonance = EFFECTS["frame_resonance"].at("x", f0=20.0, zeta=0.1, r=0.1, s=0.0)
    for kind in ("mjcf", "urdf"):
        with pytest.raises(
            InputError, match=r"only a tool with one or two axes and pulleys .* it also has frame"
        ):
            exported(kind, hframe.with_effects(resonance))
    unlimited = dataclasses.replace(
        hframe, coordinates=tuple(dataclasses.replace(c, range=None) for c in hframe.coordinates)
    )
    with pytest.raises(InputError, match="a prismatic joint of URDF has limits, but x, y has no range"):
        exported("urdf", unlimited)
