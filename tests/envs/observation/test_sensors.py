"""Sensors: what an environment measures, against true state, declaration and simulation."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import kstest, norm

from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.envs import Encoders, HFrameEnv, HFrameVectorEnv, Lasers, Reach, Sensors, observed_machine
from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES, SENSOR_KINDS, Sensor, SensorKind, rest_state

COUNT = 2 * np.pi / (4 * 512 * 5.9)  # rad, section II of the paper
OFF_CENTER = Reach(start=(0.012, -0.031), target=(0.03, 0.0))
EXACT = Sensors(lasers=Lasers(span=np.inf, noise=0.0))


def run(sensors, steps=25, action=(0.4, -0.1), task=OFF_CENTER, **options):
    """Return an environment and an episode's observations with the true state, by key, (steps + 1, n)."""
    env = HFrameEnv(sensors=sensors, privileged=True, task=task, **options)
    rows = [env.reset(seed=0)[0]]
    rows += [env.step(np.array(action, np.float32))[0] for _ in range(steps)]
    return env, {key: np.array([row[key] for row in rows], np.float64) for key in rows[0]}


# -- the preset "rig" ----------------------------------------------------------------------------------------


def test_encoders_count():
    env, observed = run("rig")
    assert [e.name for e in env.entries[:4]] == ["x", "y", "phi1", "phi2"]
    counts = observed["observation"][:, 2:4] / COUNT
    np.testing.assert_allclose(counts, np.rint(counts), atol=2e-3)
    assert np.abs(observed["observation"][:, 2:4] - observed["privileged"][:, 2:4]).max() <= 0.5001 * COUNT
    assert len(np.unique(counts[:, 0])) > 10


def test_lasers_are_noisy_within_their_range():
    envs = HFrameVectorEnv(4000, sensors="rig", privileged=True, task=OFF_CENTER)
    observation, _ = envs.reset(seed=0)
    noise = observation["observation"][:, :2].astype(float) - observation["privileged"][:, :2]
    for column in noise.T:
        assert kstest(column / 20e-6, norm.cdf).pvalue > 1e-3
    assert abs(np.corrcoef(noise.T)[0, 1]) < 0.05


def test_a_laser_sticks_at_the_end_of_its_range():
    # Voltages of opposite sign move the tool in -x. Outside the range the measurement is its end, to the bit.
    _, observed = run(Sensors(lasers=Lasers(span=0.02, centre=(0.012, -0.031))), steps=40, action=(0.6, -0.6))
    x, true = observed["observation"][:, 0], observed["privileged"][:, 0]
    beyond = np.abs(true - 0.012) > 0.01
    assert beyond.sum() > 10
    ends = 0.012 + np.array([-0.01, 0.01])
    assert np.all(np.isin(x[beyond].astype(np.float32), ends.astype(np.float32)))
    assert np.abs(x - true)[~beyond].max() < 3e-4


def test_velocities_are_differences_of_measurements():
    _, observed = run("rig")
    positions, speeds = observed["observation"][:, :4], observed["observation"][:, 4:]
    np.testing.assert_array_equal(speeds[0], 0.0)
    np.testing.assert_allclose(speeds[1:], np.diff(positions, axis=0) / 0.01, atol=2e-3)


def test_achieved_goal_is_measured_by_lasers_or_else_by_encoders():
    _, observed = run("rig")
    inside = np.abs(observed["observation"][:, :2]) < 0.05
    np.testing.assert_array_equal(observed["achieved_goal"][inside], observed["observation"][:, :2][inside])
    assert np.abs(observed["achieved_goal"] - observed["privileged"][:, :2]).max() < 3e-3
    assert 10 < inside[:, 1].sum() < len(inside)
    machine = BUILTIN_MACHINES["hframe"]()
    env, observed = run(Sensors(lasers=None))
    assert [e.name for e in env.entries] == ["phi1", "phi2", "phi1 velocity", "phi2 velocity"]
    # On unstretched belts, rest_state gives the measured angles for the achieved positions.
    angles = np.array([rest_state(machine, position)[2:4] for position in observed["achieved_goal"]])
    np.testing.assert_allclose(angles, observed["observation"][:, :2], atol=1e-5)
    # Belts do stretch, by fractions of a millimeter.
    error = np.abs(observed["achieved_goal"] - observed["privileged"][:, :2]).max()
    assert 1e-5 < error < 3e-3


def test_lasers_alone():
    env, observed = run(Sensors(encoders=None, lasers=Lasers(span=np.inf, noise=0.0)))
    assert [e.name for e in env.entries] == ["x", "y", "x velocity", "y velocity"]
    np.testing.assert_allclose(observed["observation"][:, :2], observed["privileged"][:, :2], atol=1e-7)


def test_info_holds_the_truth():
    env = HFrameEnv(
        sensors=Sensors(lasers=Lasers(noise=1e-2)), task=Reach(start=(0.0, 0.0), target=(0.0, 0.0))
    )
    _, info = env.reset(seed=0)
    assert info["distance_m"] == 0.0
    observation, reward, *_, info = env.step(np.zeros(2))
    assert info["is_success"]
    assert np.abs(observation["achieved_goal"]).max() > 1e-3
    assert reward == env.compute_reward(observation["achieved_goal"], observation["desired_goal"], {})


def test_privileged_holds_the_randomized_parameters():
    env = HFrameEnv(randomize="wide", privileged=True, machine="hframe-order20")
    observation, info = env.reset(seed=3)
    entries = env.privileged_entries
    assert observation["privileged"].shape == (len(entries),) == env.observation_space["privileged"].shape
    assert len(entries) == 2 * 10 + len(info["parameters"])
    nominal = env.batch.machine.parameters
    parameters = {
        entry.name: value * nominal[entry.name]
        for entry, value in zip(entries, observation["privileged"], strict=True)
        if not entry.coordinate
    }
    assert parameters == pytest.approx(info["parameters"], rel=1e-6)
    assert len(parameters) > 20


# -- effects at sensors --------------------------------------------------------------------------------------


def machine_with(*effects):
    """Return the machine with noise-free sensors of x and y and effects."""
    machine = BUILTIN_MACHINES["hframe"]()
    sensors = [dataclasses.replace(s, noise=0.0, resolution=0.0) for s in machine.sensors]
    return machine.replace(sensors=tuple(sensors)).with_effects(*effects)


@pytest.mark.parametrize("sensors", ["machine", EXACT])
def test_an_identified_skew_shows_in_the_observations(sensors):
    machine = machine_with(
        EFFECTS["sensor_skew"].at("x_m", a=0.05), EFFECTS["sensor_scale"].at("y_m", g=0.02)
    )
    _, observed = run(sensors, machine=machine)
    x, y = observed["privileged"][:, :2].T
    np.testing.assert_allclose(observed["observation"][:, 0], x + 0.05 * y, atol=1e-7)
    np.testing.assert_allclose(observed["observation"][:, 1], 1.02 * y, atol=1e-7)
    np.testing.assert_array_equal(observed["achieved_goal"], observed["observation"][:, :2])
    assert np.ptp(0.05 * y) > 5e-4


@pytest.mark.parametrize("delay", [0.0017, 0.01, 0.0234])
def test_an_identified_delay_shows_in_the_observations(delay):
    machine = machine_with(
        EFFECTS["sensor_delay"].at("x_m", d=delay), EFFECTS["sensor_skew"].at("x_m", a=0.05)
    )
    env, observed = run("machine", steps=20, machine=machine)
    # The same readings by the machine's simulation at every step of the integrator.
    steps = env.batch.simulator.steps
    volts = np.repeat(12.0 * np.tile(np.array([0.4, -0.1], np.float32), (20, 1)), steps, axis=0)
    start = rest_state(machine, OFF_CENTER.start)
    time_s = np.arange(len(volts) + 1) * env.batch.simulator.h
    step = env.batch.simulator.h
    outputs = simulate(machine, time_s, np.vstack([volts, volts[-1:]]), start, longest_step=step).outputs
    columns = [machine.output_channels.index(c) for c in ("x_m", "y_m", "phi1_rad", "phi2_rad")]
    np.testing.assert_allclose(
        observed["observation"][:, :4], outputs[::steps, columns], rtol=2e-6, atol=1e-8
    )
    assert np.abs(observed["observation"][:, 0] - observed["privileged"][:, 0]).max() > 1e-3


def test_delays_do_not_change_the_motion():
    machine = machine_with()
    delayed = machine_with(
        EFFECTS["sensor_delay"].at("x_m", d=0.004), EFFECTS["input_delay"].at("drives", d=0.0023)
    )
    prompt = machine.with_effects(EFFECTS["input_delay"].at("drives", d=0.0023))
    states = [run("machine", machine=m)[1]["privileged"] for m in (delayed, prompt)]
    np.testing.assert_allclose(*states, rtol=1e-6, atol=1e-9)


def test_a_delay_line_does_not_mix_episodes_or_environments():
    machine = machine_with(EFFECTS["sensor_delay"].at("x_m", d=0.015))
    envs = HFrameVectorEnv(11, sensors="machine", machine=machine, autoreset_mode="Disabled")
    envs.reset(seed=0)
    for _ in range(7):
        envs.step(np.full((11, 2), 0.5, np.float32))
    mask = np.arange(11) % 3 == 0
    observation, _ = envs.reset(seed=list(range(11)), options={"reset_mask": mask})
    fresh, _ = HFrameVectorEnv(11, sensors="machine", machine=machine).reset(seed=0)
    np.testing.assert_array_equal(observation["observation"][mask], fresh["observation"][mask])
    single = HFrameEnv(sensors="machine", machine=machine)
    single.reset(seed=3)
    for _ in range(4):
        many, *_ = envs.step(np.full((11, 2), -0.3, np.float32))
        one, *_ = single.step(np.full(2, -0.3, np.float32))
        np.testing.assert_array_equal(many["observation"][3], one["observation"])


# -- the machine's declaration -------------------------------------------------------------------------------


def test_declared_sensors_are_observed_in_the_order_of_the_state():
    env, observed = run("machine")
    assert [e.name for e in env.entries] == [e.name for e in HFrameEnv().entries]
    counts = observed["observation"][:, 2:4] / COUNT
    np.testing.assert_allclose(counts, np.rint(counts), atol=2e-3)
    assert 1e-6 < np.abs(observed["observation"][:, 0] - observed["privileged"][:, 0]).max() < 1e-4


def test_two_sensors_of_one_coordinate():
    machine = machine_with()
    scale = Sensor("x_scale_m", {"x": -1.0}, resolution=1e-3, kind="encoder")
    machine = machine.with_components(scale)
    env, observed = run("machine", machine=machine)
    assert [e.name for e in env.entries[:5]] == ["x_m", "x_scale_m", "y", "phi1", "phi2"]
    assert env.observation_space["observation"].contains(observed["observation"][3].astype(np.float32))
    np.testing.assert_allclose(observed["observation"][:, 1], -observed["privileged"][:, 0], atol=0.51e-3)


def test_sensors_that_do_not_determine_the_tool_are_refused():
    machine = BUILTIN_MACHINES["hframe"]()
    machine = machine.replace(sensors=tuple(s for s in machine.sensors if s.channel in ("x_m", "phi1_rad")))
    with pytest.raises(InputError, match=r"\(x_m, phi1_rad\) do not determine y"):
        HFrameEnv(machine=machine, sensors="machine")
    HFrameEnv(machine=machine, sensors="rig")  # adds what is missing


def test_observed_machine_declares_what_is_observed():
    machine = BUILTIN_MACHINES["hframe"]()
    assert observed_machine(machine, "state") is None
    rig = observed_machine(machine, "rig")
    assert rig.output_channels == ("x_m", "y_m", "phi1_rad", "phi2_rad")
    assert rig.sensor("x_m").noise == 20e-6
    assert rig.sensor("phi1_rad").resolution == pytest.approx(COUNT)
    assert rig.parameters["sensor_range@y_m.high"] == 0.05
    delayed = machine.with_effects(EFFECTS["sensor_delay"].at("phi1_rad", d=0.01))
    assert observed_machine(delayed, Sensors(encoders=None)).output_channels == ("x_m", "y_m")
    simulate(observed_machine(delayed, Sensors(encoders=None)), np.arange(3) * 1e-3, np.zeros((3, 2)))


@SENSOR_KINDS.register("coarse-test")
class Coarse(SensorKind):
    """A sensor that shows only positive numbers, with twice the noise."""

    @staticmethod
    def measure(reading, noise, resolution, normal):
        """Return the size of a reading with noise."""
        return np.abs(reading + 2.0 * noise * normal)


def test_a_sensor_kind_of_another_file():
    machine = BUILTIN_MACHINES["hframe"]()
    machine = machine.with_components(dataclasses.replace(machine.sensor("y_m"), kind="coarse-test"))
    envs = HFrameVectorEnv(4000, machine=machine, sensors="machine", privileged=True, task=OFF_CENTER)
    observation, _ = envs.reset(seed=0)
    error = observation["observation"][:, 1].astype(float) + observation["privileged"][:, 1]
    assert kstest(error / 40e-6, norm.cdf).pvalue > 1e-3
    after, *_ = envs.step(np.zeros((4000, 2)))
    rate = (after["observation"][:, 1].astype(float) - observation["observation"][:, 1]) / 0.01
    np.testing.assert_allclose(after["observation"][:, 5], rate, atol=2e-5)
    single = HFrameEnv(machine=machine, sensors="machine", task=OFF_CENTER)
    one, _ = single.reset(seed=7)
    np.testing.assert_array_equal(one["observation"], observation["observation"][7])


def test_environments_that_were_never_reset_have_sensors_of_nominal_resolution(monkeypatch):
    resolutions = []

    def measure(reading, noise, resolution, normal):
        resolutions.append(resolution)
        return np.abs(reading)

    monkeypatch.setattr(Coarse, "measure", staticmethod(measure))
    machine = BUILTIN_MACHINES["hframe"]()
    coarse = dataclasses.replace(machine.sensor("y_m"), kind="coarse-test", resolution=1e-3)
    machine = machine.with_components(coarse)
    envs = HFrameVectorEnv(5, machine=machine, sensors="machine", autoreset_mode="Disabled")
    envs.reset(seed=0, options={"reset_mask": np.array([False, True, False, False, True])})
    envs.step(np.zeros((5, 2)))
    np.testing.assert_array_equal(resolutions, np.full((2, 5), 1e-3))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Sensors(encoders=None, lasers=None), "neither"),
        (lambda: Encoders(lines=0), "lines is 0"),
        (lambda: Encoders(lines="512"), "lines is '512', it must be a number"),
        (lambda: Lasers(noise=None), "noise is None, it must be a number"),
        (lambda: Lasers(span="0.1"), "span is '0.1', it must be a positive number"),
        (lambda: Lasers(centre=0.0), "centre is 0.0, it must be"),
        (lambda: Lasers(centre=("a", "b")), "centre is"),
        (lambda: Sensors(encoders=512), r"encoders is 512, it must be Encoders\(...\) or None"),
        (lambda: Sensors(lasers=True), r"lasers is True, it must be Lasers\(...\) or None"),
        (lambda: Lasers(noise=-1.0), "noise is -1.0"),
        (lambda: Lasers(span=float("nan")), "span is nan"),
        (lambda: Lasers(centre=(0.0,)), "centre"),
        (lambda: HFrameEnv(sensors="eyes"), "eyes"),
        (lambda: HFrameEnv(sensors=None), "None"),
        (lambda: HFrameEnv(privileged="yes"), "yes"),
    ],
)
def test_invalid_sensors_are_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()
