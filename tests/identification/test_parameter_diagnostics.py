"""What the report says against a fitted parameter."""

from __future__ import annotations

import numpy as np

from hframe_gym.effects import EFFECTS
from hframe_gym.identification.parameter_diagnostics import parameter_doubts
from hframe_gym.machine import BUILTIN_MACHINES, Machine, Uncertainty

AXIS = BUILTIN_MACHINES["axis"]()
SWITCH = AXIS.with_effects(EFFECTS["dead_band"].at("motor", Vd=0.4, drop=1.0))


def identified(machine: Machine, relative: dict[str, float], correlation: float = 0.0) -> Machine:
    """The machine with relative standard deviations by name; the first two correlated."""
    std = np.array([share * machine.parameters[name] for name, share in relative.items()])
    together = np.eye(len(std))
    together[0, 1] = together[1, 0] = correlation
    return machine.replace(uncertainty=Uncertainty(tuple(relative), np.outer(std, std) * together))


def test_good_parameters_are_not_doubted() -> None:
    machine = identified(AXIS, {"x.mass": 0.01, "x.viscous": 0.02}, correlation=0.9)
    assert parameter_doubts(machine, AXIS) == {"x.mass": [], "x.viscous": []}


def test_a_correlation_names_the_other() -> None:
    found = parameter_doubts(identified(AXIS, {"x.mass": 0.01, "x.viscous": 0.01}, correlation=-0.98), AXIS)
    assert found == {
        "x.mass": ["hardly apart from x.viscous (-0.980)"],
        "x.viscous": ["hardly apart from x.mass (-0.980)"],
    }


def test_the_prior_and_the_data() -> None:
    """The prior of a mass is 30 % wide, that of viscous friction 70 %."""
    found = parameter_doubts(identified(AXIS, {"x.mass": 0.25, "x.viscous": 0.25}), AXIS)
    assert found == {
        "x.mass": ["told by the declared value more than by the data"],
        "x.viscous": ["poorly determined"],
    }


def test_a_bound() -> None:
    found = parameter_doubts(identified(SWITCH, {"dead_band@motor.Vd": 0.01, "dead_band@motor.drop": 0.01}), AXIS)
    assert found == {"dead_band@motor.Vd": [], "dead_band@motor.drop": ["at a bound"]}


def test_a_machine_without_uncertainty_has_none() -> None:
    assert parameter_doubts(AXIS, AXIS) == {}
