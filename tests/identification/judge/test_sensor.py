"""Which sensor deviates alone."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from hframe_gym.identification.judge.sensor import SensorEvidence, deviates_alone


@pytest.mark.parametrize(
    ("noise_ratio", "others", "alone"),
    [
        (3.2, [[0.31, 0.0]], True),
        (3.1, [[0.0]], False),  # noise
        (15.0, [[0.32, 0.0]], False),  # another sensor sees a third of the motion
        (15.0, [[0.0], [0.9]], False),  # of two motions that it measures, one is not refuted
        (15.0, [[]], False),  # nothing else measures this motion
        (15.0, [], False),
    ],
)
def test_others_must_refute_the_error_of_each_motion(
    noise_ratio: float, others: Sequence[Sequence[float]], alone: bool
) -> None:
    assert deviates_alone(SensorEvidence(noise_ratio, others)) == alone
