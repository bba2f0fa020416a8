"""Tests of the ranking of effects that replace a part of the model, or with simulated starting values."""

from __future__ import annotations

import dataclasses

import numpy as np

from hframe_gym.effects import EFFECTS
from hframe_gym.identification import default_free_parameters, fit, prepare
from hframe_gym.identification.predict.prediction import SEARCH_BANDWIDTH
from hframe_gym.identification.propose.candidates import effect_parameters
from hframe_gym.identification.propose.structures import screen_structures
from hframe_gym.identification.propose.typical_scales import scales_of_motion, typical_scales
from hframe_gym.machine import BUILTIN_MACHINES, Machine
from tests.identification.propose.recorded_axis import recorded


def test_a_clock_whose_rate_changes_ranks_first(axis: Machine) -> None:
    """Its actual samples are later than its stamps, by a t^2/2."""
    plain, a = recorded(axis), 0.01
    actual_s = plain.time_s + 0.5 * a * plain.time_s**2
    noise = plain.outputs - axis.simulate(plain.time_s, plain.inputs).outputs
    drifting = dataclasses.replace(plain, outputs=axis.simulate(actual_s, plain.inputs).outputs + noise)
    data = prepare([drifting], axis)
    current = fit(axis, default_free_parameters(axis), data, SEARCH_BANDWIDTH)
    best, *_ = screen_structures(current, data, typical_scales(current, data), 0.0)
    assert best.effects[-1].label == "clock_drift@machine"
    assert best.effects[-1].parameters["a"] > 0.0


def test_a_parameter_at_its_limit_takes_nothing_from_an_effect(axis: Machine) -> None:
    """A load swings; beyond its limit, the declared motor constant would take half of what it explains."""
    swing = EFFECTS["payload_swing"].at("x", f0=3.0, zeta=0.02, r=0.3)
    declared = axis.replace({"x.viscous": 0.1, "x.coulomb": 0.02})
    data = prepare([recorded(axis.with_effects(swing))], declared)
    current = fit(declared, default_free_parameters(declared), data, SEARCH_BANDWIDTH)
    assert any(f.at_limit(t) for f, t in zip(current.free, current.theta, strict=True))
    best, *_ = screen_structures(current, data, typical_scales(current, data), 0.25 * current.chi2)
    assert best.effects[-1].label == "payload_swing@x"


def test_fits_of_a_gap_reach_teeth_without_damping_and_without_rebound() -> None:
    """From teeth without rebound, the logarithm of the damping ratio would end at exp(-4)."""
    machine, gap = BUILTIN_MACHINES["hframe"](), EFFECTS["gear_backlash"]
    motion, volts = np.ones((2, 4)), np.ones((2, 2))
    (start,) = gap.parameter("Z").grid
    effect = gap.at("motor1", d=1e-3, J=4e-5, F=0.02, B=1e-3, K=300.0, Z=start)
    scales = scales_of_motion(machine, motion, motion, [volts])
    free = effect_parameters(effect, machine.with_effects(effect), scales)
    ratio = next(f for f in free if f.name == f"{effect.label}.Z")
    low, high = (float(ratio.value(np.float64(theta))) for theta in ratio.theta_limits)
    assert (low, high) == (0.0, 1.0)


def test_which_effects_replace_a_part_of_the_model() -> None:
    replacing = {name for name, effect in EFFECTS.items() if effect.replaces_model_part}
    assert replacing == {
        "bridge_yaw",
        "frame_resonance",
        "gear_backlash",
        "idler_inertia",
        "payload_swing",
        "presliding",
    }
