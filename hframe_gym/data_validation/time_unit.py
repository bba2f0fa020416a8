"""Find times in a wrong unit, with which inertia and friction are wrong by powers of one factor."""

from __future__ import annotations

import math

import numpy as np

from ..identification import Dataset
from ..preparation.forces.force_balance import EXPLAINED, Balance
from .findings import Finding

# Factors of a time in another unit: milliseconds, hundredths, minutes, or a wrong rate.
_CLOCK_FACTORS = (10.0, 60.0, 100.0, 1000.0, 0.1, 0.01, 0.001)
# True unit of the times by factor; other factors are wrong rates.
_CLOCK_UNITS = {1000.0: "ms", 60.0: "s", 0.001: "s"}
# Factor between the fitted viscous friction and the clock's; twice as wide for the inertia.
_CLOCK_TOLERANCE = 1.6


def check_time_unit(data: Dataset, balance: Balance | None) -> list[Finding]:
    """Report times in a wrong unit, which inertia and viscous friction reveal together.

    With times too large by f, the motion requires f^2 times the inertia and f times the viscous friction. A
    wrong unit of a position or a wrong gain changes both by the same factor.

    Args:
        data: Runs prepared for a fit.
        balance: Balance of forces for the declared wiring, see `declared_balance`; None if there is none.

    Returns:
        One finding of severity "advice", which names the factor; none without a balance, or if it does not
        explain the motion.
    """
    if balance is None or balance.unexplained > EXPLAINED:
        return []
    if not np.isfinite([balance.inertia, balance.viscous]).all():
        return []
    for factor in _CLOCK_FACTORS:
        friction = np.abs(np.log(np.maximum(balance.viscous, 1e-12) / factor))
        inertia = np.abs(np.log(np.maximum(balance.inertia, 1e-12) / factor**2))
        if (friction < math.log(_CLOCK_TOLERANCE)).all() and (inertia < 2 * math.log(_CLOCK_TOLERANCE)).all():
            direction = f"{factor:g} times too long" if factor > 1 else f"{1 / factor:g} times too short"
            period = float(np.median(np.concatenate([np.diff(run.time_s) for run in data.runs])))
            unit = _CLOCK_UNITS.get(factor)
            option = f"--unit time_s={unit}" if unit else f"--map time_s={factor / period:.4g}Hz"
            message = (
                f"the times may be {direction}: as logged, the motion requires "
                f"{float(np.median(balance.inertia)):.2g} times the declared inertia and "
                f"{float(np.median(balance.viscous)):.2g} times the viscous friction. If these "
                f"were not guessed, state the unit or the rate of the times: hframe import FILE {option}"
            )
            return [Finding("advice", "", "time_s", message)]
    return []
