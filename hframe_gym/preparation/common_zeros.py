"""Find the encoders that kept their zero in all runs of a session."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..arrays import Array
from ..machine import Machine
from .belt_stretch import max_held_angle
from .encoder_zeros import MAX_SCATTER, EncoderZeros
from .rest_measurement import InitialState

# Runs needed to distinguish an encoder that keeps its zero from one that is switched on anew for every run.
_MIN_RUNS_FOR_ZERO = 3
_MIN_STRETCH = 0.1e-3  # rad; zeros that scatter by less from run to run show no stretch of the belts.


def common_encoder_zeros(initial: Sequence[InitialState], machine: Machine, quanta: Array) -> EncoderZeros:
    """Find the encoders that kept their zero (measurement at position 0) in all runs of a session.

    An encoder on a pulley kept its zero if the standard deviation of the zero from run to run is below the belt stretch
    that static friction can maintain, or below two quantization steps. The zeros of an encoder that was switched on
    anew for every run differ by far more.

    Args:
        initial: Initial states of the runs, each estimated with unknown zeros.
        machine: Machine as declared.
        quanta: Quantization steps of the sensors, m or rad, shape (sensors,).

    Returns:
        Median over the runs of the zero of each such encoder, m or rad, shape (sensors,), NaN for all other sensors,
        and its standard deviation from run to run. With fewer than three runs or without belts: the zeros that the
        machine declares.
    """
    zeros = EncoderZeros.of_machine(machine)
    if not machine.belts or len(initial) < _MIN_RUNS_FOR_ZERO:
        return zeros
    zeros = zeros.without(np.ones(len(machine.sensors), np.bool_))
    # Runs whose position is measured at rest give the better zeros; the others count only if these are too few.
    positioned = [state.zeros for state in initial if state.position_measured]
    by_run = np.array(
        positioned if len(positioned) >= _MIN_RUNS_FOR_ZERO else [state.zeros for state in initial]
    )
    median = np.median(by_run, axis=0)  # (sensors,)
    deviation = np.abs(by_run - median)  # (runs, sensors)
    # Standard deviation from the median absolute deviation, which single deviating runs do not change.
    spread = 1.4826 * np.median(deviation, axis=0)
    limit = np.maximum(max_held_angle(machine), 2 * quanta)
    # It is zero if more than half of the runs start where nothing stretches the belts. The others show the stretch.
    kept = deviation <= limit + MAX_SCATTER * spread
    of_kept = np.sqrt(np.mean(deviation**2, axis=0, where=kept))
    for j, sensor in enumerate(machine.sensors):
        rotary = machine.coordinate(machine.coordinate_of_sensor(sensor)).kind == "rotary"
        if sensor.incremental and rotary and spread[j] < limit[j]:
            zeros.values[j] = median[j]
            scatter = max(spread[j], of_kept[j])
            zeros.spread[j] = scatter if scatter > max(quanta[j], _MIN_STRETCH) else 0.0
    return zeros
