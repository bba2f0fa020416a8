"""Tests of the velocity of runs that begin in motion."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.identification import simulate_recording
from hframe_gym.machine import Machine, Sensor, rigid_basis
from hframe_gym.preparation.runs.moving import moving_runs
from hframe_gym.preparation.start.belt_stretch import stretch_angles
from hframe_gym.preparation.start.initial_velocity import InitialVelocity, initial_velocity
from hframe_gym.preparation.start.measured_state import estimate_initial_state
from hframe_gym.recordings import Recording, load_machine

NOISE = 20e-6  # m


def driven(machine: Machine, first: int, seed: int = 0) -> tuple[Recording, np.ndarray]:
    """Return a noisy run under sinusoidal voltages, cut at its row `first`, and the true velocities there."""
    time_s = np.arange(1500) * 1e-3
    volts = np.sin(2 * np.pi * time_s[:, None] * [1.1, 1.7] + [0.5, 1.5]) * 5.0
    motion = machine.simulate(time_s, volts)
    noise = np.random.default_rng(seed).normal(0.0, [1e-4, 1e-4, NOISE, NOISE], motion.outputs.shape)
    outputs = motion.outputs + noise
    return Recording("cut", time_s[first:], volts[first:], outputs[first:]), motion.velocities[first]


def estimated_velocity(recording: Recording, machine: Machine) -> InitialVelocity:
    """Return the estimated velocity of a run that begins at the position that its lasers measure."""
    initial = estimate_initial_state(recording, machine)
    return initial_velocity(recording, machine, rigid_basis(machine), initial.position)


@pytest.mark.parametrize("first", [300, 777, 1010])
def test_a_run_that_was_cut_out_of_a_log_begins_with_the_velocity_of_its_first_rows(
    hframe: Machine, first: int
) -> None:
    recording, true = driven(hframe, first)
    velocity = estimated_velocity(recording, hframe)
    errors = (velocity.mean - true)[:2]
    assert np.abs(true[:2]).max() > 0.1
    assert np.all(np.abs(errors) < 0.03 + 2.0 * np.linalg.norm(velocity.deviations, axis=0)[:2])
    assert np.abs(errors).max() < 0.1 * np.abs(true[:2]).max()
    result = simulate_recording(hframe, recording)
    assert np.sqrt(np.mean(result.error[:, 2:] ** 2)) < 1.2 * NOISE


def test_a_run_that_begins_at_rest_with_a_voltage_has_no_velocity(hframe: Machine) -> None:
    recording, true = driven(hframe, 0)
    assert not true.any()
    assert not estimated_velocity(recording, hframe).mean.any()


def test_a_run_that_rests_first_has_no_uncertain_velocity(hframe: Machine) -> None:
    recording, _ = driven(hframe, 0)
    rest = np.arange(100) * 1e-3
    rested = Recording(
        "rested",
        np.concatenate([rest, 0.1 + recording.time_s]),
        np.pad(recording.inputs, ((100, 0), (0, 0))),
        np.pad(recording.outputs, ((100, 0), (0, 0)), mode="edge"),
    )
    initial = estimate_initial_state(rested, hframe)
    assert not initial.velocity.any()
    assert len(initial.velocity_deviations) == 0


def test_a_slow_log_gives_a_velocity_from_its_first_eight_rows() -> None:
    """At 50 Hz, no window of up to 40 ms has enough rows for a parabola."""
    axis = load_machine("axis")
    time_s = np.arange(100) * 0.02
    position = 0.1 * np.sin(1.5 * time_s)
    volts = np.full((100, 1), 1.0)
    velocity = estimated_velocity(Recording("slow", time_s, volts, position[:, None]), axis)
    assert velocity.mean[0] == pytest.approx(0.15, abs=2 * float(np.abs(velocity.deviations).max()))


def test_a_force_that_depends_on_the_position_acts_where_the_encoder_counts() -> None:
    """Friction is low where the run begins, at 1.13 m, but so high at 0 that it would stop the axis."""
    axis = load_machine("axis")
    encoder = dataclasses.replace(axis.sensors[0], kind="encoder", noise=0.0, resolution=25e-6)
    rough = EFFECTS["position_friction"].at("x", A=0.9, L=0.04, p=np.pi / 2)
    machine = axis.replace(sensors=(encoder,)).with_effects(rough)
    time_s = np.arange(300) * 1e-3
    volts = 2.0 * np.sin(2 * np.pi * 3.0 * time_s + 0.5)[:, None]
    outputs = machine.simulate(time_s, volts, [1.13, -0.04]).outputs
    recording = Recording("rough", time_s, volts, np.rint(outputs / 25e-6) * 25e-6)
    initial = estimate_initial_state(recording, machine)
    assert initial.velocity[0] == pytest.approx(-0.04, rel=0.1)
    assert np.abs(initial.velocity_deviations).max() < 0.01


def motor_run(kind: str, speed: float) -> tuple[Machine, Recording]:
    """Return a motor of 50 times its declared inertia and friction, and its run at 865 Hz from a speed."""
    declared = load_machine("motor")
    sensor = dataclasses.replace(declared.sensors[0], kind=kind, noise=0.0, resolution=0.0)
    declared = declared.replace(sensors=(sensor,))
    shaft = declared.coordinates[0]
    heavy = declared.replace({"shaft.mass": 50 * shaft.mass, "shaft.coulomb": 50 * shaft.coulomb})
    time_s = np.arange(600) / 865
    volts = np.where(time_s < 0.4, 12.0, -12.0)[:, None]
    outputs = heavy.simulate(time_s, volts, [0.0, speed]).outputs
    noise = np.random.default_rng(0).normal(0.0, 0.3 if kind == "speed" else 1e-3, outputs.shape)
    return declared, Recording("cut", time_s, volts, outputs + noise)


@pytest.mark.parametrize("kind", ["speed", "encoder"])
@pytest.mark.parametrize("speed", [150.0, -60.0, 0.0])
def test_a_declared_machine_that_is_far_too_light_does_not_hide_the_initial_velocity(
    kind: str, speed: float
) -> None:
    declared, recording = motor_run(kind, speed)
    velocity = estimate_initial_state(recording, declared).velocity[0]
    assert velocity == pytest.approx(speed, abs=0.05 * abs(speed))


def counted_speed(speed: float, seconds: float, seed: int) -> tuple[Machine, Recording]:
    """Return a motor and a run from a speed to 4.9 rad/s, whose tachometer has steps of 0.748 rad/s."""
    declared = load_machine("motor")
    declared = declared.replace(sensors=(Sensor("shaft_rad_s", {"shaft": 1.0}, noise=0.0, kind="speed"),))
    time_s = np.arange(500) * 6e-3
    motion = 4.9 + (speed - 4.9) * np.exp(-time_s / seconds)
    phases = np.random.default_rng(seed).uniform(0.0, 1.0, 500)
    counted = 0.748 * np.floor(motion / 0.748 + phases)
    return declared, Recording("cut", time_s, np.full((500, 1), 7.2), counted[:, None])


@pytest.mark.parametrize("seed", [0, 2])
@pytest.mark.parametrize("speed", [2.24, 0.0])
def test_a_speed_in_coarse_steps_shows_the_initial_velocity(speed: float, seed: int) -> None:
    """A speed of counts per interval alternates between two neighbors if it is constant: no large noise."""
    declared, recording = counted_speed(speed, 0.03, seed)
    assert estimate_initial_state(recording, declared).velocity[0] == pytest.approx(speed, abs=0.3)


def test_a_run_of_a_few_steps_of_the_speed_moves() -> None:
    assert moving_runs([counted_speed(2.24, 0.1, 2)[1]]) == ("cut",)
    assert moving_runs([counted_speed(4.9, 0.1, 2)[1]]) == ()


@pytest.mark.parametrize("speed", [200.0, 100.0])
def test_a_declared_machine_that_is_far_too_heavy_does_not_hide_a_reversal(speed: float) -> None:
    """The motor is reversed within the rows from which the velocity is estimated, the heavy one is not."""
    declared = load_machine("motor")
    declared = declared.replace(sensors=(Sensor("shaft_rad_s", {"shaft": 1.0}, noise=0.3, kind="speed"),))
    shaft = declared.coordinates[0]
    light = declared.replace({"shaft.mass": 4.0 * shaft.mass})
    heavy = declared.replace({"shaft.mass": 150.0 * shaft.mass})
    time_s = np.arange(400) / 465
    volts = np.full((400, 1), -12.0)
    outputs = light.simulate(time_s, volts, [0.0, speed]).outputs
    noisy = outputs + np.random.default_rng(0).normal(0.0, 0.3, outputs.shape)
    initial = estimate_initial_state(Recording("reversed", time_s, volts, noisy), heavy)
    assert initial.velocity[0] == pytest.approx(speed, abs=0.15 * speed)


def test_the_stretch_of_belts_does_not_depend_on_how_they_are_divided(hframe: Machine) -> None:
    """The 20th-order machine has more belt sections for the same stage."""
    finer = load_machine("hframe-order20")
    coarse, fine = stretch_angles(hframe, moving=True), stretch_angles(finer, moving=True)
    for motor in ("phi1", "phi2"):
        assert fine[motor] == pytest.approx(coarse[motor], rel=0.1)


def test_all_drives_of_a_pulley_stretch_its_belts(hframe: Machine) -> None:
    small = dataclasses.replace(hframe.drives[0], name="small", channel="v3_V", Kt=0.1 * hframe.drives[0].Kt)
    more = dataclasses.replace(hframe, drives=(*hframe.drives, small))
    assert stretch_angles(more, moving=True)["phi1"] > stretch_angles(hframe, moving=True)["phi1"]


def test_pulleys_that_no_carriage_holds_stretch_their_belt() -> None:
    """Two motors turn a pulley by a belt, and no carriage is on it."""
    machine = load_machine(Path(__file__).parents[3] / "benchmarks" / "machines" / "ced.json")
    machine = machine.with_components(Sensor("pulley_rad", {"pulley": 1.0}, kind="encoder"))
    angles = stretch_angles(machine, moving=True)
    assert list(angles) == ["pulley"]
    assert 0.0 < angles["pulley"] < 10.0
