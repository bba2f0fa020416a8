"""machine.json: round trips, defaults of optional fields, and refusals by field."""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES, SENSOR_KINDS, Machine, SensorKind, Uncertainty
from hframe_gym.recordings import load_machine, machine_to_dict, save_machine


@pytest.mark.parametrize("name", sorted(BUILTIN_MACHINES))
def test_a_preset_survives_a_round_trip_through_its_file(name: str, tmp_path: Path) -> None:
    machine = load_machine(name)
    save_machine(machine, tmp_path / "machine.json")
    again = load_machine(tmp_path / "machine.json")
    assert again.parameters == machine.parameters
    assert again.shape == machine.shape
    assert again.sensors == machine.sensors


def test_effects_and_covariance_survive_a_round_trip(hframe: Machine, tmp_path: Path) -> None:
    machine = hframe.with_effects(EFFECTS["stribeck_friction"].at("phi1", dF=0.02, vs=1.5))
    names = ("x.mass", "stribeck_friction@phi1.dF")
    covariance = np.array([[1e-4, 1e-7], [1e-7, 4e-8]])
    machine = machine.replace(uncertainty=Uncertainty(names, covariance))
    save_machine(machine, tmp_path / "machine.json")
    again = load_machine(tmp_path / "machine.json")
    assert again.parameters == machine.parameters
    assert again.uncertainty is not None
    np.testing.assert_allclose(again.uncertainty.covariance, covariance)
    content = json.loads((tmp_path / "machine.json").read_text())
    assert content["effects"][0]["parameters"]["dF"] == {"value": 0.02, "unit": "Nm", "std": 2e-4}


def change(path: list[Any], value: Any) -> Callable[[dict[str, Any]], None]:
    def edit(content: dict[str, Any]) -> None:
        for key in path[:-1]:
            content = content[key]
        content[path[-1]] = value

    return edit


def rename(path: list[Any], field: str, other: str) -> Callable[[dict[str, Any]], None]:
    def edit(content: dict[str, Any]) -> None:
        for key in path:
            content = content[key]
        content[other] = content.pop(field)

    return edit


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (change(["coordinates", 0, "mass", "value"], -1.0), "coordinates.x.mass: -1 must be positive"),
        (change(["coordinates", 0, "mass", "unit"], "g"), "coordinates.x.mass: unit is 'g', must be 'kg'"),
        (
            change(["coordinates", 2, "coulomb", "unit"], "N"),
            "coordinates.phi1.coulomb: unit is 'N', must be 'Nm'",
        ),
        (change(["coordinates", 0, "name"], "two words"), "coordinates.two words.name"),
        (change(["coordinates", 1, "name"], "x"), "coordinates: two have the same name"),
        (change(["belts", 0, "extension"], {"z": 1.0}), "belts.left.extension: no coordinate is called 'z'"),
        (change(["drives", 0, "coordinate"], "z"), "drives.motor1.coordinate: no coordinate is called 'z'"),
        (change(["sensors", 0, "noise", "unit"], "m"), "sensors.phi1_rad.noise: unit is 'm', must be 'rad'"),
        (
            change(["sensors", 0, "kind"], "magic"),
            "sensors.phi1_rad.kind: sensor kind 'magic' is not registered; choose one of encoder",
        ),
        (
            change(["sensors", 0, "kind"], "lasr"),
            "name its Python file in the environment variable HFRAME_PLUGINS; did you mean 'laser'",
        ),
        (change(["drives", 0, "converter_bits"], 40), "drives.motor1.converter_bits"),
        (change(["sensors", 2, "range"], [0.1, -0.1]), "sensors.x_m.range: must be [lowest, highest]"),
        (change(["belts", 1, "name"], "left"), "must all differ; 'left' occurs twice"),
        (
            change(["ties"], {"x.mass": ["nothing", 1.0]}),
            "ties.x.mass: 'x.mass' and 'nothing' must be parameters",
        ),
        (
            change(["uncertainty"], {"names": ["x.mass", "y.mass"], "covariance": [[1.0], [1.0, 2.0]]}),
            "uncertainty.covariance: must be a symmetric 2 x 2 matrix",
        ),
        (
            change(["uncertainty"], {"names": ["z.mass"], "covariance": [[1.0]]}),
            "uncertainty.names: the machine has no parameter z.mass",
        ),
        (
            change(["surprise"], 1),
            "surprise: unknown field; The fields here are $schema, belts, comment, coordinates",
        ),
        (
            change(["sensors", 1, "color"], "red"),
            "sensors.phi2_rad.color: unknown field; The fields here are channel",
        ),
        (change(["coordinates", 0, "Mass"], 1), "coordinates.x.Mass: unknown field; did you mean 'mass'?"),
        (rename(["coordinates", 0], "mass", "mas"), "coordinates.x.mas: unknown field; did you mean 'mass'?"),
        (rename(["coordinates", 0], "viscous", "damping"), "coordinates.x.viscous: missing; write {"),
        (change(["drives", 0, "Kt"], 0.02), 'drives.motor1.Kt: must be a value with its unit: {"value": ...'),
        (change(["drives", 0], {}), "drives.entry 1.name: missing"),
        (change(["belts", 0, "EA"], {"value": 1.0}), "belts.left.EA.unit: missing"),
        (
            change(["drives", 0, "gear_ratio", "unit"], "rad/m"),
            "drives.motor1.gear_ratio: unit is 'rad/m', must be '1'",
        ),
        (
            change(["drives", 0, "current_limit"], {"value": 12.0, "unit": "mA"}),
            "drives.motor1.current_limit: unit is 'mA', must be 'A'",
        ),
        (
            change(["drives", 0, "supply"], "vbus_V"),
            "drives.motor1.supply: a drive of the kind 'voltage' has none; delete it",
        ),
        (
            change(["coordinates", 0, "radius"], {"value": 0.02, "unit": "m"}),
            "coordinates.x.radius: a linear coordinate has none; delete it",
        ),
        (
            change(["coordinates", 2, "radius", "value"], 1e31),
            "coordinates.phi1.radius: 1e+31 must be positive, between 1e-30 and 1e+30",
        ),
        (change(["schema"], 2), "schema"),
        (change(["drives"], []), "drives: has 0 entries, must have 1 or more"),
        (
            change(["coordinates", 0, "mass", "value"], float("nan")),
            "coordinates.x.mass.value: must be a finite number",
        ),
        (
            change(["effects"], [{"name": "magic", "site": "x", "parameters": {}}]),
            "effects.magic: no such effect",
        ),
        (
            change(["effects"], [{"name": "coging", "site": "motor1", "parameters": {}}]),
            "did you mean 'cogging'?",
        ),
        (
            change(["effects"], [{"name": "constant_force", "site": "z", "parameters": {}}]),
            "effects.constant_force: site 'z' is none of",
        ),
        (
            change(["effects"], [{"name": "constant_force", "site": "x", "parameters": {}}]),
            "effects.constant_force: effect constant_force at x takes size",
        ),
    ],
)
def test_an_error_names_file_and_field(
    edit: Callable[[dict[str, Any]], None], message: str, hframe: Machine, tmp_path: Path
) -> None:
    content = machine_to_dict(hframe)
    edit(content)
    path = tmp_path / "wrong.json"
    path.write_text(json.dumps(content))
    with pytest.raises(InputError) as error:
        load_machine(path)
    assert str(path) in str(error.value)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_a_nan_in_the_file_is_refused(hframe: Machine, tmp_path: Path) -> None:
    content = machine_to_dict(hframe)
    content["coordinates"][0]["mass"]["value"] = float("nan")
    (tmp_path / "m.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"coordinates\.x\.mass"):
        load_machine(tmp_path / "m.json")


def test_a_missing_field_is_named_with_its_component(hframe: Machine, tmp_path: Path) -> None:
    content = machine_to_dict(hframe)
    del content["drives"][1]["Kt"]
    (tmp_path / "m.json").write_text(json.dumps(content))
    with pytest.raises(InputError) as error:
        load_machine(tmp_path / "m.json")
    assert str(error.value).endswith('drives.motor2.Kt: missing; write {"value": ..., "unit": "Nm/A"}')


def test_a_file_that_is_not_json_is_refused(tmp_path: Path) -> None:
    (tmp_path / "m.json").write_text("{ // comment")
    with pytest.raises(
        InputError, match=r'm\.json: is not a machine\.json: Invalid JSON.*write them as "comment"'
    ):
        load_machine(tmp_path / "m.json")


def test_an_unknown_machine_name_lists_the_presets() -> None:
    with pytest.raises(InputError, match="hframe-linear"):
        load_machine("no-such-machine")


def test_a_file_without_sensor_kinds_gets_encoders_on_rotary_and_lasers_on_linear_coordinates(
    hframe: Machine, tmp_path: Path
) -> None:
    content = machine_to_dict(hframe)
    for sensor in content["sensors"]:
        del sensor["kind"]
    for drive in content["drives"]:
        del drive["converter_bits"]
    (tmp_path / "m.json").write_text(json.dumps(content))
    machine = load_machine(tmp_path / "m.json")
    assert [s.kind for s in machine.sensors] == ["encoder", "encoder", "laser", "laser"]
    assert [d.converter_bits for d in machine.drives] == [0, 0]


def test_a_declared_range_delay_and_current_limit_are_loaded_as_effects_and_survive_a_round_trip(
    hframe: Machine, tmp_path: Path
) -> None:
    content = machine_to_dict(hframe)
    content["sensors"][2] |= {"range": [-0.05, 0.05], "delay": {"value": 2e-3, "unit": "s"}}
    content["drives"][0] |= {"current_limit": {"value": 12.0, "unit": "A"}, "converter_bits": 12}
    content["drives"][1] |= {"voltage_range": {"value": 10.0, "unit": "V"}}
    for drive in content["drives"]:
        drive["delay"] = {"value": 1e-3, "unit": "s"}
    (tmp_path / "m.json").write_text(json.dumps(content))
    machine = load_machine(tmp_path / "m.json")
    effect_parameters = {name: value for name, value in machine.parameters.items() if "@" in name}
    assert effect_parameters == {
        "sensor_range@x_m.low": -0.05,
        "sensor_range@x_m.high": 0.05,
        "sensor_delay@x_m.d": 2e-3,
        "current_limit@motor1.I": 12.0,
        "input_delay@drives.d": 1e-3,
    }
    assert machine.drives[0].converter_bits == 12
    assert machine.drives[1].voltage_range == 10.0
    save_machine(machine, tmp_path / "again.json")
    again = load_machine(tmp_path / "again.json")
    assert again.parameters == machine.parameters
    assert again.drives == machine.drives


def test_delays_that_differ_between_drives_act_on_each_drive(hframe: Machine, tmp_path: Path) -> None:
    content = machine_to_dict(hframe)
    content["drives"][1]["delay"] = {"value": 5e-3, "unit": "s"}
    (tmp_path / "m.json").write_text(json.dumps(content))
    machine = load_machine(tmp_path / "m.json")
    assert machine.parameters["input_delay@motor2.d"] == 5e-3
    save_machine(machine, tmp_path / "again.json")
    again = load_machine(tmp_path / "again.json")
    assert again.parameters == machine.parameters


def test_an_effect_that_a_field_and_the_list_of_effects_both_declare_is_refused(
    hframe: Machine, tmp_path: Path
) -> None:
    content = machine_to_dict(hframe.with_effects(EFFECTS["sensor_delay"].at("x_m", d=1e-3)))
    content["sensors"][2]["delay"] = {"value": 2e-3, "unit": "s"}
    (tmp_path / "m.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"effects\.sensor_delay: declared twice at x_m"):
        load_machine(tmp_path / "m.json")


def test_a_sensor_kind_that_a_user_registers_is_accepted_by_the_file(hframe: Machine, tmp_path: Path) -> None:
    @SENSOR_KINDS.register("resolver")
    class Resolver(SensorKind):
        """A rotary sensor that repeats after half a turn."""

        @staticmethod
        def measure(reading: Any, noise: Any, resolution: Any, normal: Any) -> Any:
            return np.mod(reading, np.pi)

    content = machine_to_dict(hframe)
    content["sensors"][0]["kind"] = "resolver"
    (tmp_path / "m.json").write_text(json.dumps(content))
    sensor = load_machine(tmp_path / "m.json").sensors[0]
    assert not sensor.incremental
    assert SENSOR_KINDS.get(sensor.kind) is Resolver


def test_a_folder_with_a_machine_is_no_machine_but_names_it(hframe: Machine, tmp_path: Path) -> None:
    save_machine(hframe, tmp_path / "machine.json")
    with pytest.raises(InputError, match=r"did you mean '.*machine\.json'\?$"):
        load_machine(tmp_path)


def test_a_sensor_kind_in_the_file_imports_no_module(
    hframe: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "kind_in_a_file.py").write_text(
        "from hframe_gym.machine import SENSOR_KINDS, SensorKind\n"
        "SENSOR_KINDS.register('from-a-module')(type('FromAModule', (SensorKind,), {}))\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    content = machine_to_dict(hframe)
    content["sensors"][0]["kind"] = "kind_in_a_file:from-a-module"
    (tmp_path / "m.json").write_text(json.dumps(content))
    with pytest.raises(
        InputError, match=r"sensors\.phi1_rad\.kind: .* is not registered; choose one of encoder"
    ):
        load_machine(tmp_path / "m.json")
    assert "kind_in_a_file" not in sys.modules
    assert "from-a-module" not in SENSOR_KINDS


def test_the_zero_of_an_encoder_is_optional_and_survives_a_round_trip(
    hframe: Machine, tmp_path: Path
) -> None:
    assert all("zero" not in sensor for sensor in machine_to_dict(hframe)["sensors"])
    zero = {"value": -0.31, "unit": "rad", "std": 2e-3}
    content = machine_to_dict(hframe)
    content["sensors"][0]["zero"] = zero
    path = tmp_path / "machine.json"
    path.write_text(json.dumps(content))
    loaded = load_machine(path)
    assert (loaded.sensors[0].zero, loaded.sensors[0].zero_std) == (-0.31, 2e-3)
    assert machine_to_dict(loaded)["sensors"][0]["zero"] == zero
    content["sensors"][0]["zero"] = zero | {"unit": "m"}
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"sensors\.phi1_rad\.zero: unit is 'm', must be 'rad'"):
        load_machine(path)


def test_a_gear_ratio_at_a_linear_coordinate_is_in_rad_per_m_or_as_in_older_files_in_1(
    tmp_path: Path,
) -> None:
    content = machine_to_dict(BUILTIN_MACHINES["axis"]())
    assert content["drives"][0]["gear_ratio"] == {"value": 50.0, "unit": "rad/m"}
    for unit in ("rad/m", "1"):
        content["drives"][0]["gear_ratio"]["unit"] = unit
        (tmp_path / "m.json").write_text(json.dumps(content))
        assert load_machine(tmp_path / "m.json").drives[0].gear_ratio == 50.0


def test_comments_are_allowed_in_every_object_and_ignored(hframe: Machine, tmp_path: Path) -> None:
    machine = hframe.with_effects(EFFECTS["stribeck_friction"].at("x", dF=1.0, vs=0.03))
    machine = machine.replace(uncertainty=Uncertainty(("x.mass",), np.array([[1e-4]])))
    content = machine_to_dict(machine) | {"comment": ["two", "lines"], "$schema": "machine.schema.json"}
    for key in ("coordinates", "belts", "drives", "sensors", "effects"):
        content[key][0]["comment"] = "a remark"
    content["coordinates"][0]["mass"]["comment"] = "weighed"
    content["uncertainty"]["comment"] = "from run 3"
    (tmp_path / "m.json").write_text(json.dumps(content))
    again = load_machine(tmp_path / "m.json")
    assert again.parameters == machine.parameters
    assert "comment" not in json.dumps(machine_to_dict(again))


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (
            change(["coordinates", 0, "range"], [-280, 280]),
            "coordinates.x.range: 280 m: is it in millimeters?",
        ),
        (
            change(["coordinates", 2, "radius", "value"], 19.4),
            "coordinates.phi1.radius: 19.4 m: is it in millimeters?",
        ),
        (
            change(["belts", 0, "rest_length", "value"], 1395.0),
            "belts.left.rest_length: 1395 m: is it in millimeters?",
        ),
        (
            change(["belts", 0, "extension", "phi1"], 0.0194),
            "belts.left.extension.phi1: 0.0194 is not a small integer; it multiplies the belt travel",
        ),
        (
            change(["belts", 0, "extension", "phi1"], 0.0),
            "coordinates.x: cannot move without stretching a belt",
        ),
        (
            change(["belts", 0, "rest_length", "value"], 0.3),
            "belts.left.rest_length: the section would be -0.17 m long",
        ),
        (change(["sensors", 2, "channel"], "x_mm"), "call the column x_m and convert its values"),
    ],
)
def test_an_implausible_value_is_loaded_with_a_warning(
    edit: Callable[[dict[str, Any]], None], message: str, hframe: Machine, tmp_path: Path
) -> None:
    content = machine_to_dict(hframe)
    edit(content)
    path = tmp_path / "doubtful.json"
    path.write_text(json.dumps(content))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        load_machine(path)
    lines = [str(warning.message) for warning in caught]
    assert all(line.startswith(f"{path}: ") for line in lines)
    assert any(message in line for line in lines)


def test_a_half_or_a_double_factor_of_a_pulley_is_plausible(hframe: Machine, tmp_path: Path) -> None:
    content = machine_to_dict(hframe)
    content["belts"] = content["belts"][:2]
    for belt in content["belts"]:
        belt["extension"] = {key: (0.5 if "phi" in key else 1.0) * f for key, f in belt["extension"].items()}
    (tmp_path / "m.json").write_text(json.dumps(content))
    load_machine(tmp_path / "m.json")  # a warning would be an error
