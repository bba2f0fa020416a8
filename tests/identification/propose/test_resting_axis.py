"""Runs where one axis of a gantry never moves: its candidates gain nothing, its parameters keep priors."""

from __future__ import annotations

import dataclasses
import warnings

import numpy as np
import pytest

from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.identification import default_free_parameters, fit, identify, prepare, screen
from hframe_gym.identification.predict.prediction import SEARCH_BANDWIDTH
from hframe_gym.identification.propose.candidates import SearchState, candidates
from hframe_gym.identification.propose.dependences import rank_dependences
from hframe_gym.machine import BUILTIN_MACHINES, Machine, rest_state
from hframe_gym.recordings import Recording

DRAG = EFFECTS["quadratic_drag"].at("x", c=30.0)
NOISE = 20e-6  # m


def gantry() -> Machine:
    """Return a gantry whose axes x and y are two of the built-in axes."""
    axis = BUILTIN_MACHINES["axis"]()
    (x,), (drive,), (sensor,) = axis.coordinates, axis.drives, axis.sensors
    return dataclasses.replace(
        axis,
        coordinates=(x, dataclasses.replace(x, name="y")),
        drives=(drive, dataclasses.replace(drive, name="motor_y", channel="vy_V", coordinate="y")),
        sensors=(sensor, dataclasses.replace(sensor, channel="y_m", row={"y": 1.0})),
    )


def runs_along_x(machine: Machine, count: int, *, noise_of_y: float) -> list[Recording]:
    """Return noisy runs along x; y rests at 0.05 m."""
    rng = np.random.default_rng(1)
    time_s = np.arange(1000) * 1e-3
    recordings = []
    for k in range(count):
        driven = 6.0 * np.sin((6.0 + 4.0 * k) * time_s + k) + rng.normal(0.0, 0.5, len(time_s))
        inputs = np.column_stack([np.where(time_s > 0.1, driven, 0.0), np.zeros(len(time_s))])
        outputs = simulate(machine, time_s, inputs, rest_state(machine, (0.0, 0.05))).outputs
        noise = rng.normal(0.0, 1.0, outputs.shape) * [NOISE, noise_of_y]
        recordings.append(Recording(f"run_{k}", time_s, inputs, outputs + noise))
    return recordings


@pytest.mark.parametrize("noise_of_y", [NOISE, 0.0])
def test_candidates_on_an_axis_that_never_moves_gain_nothing(noise_of_y: float) -> None:
    machine = gantry()
    data = prepare(runs_along_x(machine.with_effects(DRAG), 2, noise_of_y=noise_of_y), machine)
    fitted = fit(machine, default_free_parameters(machine), data, SEARCH_BANDWIDTH)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # no division by zero or overflow
        ranked = screen(fitted, candidates(SearchState.of(fitted, data)), data)
    assert ranked[0].candidate.label == DRAG.label
    at_y = [scored for scored in ranked if scored.candidate.site in ("y", "motor_y", "y_m")]
    assert len(at_y) > 20
    assert all(np.isfinite(scored.gain) and np.isfinite(scored.amounts).all() for scored in ranked)
    assert max(scored.gain for scored in at_y) < 2e-3 * ranked[0].gain


@pytest.mark.parametrize("noise_of_y", [NOISE, 0.0])
def test_an_effect_on_the_moving_axis_is_found(noise_of_y: float) -> None:
    """The parameters of the other axis keep declared values and the standard deviations of their priors."""
    machine = gantry()
    result = identify(runs_along_x(machine.with_effects(DRAG), 4, noise_of_y=noise_of_y), machine)
    [found] = result.effects
    assert found.effect.label == DRAG.label
    assert found.effect.parameters["c"] == pytest.approx(30.0, rel=0.01)
    assert {d.coordinate for d in result.dependence} == {"x"}
    uncertainty = result.after.machine.uncertainty
    assert uncertainty is not None
    # Not motor_y.Kt: it is the unit of the forces at y.
    for name in ("y.mass", "y.viscous", "y.coulomb", "motor_y.Ke"):
        prior = next(f for f in default_free_parameters(machine) if f.name == name)
        prior_std = prior.prior * (prior.center if prior.scale is None else prior.scale)
        std = uncertainty.std(name)
        assert std == pytest.approx(prior_std, rel=0.1)
        assert abs(result.after.machine.parameters[name] - machine.parameters[name]) < 0.1 * prior_std


def test_a_sensor_whose_measurement_never_changes_has_its_declared_noise() -> None:
    machine = gantry()
    data = prepare(runs_along_x(machine, 2, noise_of_y=0.0), machine)
    assert data.noise[1] == machine.sensors[1].noise
    assert data.noise[0] == pytest.approx(NOISE, rel=0.1)


def test_the_rounding_error_of_a_force_depends_on_nothing() -> None:
    """Without this limit, an exact machine would lack a force on y that depends on all variables."""
    machine = gantry()
    data = prepare(runs_along_x(machine, 2, noise_of_y=0.0), machine)
    assert "y" not in {d.coordinate for d in rank_dependences(machine, data)}
