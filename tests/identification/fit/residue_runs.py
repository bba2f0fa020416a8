"""Runs of an axis with a force that no effect describes, and fits to them."""

from __future__ import annotations

import numpy as np

from hframe_gym.dynamics import simulate_batch
from hframe_gym.effects import EFFECTS
from hframe_gym.identification import Dataset, Fit, default_free_parameters, fit, prepare
from hframe_gym.identification.predict.prediction import SEARCH_BANDWIDTH
from hframe_gym.machine import Machine
from hframe_gym.recordings import Recording

NOISE = 20e-6  # m
ROWS = 1500


def smoothed(values: np.ndarray, rows: int) -> np.ndarray:
    """Return white noise smoothed over some rows, with a standard deviation of 1."""
    colored = np.convolve(values, np.exp(-np.arange(8 * rows) / rows), "same")
    return np.asarray(colored / np.std(colored))


def recordings(
    axis: Machine,
    *,
    residue: float | tuple[float, ...] = 0.0,
    color_rows: int = 0,
    forces: tuple[float, ...] = (0.0,) * 4,
) -> Dataset:
    """Return runs of an axis, one per constant force (N), a random slow force (N), perhaps colored noise."""
    runs = []
    residues = residue if isinstance(residue, tuple) else (residue,) * len(forces)
    for k, (size, slow) in enumerate(zip(forces, residues, strict=True)):
        rng = np.random.default_rng(k)
        time_s = np.arange(ROWS) * 1e-3
        inputs = np.where(time_s > 0.1, 1.5 * np.sin((8 + k) * time_s) + 0.7 * np.sin(31 * time_s), 0.0)[
            :, None
        ]
        force = slow * smoothed(rng.normal(size=ROWS), 200)
        force[:120] = 0.0
        machine = axis.with_effects(EFFECTS["constant_force"].at("x", size=size)) if size else axis
        motion = simulate_batch(
            machine, time_s, inputs, extra_force=force[None, :, None], longest_step=0.125e-3
        )
        noise = rng.normal(size=ROWS)
        noise = NOISE * (smoothed(noise, color_rows) if color_rows else noise)
        runs.append(Recording(f"run_{k}", time_s, inputs, motion.readings[0] + noise[:, None]))
    return prepare(runs, axis)


def fitted_axis(axis: Machine, data: Dataset, *, constant_force: bool = False) -> Fit:
    """Return the fit of the axis at the bandwidth of the search, with or without a constant force."""
    machine = axis.with_effects(EFFECTS["constant_force"].at("x", size=0.05)) if constant_force else axis
    return fit(machine, default_free_parameters(machine), data, SEARCH_BANDWIDTH)
