"""Machine: parameters, units, replacement, sensor kinds and the simulator hook."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import hframe_gym
from hframe_gym.dynamics import Equations
from hframe_gym.effects import EFFECTS
from hframe_gym.errors import InputError
from hframe_gym.machine import (
    BUILTIN_MACHINES,
    SENSOR_KINDS,
    SIMULATORS,
    Belt,
    Component,
    Coordinate,
    Drive,
    Machine,
    Sensor,
    observed_coordinates,
    require_machine,
)
from hframe_gym.registry import Registry


@pytest.mark.parametrize(("name", "expected"), [("hframe", ("x", "y", "phi1", "phi2")), ("axis", ("x",))])
def test_observed_coordinates_are_the_axes_and_the_motors_each_once(
    name: str, expected: tuple[str, ...]
) -> None:
    assert observed_coordinates(BUILTIN_MACHINES[name]()) == expected


def test_device_parameters_list_sensors_and_converters_with_their_units(hframe: Machine) -> None:
    parameters = hframe.device_parameters
    assert list(parameters)[4:6] == ["x_m.noise", "x_m.resolution"]
    assert parameters["motor1.converter_bits"] == 0
    assert parameters["motor1.voltage_range"] == 12.0  # V, the rated voltage where none is declared
    units = {name: hframe.unit(name) for name in parameters}
    assert units["phi1_rad.noise"] == "rad"
    assert units["x_m.resolution"] == "m"
    assert units["motor2.converter_bits"] == "1"
    assert units["motor2.voltage_range"] == "V"


def test_a_machine_without_its_effects_has_no_ties_to_them() -> None:
    """What an effect has added keeps its values as parameters of its own; other ties remain."""
    gap = EFFECTS["gear_backlash"].at("motor", d=1e-3, J=4e-6, F=1e-3, B=0.0, K=10.0, Z=0.5)
    whole = BUILTIN_MACHINES["motor"]().with_effects(gap)
    assert whole.untied("shaft_load.mass") == ("gear_backlash@motor.J", 1.0)
    bare = whole.replace(effects=())
    assert list(bare.ties) == ["shaft_load.radius"]
    assert bare.parameters["shaft_load.mass"] == 4e-6
    assert Equations(bare).parameter("shaft_load.coulomb") == 1e-3
    # With other values of the effect's parameters, those tied to them follow.
    values = whole.with_tied({"gear_backlash@motor.F": np.array([1e-3, 2e-3]), "shaft.radius": 0.5})
    np.testing.assert_array_equal(Equations(bare, values).parameter("shaft_load.coulomb"), [1e-3, 2e-3])
    assert values["shaft_load.radius"] == 0.5


@pytest.mark.parametrize(
    ("kind", "name", "message"),
    [
        ("coordinate", "phi", "no coordinate 'phi'; choose one of x, y, phi1, phi2; did you mean 'phi2'"),
        ("belt", "top", "no belt 'top'; choose one of left, right"),
        ("drive", "motor", "no drive 'motor'; choose one of motor1, motor2; did you mean 'motor2'"),
        ("sensor", "x", "no sensor 'x'; choose one of phi1_rad, phi2_rad, x_m, y_m"),
    ],
)
def test_an_unknown_component_is_refused_with_the_names_of_the_others(
    hframe: Machine, kind: str, name: str, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        getattr(hframe, kind)(name)


@pytest.mark.parametrize(
    ("component", "message"),
    [
        (Sensor("z_m", {"z": 1.0}), "Sensor 'z_m': .* no coordinate 'z'"),
        (Sensor("twist_m", {"x*yaw": 1.0, "x": 1.0}), "Sensor 'twist_m': .* no coordinate 'yaw'"),
        (
            Sensor("i_A", {"x": 1.0}, kind="current"),
            "Sensor 'i_A': .* no drive 'x'; choose one of motor1, motor2",
        ),
        (Sensor("top_N", {"top": 1.0}, kind="belt-force"), "Sensor 'top_N': .* no belt 'top'"),
        (
            Sensor("x2_m", {"x": 1.0}, kind="lasser"),
            "sensor kind 'lasser' is unknown; .* did you mean 'laser'",
        ),
        (Belt("top", 1e4, 1.0, {"phi": 1.0}), "Belt 'top': .* no coordinate 'phi'"),
        (
            Drive("motor3", "v3_V", "phi3", 0.02, 0.02, 0.7, 5.9, 12.0),
            "Drive 'motor3': .* did you mean 'phi2'",
        ),
    ],
)
def test_a_component_that_names_what_the_machine_lacks_is_refused(
    hframe: Machine, component: Component, message: str
) -> None:
    """It had failed in the first simulation, as a KeyError or "x not in tuple"."""
    with pytest.raises(InputError, match=message):
        hframe.with_components(component)


def test_components_that_are_added_together_may_name_each_other(hframe: Machine) -> None:
    added = hframe.with_components(Sensor("z_m", {"z": 1.0}), Coordinate("z", 1.0))
    assert added.sensor("z_m").coordinate == "z"


@pytest.mark.parametrize("effect", [EFFECTS["constant_force"], "constant_force"])
def test_a_definition_is_no_effect_at_a_site(hframe: Machine, effect: Any) -> None:
    with pytest.raises(InputError, match=r"EFFECTS\['constant_force'\]\.at\(SITE"):
        hframe.with_effects(effect)


@pytest.mark.parametrize("name", ["hframe", "machine.json", None])
def test_a_name_is_no_machine(name: Any) -> None:
    with pytest.raises(InputError, match=f"machine is {name!r}; give a Machine"):
        require_machine(name)


def test_an_unknown_effect_is_answered_with_the_one_that_is_meant() -> None:
    with pytest.raises(KeyError, match="did you mean 'cogging'"):
        EFFECTS["coging"]


def test_a_machine_without_belts_says_so() -> None:
    with pytest.raises(InputError, match=r"no belt 'left'; it has no belts$"):
        BUILTIN_MACHINES["axis"]().belt("left")


def test_replace_changes_device_parameters_by_name(hframe: Machine) -> None:
    values = {
        "x_m.noise": 1e-5,
        "phi1_rad.resolution": 2e-4,
        "motor1.converter_bits": 10.0,
        "motor2.voltage_range": 9.0,
    }
    changed = hframe.replace(values)
    assert {name: changed.device_parameters[name] for name in values} == values
    assert changed.parameters == hframe.parameters
    assert changed.drives[0].converter_bits == 10
    with pytest.raises(KeyError, match=r"no parameter x_m\.color"):
        hframe.replace({"x_m.color": 1.0})


def test_components_take_the_place_of_those_of_their_name_or_follow_the_others(hframe: Machine) -> None:
    stiff = dataclasses.replace(hframe.belt("left"), EA=1e5)
    angle = Sensor("y", {"y": 1.0})  # the name of a coordinate, which stays
    changed = hframe.with_components(angle, stiff, ties={"right.EA": ("left.EA", 1.0)})
    assert changed.belts == tuple(stiff if b.name == "left" else b for b in hframe.belts)
    assert changed.sensors == (*hframe.sensors, angle)
    assert changed.coordinates == hframe.coordinates
    assert changed.ties == {**hframe.ties, "right.EA": ("left.EA", 1.0)}


def test_encoders_are_incremental_and_lasers_are_not(hframe: Machine) -> None:
    assert [sensor.incremental for sensor in hframe.sensors] == [True, True, False, False]


def test_a_sensor_adds_noise_and_rounds_to_its_resolution() -> None:
    kind = SENSOR_KINDS.get("encoder")
    reading = np.array([[0.0, 1.04], [2.0, 3.0]])
    measured = kind.measure(reading, noise=0.1, resolution=np.array([0.0, 0.5]), normal=np.array([1.0, -1.0]))
    np.testing.assert_allclose(measured, [[0.1, 1.0], [2.1, 3.0]])


def test_units_follow_the_kind_of_the_coordinate_at_the_site(hframe: Machine) -> None:
    machine = hframe.with_effects(
        EFFECTS["stribeck_friction"].at("x", dF=1.0, vs=0.1),
        EFFECTS["stribeck_friction"].at("phi1", dF=0.01, vs=1.0),
    )
    names = ("x.mass", "phi1.mass", "x.coulomb", "phi1.coulomb", "left.EA", "motor1.Ke", "phi1.radius")
    assert [machine.unit(name) for name in names] == ["kg", "kg m^2", "N", "Nm", "N", "Vs/rad", "m"]
    assert machine.unit("stribeck_friction@x.dF") == "N"
    assert machine.unit("stribeck_friction@phi1.dF") == "Nm"
    with pytest.raises(KeyError, match="'stribeck_friction' has no parameter 'A'"):
        machine.unit("stribeck_friction@phi1.A")
    for name in ("nobody.EA", "nobody.gear_ratio", "left.gear_ratio", "stribeck_friction@y.dF", "mass"):
        with pytest.raises(KeyError, match=f"machine 'hframe' has no parameter {name}"):
            machine.unit(name)


def test_replace_moves_tied_parameters_along(hframe: Machine) -> None:
    yawing = hframe.with_effects(EFFECTS["bridge_yaw"].at("machine", J=0.1, k=2e3, c=1.0, w=0.25))
    assert "yaw.mass" not in yawing.parameters
    assert yawing.replace({"bridge_yaw@machine.J": 0.2}).coordinate("yaw").mass == 0.2


@pytest.mark.parametrize(
    ("name", "site", "choices"),
    [
        ("cogging", "x", "motor1, motor2"),
        ("stribeck_friction", "z", "x, y, "),
        ("sensor_skew", "x", "phi1_rad, "),
    ],
)
def test_an_effect_at_a_site_that_the_machine_lacks_is_refused(
    name: str, site: str, choices: str, hframe: Machine
) -> None:
    definition = EFFECTS[name]
    effect = definition.at(site, **{p.name: p.upper for p in definition.parameters})
    with pytest.raises(
        ValueError, match=f"{name}: machine 'hframe' has no site '{site}'; choose one of {choices}"
    ):
        hframe.with_effects(effect)


def test_machine_simulate_calls_the_registered_simulator(hframe: Machine) -> None:
    from hframe_gym.dynamics import simulate

    time = np.arange(50) * 1e-3
    inputs = np.full((50, 2), -4.0)
    np.testing.assert_array_equal(
        hframe.simulate(time, inputs).outputs, simulate(hframe, time, inputs).outputs
    )


def test_without_a_simulator_the_error_names_what_to_import(
    monkeypatch: pytest.MonkeyPatch, hframe: Machine
) -> None:
    assert "default" in SIMULATORS
    monkeypatch.setattr("hframe_gym.machine.machine.SIMULATORS", Registry("simulator"))
    with pytest.raises(RuntimeError, match="import hframe_gym"):
        hframe.simulate(np.zeros(1), np.zeros((1, 2)))


def test_the_range_of_a_sensor_is_that_of_all_effects_that_limit_it(hframe: Machine) -> None:
    declared = EFFECTS["sensor_range"]
    narrower = dataclasses.replace(declared, name="narrower_range")
    limited = hframe.with_effects(
        declared.at("x_m", low=-0.1, high=0.2), narrower.at("x_m", low=-0.2, high=0.1)
    )
    assert hframe.measuring_ranges == {}
    assert limited.measuring_ranges == {"x_m": (-0.1, 0.1)}


@pytest.mark.parametrize(
    ("component", "attribute", "value", "message"),
    [
        ("x", "mass", -1.0, "x.mass is -1; it must be positive"),
        ("x", "mass", math.nan, "x.mass is nan"),
        ("y", "coulomb", -2.0, "y.coulomb is -2; it must be zero or more"),
        ("motor1", "resistance", 0.0, "motor1.resistance is 0; it must be positive"),
        ("x", "range", (0.0, math.inf), "x.range is inf; it must be between -1e[+]30 and 1e[+]30"),
    ],
)
def test_values_that_a_program_gives_a_machine_are_checked(
    component: str, attribute: str, value: Any, message: str
) -> None:
    machine = BUILTIN_MACHINES["hframe"]()
    changed: dict[str, Any] = {
        kind: tuple(dataclasses.replace(c, **{attribute: value}) if c.name == component else c for c in found)
        for kind, found in (("coordinates", machine.coordinates), ("drives", machine.drives))
    }
    impossible = machine.replace(**changed)
    with pytest.raises(InputError, match=message):
        hframe_gym.load_machine(impossible)
    with pytest.raises(InputError, match=message):
        hframe_gym.simulate(impossible, [0.0, 0.1], np.zeros((2, 2)))
    with pytest.raises(InputError, match=message):
        gym.make("HFrame-v0", machine=impossible)
