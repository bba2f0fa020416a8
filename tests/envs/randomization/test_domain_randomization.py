"""Rules, distributions and presets of domain randomization."""

import json
import re

import numpy as np
import pytest
from scipy.stats import kstest, norm

from hframe_gym.effects import EFFECTS
from hframe_gym.envs import DISTRIBUTIONS, HFrameEnv, LogUniform, Normal, RandomizeParameter, Uniform
from hframe_gym.envs.randomization.domain_randomization import as_rules, matching
from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES

NAMES = ("x.mass", "y.mass", "left.EA", "x_m.noise", "task.speed")


def test_patterns_match_full_names():
    assert matching(NAMES, RandomizeParameter("*.mass", Uniform(1, 2))) == [0, 1]
    assert matching(NAMES, RandomizeParameter("x_m.*", Uniform(1, 2))) == [3]
    assert matching(NAMES, RandomizeParameter("task.speed", Uniform(1, 2))) == [4]


def test_a_distribution_can_be_given_by_name():
    assert RandomizeParameter("x.mass", ("log_uniform", 0.5, 2.0)).distribution == LogUniform(0.5, 2.0)
    assert set(DISTRIBUTIONS) >= {"uniform", "log_uniform", "normal"}
    with pytest.raises(InputError, match="distribution 'gamma' is unknown; choose one of uniform"):
        RandomizeParameter("x.mass", ("gamma", 1.0))
    with pytest.raises(InputError, match="uniform"):
        RandomizeParameter("x.mass", ("uniform", 1.0))
    for wrong in (1.0, "uniform", "unifrom", "", Uniform, (0.8, 1.2), ()):
        with pytest.raises(
            InputError, match=r"randomize: the distribution of 'x.mass' is .*; give a Distribution such as"
        ):
            RandomizeParameter("x.mass", wrong)
    with pytest.raises(
        InputError, match=r"of 'x.mass' is .*: the distribution .* must have finite numbers with low <= "
    ):
        RandomizeParameter("x.mass", ("uniform", "a", 1.0))


def test_a_rule_can_be_a_mapping():
    mapping = {"parameter": "x.mass", "distribution": ["uniform", 0.9, 1.1], "when": "startup"}
    assert as_rules([mapping], NAMES) == (RandomizeParameter("x.mass", Uniform(0.9, 1.1), when="startup"),)
    with pytest.raises(InputError, match="parametre"):
        as_rules([{"parametre": "x.mass"}], NAMES)


@pytest.mark.parametrize("wrong", [{"x.mass": (0.8, 1.2)}, [{"x.mass": (0.8, 1.2)}]])
def test_the_example_of_a_refusal_is_accepted(wrong):
    with pytest.raises(InputError, match=r"such as \[\{") as refusal:
        as_rules(wrong, NAMES)
    (example,) = re.findall(r"\[\{.*?\}\]", str(refusal.value))
    assert as_rules(json.loads(example), NAMES) == (RandomizeParameter("x.mass", Uniform(0.8, 1.2)),)


@pytest.mark.parametrize(
    ("how", "expected"), [("scale", [4.0, 6.0]), ("add", [4.0, 5.0]), ("set", [2.0, 3.0])]
)
def test_apply(how, expected):
    rule = RandomizeParameter("x.mass", Uniform(1, 2), how=how)
    np.testing.assert_array_equal(rule.apply(np.full(2, 2.0), np.array([2.0, 3.0])), expected)


@pytest.mark.parametrize(
    ("rules", "message"),
    [
        ([("x.mass", 0.8, 1.2)], r"write for example RandomizeParameter\('x.mass', Uniform\(0.8, 1.2\)\)"),
        (
            [RandomizeParameter("input_delay@drives.d", Uniform(0, 0.01), how="set")],
            r"only if the machine has the effect: add it by machine.with_effects",
        ),
        (
            [RandomizeParameter("z.mass", Uniform(1, 2))],
            "no parameter 'z.mass'; names are, for example, .*x.mass",
        ),
        ([RandomizeParameter("x.mass", Uniform(-1, 1))], "x.mass = -4.07"),
        ([RandomizeParameter("x.mass", Uniform(1, 2), how="times")], "times"),
        ([RandomizeParameter("x.mass", Uniform(1, 2), when="never")], "never"),
        (
            [{"parameter": "x.mass", "distribution": "uniform"}],
            r"of 'x.mass' is 'uniform'; .* \['uniform', 0.9, 1.1\]",
        ),
        ([{"parameter": 5, "distribution": ["uniform", 1, 2]}], "parameter is 5, it must be the name"),
        (["x.mass"], "neither"),
    ],
)
def test_invalid_rules_are_refused(rules, message):
    with pytest.raises(InputError, match=message):
        HFrameEnv(randomize=rules)


@pytest.mark.parametrize(
    ("distribution", "numbers"),
    [
        *((Uniform, numbers) for numbers in ((2, 1), (0, np.inf), ("a", 1), (True, 2))),
        *((LogUniform, numbers) for numbers in ((0, 1), (None, 1))),
        *((Normal, numbers) for numbers in ((0, -1), (np.nan, 1), ([0.0], 1))),
    ],
)
def test_invalid_distributions_are_refused(distribution, numbers):
    with pytest.raises(InputError, match=distribution.__name__):
        distribution(*numbers)


@pytest.mark.parametrize(
    ("pattern", "distribution", "refused"),
    [
        ("high", Uniform(-0.2, 0.06), True),
        ("low", Uniform(-0.06, 0.06), True),
        ("high", Normal(0.05, 0.1), True),
        ("high", Uniform(0.04, 0.06), False),
        ("high", Normal(0.05, 1e-3), False),
    ],
)
def test_a_sensor_range_cannot_be_reversed_by_rules(pattern, distribution, refused):
    rule = RandomizeParameter(f"sensor_range@x_m.{pattern}", distribution, how="set")
    if not refused:
        HFrameEnv(sensors="rig", randomize=[rule]).reset(seed=0)
        return
    with pytest.raises(
        InputError, match=r"can yield sensor_range@x_m.high = .*, below sensor_range@x_m.low = "
    ):
        HFrameEnv(sensors="rig", randomize=[rule])


def test_one_number_for_both_ends_of_a_range_keeps_their_order():
    rule = RandomizeParameter("sensor_range@x_m.*", LogUniform(0.01, 100.0), shared=True)
    machine = BUILTIN_MACHINES["hframe"]().with_effects(EFFECTS["sensor_range"].at("x_m", low=0.01, high=0.1))
    HFrameEnv(machine=machine, sensors="machine", randomize=[rule]).reset(seed=0)


@pytest.mark.parametrize(
    ("ends", "message"),
    [
        ({"low": 0.1, "high": -0.1}, "range at x_m: high = -0.1 is below low = 0.1; it must not be smaller"),
        ({"low": "left", "high": 0.1}, "effect sensor_range at x_m: low is 'left', it must be a number"),
        ({"low": np.nan, "high": 0.1}, "effect sensor_range at x_m: low = nan is outside"),
        ({"low": 0.1}, "effect sensor_range at x_m takes low, high: high is missing"),
    ],
)
def test_an_impossible_sensor_range_is_refused(ends, message):
    with pytest.raises(InputError, match=message):
        EFFECTS["sensor_range"].at("x_m", **ends)


@pytest.mark.parametrize("distribution", [Uniform(1, 3), LogUniform(0.1, 9), Normal(2, 1)])
def test_a_value_depends_on_its_uniform_number_alone(distribution):
    u = np.random.default_rng(0).random(1001)
    together = distribution.quantile(u)
    separately = [distribution.quantile(u[i : i + 1])[0] for i in range(len(u))]
    np.testing.assert_array_equal(together, separately)


def test_quantiles_of_the_distributions():
    u = (np.arange(20000) + 0.5) / 20000
    assert kstest((Normal(2.0, 0.5).quantile(u) - 2.0) / 0.5, norm.cdf).pvalue > 0.999
    assert np.median(LogUniform(0.25, 4.0).quantile(u)) == pytest.approx(1.0, rel=1e-3)
    assert kstest(Uniform(1.0, 3.0).quantile(u), "uniform", args=(1.0, 2.0)).pvalue > 0.999


@pytest.mark.parametrize("randomize", [True, 0.3, None, "some"])
def test_a_randomization_that_is_neither_a_preset_nor_rules_is_refused_with_the_choices(randomize):
    with pytest.raises(InputError, match=f"randomize is {randomize!r}; choose one of none, default, wide"):
        HFrameEnv(randomize=randomize)
