"""A run that was repeated, compared with a result file draw by draw."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from .protocol import Draws, get_protocol
from .result_file import ResultFile
from .scores import fill_unsettled

# Differences of a run that is repeated elsewhere: two samples of 1 ms, and 1 um and 1 % of an error in mm.
REPEATED_S, REPEATED_MM, REPEATED_FRACTION = 2.1e-3, 1e-3, 1e-2
# Fraction of draws that may differ by more; standard deviations of a sum of differences with random signs;
# fraction of a mean, for differences below the tolerances.
REPEATED_DRAWS, REPEATED_SIGMAS, REPEATED_MEAN = 0.12, 2.0, 0.002


class Comparison(NamedTuple):
    """Comparison of the values of a repeated run with those of a result file.

    Attributes:
        values: Number of values that were compared.
        equal: Number of those that are equal.
        worst: Description of the largest difference; empty if all are equal.
        reproduced: Whether all differences are within what other processors and package versions explain.
    """

    values: int
    equal: int
    worst: str
    reproduced: bool


def compare_draws(result: ResultFile, draws: Mapping[str, Draws]) -> Comparison:
    """Compare the draws of a result file with those of a repeated run, to detect edited results.

    Sums are rounded differently on other processors. Friction, estimators and plans amplify this, so that a
    draw that ends near the edge of a band may be inside on one processor and outside on another. On another
    processor, `apg_plan` differed by more than the tolerances in 2 of 512 draws of reach-v1, and
    `adaptive-pid` in 53 of 512 of hard-v1; the differences had both signs, and means changed by at most 0.8
    %. A file is therefore reproduced if, for each metric, at most 12 % of the draws differ by more than two
    samples of 1 ms or 1 um + 1 % of the error, and the sum of the differences is at most twice what random
    signs would give, plus 0.2 % of the sum of the values. Edited draws, in contrast, are all better, so that
    more than a handful are detected.

    Args:
        result: Content of the result file.
        draws: Values of the repeated run by part and by metric, as `run_protocol` returns them.

    Returns:
        Number of compared values, number of equal ones, the largest difference in words, and whether the file
        is reproduced.
    """
    protocol = get_protocol(result.protocol)
    count = equal = 0
    largest, worst, reproduced = 0.0, "", True
    for part, columns in draws.items():
        for metric, column in columns.items():
            given = result.draws[part][metric]
            before, after = (fill_unsettled(values, protocol.duration_s) for values in (given, column))
            if metric.startswith("settling_s."):
                allowed = np.full(len(before), REPEATED_S)
            else:
                allowed = REPEATED_MM + REPEATED_FRACTION * np.maximum(before, after)
            sizes = np.abs(after - before) / allowed
            count += len(given)
            equal += sum(old == new for old, new in zip(given, column, strict=True))
            differences = after - before
            expected = REPEATED_SIGMAS * np.sqrt(np.sum(differences**2)) + REPEATED_MEAN * before.sum()
            reproduced &= int((sizes > 1.0).sum()) <= int(REPEATED_DRAWS * len(given))
            reproduced &= abs(differences.sum()) <= expected
            draw = int(sizes.argmax())
            if sizes[draw] > largest:
                largest = float(sizes[draw])
                worst = f"{part}, draw {draw}, {metric}: {given[draw]} in the file, {column[draw]} now"
    return Comparison(count, int(equal), worst, bool(reproduced))
