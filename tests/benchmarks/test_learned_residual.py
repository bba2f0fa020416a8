"""Test the entries NAME-learned of `gap-v1`: the forces that a machine lacks, and their compensation."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from benchmarks.gap.catalog import get_entry
from benchmarks.gap.control_loop import PERIOD_S
from benchmarks.gap.learned_residual import Compensated, LearnedResidual, VoltageResidual, missing_forces
from benchmarks.gap.learned_residual import _Remembering as Remembering
from benchmarks.gap.plants import declared_machine
from hframe_gym.controllers import Controller, MotionModel
from hframe_gym.dynamics import simulate
from hframe_gym.machine import Machine
from hframe_gym.recordings import Recording
from tests.reference_simulator import Array

MODEL = MotionModel(declared_machine())
CHANGED = declared_machine().replace({"x.mass": 1.2 * MODEL.mass[0], "y.viscous": 8.0})


def recorded(machine: Machine) -> list[Recording]:
    """Return three runs of a machine with other voltages each, with the noise of encoders and lasers."""
    runs, rng = [], np.random.default_rng(0)
    time_s = np.arange(1500) / 1000.0
    for number in range(3):
        frequency, phase = rng.uniform(1.0, 5.0, (3, 2)), rng.uniform(0.0, 6.0, (3, 2))
        volts = 2.5 * np.sin(2.0 * np.pi * frequency * time_s[:, None, None] + phase).sum(axis=1)
        q = simulate(machine, time_s, volts).positions[:, [2, 3, 0, 1]]
        noise = rng.normal(0.0, [1.5e-4, 1.5e-4, 2e-5, 2e-5], q.shape)
        runs.append(Recording(f"run {number}", time_s, volts, q + noise))
    return runs


def test_a_machine_lacks_the_forces_by_which_the_plant_differs() -> None:
    none = missing_forces(MODEL, recorded(declared_machine()))
    changed = missing_forces(MODEL, recorded(CHANGED))
    for same, other in zip(none, changed, strict=True):
        assert len(other.force_N) > 100
        assert np.std(same.force_N) < 0.25 * np.std(other.force_N)


def test_learned_voltages_explain_runs_that_were_not_seen() -> None:
    *seen, unseen = recorded(CHANGED)
    residual = VoltageResidual(MODEL, seen)
    scale = np.tile(MODEL.machine.travel_per_unit, 2)
    motion = simulate(CHANGED, unseen.time_s, unseen.inputs)
    state = np.hstack([motion.positions, motion.velocities]) * scale
    moving = (np.abs(state[:, 4:]) > 0.02).all(axis=1)
    speed, volts = state[moving, 4:], unseen.inputs[moving]
    learned = residual(state[moving], volts) @ MODEL.force_per_volt.T
    # More mass needs more force, less friction less of it.
    forces = (volts @ MODEL.drive.T - MODEL.viscous * speed - MODEL.coulomb * np.sign(speed)) @ MODEL.rigid
    mass = MODEL.mass @ MODEL.rigid**2
    lighter = declared_machine().parameters["y.viscous"] - CHANGED.parameters["y.viscous"]
    missing = [(mass[0] / (mass[0] + 0.2 * MODEL.mass[0]) - 1.0) * forces[:, 0], lighter * speed[:, 1]]
    error = learned - np.transpose(missing)
    assert (error.std(axis=0) < 0.3 * np.std(missing, axis=1)).all()


class Wanting(Controller):
    """Controller that wants the same always, and remembers what acted instead."""

    def act(self, observation: Any) -> Array:
        return np.tile([0.5, -0.9], (len(observation["observation"]), 1))

    def replace_last_action(self, actions: Array) -> None:
        self.told = actions


def test_learned_voltages_are_subtracted_and_the_controller_knows_what_acts() -> None:
    wanting, estimator = Wanting(declared_machine()), Remembering(declared_machine(), PERIOD_S)
    learned = np.array([[1.2, 3.0]])
    controller = Compensated(wanting, estimator, lambda state, volts: learned)  # type: ignore[arg-type]
    command = controller.act({"observation": np.zeros((1, 4)), "desired_goal": np.zeros((1, 2))})
    np.testing.assert_allclose(command, [[0.5 - 1.2 / MODEL.rated[0], -1.0]])
    np.testing.assert_allclose(wanting.told, [[0.5, -1.0 + 3.0 / MODEL.rated[1]]])


@pytest.mark.parametrize("name", ["pid-learned", "ppo_mix-learned"])
def test_controllers_and_agents_have_such_an_entry(name: str) -> None:
    make = get_entry(name)
    assert issubclass(make, LearnedResidual)
    assert (make.track, make.learned) == ("identified", True)
