"""Tables of evidence about the variable on which a missing force depends."""

from __future__ import annotations

import pytest

from hframe_gym.identification.judge import cause
from hframe_gym.identification.judge.cause import CauseEvidence


@pytest.mark.parametrize(
    ("explained", "certain", "fraction", "counts"),
    [(6.0, 1.0, 0.06, True), (4.0, 1.0, 0.06, False), (6.0, 1.0, 0.04, False), (6.0, -0.1, 0.06, False)],
)
def test_a_variable_is_a_cause_from_a_twentieth_on(
    explained: float, certain: float, fraction: float, counts: bool
) -> None:
    evidence = CauseEvidence(explained, certain, fraction, beyond_noise=100.0, plain=True)
    assert cause.is_cause(evidence) == counts


def test_what_is_less_plain_must_explain_clearly_more() -> None:
    plain, special = (CauseEvidence(50.0, 40.0, 0.5, 100.0, plain=plain) for plain in (True, False))
    assert cause.rank_of_cause(plain, 100.0) == pytest.approx(0.4)
    assert cause.rank_of_cause(special, 100.0) == pytest.approx(0.38)
    constant = CauseEvidence(50.0, 40.0, 0.5, 100.0, plain=False, constant=True)
    assert cause.rank_of_cause(constant, 100.0) == pytest.approx(0.421, abs=0.001)
    assert cause.beyond_noise(100.0, 20.0) == 80.0
    assert cause.beyond_noise(25.0, 20.0) == 10.0


@pytest.mark.parametrize(
    ("matches", "named"),
    [
        ([[True, False]], True),
        ([[False, True]], False),  # another cause leads
        ([[True, False], [False, True]], True),
        ([[True, False], [False, False]], False),
        ([[]], False),
        ([], False),
    ],
)
def test_effects_name_the_causes(matches: list[list[bool]], named: bool) -> None:
    assert cause.names_causes(matches) == named
