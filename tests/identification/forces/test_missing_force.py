"""Tests of the missing force: its size on a carriage, and the coordinate and variables it depends on."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.dynamics.simulation import simulate_batch
from hframe_gym.effects import EFFECTS
from hframe_gym.identification.fit.channel_errors import white_sensors
from hframe_gym.identification.forces.missing_force import (
    missing_force,
    missing_motions,
    smooth_force_residual,
)
from hframe_gym.identification.forces.motion_variables import dependence_variables, smooth_sign
from hframe_gym.identification.propose.causes import _curve
from hframe_gym.identification.propose.dependences import rank_dependences
from hframe_gym.identification.propose.periodogram import periodogram_peaks
from hframe_gym.identification.report.plots.panels import _with_unit
from hframe_gym.machine import BUILTIN_MACHINES, AppliedEffect, Coordinate, Drive, Machine, Sensor
from hframe_gym.preparation.session import prepare
from hframe_gym.recordings import Recording
from tests.drives.test_set_point import SERVOS, servo_machine


def one_motor(kind: str) -> Machine:
    """Return a shaft behind a gear of 3, which a drive of a kind without a law moves."""
    shaft = Coordinate("shaft", 2e-4, 1e-4, 0.004, "rotary", 0.01)
    sensor = Sensor("phi_rad", {"shaft": 1.0}, 0.0, 2 * np.pi / 4096, "encoder")
    electrical = {"voltage": (0.02, 0.02, 1.5), "current": (0.02, 0.0, 1.0), "torque": (1.0, 0.0, 1.0)}[kind]
    return Machine(
        "one motor",
        (shaft,),
        (),
        (Drive("motor", "u", "shaft", *electrical, 3.0, 5.0, kind=kind),),
        (sensor,),
    )


@pytest.mark.parametrize("axis", ["x", "y"])
def test_encoders_alone_show_the_period_of_the_friction_of_a_carriage(hframe: Machine, axis: str) -> None:
    machine = dataclasses.replace(hframe, sensors=hframe.sensors[:2])
    rough = machine.with_effects(EFFECTS["position_friction"].at(axis, A=0.3, L=0.02, p=1.0))
    time_s = np.arange(4000) * 1e-3
    inputs = 8.0 * np.sin(2 * np.pi * np.outer(time_s, [0.7, 0.45]))
    inputs[:200] = 0.0
    readings = simulate_batch(rough, time_s, inputs).readings[0]
    data = prepare([Recording("run_01", time_s, inputs, readings)], machine)
    motion = missing_force(machine, data)[axis]
    strongest = periodogram_peaks(motion, data.period, factor=np.sign(motion[:, 1]))[0]
    assert 2 * np.pi / strongest == pytest.approx(0.02, rel=0.03)


def test_an_input_at_rest_does_not_stand_for_time() -> None:
    """Equal values of a variable are one value of the curve; in the order of samples they would be time."""
    drift = np.linspace(-1.0, 1.0, 1600)

    def explained(variable: np.ndarray) -> float:
        curve = _curve(variable, 13)
        fitted = curve @ np.linalg.lstsq(curve, drift, rcond=None)[0]
        return 1.0 - np.var(drift - fitted) / np.var(drift)

    assert explained(np.where(drift < 0.9, 0.0, drift)) < 0.2
    assert explained(drift) > 0.95


def excited_runs(machine: Machine, *, noise: float = 1.0, count: int = 2) -> list[Recording]:
    """Return runs of 2 s with noise as a multiple of the declared one (encoders: rounding to 0.5 mrad)."""
    rng = np.random.default_rng(3)
    time_s = np.arange(2000) * 1e-3
    runs = []
    for k in range(count):
        inputs = 5.0 * np.sin(2 * np.pi * np.outer(time_s, [0.7 + 0.4 * k, 1.1 - 0.3 * k]) + k)
        inputs[:200] = 0.0
        readings = simulate_batch(machine, time_s, inputs, longest_step=0.125e-3).readings[0]
        readings[:, :2] = np.round(readings[:, :2] / 0.5e-3) * 0.5e-3
        readings[:, 2:] += rng.normal(0.0, 20e-6 * noise, readings[:, 2:].shape)
        runs.append(Recording(f"run_{k}", time_s, inputs, readings))
    return runs


@pytest.mark.parametrize(
    ("effect", "coordinate", "variable"),
    [
        (EFFECTS["quadratic_drag"].at("x", c=20.0), "x", "velocity of x"),
        (EFFECTS["quadratic_drag"].at("y", c=20.0), "y", "velocity of y"),
        (EFFECTS["cogging"].at("motor1", A=0.01, n=3.0, p=0.0), "phi1", "position of phi1"),
        (EFFECTS["constant_force"].at("y", size=2.0), "y", "constant"),
    ],
)
def test_the_coordinate_on_which_a_force_acts_is_named(
    hframe: Machine, effect: AppliedEffect, coordinate: str, variable: str
) -> None:
    """The observer attributes most of a force on y to the pulleys, whose encoders it follows faster."""
    data = prepare(excited_runs(hframe.with_effects(effect)), hframe)
    strongest = rank_dependences(hframe, data)[0]
    assert (strongest.coordinate, strongest.variable) == (coordinate, variable)


@pytest.mark.parametrize("count", [1, 2])
def test_noise_alone_depends_on_nothing(hframe: Machine, count: int) -> None:
    """In a short recording, chance correlates the noise with every variable."""
    data = prepare(excited_runs(hframe, count=count), hframe)
    assert rank_dependences(hframe, data) == []


def test_the_force_that_noise_causes_is_predicted(hframe: Machine) -> None:
    """Also that of encoders, whose rounding error is constant at rest."""
    motions = missing_motions(hframe, prepare(excited_runs(hframe, count=4), hframe))
    for values, noise in ((m.correction, m.correction_noise) for m in motions):
        assert values.std(axis=0) == pytest.approx(noise.std(axis=0), rel=0.25)
    for values, noise in ((m.disagreement, m.disagreement_noise) for m in motions):
        assert values.std(axis=0) == pytest.approx(noise.std(axis=0), rel=0.25)


def test_an_axis_that_lacks_no_force_depends_on_nothing(hframe: Machine) -> None:
    dragged = hframe.with_effects(EFFECTS["quadratic_drag"].at("y", c=20.0))
    data = prepare(excited_runs(dragged, noise=5.0), hframe)
    named = {d.coordinate for d in rank_dependences(hframe, data)}
    assert "y" in named
    assert "x" not in named


def test_the_noise_of_a_sensor_does_not_reduce_the_share_of_a_variable() -> None:
    """The noise of 0.03 mm causes a sixth of the variance left of the drag beside viscous friction."""
    axis = BUILTIN_MACHINES["axis"]()
    time_s = np.arange(2000) * 1e-3
    inputs = np.where(time_s < 0.2, 0.0, 6.0 * np.sin(2 * np.pi * time_s))[:, None]
    readings = simulate_batch(
        axis.with_effects(EFFECTS["quadratic_drag"].at("x", c=1.0)), time_s, inputs
    ).readings[0]
    for noise in (1e-6, 0.03e-3):
        noisy = readings + np.random.default_rng(2).normal(0.0, noise, readings.shape)
        ranked = rank_dependences(axis, prepare([Recording("run", time_s, inputs, noisy)], axis))
        share = next(d.explained for d in ranked if d.variable == "velocity of x")
        assert share == pytest.approx(0.95, abs=0.1)


@pytest.mark.parametrize("sensors", [2, 4])
@pytest.mark.parametrize("axis", ["x", "y"])
def test_the_residual_force_on_a_carriage_is_complete(hframe: Machine, axis: str, sensors: int) -> None:
    """The observer corrects the pulleys as well; what they take must not be missing on the carriage."""
    runs = excited_runs(hframe.with_effects(EFFECTS["quadratic_drag"].at(axis, c=20.0)), noise=0.1)
    hframe = dataclasses.replace(hframe, sensors=hframe.sensors[:sensors])
    data = prepare([dataclasses.replace(run, outputs=run.outputs[:, :sensors]) for run in runs], hframe)
    [force, velocity] = (
        np.concatenate([of_run(hframe, run, data) for run in data.runs])
        for of_run in (smooth_force_residual, lambda *run: dependence_variables(*run)[f"velocity of {axis}"])
    )
    drag = -20.0 * np.abs(velocity) * velocity
    amount = force[:, hframe.coordinate_names.index(axis)] @ drag / (drag @ drag)
    assert amount == pytest.approx(1.0, abs=0.15)


def test_the_missing_force_of_a_motor_is_complete(hframe: Machine) -> None:
    """The observer divides it among pulley and carriages, which move together."""
    cogging = EFFECTS["cogging"].at("motor1", A=0.01, n=6.0, p=0.0)
    data = prepare(excited_runs(hframe.with_effects(cogging), noise=0.1), hframe)
    angle, speed, force = missing_force(hframe, data)["phi1"].T
    slow = (np.abs(speed) > 1.0) & (np.abs(6.0 * speed) < 2.0 * np.pi * 10.0)  # the force has less than 10 Hz
    basis = np.stack([np.sin(6.0 * angle), np.cos(6.0 * angle)], axis=1)[slow]
    amplitude = np.hypot(*np.linalg.lstsq(basis, force[slow])[0])
    assert amplitude == pytest.approx(0.01, rel=0.15)


def test_a_sensor_with_a_slow_error_is_not_white(hframe: Machine) -> None:
    """Also one that measures in every tenth row only."""
    [run] = excited_runs(hframe, count=1)
    outputs = run.outputs.copy()
    assert white_sensors(hframe, prepare([run], hframe)).all()
    outputs[:, 3] += 50e-6 * np.sin(5.0 * run.time_s)
    outputs[np.arange(len(outputs)) % 10 > 0, 3] = np.nan
    data = prepare([dataclasses.replace(run, outputs=outputs)], hframe)
    assert white_sensors(hframe, data).tolist() == [True, True, True, False]


def test_parameters_may_be_integers(hframe: Machine) -> None:
    """As a machine file may have them."""
    coordinates = tuple(dataclasses.replace(c, viscous=round(c.viscous)) for c in hframe.coordinates)
    rounded = dataclasses.replace(hframe, coordinates=coordinates)
    data = prepare(excited_runs(rounded, count=1), rounded)
    assert all(np.isfinite(motion).all() for motion in missing_force(rounded, data).values())


def test_every_cause_has_a_variable_with_a_unit_that_the_report_can_draw(hframe: Machine) -> None:
    run = prepare(excited_runs(hframe, count=1), hframe)
    variables = dependence_variables(hframe, run.runs[0], run)
    assert all(values.shape == run.runs[0].time_s.shape for values in variables.values())
    units = {name: _with_unit(name, hframe).rpartition(", ")[2] for name in variables}
    assert (units["current of motor1"], units["acceleration of x"], units["load of motor2"]) == (
        "A",
        "m/s^2",
        "Nm",
    )
    assert all(units[name] != name for name in variables if not name.startswith("v"))


@pytest.mark.parametrize(
    ("machine", "of_motor", "unit", "unit_of_heat"),
    [
        (servo_machine("position", SERVOS["position"]), "torque", "Nm", "(Nm)^2"),
        (one_motor("torque"), "torque", "Nm", "(Nm)^2"),
        (one_motor("current"), "current", "A", "A^2"),
        (one_motor("voltage"), "current", "A", "A^2"),
    ],
)
def test_a_torque_is_no_current_and_power_is_in_watts(
    machine: Machine, of_motor: str, unit: str, unit_of_heat: str
) -> None:
    """A servo's law and a torque drive know the torque of the shaft only; a current has a torque as well."""
    time_s = np.arange(400) * 5e-3
    command = np.sign(np.sin(8.0 * time_s))[:, None]
    readings = simulate_batch(machine, time_s, command).readings[0]
    data = prepare([Recording("run_01", time_s, command, readings)], machine)
    variables = dependence_variables(machine, data.runs[0], data)
    expected = {f"{of_motor} of motor": unit, f"{of_motor} of drives": unit, "heat of motor": unit_of_heat}
    shown = {name: _with_unit(name, machine).rpartition(", ")[2] for name in variables}
    assert {name: shown[name] for name in shown if name.startswith(("current", "torque", "heat"))} == expected
    drive, motor, speed = machine.drives[0], variables[f"{of_motor} of motor"], variables["velocity of shaft"]
    if drive.command == "voltage":
        power = command[:, 0] * motor
    else:
        power = drive.Kt * drive.gear_ratio * motor * speed
    np.testing.assert_allclose(variables["power of drives"], power)


@pytest.mark.parametrize(
    ("component", "variable"),
    [("motor1", "heat of motor1"), ("x", "position of y"), ("drives", "power of drives")],
)
def test_causes_outside_the_library_are_named_with_their_component(
    hframe: Machine, component: str, variable: str
) -> None:
    """Forces proportional to a current, a direction or a voltage times a variable, unlike library effects."""
    runs = []
    for run in excited_runs(hframe, count=4):
        data = prepare([run], hframe)
        of_run = dependence_variables(hframe, data.runs[0], data)
        if component == "motor1":
            forces = {"phi1": -0.003 * of_run["current of motor1"] * of_run[variable]}
        elif component == "x":
            forces = {"x": -10.0 * smooth_sign(of_run["velocity of x"]) * of_run[variable]}
        else:
            forces = {f"phi{j}": -4e-4 * of_run[f"v{j}_V"] * of_run[variable] for j in (1, 2)}
        extra = np.zeros((1, len(run.time_s), 4))
        for coordinate, force in forces.items():
            extra[0, :, hframe.coordinate_names.index(coordinate)] = force
        readings = simulate_batch(
            hframe, run.time_s, run.inputs, extra_force=extra, longest_step=0.125e-3
        ).readings[0]
        readings[:, 2:] += np.random.default_rng(1).normal(0.0, 20e-6, readings[:, 2:].shape)
        runs.append(dataclasses.replace(run, outputs=readings))
    strongest = rank_dependences(hframe, prepare(runs, hframe))[0]
    assert (strongest.component, strongest.variable) == (component, variable)
    assert strongest.explained > 0.5


def test_the_error_of_one_sensor_is_named_with_the_sensor(hframe: Machine) -> None:
    """A graduation with a period of 6 mm; no force causes it, because the encoders show none."""
    runs = []
    for run in excited_runs(hframe, count=4):
        outputs = run.outputs.copy()
        outputs[:, 2] += 0.15e-3 * np.sin(2.0 * np.pi * outputs[:, 2] / 6e-3)
        runs.append(dataclasses.replace(run, outputs=outputs))
    strongest = rank_dependences(hframe, prepare(runs, hframe))[0]
    assert (strongest.component, strongest.variable) == ("x_m", "position of x")
    assert strongest.explained > 0.8


def test_a_prediction_that_diverges_has_no_causes(hframe: Machine) -> None:
    """Friction that accelerates, faster than the observer corrects."""
    data = prepare(excited_runs(hframe, count=1), hframe)
    x, *others = hframe.coordinates
    unstable = hframe.replace(coordinates=(dataclasses.replace(x, viscous=-1e4), *others))
    assert not np.isfinite(missing_motions(unstable, data)[0].velocities).all()
    assert rank_dependences(unstable, data) == []
