from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.machine import SENSOR_KINDS, Machine


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


def test_encoders_are_incremental_and_lasers_are_not(hframe: Machine) -> None:
    assert [sensor.incremental for sensor in hframe.sensors] == [True, True, False, False]


def test_a_sensor_adds_noise_and_rounds_to_its_resolution() -> None:
    kind = SENSOR_KINDS.get("encoder")
    reading = np.array([[0.0, 1.04], [2.0, 3.0]])
    measured = kind.measure(reading, noise=0.1, resolution=np.array([0.0, 0.5]), normal=np.array([1.0, -1.0]))
    np.testing.assert_allclose(measured, [[0.1, 1.0], [2.1, 3.0]])
