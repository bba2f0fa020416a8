"""Sensors of speed, acceleration, current, belt force and single-turn angle, simulated and identified."""

import dataclasses

import gymnasium as gym
import numpy as np
import pytest

from hframe_gym import load_machine
from hframe_gym.controllers import StateEstimator
from hframe_gym.data_validation import check_recordings
from hframe_gym.dynamics import linearize, simulate
from hframe_gym.envs import DeclaredSensors
from hframe_gym.envs.observation.spaces import sensor_signals
from hframe_gym.identification import default_free_parameters, fit, identify, prepare
from hframe_gym.identification.report.plots.panels import readable_unit
from hframe_gym.machine import SENSOR_KINDS, Coordinate, Drive, Machine, Sensor, SensorKind
from hframe_gym.recordings import Recording, load_recording, machine_to_dict, save_machine, write_recording
from tests.identification.control_of_kinds import action_of_a_trained_agent, largest_error_of_pid
from tests.reference_simulator import Rig, Stage
from tests.reference_simulator.axis import Axis, held_levels, record

ROWS, PERIOD = 1000, 2e-3
TRUE = Axis()
ENCODER = Sensor("phi_rad", {"shaft": 1.0}, 0.0, 2 * np.pi / 2000, "encoder")
SENSORS = {
    "speed": (Sensor("speed_rad_s", {"shaft": 1.0}, 0.2, 0.0, "speed"),),
    "unsigned-speed": (Sensor("speed_rad_s", {"shaft": 1.0}, 0.2, 0.0, "unsigned-speed"),),
    "acceleration": (ENCODER, Sensor("acc_rad_s2", {"shaft": 1.0}, 20.0, 0.0, "acceleration")),
    "current": (ENCODER, Sensor("i_A", {"motor": 1.0}, 0.02, 0.0, "current")),
    "absolute-angle": (Sensor("phi_rad", {"shaft": 1.0}, 0.0, 2 * np.pi / 4096, "absolute-angle"),),
}
ALL = (
    Sensor("vx_m_s", {"x": 1.0}, 0.001, 0.0, "speed"),
    Sensor("ay_m_s2", {"y": 1.0}, 0.05, 0.01, "acceleration"),
    Sensor("i1_A", {"motor1": 1.0}, 0.01, 0.005, "current"),
    Sensor("w2_rad_s", {"phi2": 1.0}, 0.0, 0.1, "unsigned-speed"),
    Sensor("angle_rad", {"phi1": 1.0}, 0.0, 1e-3, "absolute-angle"),
    Sensor("left_N", {"left": 1.0}, 0.1, 0.0, "belt-force"),
)


def motor(sensors: tuple[Sensor, ...], axis: Axis = TRUE) -> Machine:
    shaft = Coordinate("shaft", axis.inertia, axis.viscous, axis.coulomb, "rotary", 0.01)
    drive = Drive(
        "motor", "v_V", "shaft", axis.torque_constant, axis.torque_constant, axis.resistance, 1.0, 12.0
    )
    return Machine("motor", (shaft,), (), (drive,), sensors)


def runs(sensors: tuple[Sensor, ...], count: int = 4) -> list[Recording]:
    """Return recordings of the independent simulator; the accelerometer has an offset of 50 rad/s^2."""
    rng, recordings = np.random.default_rng(0), []
    for run in range(count):
        motion = record(TRUE, held_levels(run, ROWS, 40, 8.0), ROWS, PERIOD)
        outputs = []
        for sensor in sensors:
            kind = SENSOR_KINDS.get(sensor.kind)
            ideal = kind.signal(getattr(motion, sensor.quantity)) + 50.0 * (sensor.quantity == "acceleration")
            outputs.append(kind.measure(ideal, sensor.noise, sensor.resolution, rng.normal(size=ROWS)))
        recordings.append(
            Recording(f"run_{run}", motion.time_s, motion.command[:, None], np.column_stack(outputs))
        )
    return recordings


@pytest.fixture(scope="module")
def stage_machine() -> Machine:
    machine = load_machine("hframe")
    return machine.with_components(*ALL)


def tension_of_left(stage: Stage) -> float:
    """Return EA s / l of the left belt, N, from the other simulator: eq. 38 and 42 of the paper."""
    (x, y, phi1, _), rig = stage.position, stage.rig
    extension, length = x + y + rig.pulley_radius_m * phi1, rig.belt_length_m[0] + x + y
    return float(rig.belt_EA_N[0] * extension / length)


@pytest.mark.oracle
def test_readings_agree_with_the_independent_simulator() -> None:
    """The other simulator has the same accelerations and currents just before each command, and tensions."""
    machine = load_machine("hframe")
    sensors = [Sensor(f"a_{c}", {c: 1.0}, kind="acceleration") for c in ("x", "y", "phi1", "phi2")]
    sensors += [Sensor(f"v_{c}", {c: 1.0}, kind="speed") for c in ("x", "y", "phi1", "phi2")]
    sensors += [Sensor(f"i_{d.name}", {d.name: 1.0}, kind="current") for d in machine.drives]
    sensors += [Sensor("left_N", {"left": 1.0}, kind="belt-force")]
    machine = machine.replace(sensors=tuple(sensors))
    rig = Rig()
    machine = machine.replace(
        {f"{c}.coulomb": level for c, level in zip(("x", "y", "phi1", "phi2"), rig.coulomb, strict=True)}
    )
    rng = np.random.default_rng(3)
    time_s = np.arange(60) * 2e-3
    volts = np.repeat(rng.uniform(-8.0, 8.0, (6, 2)), 10, axis=0)
    stage = Stage(rig)
    rows = [np.zeros(11)]
    for k in range(len(time_s) - 1):
        stage.step(volts[k], float(time_s[k + 1]))
        rows.append(
            np.concatenate([stage.acceleration, stage.velocity, stage.current, [tension_of_left(stage)]])
        )
    expected = np.array(rows)
    readings = simulate(machine, time_s, volts, longest_step=2e-5).outputs
    size = np.abs(expected).max(axis=0)
    assert np.all(np.abs(readings - expected).max(axis=0) < 2e-3 * size)
    assert np.all(size > 0.0)


def test_the_linear_model_has_speeds_accelerations_and_currents() -> None:
    model = linearize(motor((*SENSORS["speed"], *SENSORS["acceleration"], SENSORS["current"][1])))
    J, b, k, R = 2e-4, 1e-4, 0.03, 1.5
    np.testing.assert_allclose(model.C, [[0, 1], [1, 0], [0, -(b + k * k / R) / J], [0, -k / R]], rtol=1e-12)
    np.testing.assert_allclose(model.D, [[0], [0], [k / R / J], [1 / R]], rtol=1e-12)


@pytest.mark.parametrize("name", list(SENSORS))
def test_a_machine_file_states_each_kind(name: str, tmp_path) -> None:
    machine = motor(SENSORS[name])
    save_machine(machine, tmp_path / "motor.json")
    assert load_machine(tmp_path / "motor.json").sensors == machine.sensors
    units = {s["channel"]: s["noise"]["unit"] for s in machine_to_dict(machine)["sensors"]}
    assert units == {s.channel: machine.sensor_unit(s) for s in machine.sensors}


@pytest.mark.oracle
@pytest.mark.parametrize("name", list(SENSORS))
def test_each_kind_identifies_the_axis_of_the_independent_simulator(name: str) -> None:
    sensors = SENSORS[name]
    resistance = 1.3 if name == "current" else 1.0  # only a measured current determines it
    # Without a direction, nothing corrects a prediction, so that the start must be nearer.
    start = (2.2e-4, 8e-5, 0.005) if name == "unsigned-speed" else (2.8e-4, 5e-5, 0.007)
    wrong = Axis(*start, resistance=1.5 * resistance)
    recordings = runs(sensors)
    assert [f for f in check_recordings(recordings, motor(sensors, wrong)) if f.severity == "fault"] == []
    result = identify(recordings, motor(sensors, wrong))
    assert result.verdict == "no_effect"
    found = result.after.machine.parameters
    assert found["shaft.mass"] == pytest.approx(2e-4, rel=3e-3)
    assert found["shaft.coulomb"] == pytest.approx(0.004, rel=1e-2)
    damping = found["shaft.viscous"] + found["motor.Kt"] * found["motor.Ke"] / found["motor.resistance"]
    assert damping == pytest.approx(1e-4 + 0.03**2 / 1.5, rel=3e-3)
    if name == "current":
        assert found["motor.resistance"] == pytest.approx(1.5, rel=2e-3)
        assert found["motor.Ke"] == pytest.approx(0.03, rel=5e-3)


def test_a_measured_belt_force_determines_the_torque_constant() -> None:
    """Without it, motion determines only the ratios of forces, masses and torque constants."""
    machine = load_machine("belt-axis")
    belt, drive = machine.belts[0].name, machine.drives[0].name
    machine = machine.with_components(Sensor("belt_N", {belt: 1.0}, 0.02, 0.0, "belt-force"))
    factor = 1.15
    names = [
        n for n in machine.parameters if n.rpartition(".")[2] in ("mass", "viscous", "coulomb", "EA", "Kt")
    ]
    true = machine.replace({name: factor * machine.parameters[name] for name in names})
    rng, time_s, recordings = np.random.default_rng(0), np.arange(600) * 1e-3, []
    for k in range(2):
        volts = np.repeat(rng.uniform(-8.0, 8.0, (15, len(machine.drives))), 40, axis=0)
        volts[:40] = 0.0
        outputs = simulate(true, time_s, volts).outputs
        noise = rng.normal(size=outputs.shape) * [s.noise for s in machine.sensors]
        outputs[:, -1] += 3.0  # an offset, as of a bridge amplifier
        recordings.append(Recording(f"run_{k}", time_s, volts, outputs + noise))
    found = fit(
        machine, default_free_parameters(machine), prepare(recordings, machine), 60.0
    ).machine.parameters
    assert found[f"{drive}.Kt"] / machine.parameters[f"{drive}.Kt"] == pytest.approx(factor, rel=0.01)


def test_a_kind_may_state_its_unit(tmp_path) -> None:
    """The generator of a tachometer: 0.02 V per rad/s."""

    @SENSOR_KINDS.register("generator")
    class Generator(SensorKind):
        unit = "V"

        @staticmethod
        def signal(speed):
            return speed

    try:
        machine = motor((ENCODER, Sensor("generator_V", {"shaft": 0.02}, 1e-3, 0.0, "generator")))
        save_machine(machine, tmp_path / "motor.json")
        loaded = load_machine(tmp_path / "motor.json")
        assert loaded.sensors == machine.sensors
        assert [loaded.sensor_unit(s) for s in loaded.sensors] == ["rad", "V"]
        assert loaded.unit("generator_V.noise") == "V"
        volts = np.full((40, 1), 6.0)
        moved = simulate(loaded, np.arange(40) * PERIOD, volts)
        np.testing.assert_allclose(moved.outputs[:, 1], 0.02 * moved.velocities[:, 0])
        signal = sensor_signals(loaded, loaded.sensors)[1]
        assert (signal.name, signal.unit) == ("generator_V", "V")
    finally:
        SENSOR_KINDS.unregister("generator")


def test_a_formula_that_cannot_be_compiled_is_named() -> None:
    @SENSOR_KINDS.register("bent")
    class Bent(SensorKind):
        @staticmethod
        def signal(position):
            return np.tanh(position)

    try:
        with pytest.raises(
            TypeError, match=r"^sensor kind bent, signal: test_sensor_kinds.py, line .*; use the "
        ):
            simulate(
                motor((Sensor("bent_rad", {"shaft": 1.0}, kind="bent"),)), np.arange(3.0), np.zeros((3, 1))
            )
    finally:
        SENSOR_KINDS.unregister("bent")


def test_every_kind_is_tested_here(stage_machine: Machine) -> None:
    tested = {sensor.kind for sensors in (*SENSORS.values(), stage_machine.sensors) for sensor in sensors}
    kinds = {name for name in SENSOR_KINDS if SENSOR_KINDS.get(name).__module__.startswith("hframe_gym.")}
    assert kinds == tested, "add a sensor of the new kind to SENSORS or ALL"


@pytest.mark.parametrize(
    ("signal", "has_direction"),
    [
        (lambda position: position, True),
        (lambda position: abs(position), False),
        (lambda position: position + 0.05 * position * position, True),  # a string that sags
    ],
)
def test_a_sensor_shows_no_direction_only_if_its_formula_hides_it(signal, has_direction: bool) -> None:
    assert type("Kind", (SensorKind,), {"signal": staticmethod(signal)}).has_direction() == has_direction


def test_the_formula_of_a_registered_kind_says_whether_it_measures_velocities() -> None:
    @SENSOR_KINDS.register("geared-tacho")
    class GearedTacho(SensorKind):
        @staticmethod
        def signal(speed):
            return 20.0 * speed

    try:
        of_velocity = {kind for kind in SENSOR_KINDS if Sensor("w", {"shaft": 1.0}, kind=kind).of_velocity}
    finally:
        SENSOR_KINDS.unregister("geared-tacho")
    assert of_velocity == {"speed", "geared-tacho"}


def test_the_environment_measures_each_kind(stage_machine: Machine) -> None:
    env = gym.make("HFrame-v0", machine=stage_machine, sensors="machine").unwrapped
    observation, _ = env.reset(seed=1)
    names = [
        signal.name for signal in sensor_signals(stage_machine, DeclaredSensors().observed(stage_machine))
    ]
    column = {name: k for k, name in enumerate(names)}
    before = None
    for _ in range(50):
        observation, *_ = env.step(np.array([0.6, 0.2], np.float32))
        values = observation["observation"]
        if before is not None and abs(values[column["x"]] - before) > 1e-5:
            assert values[column["vx_m_s"]] * (values[column["x"]] - before) > -1e-6
        before = values[column["x"]]
    assert 0.0 <= values[column["angle_rad"]] < 2 * np.pi
    drive = stage_machine.drives[0]
    rate = values[column["phi1 velocity"]] if "phi1 velocity" in column else values[column["phi1_rad rate"]]
    current = (0.6 * drive.rated_voltage - drive.emf_constant * rate) / drive.resistance
    assert values[column["i1_A"]] == pytest.approx(current, abs=0.5)
    assert values[column["w2_rad_s"]] >= 0.0


def test_noise_of_each_kind_is_randomized(stage_machine: Machine) -> None:
    assert {f"{s.channel}.{key}" for s in ALL for key in ("noise", "resolution")} <= set(
        stage_machine.device_parameters
    )
    assert stage_machine.unit("i1_A.noise") == "A"
    assert stage_machine.unit("ay_m_s2.resolution") == "m/s^2"


def test_a_controller_estimates_the_state_with_speeds(stage_machine: Machine) -> None:
    """A tachometer on the carriage makes its estimated speed more accurate than encoders and lasers do."""

    def error(machine: Machine) -> float:
        estimator, rng = StateEstimator(machine, 4e-3), np.random.default_rng(0)
        time_s = np.arange(100) * 4e-3
        volts = np.repeat(rng.uniform(-6.0, 6.0, (5, 2)), 20, axis=0)
        motion = simulate(machine.replace({"x.mass": 1.2 * machine.coordinate("x").mass}), time_s, volts)
        noise = np.array([np.hypot(s.noise, s.resolution / 3.5) for s in machine.sensors])
        outputs = motion.outputs + noise * rng.normal(size=motion.outputs.shape)
        errors = []
        for k in range(len(time_s)):
            state = estimator.update(outputs[k : k + 1])
            estimator.send(volts[k : k + 1])
            errors.append(state[0, len(machine.coordinates)] - motion.velocities[k, 0])
        return float(np.sqrt(np.mean(np.square(errors[20:]))))

    machine = load_machine("hframe")
    fast = machine.with_components(dataclasses.replace(ALL[0], noise=1e-4))
    assert error(fast) < 0.7 * error(machine)


@pytest.mark.integration
def test_a_controller_reaches_the_goal_with_all_kinds(stage_machine: Machine) -> None:
    env = gym.make("HFrame-v0", machine=stage_machine, sensors="machine")
    assert largest_error_of_pid(env, 120) < 1e-3  # m


@pytest.mark.train
def test_an_agent_trains_with_all_kinds(stage_machine: Machine) -> None:
    env = gym.make("HFrame-v0", machine=stage_machine, sensors="machine", normalize=True)
    assert np.all(np.isfinite(action_of_a_trained_agent(env)))


def test_a_recording_of_each_kind_is_written_and_read(tmp_path) -> None:
    sensors = SENSORS["current"]
    machine = motor(sensors)
    (recording,) = runs(sensors, 1)
    write_recording(tmp_path / "run_0.csv", recording, machine)
    np.testing.assert_array_equal(load_recording(tmp_path / "run_0.csv", machine).outputs, recording.outputs)


def test_reports_state_the_unit_of_each_kind() -> None:
    units = [readable_unit(channel, 5.0)[1] for channel in ("x_m", "vx_m_s", "w_rad_s", "ay_m_s2", "i1_A")]
    assert units == ["m", "m/s", "rad/s", "m/s^2", "A"]
