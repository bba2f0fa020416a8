"""Tables of evidence about an effect: what is doubted and why, each limit from both sides, unsimulated."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest

from hframe_gym.identification import SelectionCriteria
from hframe_gym.identification.judge import effect as judge
from hframe_gym.identification.judge.chance import LongRunVariance
from hframe_gym.identification.judge.effect import (
    Addition,
    Chance,
    Disagreement,
    EffectEvidence,
    Forces,
    MachineBehavior,
    ParameterValue,
    Size,
    SizeByFit,
    TimingEvidence,
)
from hframe_gym.identification.judge.error import FitError

CRITERIA = SelectionCriteria()
COUNT = 1e4


def error(chi2: float, bandwidth: float = 0.0) -> FitError:
    """Return the error of a fit to 10,000 values."""
    return FitError(chi2 * COUNT, COUNT, bandwidth, bandwidth == 60.0)


def evidence(without: float = 1.4, with_effect: float = 1.2, **known: Any) -> EffectEvidence:
    """Return evidence of an effect without doubt, but for what is given; chi-squared per sample of both fits.

    Where the effect is not confirmed by a linear model, a fit without the run says the same unless it is
    given.
    """
    known = {"confirmed_accurate": known["confirmed"], **known} if "confirmed" in known else known
    gain = (without - with_effect) * COUNT
    found = EffectEvidence(
        without=error(without),
        with_effect=error(with_effect),
        forceless=False,
        confirmed=lambda: gain,
        confirmed_accurate=lambda least: gain,
        fault=lambda: "",
        chance=lambda: Chance(gain, LongRunVariance(1.0)),
        chance_narrower=None,
        forces=lambda: Forces(1.0, 0.1),
        forces_accurate=lambda: Forces(1.0, 0.1),
        additions=lambda: (),
    )
    eager = ("forceless", "parameters")
    lazy = {n: v if n in eager or callable(v) else (lambda *_, known=v: known) for n, v in known.items()}
    return dataclasses.replace(found, **lazy)


def by_chance(gain: float, ratio: float) -> Chance:
    """Return a reduction of cost by an effect of one parameter; ratio of long-run variance to white."""
    return Chance(gain, LongRunVariance(ratio))


def by_another(value: float, other: float, std: float) -> SizeByFit:
    """Return a size c in the fit of the search and in another one."""
    return SizeByFit("c", value, other, lambda: std)


@pytest.mark.parametrize(
    ("n", "reason"),
    [
        (0.991, "is eccentric_encoder, which has fewer parameters: n = 0.991 instead of 1"),
        (1.009, "is eccentric_encoder, which has fewer parameters: n = 1.009 instead of 1"),
        (0.989, ""),
        (1.011, ""),
    ],
)
def test_an_effect_that_is_a_simpler_one_is_doubted(n: float, reason: str) -> None:
    value = ParameterValue("n", "", n, simpler={1.0: "eccentric_encoder"})
    of_effect = evidence(parameters=(value,))
    assert judge.doubt_about_candidate(of_effect, CRITERIA) == reason
    assert judge.doubt_beside_others(of_effect, CRITERIA) == reason


OTHER_SIZE = (
    "has another size in fast errors (c = 0.0042 instead of 0.00072), as what imitates voltages between the "
    "rows does"
)
CHANCE = "reduces the error by no more than chance may, since the remaining error is correlated in time"
BETWEEN_ROWS = (
    "explains little more than chance may beside the voltages between the rows, which are not known"
)
MOTION = "makes the sensors of one motion disagree more: something else is in error than one of them"
FORM = (
    "adds 19 % to the force of drag@x, which depends on the same variable: "
    "the form of that effect may be in error"
)


@pytest.mark.parametrize(
    ("known", "reason"),
    [
        ({}, ""),
        ({"confirmed": 0.31 * 2000.0}, ""),
        (
            {"confirmed": 0.29 * 2000.0},
            "is not confirmed by runs that it was not fitted to (no more than 29 % of the gain)",
        ),
        (
            {"confirmed": -4e6},
            "is not confirmed by runs that it was not fitted to (their error grows with it)",
        ),
        ({"confirmed": -4e6, "confirmed_accurate": 0.31 * 2000.0}, ""),  # the linear step was too long
        (
            {"confirmed": -4e6, "confirmed_accurate": 0.29 * 2000.0},
            "is not confirmed by runs that it was not fitted to (no more than 29 % of the gain)",
        ),
        (
            {"confirmed": 0.31 * 2000.0, "confirmed_accurate": 0.0},
            "",
        ),  # fits are for a linear model that is against it
        ({"fault": "makes the machine diverge"}, "makes the machine diverge"),
        (
            {"chance": by_chance(2000.0, 80.0)},
            "",
        ),  # with one parameter, the smallest gain is 24 times the variance
        ({"chance": by_chance(2000.0, 85.0)}, CHANCE),
        (
            {"chance": by_chance(2000.0, 85.0), "chance_narrower": by_chance(2100.0, 80.0)},
            "",
        ),  # in doubt, the slow error
        ({"chance": by_chance(2000.0, 85.0), "chance_narrower": by_chance(2000.0, 85.0)}, CHANCE),
        # An error of a laser beside a force, and an eccentric encoder beside an eccentric pulley (random
        # rigs).
        ({"disagreement": Disagreement(29_180.0, 29_704.0)}, MOTION),
        ({"disagreement": Disagreement(22_362.0, 21_912.0)}, ""),
        ({"beside_voltages": 49.0}, ""),  # twice what chance reaches
        ({"beside_voltages": 47.0}, BETWEEN_ROWS),
        (
            {"sizes_by_observer": (by_another(7.43e-4, 9.18e-4, 4.4e-5),)},
            "",
        ),  # a damping of belts that is there
        ({"sizes_by_observer": (by_another(7.2e-4, 4.18e-3, 4.1e-4),)}, OTHER_SIZE),  # one that is not
        ({"sizes_by_observer": (by_another(7.2e-4, 4.18e-3, 7.2e-4),)}, ""),  # not known better
        (
            {"sizes_by_observer": (by_another(-1.0, 1.0, 0.1),)},
            "has another size in fast errors (c = 1 instead of -1), "
            "as what imitates voltages between the rows does",
        ),
        ({"sizes_by_observer": (by_another(1.0, 9.0, 0.1), by_another(1.0, 1.9, 0.1))}, ""),
        ({"sizes_by_observer": ()}, ""),
        # A damping of belts that is not there, and the friction by load of a pulley (random rigs).
        (
            {"sizes_by_instruments": (by_another(9.9e-4, 1.9e-4, 8.8e-5),)},
            "has another size by instruments (c = 0.00019 instead of 0.00099), "
            "as what imitates voltages between the rows does",
        ),
        ({"sizes_by_instruments": (by_another(0.1432, 0.1332, 2.8e-3),)}, ""),
        ({"sizes_by_instruments": ()}, ""),
        ({"forces": Forces(0.202, 0.2)}, ""),
        (
            {"forces": Forces(0.198, 0.2), "forces_accurate": Forces(0.198, 0.1)},
            "",
        ),  # measured again in doubt
        (
            {"forces": Forces(0.198, 0.2), "forces_accurate": Forces(0.198, 0.2)},
            "has a force of 0.2 N, where 0.2 N remain unexplained",
        ),
        ({"forces": Forces(0.09, 0.2)}, "has a force of 0.09 N, where 0.2 N remain unexplained"),  # no doubt
        (
            {"forces": Forces(0.1, 0.3), "forceless": True, "with_effect": 1.6, "without": 2.0},
            "explains a force of 0.1 N, where 0.3 N remain unexplained",
        ),
        # A load of 1.5 % that swings, at 60 rad/s and in simulation: rounding errors hid it from the
        # observer.
        (
            {
                "forces": Forces(0.0038, 0.0116),
                "forces_accurate": Forces(0.0021, 2.4e-5),
                "forceless": True,
            },
            "",
        ),
        (
            {"forces": Forces(0.1, 0.3), "forces_accurate": Forces(0.1, 0.2), "forceless": True},
            "explains a force of 0.1 N, where 0.2 N remain unexplained",
        ),
        (
            {"forces": Forces(0.1, 0.3), "forceless": True, "beside_voltages": 2000.0},
            "",
        ),  # unknown voltages cause the rest
        (
            {"forces": Forces(0.1, 0.3), "beside_voltages": 2000.0},
            "has a force of 0.1 N, where 0.3 N remain unexplained",
        ),
        ({"additions": [Addition("drag@x", 0.21)]}, ""),
        ({"additions": [Addition("spring@x", 0.5), Addition("drag@x", 0.19)]}, FORM),
    ],
)
def test_doubts_where_the_data_are_nearly_explained(known: dict[str, Any], reason: str) -> None:
    assert judge.doubt_about_candidate(evidence(**known), CRITERIA) == reason
    assert judge.doubt_beside_others(evidence(**known), CRITERIA) == reason


@pytest.mark.parametrize(
    ("known", "candidate", "beside_others"),
    [
        ({"confirmed": 0.0}, "", "not confirmed"),
        ({"chance": by_chance(4000.0, 1e6)}, "", "chance"),
        ({"disagreement": Disagreement(1.0, 2.0)}, "", "disagree"),
        ({"fault": "diverges"}, "diverges", "diverges"),
        ({"forces": Forces(0.01, 1.0)}, "remain unexplained", "remain unexplained"),
    ],
)
def test_while_much_is_unexplained_no_statistical_test_is_made(
    known: dict[str, Any], candidate: str, beside_others: str
) -> None:
    found = evidence(1.6, 1.2, **known)
    for reason, expected in (
        (judge.doubt_about_candidate(found, CRITERIA), candidate),
        (judge.doubt_beside_others(found, CRITERIA), beside_others),
    ):
        assert (expected in reason) if expected else reason == ""


@pytest.mark.parametrize(("without", "doubted"), [(2.01, True), (2.2, False)])
def test_an_effect_must_reduce_the_error_beside_all_others(without: float, doubted: bool) -> None:
    """By a tenth of the excess of the complete machine."""
    reason = judge.doubt_beside_others(evidence(without, 2.0), CRITERIA)
    assert reason == ("has no effect on the error" if doubted else "")


@pytest.mark.parametrize(
    ("with_effect", "known", "candidate", "beside_others"),
    [
        # A damping of belts removes 8 % of the error that a log slower than its controller leaves, and is
        # there.
        (1.607, {"beside_voltages": 700.0}, "", ""),
        (1.607, {"beside_voltages": 40.0}, BETWEEN_ROWS, BETWEEN_ROWS),
        (1.607, {"beside_voltages": 700.0, "chance": by_chance(540.0, 30.0)}, CHANCE, CHANCE),
        (1.607, {}, "", "has no effect on the error"),  # the log has all voltages
        (1.655, {"beside_voltages": 700.0}, "", "has no effect on the error"),
        # While more is missing, chance says nothing about an effect that removes much of the error.
        (1.3, {"beside_voltages": 40.0}, "", BETWEEN_ROWS),
    ],
)
def test_where_voltages_are_unknown_an_effect_need_not_remove_a_part_of_the_error(
    with_effect: float, known: dict[str, Any], candidate: str, beside_others: str
) -> None:
    found = evidence(1.661, with_effect, **known)
    assert judge.doubt_about_candidate(found, CRITERIA) == candidate
    assert judge.doubt_beside_others(found, CRITERIA) == beside_others


@pytest.mark.parametrize(
    ("left", "known", "required"),
    [
        (1.5, True, 0.05),
        (1.5, False, 0.01),
        (1e4, False, 1e3),  # far more than unknown voltages may cause
    ],
)
def test_the_gain_that_is_required_beside_unknown_voltages(left: float, known: bool, required: float) -> None:
    found = judge.enough_gain(error(left), CRITERIA, voltages_known=known)
    assert found == pytest.approx(required, rel=1e-3)


@pytest.mark.parametrize(
    ("without", "with_effect", "sure"),
    [(60.0, 1.1, True), (60.0, 3.0, False), (10.1, 1.0, True), (9.9, 1.0, False)],
)
def test_an_effect_that_removes_a_clear_error_is_no_correction_of_a_form(
    without: float, with_effect: float, sure: bool
) -> None:
    reason = judge.doubt_about_candidate(
        evidence(without, with_effect, additions=[Addition("a@x", 0.05)]), CRITERIA
    )
    assert ("the form of that effect may be in error" not in reason) == sure


def test_evidence_that_takes_seconds_is_asked_for_only_if_needed() -> None:
    asked: list[str] = []

    def force() -> Forces:
        asked.append("force")
        return Forces(1.0, 0.1)

    def refitted(least: float) -> float:
        asked.append("fits without each run")
        return least

    chance = by_chance(2000.0, 85.0)
    known: dict[str, Any] = {"confirmed": 0.0, "confirmed_accurate": refitted, "forces": force}
    assert judge.doubt_about_candidate(evidence(**known, chance=chance), CRITERIA) == CHANCE
    assert asked == []
    assert not judge.doubt_about_candidate(evidence(**known), CRITERIA)
    assert asked == ["force", "fits without each run"]


@pytest.mark.parametrize(
    ("parameter", "doubted"),
    [
        (ParameterValue("s", "", 1.49, (-0.5, 1.5)), True),
        (ParameterValue("s", "", 1.45, (-0.5, 1.5)), False),
        (ParameterValue("s", "", -0.5, (-0.5, 1.5)), True),
        (ParameterValue("s", "", 0.0, ()), False),  # 0 and starting values are meaningful
        (ParameterValue("vs", "m/s", 0.995, (), (0.0, 1.0)), True),
        (ParameterValue("vs", "m/s", 0.9, (), (0.0, 1.0)), False),
        (ParameterValue("n", "rad/m", 10.05, (), (10.0, 100.0), covered_below=True), True),
        (ParameterValue("n", "rad/m", 10.05, (), (10.0, 100.0)), False),
        (ParameterValue("n", "rad/m", 11.0, (), (10.0, math.inf), covered_below=True), False),
    ],
)
def test_a_parameter_at_a_limit_is_doubted(parameter: ParameterValue, doubted: bool) -> None:
    reason = judge.parameter_at_limit([ParameterValue("a", "N", 1.0), parameter])
    assert reason.startswith(f"fits only with {parameter.name} at the limit of") == doubted
    assert bool(reason) == doubted
    assert judge.doubt_beside_others(evidence(parameters=[parameter]), CRITERIA) == reason


@pytest.mark.parametrize(
    ("speeds", "reason"),
    [
        ((4.9, 1.0), ""),
        ((5.1, 1.0), "diverge"),
        ((math.inf, 1.0), "diverge"),
        ((1.0, math.nan), "diverge"),
    ],
)
def test_a_machine_must_stay_physical(speeds: tuple[float, float], reason: str) -> None:
    text = judge.fault_of_machine(MachineBehavior(lambda: speeds))
    assert (reason in text) if reason else text == ""


def test_a_spring_must_pull_back() -> None:
    """A controller that adds a voltage in the direction of its command feigns one that pushes away."""
    behavior = MachineBehavior(lambda: (1.0, 1.0), misnamed=["cable_spring@x"])
    assert "cable_spring@x is not what its name says" in judge.fault_of_machine(behavior)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({}, ""),
        ({"search": (100.0, 90.0)}, "explains a slow error, not a fast one"),
        ({"search": (100.0, 110.0), "wide": (10.0, 10.1)}, "explains a slow error, not a fast one"),
        ({"variance": lambda: LongRunVariance(0.04)}, ""),  # the gain of 1 is 25 times that
        ({"variance": lambda: LongRunVariance(0.042)}, CHANCE),
        ({"confirmed": lambda: 0.31}, ""),
        ({"confirmed": lambda: 0.29}, ""),  # a fit without the run says otherwise
        (
            {"confirmed": lambda: 0.29, "confirmed_accurate": lambda least: 0.29},
            "is not confirmed by runs that it was not fitted to",
        ),
        ({"fault": lambda: "diverges"}, "diverges"),
        ({"held_out_gain": lambda: 0.0}, "does not reduce the error of the held-out runs"),
    ],
)
def test_a_delay_must_be_fast_certain_and_confirmed(changes: dict[str, Any], reason: str) -> None:
    """It removes 3 % of the error with the observer of the search, and 10 % with the wider one."""
    sure = TimingEvidence(
        search=(100.0, 97.0),
        wide=(10.0, 9.0),
        variance=lambda: LongRunVariance(1e-3),
        confirmed=lambda: 1.0,
        confirmed_accurate=lambda least: 1.0,
        fault=lambda: "",
        held_out_gain=lambda: 0.1,
    )
    assert judge.doubt_about_timing(dataclasses.replace(sure, **changes), CRITERIA) == reason


@pytest.mark.parametrize(
    ("sizes", "doubt"),
    [
        (
            [(1.9e-3, 19e-3)],
            "d0 = 0.0019 +- 0.019 m",
        ),  # a play of belts, found on a machine with encoders only
        ([(-1.0, 0.21)], "d0 = -1 +- 0.21 m"),
        ([(-1.0, 0.20)], ""),
        ([(0.005, 0.0013)], "d0 = 0.005 +- 0.0013 m"),  # an asymmetry that an encoder alone does not show
        ([(0.0, 0.0)], ""),  # no covariance: nothing is known against it
        ([(0.1, 1.0), (5.0, 1.0)], ""),  # one part of the effect exists
        ([(0.1, 1.0), (0.2, 1.0)], "d0 = 0.1 +- 1 m and d1 = 0.2 +- 1 m"),
        ([], ""),  # thresholds and limits: the effect is not absent at 0
    ],
)
def test_an_effect_whose_size_may_be_zero_is_not_certain(
    sizes: list[tuple[float, float]], doubt: str
) -> None:
    reason = judge.uncertain_size([Size(f"d{i}", "m", *size) for i, size in enumerate(sizes)], CRITERIA)
    assert reason == (doubt and f"is not certain to exist: the final fit gives {doubt}")
