"""Physical quantities of columns are recognized by unit and name; impossible maps are refused."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from hframe_gym.errors import InputError
from hframe_gym.machine import Machine
from hframe_gym.recordings import ImportSettings, MappingOptions, Recording, import_logs, load_recordings
from hframe_gym.recordings.quantities import QUANTITIES, meaning_of, normalize_unit, split_unit


@pytest.mark.parametrize(
    ("header", "name", "unit"),
    [
        ("Pos X [mm]", "Pos X", "mm"),
        ("x_m", "x", "m"),
        ("vel_rad_s", "vel", "rad/s"),
        ("vel_m_per_s", "vel", "m/s"),
        ("feed_mm_min", "feed", "mm/min"),
        ("acc_m_s2", "acc", "m/s^2"),
        ("ax_mps2", "ax", "m/s^2"),
        ("Beschleunigung [m/s²]", "Beschleunigung", "m/s^2"),
        ("w [rad s^-1]", "w", "rad/s"),
        ("Drehzahl in 1/min", "Drehzahl", "rpm"),
        ("speed m/s", "speed", "m/s"),
        ("current_A", "current", "A"),
        ("iq_A", "iq", "A"),
        ("torque_Nm", "torque", "Nm"),
        ("M [N m]", "M", "Nm"),
        ("temp_C", "temp", "degC"),
        ("Vitesse (deg./s)", "Vitesse", "deg/s"),
        ("n [tr/min]", "n", "rpm"),
        ("Enc1 [in/s]", "Enc1", "in/s"),
        ("height_ft", "height", "ft"),
        ("TIME_S", "TIME", "s"),
        ("t_sec", "t", "s"),
        ("rpm", "rpm", "rpm"),  # a name that is a unit
        ("ms", "ms", "ms"),
        ("Micros", "Micros", "us"),
        ("us", "us", ""),  # a supply voltage
        ("motorRPM_left", "motorRPM_left", "rpm"),
        ("phase_A", "phase_A", ""),  # a letter that numbers a phase
        ("u_m", "u_m", ""),  # the voltage of a motor
        ("v_in", "v_in", ""),  # the voltage at an input
        ("x_min", "x_min", ""),  # a minimum
        ("x_s", "x_s", ""),  # a set point
        ("position[0]", "position[0]", ""),  # the first of a list
        ("position [0]", "position", "0"),
        ("_" * 70_000, "_" * 70_000, ""),
        ("a " * 35_000, ("a " * 35_000).strip(), ""),
    ],
)
def test_name_and_unit_of_a_header_are_separated(header: str, name: str, unit: str) -> None:
    assert split_unit(header) == (name, unit)


@pytest.mark.parametrize(
    ("header", "quantity", "role"),
    [
        ("Uhrzeit", "time", ""),
        ("Motorspannung", "voltage", ""),
        ("PWM1", "duty cycle", ""),
        ("u [%]", "duty cycle", ""),
        ("torque [%]", "torque", ""),
        ("current [%]", "current", ""),
        ("currentPosition", "position", ""),
        ("Present Current", "current", ""),
        ("torque current", "current", ""),
        ("Motorstrom", "current", ""),
        ("torque_nm", "torque", ""),
        ("x [nm]", "length", ""),
        ("motorRPM", "angular speed", ""),
        ("phi1", "angle", ""),
        ("Sollposition in mm", "length", "set point"),
        ("target_angle", "angle", "set point"),
        ("pos error [mm]", "length", "control error"),
        ("accel_x", "acceleration", ""),
        ("Temperatur", "temperature", ""),
        ("Axis0_vel_gain", "gain", ""),
        ("theta_dot", "speed", ""),
        ("phiDdot", "acceleration", ""),
        ("yaw rate", "speed", ""),
        ("sample", "row number", ""),
        ("enable", "state", ""),
        ("counter [#]", "count", ""),
        ("q_0", "position", ""),
        ("q1", "position", ""),
        ("q[1]", "position", ""),
        ("qd_0", "speed", ""),
        ("dq1", "speed", ""),
        ("actual_qd_1", "speed", ""),
        ("ddq_2", "acceleration", ""),
        ("tau_1", "torque", ""),
        ("target_q_0", "position", "set point"),
        ("q_des_0", "position", "set point"),
        ("dq_d[0]", "speed", "set point"),
        ("voltage.q", "voltage", ""),  # of the quadrature axis
        ("uq", "", ""),
        ("U1", "", ""),
        ("Wert", "", ""),
    ],
)
def test_the_quantity_of_a_column_follows_from_its_header(header: str, quantity: str, role: str) -> None:
    meaning = meaning_of(*split_unit(header))
    assert (meaning.quantity, meaning.role) == (quantity, role)


def test_every_unit_is_recognized_in_the_spelling_of_the_table_and_belongs_to_one_quantity() -> None:
    units = [unit for quantity in QUANTITIES.values() for unit in quantity.units]
    assert len(set(units)) == len(units)
    for name, quantity in QUANTITIES.items():
        for unit in quantity.units:
            assert normalize_unit(f"[{unit}]") == unit
            assert meaning_of("Wert", unit).quantity == name


@pytest.fixture
def current_axis(axis: Machine) -> Machine:
    """Return an axis whose amplifier controls the current."""
    drive = dataclasses.replace(
        axis.drives[0], channel="current_A", Ke=0.0, resistance=1.0, rated_voltage=10.0
    )
    return dataclasses.replace(axis, drives=(drive,))


def log_of(path: Path, **columns: np.ndarray) -> Path:
    """Write a log; "__" in the name of a column stands for a blank, as in "torque__[%]"."""
    header = ",".join(name.replace("__", " ") for name in columns)
    np.savetxt(
        path, np.column_stack(list(columns.values())), fmt="%.9g", delimiter=",", header=header, comments=""
    )
    return path


TIME = np.arange(200) * 1e-3
INPUT = 3.0 * np.sin(20 * TIME)
POSITION = 0.01 * np.cumsum(INPUT) * 1e-3


def run_of(path: Path, machine: Machine, **options: dict[str, object]) -> Recording:
    """Import a log and return its run."""
    out = path.parent / "runs"
    import_logs(path, out, machine, ImportSettings(MappingOptions(**options)), log=lambda line: None)  # type: ignore[arg-type]
    return load_recordings(out, machine)[0]


IMPOSSIBLE = [
    # header of the input, options, what the message says
    (
        "current_A",
        {},
        "current_A is a current in A, and v_V is a voltage; map the voltage that was applied, or, if",
    ),
    ("current_A", {"scales": {"v_V": 1.2}}, "the kind current and the channel i_A"),
    ("current_A", {"units": {"v_V": "V"}}, "current_A is a current in A, and v_V is a voltage"),
    (
        "torque__[%]",
        {},
        r"torque \[%\] is a torque in percent, and v_V is a voltage"
        ".*the kind torque and the channel torque_Nm",
    ),
    ("torque__[%]", {"units": {"v_V": "%"}}, "is a torque in percent, and v_V is a voltage"),
    ("torque", {}, "torque is a torque by its name, and v_V is a voltage.*--unit v_V=V only if"),
    ("torque", {"units": {"v_V": "%"}}, "torque is a torque by its name"),
    ("torque", {"scales": {"v_V": 2.0}}, "torque is a torque by its name"),
    ("a__[m/s^2]", {"scales": {"v_V": 2.0}}, "is a linear acceleration in m/s.2, and v_V is a voltage"),
    (
        "temperature",
        {"units": {"v_V": "V"}},
        "temperature is a temperature by its name, and v_V is a voltage",
    ),
    ("position", {"scales": {"v_V": 2.0}}, "position is a position by its name, and v_V is a voltage"),
    ("position", {}, "position is a position by its name, and v_V is a voltage"),
]


@pytest.mark.parametrize(("header", "options", "message"), IMPOSSIBLE)
def test_a_column_of_another_quantity_is_no_voltage(
    header: str, options: dict[str, dict[str, object]], message: str, axis: Machine, tmp_path: Path
) -> None:
    path = log_of(tmp_path / "log.csv", **{"time_s": TIME, header: INPUT, "x_m": POSITION})
    column = header.replace("__", " ")
    with pytest.raises(InputError, match=rf"log.csv: --map .?v_V=.*{message}") as error:
        run_of(path, axis, columns={"v_V": column}, **options)
    assert "\n" not in str(error.value)
    assert not (tmp_path / "runs").exists()
    with pytest.raises(InputError, match="--map v_V=COLUMN"):  # nor is it proposed
        run_of(path, axis)


def test_a_command_named_after_its_purpose_may_have_the_unit_of_the_input(
    axis: Machine, tmp_path: Path
) -> None:
    drive = dataclasses.replace(axis.drives[0], kind="torque", channel="torque_Nm", Ke=0.0, Kt=1.0)
    machine = axis.replace(drives=(drive,))
    path = log_of(tmp_path / "log.csv", time_s=TIME, velocity=INPUT, x_m=POSITION)
    with pytest.raises(
        InputError, match="add --unit torque_Nm=Nm if the column is the torque in spite of its"
    ):
        run_of(path, machine, columns={"torque_Nm": "velocity"})
    run = run_of(path, machine, columns={"torque_Nm": "velocity"}, units={"torque_Nm": "Nm"})
    np.testing.assert_allclose(run.inputs[:, 0], INPUT, rtol=1e-6)


@pytest.mark.parametrize(
    ("header", "options", "message"),
    [
        (
            "ax_mps2",
            {},
            "ax_mps2 is a linear acceleration in m/s.2, and x_m is a length; map a position, or a speed",
        ),
        ("ax_mps2", {"units": {"x_m": "mm"}}, "ax_mps2 is a linear acceleration"),
        ("accel_x", {"units": {"x_m": "mm"}}, "accel_x is an acceleration by its name"),
        ("velocity", {}, "velocity is a speed by its name"),
        ("velocity", {"units": {"x_m": "mm"}}, "a speed is integrated to it if its unit is one of m/s, mm/s"),
        ("force__[N]", {"scales": {"x_m": 0.1}}, "is a force in N"),
        ("current_A", {"scales": {"x_m": 0.1}}, "is a current in A"),
        ("u__[V]", {}, "if it is the signal of a sensor, state the factor to m by --scale x_m=FACTOR"),
        (
            "angle",
            {},
            "angle is an angle by its name, and x_m is a length; state its unit by --unit x_m=UNIT",
        ),
        ("zeit", {}, "zeit is a time by its name, and x_m is a length"),
    ],
)
def test_a_column_of_another_quantity_is_no_position(
    header: str, options: dict[str, dict[str, object]], message: str, axis: Machine, tmp_path: Path
) -> None:
    path = log_of(tmp_path / "log.csv", **{"time_s": TIME, "v_V": INPUT, header: POSITION})
    with pytest.raises(InputError, match=rf"--map .?x_m=.*{message}.*--map x_m=none"):
        run_of(path, axis, columns={"x_m": header.replace("__", " ")}, **options)


@pytest.mark.parametrize(
    ("header", "options", "message"),
    [
        (
            "position__[turns]",
            {},
            "and time_s is a time; for a log without a column of time state the rate of its",
        ),
        ("position__[turns]", {"scales": {"time_s": 0.001}}, "is an angle in rev, and time_s is a time"),
        (
            "torque",
            {},
            "torque is a torque by its name, and time_s is a time.*--unit time_s=s if the column is",
        ),
        ("torque", {"units": {"time_s": "Nm"}}, "torque is a torque by its name, and time_s is a time"),
        (
            "sample",
            {},
            "sample is a row number by its name, and time_s is a time; state the rate of its steps by --unit",
        ),
    ],
)
def test_a_column_of_another_quantity_is_no_time(
    header: str, options: dict[str, dict[str, object]], message: str, axis: Machine, tmp_path: Path
) -> None:
    path = log_of(tmp_path / "log.csv", **{header: np.arange(200), "v_V": INPUT, "x_m": POSITION})
    with pytest.raises(InputError, match=message):
        run_of(path, axis, columns={"time_s": header.replace("__", " ")}, **options)
    if header != "sample":
        with pytest.raises(InputError, match="--map time_s=200Hz; no column is a time"):
            run_of(path, axis)


def test_curves_with_their_own_times_are_read_by_the_unit_of_the_times(axis: Machine, tmp_path: Path) -> None:
    columns = {"/effort[1]_x": TIME, "/effort[1]_y": INPUT, "/pose_x": TIME + 2e-4, "/pose_y": POSITION}
    log = log_of(tmp_path / "log.csv", **columns)
    names = {"time_s": "/effort[1]_x,/pose_x", "v_V": "/effort[1]_y", "x_m": "/pose_y"}
    run = run_of(log, axis, columns=names, units={"time_s": "s", "v_V": "V"})
    measured = ~np.isnan(run.outputs[:, 0])
    np.testing.assert_allclose(run.time_s[measured], TIME + 2e-4, atol=1e-9)
    np.testing.assert_allclose(run.outputs[measured, 0], POSITION, rtol=1e-6)


@pytest.mark.parametrize(("header", "unit"), [("ms", 1e-3), ("micros", 1e-6)])
def test_a_time_that_is_called_by_its_unit_is_found(
    header: str, unit: float, axis: Machine, tmp_path: Path
) -> None:
    log = log_of(tmp_path / "log.csv", **{header: TIME / unit, "v_V": INPUT, "x_m": POSITION})
    np.testing.assert_allclose(run_of(log, axis).time_s, TIME, rtol=1e-9)


def test_a_temperature_called_t_is_no_time(axis: Machine, tmp_path: Path) -> None:
    path = log_of(tmp_path / "log.csv", time_s=TIME, v_V=INPUT, x_m=POSITION)
    path.write_text(path.read_text().replace("time_s,v_V,x_m", "t [s],v_V,x_m").replace("\n", ",20.5\n"))
    path.write_text(path.read_text().replace("x_m,20.5", "x_m,T [°C]", 1))
    np.testing.assert_allclose(run_of(path, axis).time_s, TIME, rtol=1e-9)


def test_a_counter_of_rows_is_a_time_at_a_stated_rate(axis: Machine, tmp_path: Path) -> None:
    path = log_of(tmp_path / "log.csv", sample=np.arange(0, 400, 2), v_V=INPUT, x_m=POSITION)
    run = run_of(path, axis, columns={"time_s": "sample"}, units={"time_s": "2kHz"})
    np.testing.assert_allclose(run.time_s, TIME, rtol=1e-14)


@pytest.mark.parametrize(
    ("header", "options", "factor"),
    [
        ("torque", {"units": {"v_V": "V"}}, 1.0),  # the output of a controller, named after its purpose
        ("speed", {"units": {"v_V": "%"}}, 0.12),
        ("speed", {"scales": {"v_V": 0.5}}, 0.5),
        ("u__[mV]", {}, 1e-3),
        ("power", {"units": {"v_V": "pu"}}, 12.0),
        ("pwm", {"scales": {"v_V": 0.047}}, 0.047),
        ("pwm", {"units": {"v_V": "%"}}, 0.12),
        ("Wert", {}, 1.0),
        ("Wert", {"scales": {"v_V": 2.0}}, 2.0),
        ("u_cmd__[V]", {}, 1.0),
    ],
)
def test_what_the_user_states_overrides_a_name(
    header: str, options: dict[str, dict[str, object]], factor: float, axis: Machine, tmp_path: Path
) -> None:
    path = log_of(tmp_path / "log.csv", **{"time_s": TIME, header: INPUT, "x_m": POSITION})
    run = run_of(path, axis, columns={"v_V": header.replace("__", " ")}, **options)
    np.testing.assert_allclose(run.inputs[:, 0], factor * INPUT, rtol=1e-8, atol=1e-12)


def test_a_duty_cycle_without_a_unit_is_proposed_and_its_unit_asked_for(
    axis: Machine, tmp_path: Path
) -> None:
    path = log_of(tmp_path / "log.csv", time_s=TIME, PWM=INPUT, x_m=POSITION)
    with pytest.raises(InputError, match="--map v_V=PWM"):
        run_of(path, axis)
    with pytest.raises(
        InputError, match=r"PWM is a duty cycle by its name, .*--unit v_V=% or --unit v_V=pu .*--scale"
    ):
        run_of(path, axis, columns={"v_V": "PWM"})


def test_the_signal_of_an_analog_sensor_and_counts_are_positions_by_a_factor(
    axis: Machine, tmp_path: Path
) -> None:
    for number, header in enumerate(("sensor__[V]", "ticks", "counts__[#]")):
        (tmp_path / str(number)).mkdir()
        path = log_of(
            tmp_path / str(number) / "log.csv", **{"time_s": TIME, "v_V": INPUT, header: POSITION * 100}
        )
        run = run_of(path, axis, columns={"x_m": header.replace("__", " ")}, scales={"x_m": 0.01})
        np.testing.assert_allclose(run.outputs[:, 0], POSITION, atol=1e-9)


def test_proposals_prefer_measurements_to_set_points_and_positions_to_speeds(
    axis: Machine, tmp_path: Path
) -> None:
    columns = {"x_ref__[mm]": POSITION, "v__[mm/s]": POSITION, "Istposition__[mm]": POSITION, "i__[A]": INPUT}
    path = log_of(tmp_path / "log.csv", **{"t": TIME, "u": INPUT, **columns})
    with pytest.raises(InputError, match=r"--map v_V=u --map 'x_m=Istposition \[mm\]' \("):
        run_of(path, axis)


def test_a_machine_with_a_current_input_takes_currents(current_axis: Machine, tmp_path: Path) -> None:
    path = log_of(tmp_path / "log.csv", **{"time_s": TIME, "current__[mA]": INPUT * 1e3, "x_m": POSITION})
    np.testing.assert_allclose(run_of(path, current_axis).inputs[:, 0], INPUT, rtol=1e-8, atol=1e-12)
    (tmp_path / "voltage").mkdir()
    path = log_of(tmp_path / "voltage" / "log.csv", **{"time_s": TIME, "u__[V]": INPUT, "x_m": POSITION})
    with pytest.raises(InputError, match=r"u \[V\] is a voltage in V, and current_A is a current"):
        run_of(path, current_axis, columns={"current_A": "u"})
    # An amplifier's monitor.
    run = run_of(path, current_axis, columns={"current_A": "u"}, scales={"current_A": 2.0})
    np.testing.assert_allclose(run.inputs[:, 0], 2.0 * INPUT, rtol=1e-8, atol=1e-12)


def test_a_drive_without_back_emf_takes_currents_and_torques_in_its_voltage_channel(
    axis: Machine, tmp_path: Path
) -> None:
    drive = dataclasses.replace(axis.drives[0], Ke=0.0, resistance=2.0, Kt=0.1)
    machine = dataclasses.replace(axis, drives=(drive,))
    for header, factor in (("i__[A]", 2.0), ("M__[Nm]", 20.0)):
        (tmp_path / header[0]).mkdir()
        path = log_of(tmp_path / header[0] / "log.csv", **{"time_s": TIME, header: INPUT, "x_m": POSITION})
        run = run_of(path, machine, columns={"v_V": header.replace("__", " ")})
        np.testing.assert_allclose(run.inputs[:, 0], factor * INPUT, rtol=1e-8, atol=1e-12)


def test_a_current_without_a_unit_needs_one_or_a_factor_for_a_drive_without_back_emf(
    axis: Machine, tmp_path: Path
) -> None:
    machine = dataclasses.replace(axis, drives=(dataclasses.replace(axis.drives[0], Ke=0.0, resistance=1.0),))
    path = log_of(tmp_path / "log.csv", time_s=TIME, current=INPUT, x_m=POSITION)
    with pytest.raises(
        InputError, match=r"current is a current by its name, and v_V is a voltage; state its unit by"
    ):
        run_of(path, machine, columns={"v_V": "current"})
    run = run_of(path, machine, columns={"v_V": "current"}, scales={"v_V": 1.0})
    np.testing.assert_allclose(run.inputs[:, 0], INPUT, rtol=1e-8, atol=1e-12)
    (tmp_path / "again").mkdir()
    path = log_of(tmp_path / "again" / "log.csv", time_s=TIME, current=INPUT * 1e3, x_m=POSITION)
    run = run_of(path, machine, columns={"v_V": "current"}, units={"v_V": "mA"})
    np.testing.assert_allclose(run.inputs[:, 0], INPUT, rtol=1e-8, atol=1e-12)


def test_an_angle_by_its_name_becomes_a_length_by_a_factor(axis: Machine, tmp_path: Path) -> None:
    path = log_of(tmp_path / "log.csv", time_s=TIME, v_V=INPUT, angle=POSITION * 50)
    run = run_of(path, axis, columns={"x_m": "angle"}, scales={"x_m": 0.02})
    np.testing.assert_allclose(run.outputs[:, 0], POSITION, rtol=1e-6, atol=1e-9)


def test_a_machine_whose_current_input_is_taken_for_a_voltage_is_refused(
    current_axis: Machine, tmp_path: Path
) -> None:
    machine = dataclasses.replace(
        current_axis, drives=(dataclasses.replace(current_axis.drives[0], Ke=0.05),)
    )
    path = log_of(tmp_path / "log.csv", time_s=TIME, current_A=INPUT, x_m=POSITION)
    with pytest.raises(
        InputError, match=r"current_A is a current by its name, but its drive motor has a back-EMF; an"
    ):
        run_of(path, machine)
