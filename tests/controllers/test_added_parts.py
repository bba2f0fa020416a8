"""Control of machines with parts that effects add, and that controllers and state estimators leave out."""

import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.evaluation import evaluate
from hframe_gym.machine import BUILTIN_MACHINES

HFRAME = BUILTIN_MACHINES["hframe"]()
# A half gap of 2 mrad moves the belt by 39 um; a fifth of the pulley's inertia and friction is behind it.
GAP = EFFECTS["gear_backlash"].at("motor1", d=2e-3, J=4e-5, F=0.02, B=1e-4, K=280.0, Z=0.1)
IDLERS = EFFECTS["idler_inertia"].at("machine", J_left=3e-5, J_right=3e-5, B_left=5e-4, B_right=5e-4)


@pytest.mark.parametrize("effect", [GAP, IDLERS], ids=lambda effect: effect.name)
def test_controllers_run_from_the_sensors_of_the_machine(effect) -> None:
    machine = HFRAME.with_effects(effect)
    both, options = ["pid", "predictive"], {"sensors": "machine", "randomize": "none", "episodes": 8}
    moves = evaluate(both, machine, **options).scores["controllers"]
    paths = evaluate(both, machine, task="track", **options).scores["controllers"]
    for name in both:
        assert moves[name]["success"]["0.2mm"] == 1.0
        assert moves[name]["settling_s"]["0.2mm"]["mean"] < 0.4
        assert paths[name]["contour_mm"]["rms"]["mean"] < 0.04
