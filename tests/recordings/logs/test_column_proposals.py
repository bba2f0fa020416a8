"""Columns that the message about a missing column proposes."""

import dataclasses
from pathlib import Path

import pytest

from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES, Sensor
from hframe_gym.recordings import MappingOptions, open_logs, propose_columns
from hframe_gym.recordings.logs.log_mapping import map_columns
from hframe_gym.recordings.logs.measurement_units import wrong_unit_message


@pytest.mark.parametrize(
    ("header", "proposed"),
    [
        ("encoder_V", None),  # the signal of a sensor
        ("tacho_V", None),
        ("amplifier_V", "amplifier_V"),
        ("motor_voltage_V", "motor_voltage_V"),
    ],
)
def test_the_voltage_of_a_sensor_is_not_proposed_as_a_command(
    header: str, proposed: str | None, tmp_path: Path
) -> None:
    rows = "\n".join(f"{k * 1e-3:g},{k % 7},{k}" for k in range(40))
    (tmp_path / "log.csv").write_text(f"time,{header},level\n{rows}\n")
    (log,) = open_logs(tmp_path / "log.csv")
    assert propose_columns(log, BUILTIN_MACHINES["motor"]()).proposed.get("v_V") == proposed


def test_set_points_without_a_quantity_are_proposed_for_a_drive_that_follows_them(tmp_path: Path) -> None:
    """A second clock in the log is no reason why a command cannot be mapped."""
    rows = "\n".join(f"{k * 2e-3:g},{k * 4e-3:g},{k % 7},{k % 5},{k % 3}" for k in range(40))
    (tmp_path / "log.csv").write_text(f"timestamp,real_time,FR_1_target,FR_1_actual,FR_1_error\n{rows}\n")
    (log,) = open_logs(tmp_path / "log.csv")
    with pytest.raises(InputError, match="--map command_rad=FR_1_target --map horn_rad=") as refused:
        map_columns(log, BUILTIN_MACHINES["servo"](), MappingOptions())
    assert "real_time is" not in str(refused.value)
    assert "command_rad" not in propose_columns(log, BUILTIN_MACHINES["motor"]()).proposed


@pytest.mark.parametrize("header", ["u", "input", "U1", "cmd"])
def test_what_is_called_an_input_is_proposed_as_the_command_of_any_drive(header: str, tmp_path: Path) -> None:
    motor = BUILTIN_MACHINES["motor"]()
    machine = motor.replace(drives=(dataclasses.replace(motor.drives[0], kind="duty-cycle", channel="duty"),))
    rows = "\n".join(f"{k * 1e-3:g},{k % 3},{k % 2},{k % 7},{k % 5}" for k in range(40))
    (tmp_path / "log.csv").write_text(f"t,{header},{header}_raw,theta_1,theta_2\n{rows}\n")
    (log,) = open_logs(tmp_path / "log.csv")
    assert propose_columns(log, machine).proposed["duty"] == header


@pytest.mark.parametrize(
    ("unit", "factor"), [("8bits", "0.0039216 if 255 is"), ("10 bit", "0.00097752 if 1023 is")]
)
def test_a_duty_cycle_in_bits_is_refused_with_its_factor(unit: str, factor: str) -> None:
    motor = BUILTIN_MACHINES["motor"]()
    machine = motor.replace(drives=(dataclasses.replace(motor.drives[0], kind="duty-cycle", channel="duty"),))
    assert f"(FACTOR is {factor} the full duty cycle)" in wrong_unit_message(machine, "duty", unit)


def test_a_speed_under_the_name_of_a_position_is_read_as_its_message_says(tmp_path: Path) -> None:
    motor = BUILTIN_MACHINES["motor"]()
    tachometer = Sensor("shaft_rad_s", {"shaft": 1.0}, noise=0.1, kind="speed")
    rows = "\n".join(f"{k * 1e-3:g},{k % 3},{k % 7}" for k in range(40))
    (tmp_path / "log.csv").write_text(f"t,v_V,Position.values\n{rows}\n")
    (log,) = open_logs(tmp_path / "log.csv")
    columns = {"shaft_rad_s": "Position.values"}
    with pytest.raises(InputError, match=r"--unit shaft_rad_s=UNIT .*in spite of its name"):
        map_columns(log, motor.replace(sensors=(tachometer,)), MappingOptions(columns))
    map_columns(
        log, motor.replace(sensors=(tachometer,)), MappingOptions(columns, units={"shaft_rad_s": "rad/s"})
    )
