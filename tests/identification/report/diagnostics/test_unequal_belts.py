"""Tests of belts that are declared alike and whose fitted stiffness differs."""

from __future__ import annotations

import dataclasses
from typing import Any, cast

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.identification.report.content.saved_result import SavedResult
from hframe_gym.identification.report.diagnostics.unequal_belts import unequal_belts
from hframe_gym.identification.report.words.answers import wrong_with_declared
from hframe_gym.machine import BUILTIN_MACHINES, Machine, Uncertainty
from tests.identification.report.axis_results import report_with

HFRAME = BUILTIN_MACHINES["hframe"]()
COREXY = BUILTIN_MACHINES["corexy"]()
STDS = 3.0


def fitted(
    declared: Machine,
    factors: dict[str, float],
    relative_std: float = 0.01,
    correlation: float = 0.0,
    names: tuple[str, ...] = (),
) -> Machine:
    """Return a machine with parameters times factors, and with an uncertainty of its belts.

    Args:
        relative_std: Standard deviation of each parameter of the belts, relative to its value.
        correlation: Of EA and rest_length of each belt.
        names: Fitted parameters, those of a belt beside each other. Default: those of all belts.
    """
    if not names:
        names = tuple(f"{b.name}.{key}" for b in declared.belts for key in ("EA", "rest_length"))
        names = tuple(name for name in names if name not in declared.ties)
    machine = declared.replace({name: factor * declared.parameters[name] for name, factor in factors.items()})
    std = relative_std * np.array([machine.parameters[name] for name in names])
    correlations = np.eye(len(names))
    for j in range(1, len(names)):
        if names[j].rpartition(".")[0] == names[j - 1].rpartition(".")[0]:
            correlations[j, j - 1] = correlations[j - 1, j] = correlation
    return machine.replace(uncertainty=Uncertainty(names, np.outer(std, std) * correlations))


def compared(machine: Machine, declared: Machine = HFRAME) -> list[tuple[str, str]]:
    """Return the names of the softer and the stiffer belt of each pair that differs."""
    return [(pair.softer, pair.stiffer) for pair in unequal_belts(machine, declared, STDS)]


def test_of_belts_declared_alike_those_that_differ_most_are_named_with_their_interval() -> None:
    (pair,) = unequal_belts(fitted(HFRAME, {"left.EA": 0.8, "bottom.EA": 0.9}), HFRAME, STDS)
    assert (pair.softer, pair.stiffer, pair.ratio) == ("left", "right", pytest.approx(0.8))
    # Four parameters of 1 % each, in the logarithm.
    assert (pair.low, pair.high) == pytest.approx(0.8 * np.exp(STDS * 0.02 * np.array([-1.0, 1.0])))


def test_a_clamp_that_yields_is_seen_as_a_longer_belt() -> None:
    (pair,) = unequal_belts(fitted(HFRAME, {"bottom.rest_length": 1.25}), HFRAME, STDS)
    assert (pair.softer, pair.ratio) == ("bottom", pytest.approx(0.8))


def test_the_stiffness_may_be_certain_where_ea_and_length_are_not() -> None:
    loose = {"left.EA": 0.9}
    assert compared(fitted(HFRAME, loose, relative_std=0.05)) == []
    assert compared(fitted(HFRAME, loose, relative_std=0.05, correlation=0.99)) == [("left", "right")]


@pytest.mark.parametrize(
    ("machine", "declared"),
    [
        (fitted(HFRAME, {"left.EA": 0.95}), HFRAME),  # 5 % are within three standard deviations of 2 %
        (HFRAME.replace({"left.EA": 5000.0}), HFRAME),  # no uncertainty
        # The prior of 30 % determines the stiffness, whatever the fit ends at.
        (fitted(HFRAME, {"left.EA": 0.4, "left.rest_length": 1.4}, relative_std=0.16), HFRAME),
        # EA of the left belt was not fitted.
        (fitted(HFRAME, {"left.EA": 0.8}, names=("right.EA", "bottom.EA", "x.mass")), HFRAME),
        # Four standard deviations of the prior, the limit of the fit.
        (fitted(HFRAME, {"left.EA": np.exp(-4.0 * 0.3)}), HFRAME),
        (fitted(HFRAME, {"left.EA": 0.8}), HFRAME.replace({"left.EA": 0.99 * 13906.5})),  # declared unlike
        # Beside EA, play determines the stiffness of the left belt.
        (fitted(HFRAME.with_effects(EFFECTS["belt_play"].at("left", d=1e-4)), {"left.EA": 0.8}), HFRAME),
        (fitted(COREXY, {"belt1_short.EA": 1.2, "belt2_short.EA": 1.2}), COREXY),
    ],
)
def test_belts_are_not_compared_where_the_data_do_not_tell(machine: Machine, declared: Machine) -> None:
    assert compared(machine, declared) == []


def test_of_the_two_sections_of_a_belt_ea_is_one_parameter() -> None:
    (pair,) = compared(fitted(COREXY, {"belt2_short.EA": 0.8}), COREXY)
    assert pair == ("belt2_short", "belt1_short")


def test_belts_of_separate_axes_are_not_compared() -> None:
    """The declared torque constants of both motors set the units of their forces."""
    rows = {"left": {"x": 1.0, "phi1": 1.0}, "right": {"y": -1.0, "phi2": -1.0}}
    belts = tuple(dataclasses.replace(b, extension=rows[b.name], length={}) for b in HFRAME.belts[:2])
    table = HFRAME.replace(belts=belts)
    assert compared(fitted(table, {"left.EA": 0.8}), table) == []


def test_belts_that_an_effect_divides_have_the_length_of_their_sections() -> None:
    idlers = EFFECTS["idler_inertia"].at("machine", J_left=2e-5, J_right=2e-5, B_left=1e-5, B_right=1e-5)
    divided = HFRAME.with_effects(idlers)
    assert compared(fitted(divided, {})) == []
    assert compared(fitted(divided, {"left.EA": 0.8})) == [("left", "right")]


@pytest.mark.parametrize("verdict", ["no_effect", "effect_found", "unexplained"])
def test_the_report_says_by_how_much_and_what_to_check(verdict: str) -> None:
    machine = fitted(HFRAME, {"left.EA": 0.8})
    saved = SavedResult(report_with(verdict=verdict), machine, HFRAME, cast(Any, None))
    sentence = (
        "The belt sections left and right are declared with the same EA, but for its declared length left is "
        "20 % less stiff than right (15 to 25 %, 3 standard deviations each way): check its tension, its "
        "clamps, and the rest_length of both in the machine file."
    )
    # What a model lacks that is not explained may pass for the stiffness of a belt.
    assert (sentence in wrong_with_declared(saved)) == (verdict != "unexplained")


def test_the_interval_has_the_digits_that_tell_its_ends_apart() -> None:
    (pair,) = unequal_belts(fitted(HFRAME, {"left.EA": 0.8}, relative_std=1e-4), HFRAME, STDS)
    assert "left is 20.0 % less stiff than right (20.0 to 20.0 %" not in pair.sentence()
    assert "left is 20.00 % less stiff than right (19.95 to 20.05 %" in pair.sentence()


def test_a_difference_that_no_sensor_could_show_is_not_told() -> None:
    """At full force, 0.3 % move the tool by 17 um, less than the noise of its sensors, and 20 % by 1.3 mm."""
    slightly = fitted(HFRAME, {"left.EA": 0.997}, relative_std=1e-5)
    assert compared(slightly) == []
    assert compared(slightly.replace({"x_m.noise": 1e-5})) == [("left", "right")]
    assert compared(fitted(HFRAME, {"left.EA": 0.8}, relative_std=1e-5)) == [("left", "right")]


def test_without_a_sensor_of_the_tool_those_of_the_motors_count() -> None:
    """Their rounding error is 3 um of belt travel."""
    encoders = HFRAME.replace(sensors=HFRAME.sensors[:2])
    assert compared(fitted(encoders, {"left.EA": 0.997}, relative_std=1e-5), encoders) == [("left", "right")]
    assert compared(fitted(encoders, {"left.EA": 0.9996}, relative_std=1e-5), encoders) == []
