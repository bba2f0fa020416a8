"""Tests of the ranking of effects that replace a part of the model, or with simulated starting values."""

from __future__ import annotations

import dataclasses

from hframe_gym.effects import EFFECTS
from hframe_gym.identification import default_free_parameters, fit, prepare
from hframe_gym.identification.predict.prediction import SEARCH_BANDWIDTH
from hframe_gym.identification.propose.structures import screen_structures
from hframe_gym.identification.propose.typical_scales import typical_scales
from hframe_gym.machine import Machine
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
