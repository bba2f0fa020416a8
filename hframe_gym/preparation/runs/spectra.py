"""Compare the kinds of motion of runs by the spectra of their voltages."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from ...arrays import Array
from ...recordings import Recording

# Relative difference of spectra below which runs count as alike. Repetitions with other random numbers differ
# by 0.05 to 0.2; steps, slow sines, multisines and chirps of the same amplitude differ from each other by 0.2
# to 0.6.
_ALIKE = 0.2


def spectral_differences(recordings: Sequence[Recording]) -> Array:
    """Compare the kinds of motion of runs by the spectra of their voltages.

    The spectrum s of a run consists of the root mean square voltages in each octave of frequency: of each
    drive, and of the sum and the difference of each pair of drives, divided by sqrt(2). On a machine with
    belts, sum and difference move different axes. Adjacent octaves overlap, so that a small change of a
    frequency changes the spectrum little.

    Args:
        recordings: Runs with their voltages, V, of any durations and sampling rates.

    Returns:
        |s_i - s_j| / (|s_i| + |s_j|) for each pair of runs i and j, dimensionless, shape (runs, runs). It is
        1 if the runs have no octave in common, and 1/3 if one run has twice the voltages of the other. Values
        below 0.2, such as those of repetitions of a run, are set to 0.
    """
    duration = max(float(r.time_s[-1] - r.time_s[0]) for r in recordings)
    spectra = [_octave_spectrum(r, duration) for r in recordings]
    octaves = max(len(s) for s in spectra)
    padded = np.array([np.pad(s, ((0, octaves - len(s)), (0, 0))).ravel() for s in spectra])
    size = np.linalg.norm(padded, axis=1)
    difference = np.array([np.linalg.norm(padded - other, axis=1) for other in padded])
    difference /= np.maximum(size[:, None] + size, np.finfo(float).tiny)  # both are 0 without any voltage
    return np.where(difference < _ALIKE, 0.0, difference)


def _octave_spectrum(recording: Recording, duration: float) -> Array:
    """Return rms voltages by octave of frequency, from 1 / duration (s) on, V, shape (octaves, signals)."""
    rows = len(recording.time_s)
    amplitudes = np.fft.rfft(recording.inputs, axis=0) / rows
    pairs = itertools.combinations(amplitudes.T, 2)
    signals = [*amplitudes.T, *(c / np.sqrt(2.0) for a, b in pairs for c in (a + b, a - b))]
    period = float(np.median(np.diff(recording.time_s)))
    octave = np.log2(np.maximum(np.fft.rfftfreq(rows, period) * duration, 1.0))
    lower = octave.astype(int)
    fraction = octave - lower  # of the power that belongs to the next octave
    powers = [
        np.bincount(lower, power * (1.0 - fraction), lower[-1] + 2)
        + np.bincount(lower + 1, power * fraction, lower[-1] + 2)
        for power in (np.abs(signal) ** 2 for signal in signals)
    ]
    return np.sqrt(np.column_stack(powers))
