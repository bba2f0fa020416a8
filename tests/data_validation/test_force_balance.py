"""The balance of forces tells a wrong sign from forces that the machine file lacks."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.data_validation import Finding, check_before_fit
from hframe_gym.effects import EFFECTS
from hframe_gym.machine import AppliedEffect, Coordinate, Drive, Machine, Sensor
from hframe_gym.recordings import Recording
from tests.data_validation.planted_mistakes import faults, measure

REMEDY = "correct the columns of the file, or the declaration in machine.json"
QUANTUM = 2 * np.pi / 4096


def torque_motor() -> Machine:
    """Return a shaft under a commanded torque, with an encoder of 4096 counts."""
    return Machine(
        name="shaft",
        belts=(),
        coordinates=(Coordinate("shaft", 1e-3, 1e-3, 0.01, "rotary", 0.05),),
        drives=(
            Drive(
                "motor",
                "torque_Nm",
                "shaft",
                Kt=1.0,
                Ke=0.0,
                resistance=1.0,
                gear_ratio=1.0,
                rated_voltage=0.15,
            ),
        ),
        sensors=(Sensor("angle_rad", {"shaft": 1.0}, resolution=QUANTUM, kind="encoder"),),
    )


def slow_runs(
    machine: Machine, effect: AppliedEffect | None, sign: float = 1.0, size: float = 0.1
) -> list[Recording]:
    """Return runs with slow sines, below the resonance of a spring or a weight, measured with a sign."""
    rig = machine if effect is None else machine.with_effects(effect)
    runs = []
    for k, frequency in enumerate((0.5, 0.7, 0.9)):
        time = np.arange(2000) * 2e-3
        torque = np.where(time > 0.2, size * np.sin(2 * np.pi * frequency * (time - 0.2)), 0.0)[:, None]
        outputs = measure(machine, rig.simulate(time, torque).outputs)
        runs.append(Recording(f"run_{k}", 10.0 * k + time, torque, sign * outputs))
    return runs


def signs(findings: list[Finding]) -> list[str]:
    """Return the severities of the findings about signs."""
    return [finding.severity for finding in findings if "sign" in finding.message]


@pytest.mark.parametrize("stiffness", [0.05, 0.15, 0.5])
def test_an_undeclared_spring_is_no_wrong_sign(stiffness: float) -> None:
    """Below resonance, torque and angle have one sign; the declared machine would turn the other way."""
    machine = torque_motor()
    spring = EFFECTS["cable_spring"].at("shaft", k=stiffness, q0=0.0)
    assert signs(check_before_fit(slow_runs(machine, spring), machine)) == []


def test_an_undeclared_weight_is_no_wrong_sign() -> None:
    machine = torque_motor()
    weight = EFFECTS["unbalance"].at("shaft", A=0.15, p=0.0)
    assert signs(check_before_fit(slow_runs(machine, weight), machine)) == []


def test_a_wrong_sign_is_a_fault() -> None:
    machine = torque_motor()
    lines = faults(check_before_fit(slow_runs(machine, None, -1.0), machine))
    assert lines == [f"fault: angle_rad has the wrong sign or torque_Nm has the wrong sign: {REMEDY}"]


def test_a_wrong_sign_beside_an_undeclared_spring_is_a_fault_where_friction_shows_it() -> None:
    """The spring explains the phase of either sign, dry friction only of one."""
    machine = torque_motor()
    soft = EFFECTS["cable_spring"].at("shaft", k=0.02, q0=0.0)
    assert signs(check_before_fit(slow_runs(machine, soft, -1.0), machine)) == ["fault"]


@pytest.mark.parametrize("seed", range(8))
def test_random_machines_with_springs_weights_and_offsets_have_no_fault(seed: int) -> None:
    """Right wiring, whatever the file lacks: parameters off by up to 2, a spring, a weight and a bias."""
    rng = np.random.default_rng(seed)
    declared = torque_motor()
    factors = np.exp(rng.uniform(-0.7, 0.7, 3))
    rig = declared.replace(
        {
            f"shaft.{name}": declared.parameters[f"shaft.{name}"] * f
            for name, f in zip(("mass", "viscous", "coulomb"), factors, strict=True)
        }
    ).with_effects(
        EFFECTS["cable_spring"].at("shaft", k=rng.uniform(0.0, 0.3), q0=rng.uniform(-0.2, 0.2)),
        EFFECTS["constant_force"].at("shaft", size=rng.uniform(-0.02, 0.02)),
    )
    time = np.arange(1500) * 2e-3
    runs = []
    for k in range(3):
        torque = np.repeat(rng.uniform(-0.12, 0.12, 15), 100)[:, None] * (time > 0.2)[:, None]
        runs.append(
            Recording(
                f"run_{k}", 5.0 * k + time, torque, measure(declared, rig.simulate(time, torque).outputs)
            )
        )
    findings = check_before_fit(runs, declared)
    assert [f for f in findings if f.severity == "fault"] == []
    assert signs(findings) == []


def test_inputs_of_another_recording_are_advice() -> None:
    machine = torque_motor()
    rng = np.random.default_rng(1)
    time = np.arange(2000) * 2e-3
    runs = []
    for k in range(3):
        torque, other = (np.repeat(rng.uniform(-0.1, 0.1, 20), 100)[:, None] for _ in range(2))
        runs.append(
            Recording(
                f"run_{k}", 5.0 * k + time, other, measure(machine, machine.simulate(time, torque).outputs)
            )
        )
    [advice] = [f for f in check_before_fit(runs, machine) if "the inputs explain only" in f.message]
    assert advice.severity == "advice"
