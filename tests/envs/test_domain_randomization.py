"""Randomisation: rules, presets, limits, and draws that depend on the seed alone."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import kstest, norm

from hframe_gym.envs import HFrameEnv, HFrameVectorEnv
from hframe_gym.envs.distributions import LogUniform, Normal, Uniform
from hframe_gym.envs.domain_randomization import DEFAULT, RandomizeIdentified, RandomizeParameter
from hframe_gym.envs.rule_sampler import RuleSampler
from hframe_gym.machine import BUILTIN_MACHINES, Uncertainty

MACHINE = BUILTIN_MACHINES["hframe"]()


def draw(rules, k=1000, machine=MACHINE):
    sampler = RuleSampler(machine, rules, "reset")
    rng = np.random.default_rng(0)
    base = np.tile(np.array(list(machine.parameters.values())), (k, 1))
    values = sampler.draw(base, rng.random((k, sampler.draws)))
    return dict(zip(machine.parameters, values.T, strict=True)), sampler


@pytest.mark.parametrize(
    ("how", "low", "high"), [("scale", 4.07 * 0.5, 4.07 * 2.0), ("add", 4.57, 6.07), ("set", 0.5, 2.0)]
)
def test_scale_add_set(how, low, high):
    values, sampler = draw([RandomizeParameter("x.mass", Uniform(0.5, 2.0), how=how)])
    assert sampler.names == ("x.mass",)
    assert low <= values["x.mass"].min() < values["x.mass"].max() <= high
    np.testing.assert_array_equal(values["y.mass"], MACHINE.parameters["y.mass"])


def test_a_pattern_draws_each_unless_shared():
    values, _ = draw([RandomizeParameter("*.EA", Uniform(0.7, 1.3))])
    assert not np.array_equal(values["left.EA"], values["right.EA"])
    values, _ = draw([RandomizeParameter("*.EA", Uniform(0.7, 1.3), shared=True)])
    np.testing.assert_array_equal(values["left.EA"], values["right.EA"])


def test_log_uniform_has_its_median_in_the_middle():
    values, _ = draw([RandomizeParameter("x.viscous", LogUniform(0.25, 4.0))])
    assert np.median(values["x.viscous"] / MACHINE.parameters["x.viscous"]) == pytest.approx(1.0, rel=0.15)


def test_default_is_what_it_says():
    values, sampler = draw(DEFAULT)
    nominal = MACHINE.parameters
    ratio = {name: values[name] / nominal[name] for name in sampler.names}
    ends = {"EA": (0.7, 1.3), "rest_length": (0.85, 1.2), "coulomb": (0.5, 2.0), "mass": (0.9, 1.2)}
    assert len(ratio) == 3 + 3 + 4 + 4
    for name, r in ratio.items():
        low, high = ends[name.rpartition(".")[2]]
        assert low <= r.min() < low + 0.02 * (high - low), name
        assert high - 0.02 * (high - low) < r.max() <= high, name


def test_normal_is_normal():
    values, _ = draw([RandomizeParameter("y.mass", Normal(0.3, 0.05), how="add")], k=20000)
    assert kstest((values["y.mass"] - 1.0412 - 0.3) / 0.05, norm.cdf).pvalue > 0.001


def test_friction_that_would_be_negative_is_none():
    values, _ = draw([RandomizeParameter("x.coulomb", Normal(0.0, 5.0), how="add")])
    assert values["x.coulomb"].min() == 0.0


def test_a_mass_that_would_be_negative_is_refused_at_the_draw():
    with pytest.raises(ValueError, match=r"Normal\(mean=1.0, std=2.0\).* drew y.mass = -.*bounded distribution"):
        draw([RandomizeParameter("y.mass", Normal(1.0, 2.0))])


def test_two_rules_are_judged_together():
    half = RandomizeParameter("x.mass", Uniform(0.2, 1.0))
    draw([half])
    with pytest.raises(ValueError, match=r"can make x.mass = 0.1628, outside \[0.2035, inf\]"):
        draw([half, half])
    with pytest.raises(ValueError, match=r"can make x.mass"):
        HFrameEnv(randomize=[half, RandomizeParameter("x.mass", Uniform(0.2, 1.0), when="startup")])


def test_a_belt_must_keep_a_length_wherever_the_carriage_is():
    # The bottom belt is 1.28 m long at x = 0 and 0.56 m shorter at x = 0.28 m.
    with pytest.raises(ValueError, match=r"Uniform\(low=0.4, high=1.0\).* can make bottom.rest_length = 0.513"):
        HFrameEnv(randomize=[RandomizeParameter("*.rest_length", Uniform(0.4, 1.0))])


def test_bounds_hold_what_is_drawn():
    rules = [
        RandomizeParameter("*.mass", Normal(1.0, 0.05)),
        RandomizeParameter("x.mass", Uniform(-0.5, 0.5), how="add"),
        *DEFAULT,
    ]
    values, sampler = draw(rules)
    for i, name in enumerate(MACHINE.parameters):
        assert sampler.low[i] <= values[name].min() <= values[name].max() <= sampler.high[i]


def identified():
    names = ("x.coulomb", "y.viscous")
    covariance = np.array([[0.04, 0.05], [0.05, 0.25]])
    return dataclasses.replace(MACHINE, uncertainty=Uncertainty(names, covariance))


def test_identified_draws_from_the_covariance():
    values, sampler = draw([RandomizeIdentified()], k=20000, machine=identified())
    assert sampler.names == ("x.coulomb", "y.viscous")
    found = np.cov(values["x.coulomb"], values["y.viscous"])
    np.testing.assert_allclose(found, [[0.04, 0.05], [0.05, 0.25]], rtol=0.05)
    env = HFrameEnv(machine=identified(), randomize="identified")
    assert set(env.reset(seed=0)[1]["parameters"]) == {"x.coulomb", "y.viscous"}


def test_identified_is_alike_in_any_batch():
    envs = HFrameVectorEnv(13, machine=identified(), randomize="identified")
    _, info = envs.reset(seed=0)
    env = HFrameEnv(machine=identified(), randomize="identified")
    for b in range(13):
        _, own = env.reset(seed=b)
        for name, value in own["parameters"].items():
            assert info["parameters"][name][b] == value


@pytest.mark.parametrize(
    ("rules", "message"),
    [
        ([RandomizeParameter("z.mass", Uniform(1, 2))], "no parameter 'z.mass'"),
        ([RandomizeParameter("x.mass", Uniform(-1, 1))], "x.mass = -4.07"),
        ([RandomizeParameter("x.mass", Uniform(1, 2), how="times")], "times"),
        ([RandomizeParameter("x.mass", Uniform(1, 2), when="never")], "never"),
        (["x.mass"], "neither"),
    ],
)
def test_rules_that_cannot_be_are_refused(rules, message):
    with pytest.raises(ValueError, match=message):
        HFrameEnv(randomize=rules)


@pytest.mark.parametrize(
    ("distribution", "numbers"),
    [(Uniform, (2, 1)), (Uniform, (0, np.inf)), (LogUniform, (0, 1)), (Normal, (0, -1)), (Normal, (np.nan, 1))],
)
def test_distributions_that_cannot_be_are_refused(distribution, numbers):
    with pytest.raises(ValueError, match=distribution.__name__):
        distribution(*numbers)


@pytest.mark.parametrize("distribution", [Uniform(1, 3), LogUniform(0.1, 9), Normal(2, 1)])
def test_a_number_s_value_depends_on_it_alone(distribution):
    u = np.random.default_rng(0).random(1001)
    together = distribution.quantile(u)
    alone = [distribution.quantile(u[i : i + 1])[0] for i in range(len(u))]
    np.testing.assert_array_equal(together, alone)
