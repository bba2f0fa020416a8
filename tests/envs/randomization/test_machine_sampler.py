"""Sampling of machine, device and task parameters: values, limits, and dependence on the seed alone."""

import dataclasses

import numpy as np
import pytest

from hframe_gym.envs import (
    HFrameEnv,
    HFrameVectorEnv,
    LogUniform,
    Normal,
    RandomizeIdentified,
    RandomizeParameter,
    Track,
    Uniform,
)
from hframe_gym.envs.randomization.domain_randomization import DEFAULT
from hframe_gym.envs.randomization.machine_sampler import ParameterSpace, RuleSampler
from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES, Uncertainty

MACHINE = BUILTIN_MACHINES["hframe"]()


def sample(rules, count=1000, machine=MACHINE):
    """Return sampled values by full name, (count,) each, and the sampler."""
    space = ParameterSpace.of(machine, {"speed": 0.3})
    sampler = RuleSampler(space, rules, machine, "reset")
    uniforms = np.random.default_rng(0).random((count, sampler.draws))
    values = sampler.sample(np.tile(space.nominal, (count, 1)), uniforms)
    return dict(zip(space.names, values.T, strict=True)), sampler


def test_bounds_of_a_normal_distribution_are_finite():
    """Uniform numbers lie between 2^-54 and 1 - 2^-53, that is, within 8.3 standard deviations."""
    values, sampler = sample([RandomizeParameter("x.mass", Normal(1.0, 0.05))])
    j = list(values).index("x.mass")
    assert sampler.low[j] == pytest.approx(4.07 * (1.0 - 8.292 * 0.05), rel=1e-3)
    assert sampler.high[j] == pytest.approx(4.07 * (1.0 + 8.210 * 0.05), rel=1e-3)


@pytest.mark.parametrize(
    ("how", "low", "high"), [("scale", 4.07 * 0.5, 4.07 * 2.0), ("add", 4.57, 6.07), ("set", 0.5, 2.0)]
)
def test_scale_add_and_set(how, low, high):
    values, sampler = sample([RandomizeParameter("x.mass", Uniform(0.5, 2.0), how=how)])
    assert sampler.names == ("x.mass",)
    assert low <= values["x.mass"].min() < values["x.mass"].max() <= high
    np.testing.assert_array_equal(values["y.mass"], MACHINE.parameters["y.mass"])


def test_a_pattern_samples_one_number_each_unless_shared():
    values, _ = sample([RandomizeParameter("*.EA", Uniform(0.7, 1.3))])
    assert not np.array_equal(values["left.EA"], values["right.EA"])
    values, _ = sample([RandomizeParameter("*.EA", Uniform(0.7, 1.3), shared=True)])
    np.testing.assert_array_equal(values["left.EA"], values["right.EA"])


def test_the_default_preset():
    values, sampler = sample(DEFAULT)
    ratio = {name: values[name] / MACHINE.parameters[name] for name in sampler.names}
    ends = {"EA": (0.7, 1.3), "rest_length": (0.85, 1.2), "coulomb": (0.5, 2.0), "mass": (0.9, 1.2)}
    assert len(ratio) == 3 + 3 + 4 + 4
    for name, r in ratio.items():
        low, high = ends[name.rpartition(".")[2]]
        assert low <= r.min() < low + 0.02 * (high - low), name
        assert high - 0.02 * (high - low) < r.max() <= high, name


@pytest.mark.parametrize("name", ["x.coulomb", "x_m.noise"])
def test_negative_friction_and_noise_become_zero(name):
    values, _ = sample([RandomizeParameter(name, Normal(0.0, 5.0), how="add")])
    assert values[name].min() == 0.0


def test_a_negative_mass_is_refused_when_it_is_sampled():
    with pytest.raises(
        InputError, match=r"Normal\(mean=1.0, std=2.0\).* yielded y.mass = -.*bounded distribution"
    ):
        sample([RandomizeParameter("y.mass", Normal(1.0, 2.0))])


def test_rules_on_one_parameter_are_checked_together():
    half = RandomizeParameter("x.mass", Uniform(0.2, 1.0))
    sample([half])
    with pytest.raises(InputError, match=r"can yield x.mass = 0.1628, outside \[0.2035, inf\]"):
        sample([half, half])
    with pytest.raises(InputError, match=r"can yield x.mass"):
        HFrameEnv(randomize=[half, RandomizeParameter("x.mass", Uniform(0.2, 1.0), when="startup")])


def test_a_belt_keeps_a_length_wherever_the_carriage_is():
    # The bottom belt is 1.28 m long at x = 0 and 0.56 m shorter at x = 0.28 m.
    with pytest.raises(
        InputError, match=r"Uniform\(low=0.4, high=1.0\).* can yield bottom.rest_length = 0.513"
    ):
        HFrameEnv(randomize=[RandomizeParameter("*.rest_length", Uniform(0.4, 1.0))])


def test_limits_follow_from_the_sign_of_the_nominal_value():
    space = ParameterSpace.of(MACHINE, {"speed": 0.3, "offset": 0.0, "slope": -1.0})
    limits = dict(zip(space.names, zip(space.lower.tolist(), space.upper.tolist(), strict=True), strict=True))
    assert limits["task.speed"] == (pytest.approx(0.015), np.inf)
    assert limits["task.offset"] == (0.0, np.inf)
    assert limits["task.slope"] == (-np.inf, np.inf)
    assert limits["x.coulomb"] == (0.0, np.inf)
    assert limits["motor1.converter_bits"] == (0.0, 32.0)


def test_the_range_of_a_rotary_coordinate_limits_a_belt_by_its_travel():
    pulley = dataclasses.replace(MACHINE.coordinate("phi1"), range=(-10.0, 10.0))
    left = dataclasses.replace(MACHINE.belt("left"), length={"phi1": 1.0})
    space = ParameterSpace.of(MACHINE.with_components(pulley, left))
    rest_length, radius = MACHINE.parameters["left.rest_length"], MACHINE.parameters["phi1.radius"]
    assert space.lower[space.names.index("left.rest_length")] == pytest.approx(
        0.05 * rest_length + 10.0 * radius
    )


def test_rules_are_applied_in_their_order():
    rules = [RandomizeIdentified(), RandomizeParameter("x.coulomb", Uniform(0.1, 0.2))]
    values, sampler = sample(rules, machine=identified_machine())
    i = list(values).index("x.coulomb")
    assert sampler.low[i] <= values["x.coulomb"].min() <= values["x.coulomb"].max() <= sampler.high[i]


def test_low_and_high_enclose_the_samples():
    rules = [
        RandomizeParameter("*.mass", Normal(1.0, 0.05)),
        RandomizeParameter("x.mass", Uniform(-0.5, 0.5), how="add"),
        *DEFAULT,
    ]
    values, sampler = sample(rules)
    for i, column in enumerate(values.values()):
        assert sampler.low[i] <= column.min() <= column.max() <= sampler.high[i]


def identified_machine():
    """Return the machine with a covariance of two parameters."""
    covariance = np.array([[0.04, 0.05], [0.05, 0.25]])
    return dataclasses.replace(MACHINE, uncertainty=Uncertainty(("x.coulomb", "y.viscous"), covariance))


def test_identified_parameters_have_their_covariance():
    values, sampler = sample([RandomizeIdentified()], count=20000, machine=identified_machine())
    assert sampler.names == ("x.coulomb", "y.viscous")
    covariance = np.cov(values["x.coulomb"], values["y.viscous"])
    np.testing.assert_allclose(covariance, [[0.04, 0.05], [0.05, 0.25]], rtol=0.05)
    env = HFrameEnv(machine=identified_machine(), randomize="identified")
    assert set(env.reset(seed=0)[1]["parameters"]) == {"x.coulomb", "y.viscous"}


def test_identified_parameters_do_not_depend_on_the_batch():
    envs = HFrameVectorEnv(13, machine=identified_machine(), randomize="identified")
    _, info = envs.reset(seed=0)
    env = HFrameEnv(machine=identified_machine(), randomize="identified")
    for b in range(13):
        _, single = env.reset(seed=b)
        assert set(single["parameters"]) == {"x.coulomb", "y.viscous"}
        for name, value in single["parameters"].items():
            assert info["parameters"][name][b] == value


# -- devices and tasks: what is randomized is what acts ------------------------------------------------------


def measurements(steps=12, action=(0.4, -0.1), **options):
    """Return observations, (steps + 1, n), and the info of an episode from (0.01, -0.03)."""
    env = HFrameEnv(**options)
    start = {"start": (0.01, -0.03)} if options.get("task") is None else {}
    observation, info = env.reset(seed=0, options=start)
    rows = [observation["observation"]]
    rows += [env.step(np.array(action, np.float32))[0]["observation"] for _ in range(steps)]
    return np.array(rows, np.float64), info


def fixed(name, value):
    """Return a rule that sets a parameter."""
    return [RandomizeParameter(name, Uniform(value, value), how="set")]


def with_sensor(machine=MACHINE, **fields):
    """Return the machine with other fields of its sensor x_m."""
    return machine.with_components(dataclasses.replace(machine.sensor("x_m"), **fields))


@pytest.mark.parametrize(("field", "value"), [("noise", 1e-3), ("resolution", 5e-4)])
def test_sensor_noise_and_resolution_can_be_randomized(field, value):
    rows, info = measurements(sensors="machine", randomize=fixed(f"x_m.{field}", value))
    assert info["parameters"] == {f"x_m.{field}": value}
    expected, _ = measurements(sensors="machine", machine=with_sensor(**{field: value}))
    np.testing.assert_array_equal(rows, expected)
    assert not np.array_equal(rows, measurements(sensors="machine")[0])


def test_noise_differs_between_environments():
    rules = [RandomizeParameter("x_m.noise", LogUniform(0.01, 100.0))]
    envs = HFrameVectorEnv(2000, sensors="rig", randomize=rules, privileged=True)
    observation, info = envs.reset(seed=0, options={"start": (0.0, 0.0)})
    error = observation["observation"][:, 0] - observation["privileged"][:, 0].astype(float)
    noise = info["parameters"]["x_m.noise"]
    assert noise.min() < 1e-6 < 1e-3 < noise.max()
    assert np.std(error / noise) == pytest.approx(1.0, rel=0.1)


def test_the_range_of_a_laser_can_be_randomized():
    rows, info = measurements(sensors="rig", randomize=fixed("sensor_range@x_m.high", 0.005))
    assert info["parameters"] == {"sensor_range@x_m.high": 0.005}
    expected, _ = measurements(sensors="rig")
    beyond = expected[:, 0] > 0.0051
    assert 2 < beyond.sum() < len(rows)
    np.testing.assert_array_equal(rows[beyond, 0], np.float32(0.005))
    inside = expected[:, 0] < 0.0049
    np.testing.assert_array_equal(rows[inside, 0], expected[inside, 0])


def test_the_delay_of_a_sensor_can_be_randomized():
    from hframe_gym.effects import EFFECTS

    machine = MACHINE.with_effects(EFFECTS["sensor_delay"].at("x_m", d=0.0))
    machine = with_sensor(machine, noise=0.0)
    rows, info = measurements(sensors="machine", machine=machine, randomize=fixed("sensor_delay@x_m.d", 0.02))
    assert info["parameters"] == {"sensor_delay@x_m.d": 0.02}
    prompt, _ = measurements(sensors="machine", machine=machine)
    np.testing.assert_allclose(rows[2:, 0], prompt[:-2, 0], rtol=1e-6)
    np.testing.assert_allclose(rows[:, 1:4], prompt[:, 1:4], rtol=1e-5, atol=1e-4)


def test_converter_bits_can_be_randomized():
    from hframe_gym.envs import Actuators

    rows, info = measurements(randomize=fixed("motor*.converter_bits", 3))
    assert info["parameters"] == {"motor1.converter_bits": 3.0, "motor2.converter_bits": 3.0}
    np.testing.assert_array_equal(rows, measurements(drives=Actuators(bits=3))[0])
    assert not np.array_equal(rows, measurements()[0])
    rules = [RandomizeParameter("motor1.converter_bits", Uniform(2, 6), how="set")]
    envs = HFrameVectorEnv(50, randomize=rules)
    bits = envs.reset(seed=0)[1]["parameters"]["motor1.converter_bits"]
    assert set(bits) == {2.0, 3.0, 4.0, 5.0, 6.0}


def test_the_voltage_range_can_be_randomized():
    rows, _ = measurements(action=(0.8, -0.8), randomize=fixed("*.voltage_range", 6.0))
    np.testing.assert_array_equal(rows, measurements(action=(0.5, -0.5))[0])


def test_the_current_limit_can_be_randomized():
    from hframe_gym.envs import Actuators

    rows, info = measurements(drives="rig", action=(1.0, 1.0), randomize=fixed("current_limit@*.I", 2.0))
    assert info["parameters"] == {"current_limit@motor1.I": 2.0, "current_limit@motor2.I": 2.0}
    expected, _ = measurements(drives=Actuators(bits=12, current_limit=2.0), action=(1.0, 1.0))
    np.testing.assert_array_equal(rows, expected)
    assert not np.array_equal(rows, measurements(drives="rig", action=(1.0, 1.0))[0])


def test_the_speed_of_a_task_can_be_randomized():
    env = HFrameEnv(task="track", randomize=fixed("task.speed", 0.1))
    _, info = env.reset(seed=4)
    assert info["parameters"] == {"task.speed": 0.1}
    slow = HFrameEnv(task=Track(speed=0.1))
    slow.reset(seed=4)
    for _ in range(30):
        observation, expected = (e.step(np.zeros(2))[0] for e in (env, slow))
        np.testing.assert_array_equal(observation["desired_goal"], expected["desired_goal"])
        np.testing.assert_array_equal(observation["preview"], expected["preview"])
    envs = HFrameVectorEnv(40, task="track", randomize=[RandomizeParameter("task.speed", Uniform(0.5, 1.5))])
    envs.reset(seed=0)
    positions = [envs.step(np.zeros((40, 2)))[0]["desired_goal"].astype(float) for _ in range(40)]
    speed = np.linalg.norm(positions[-1] - positions[-2], axis=1) / 0.01
    expected = envs.step(np.zeros((40, 2)))[4]["parameters"]["task.speed"]
    np.testing.assert_allclose(speed, expected, rtol=1e-2)
    assert np.ptp(speed) > 0.2


def test_sampled_bits_stay_in_the_bounds_of_privileged():
    rule = RandomizeParameter("motor*.converter_bits", Uniform(10.4, 13.6), how="set")
    envs = HFrameVectorEnv(64, privileged=True, randomize=[rule])
    observation, info = envs.reset(seed=0)
    assert envs.observation_space.contains(observation)
    assert set(info["parameters"]["motor1.converter_bits"]) == {10.0, 11.0, 12.0, 13.0, 14.0}
    assert [(e.low, e.high) for e in envs.privileged_entries[-2:]] == [(10.0, 14.0)] * 2


def test_a_scaled_zero_is_not_randomized():
    frictionless = MACHINE.replace({"x.coulomb": 0.0})
    names = sample([RandomizeParameter("*.coulomb", Uniform(0.5, 2.0))], machine=frictionless)[1].names
    assert "y.coulomb" in names
    assert "x.coulomb" not in names
    rules = [RandomizeParameter("x.coulomb", Uniform(0.5, 2.0), how=how) for how in ("add", "scale")]
    assert sample(rules, machine=frictionless)[1].names == ("x.coulomb",)
