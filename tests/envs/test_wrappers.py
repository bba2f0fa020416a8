"""Quantities of a step as penalties, costs and observations, and random forces on the tool."""

from __future__ import annotations

import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from hframe_gym.effects import EFFECTS
from hframe_gym.envs import (
    DISTURBANCES,
    QUANTITIES,
    CostWrapper,
    DisturbanceWrapper,
    HFrameEnv,
    HFrameVectorEnv,
    ObserveQuantities,
    PenaltyWrapper,
    VectorCostWrapper,
    VectorDisturbanceWrapper,
    VectorObserveQuantities,
    VectorPenaltyWrapper,
    machine_for_disturbances,
)
from hframe_gym.envs.wrappers.quantities import quantity
from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES

MACHINE = BUILTIN_MACHINES["hframe"]()
ALL = ("action", "action_change", "saturation", "velocity", "energy", "belt_force", "outside")


def actions(steps, count=None, seed=0):
    shape = (steps, 2) if count is None else (steps, count, 2)
    return np.random.default_rng(seed).uniform(-1.2, 1.2, shape).astype(np.float32)


def test_quantities_describe_the_step():
    env = HFrameEnv(randomize="default")
    wrapped = PenaltyWrapper(env, dict.fromkeys(ALL, 0.0))
    wrapped.reset(seed=3)
    machine = env.batch.machine
    last = np.zeros(2)
    for action in actions(30):
        observation, *_, info = wrapped.step(action)
        simulator, limited = env.batch.simulator, np.clip(action, -1.0, 1.0).astype(float)
        assert info["quantity_belt_force"] == pytest.approx(
            max(map(abs, simulator.tensions(0).values())), rel=1e-12
        )
        assert info["quantity_action"] == pytest.approx((limited**2).sum())
        assert info["quantity_action_change"] == pytest.approx(((limited - last) ** 2).sum())
        assert info["quantity_saturation"] == (np.abs(action) >= 1.0).mean()
        parameters = dict(zip(machine.parameters, env.batch.values[0].tolist(), strict=False))
        speeds = simulator.state[0, 6:8, 0] * simulator.units_per_travel[0, 2:4, 0]
        power = 0.0
        for j, drive in enumerate(machine.drives):
            gear, emf, ohm = (parameters[f"{drive.name}.{key}"] for key in ("gear_ratio", "Ke", "resistance"))
            volts = limited[j] * drive.rated_voltage
            power += volts * (volts - emf * gear * speeds[j]) / ohm
        assert info["quantity_energy"] == pytest.approx(power * 0.01, rel=1e-9)
        assert info["quantity_velocity"] == pytest.approx(
            np.linalg.norm(observation["observation"][4:6]), rel=1e-5
        )
        last = limited


def test_a_penalty_reduces_the_reward_and_nothing_else():
    plain, wrapped = HFrameEnv(), PenaltyWrapper(HFrameEnv(), {"energy": 0.5, "action_change": 0.1})
    plain.reset(seed=1)
    wrapped.reset(seed=1)
    for action in actions(20):
        expected, reward, *_ = plain.step(action)
        observation, reduced, *_, info = wrapped.step(action)
        for key, values in expected.items():
            np.testing.assert_array_equal(observation[key], values)
        penalty = 0.5 * info["quantity_energy"] + 0.1 * info["quantity_action_change"]
        assert penalty > 0.0
        assert reduced == pytest.approx(reward - penalty, rel=1e-12)


def test_costs_count_exceeded_limits_and_can_be_the_third_value():
    env = CostWrapper(HFrameEnv(), {"belt_force": 1e3, "velocity": 0.3}, six_values=True)
    env.reset(seed=1)
    costs = set()
    for _ in range(30):
        observation, reward, cost, terminated, truncated, info = env.step(np.array([1.0, 1.0], np.float32))
        assert info["cost"] == cost == info["cost_belt_force"] + info["cost_velocity"]
        assert info["cost_velocity"] == float(info["quantity_velocity"] > 0.3)
        assert isinstance(reward, float)
        assert not terminated
        assert not truncated
        assert observation["observation"].shape == (8,)
        costs.add(cost)
    assert {0.0, 1.0} <= costs
    five = CostWrapper(HFrameEnv(), {"belt_force": 20.0})
    five.reset(seed=1)
    assert len(five.step(np.ones(2, np.float32))) == 5


def test_observed_quantities_satisfy_gymnasium():
    for flat in (False, True):
        env = ObserveQuantities(HFrameEnv(normalize=True, flat=flat), ("belt_force", "energy"))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # that there is a wrapper
            check_env(env, skip_render_check=True)
    observation, _ = env.reset(seed=0)
    assert observation[-1] == 0.0
    observation, *_ = env.step(np.ones(2, np.float32))
    tension = max(map(abs, env.unwrapped.batch.simulator.tensions(0).values()))
    assert observation[-2] == pytest.approx(tension / QUANTITIES.get("belt_force").largest, rel=1e-6)


def test_vector_wrappers_give_the_same_as_single_ones():
    singles = [CostWrapper(HFrameEnv(), {"belt_force": 20.0, "energy": 0.1}) for _ in range(3)]
    penalized = VectorPenaltyWrapper(HFrameVectorEnv(3), {"velocity": 2.0})
    vector = VectorCostWrapper(penalized, {"belt_force": 20.0, "energy": 0.1}, six_values=True)
    for k, env in enumerate(singles):
        env.reset(seed=4 + k)
    vector.reset(seed=4)
    for row in actions(20, 3):
        _, reward, cost, _, _, info = vector.step(row)
        results = [env.step(action) for env, action in zip(singles, row, strict=True)]
        np.testing.assert_array_equal(cost, [result[-1]["cost"] for result in results])
        np.testing.assert_allclose(
            info["quantity_energy"], [r[-1]["quantity_energy"] for r in results], rtol=1e-12
        )
        np.testing.assert_allclose(
            reward, [r[1] for r in results] - 2.0 * info["quantity_velocity"], rtol=1e-12
        )
    assert cost.any()


def test_where_an_episode_begins_there_is_no_cost():
    env = VectorCostWrapper(HFrameVectorEnv(2, max_episode_steps=3), {"action": 0.5}, six_values=True)
    env.reset(seed=0)
    found = [env.step(np.ones((2, 2), np.float32))[2].tolist() for _ in range(5)]
    assert found == [[1.0, 1.0]] * 3 + [[0.0, 0.0]] + [[1.0, 1.0]]


def test_vector_observations_have_the_quantities():
    env = VectorObserveQuantities(HFrameVectorEnv(3), ("velocity",))
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    assert not observation["quantities"].any()
    for _ in range(3):
        observation, *_ = env.step(np.ones((3, 2), np.float32))
    assert env.observation_space.contains(observation)
    assert observation["quantities"].min() > 0.0


def test_a_registered_quantity_works_by_its_name():
    quantity("test_double_speed", "m/s", 1.0)(lambda step: 2.0 * QUANTITIES.get("velocity").function(step))
    env = PenaltyWrapper(HFrameEnv(), {"test_double_speed": 1.0, "velocity": 1.0})
    env.reset(seed=0)
    for action in actions(5):
        info = env.step(action)[-1]
    assert info["quantity_test_double_speed"] == 2.0 * info["quantity_velocity"] > 0.0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: PenaltyWrapper(HFrameEnv(), {"torque": 1.0}), "torque"),
        (lambda: PenaltyWrapper(HFrameEnv(), {"energy": float("nan")}), "the weight of 'energy' is nan"),
        (lambda: CostWrapper(HFrameEnv(), {}), "name at least one quantity of action"),
        (lambda: CostWrapper(gym.make("CartPole-v1"), {"energy": 1.0}), "not an environment of this package"),
        (
            lambda: VectorCostWrapper(HFrameVectorEnv(2, autoreset_mode="SameStep"), {"energy": 1.0}),
            "NextStep",
        ),
        (lambda: DisturbanceWrapper(HFrameEnv(), "white"), r"machine=machine_for_disturbances\(machine\)"),
        (lambda: disturbed("brown"), "brown"),
        (lambda: disturbed("white", std=-1.0), "std is -1"),
    ],
)
def test_wrong_arguments_are_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()


def disturbed(process, **options):
    return DisturbanceWrapper(HFrameEnv(machine=machine_for_disturbances(MACHINE)), process, **options)


def test_a_disturbance_is_a_force_on_the_tool():
    @DISTURBANCES.register("test_constant")
    class Constant:
        def begin(self, shape, period, generator):
            return np.tile([7.0, -4.0], (shape[0], 1))

        def follow(self, forces, period, generator):
            return forces

    force = EFFECTS["constant_force"]
    declared = MACHINE.with_effects(force.at("x", size=7.0), force.at("y", size=-4.0))
    expected, env = HFrameEnv(machine=declared), disturbed("test_constant")
    expected.reset(seed=2)
    env.reset(seed=2)
    for action in actions(20):
        right, found = expected.step(action), env.step(action)
        np.testing.assert_array_equal(found[0]["observation"], right[0]["observation"])
        np.testing.assert_array_equal(found[-1]["disturbance_N"], [7.0, -4.0])


def test_a_seed_determines_the_forces():
    def episode(env):
        env.reset(seed=5)
        return np.array([env.step(np.zeros(2, np.float32))[-1]["disturbance_N"] for _ in range(10)])

    env = disturbed("ornstein_uhlenbeck", std=3.0)
    first, again = episode(env), episode(env)
    np.testing.assert_array_equal(first, again)
    assert np.ptp(first) > 0.1
    assert len(np.unique(first)) == first.size


@pytest.mark.parametrize(
    ("name", "options", "std", "correlation"),
    [
        ("white", {"std": 3.0}, 3.0, 0.0),
        ("ornstein_uhlenbeck", {"std": 3.0, "time_s": 0.05}, 3.0, np.exp(-0.2)),
        ("pulses", {"size": 10.0, "rate": 5.0, "length_s": 0.05}, 10.0 * np.sqrt(0.2), 0.8),
    ],
)
def test_processes_have_their_size_and_correlation(name, options, std, correlation):
    process, generator = DISTURBANCES.get(name)(**options), np.random.default_rng(0)
    forces = [process.begin((500, 2), 0.01, generator)]
    for _ in range(400):
        forces.append(process.follow(forces[-1], 0.01, generator))
    late = np.array(forces[100:])
    assert late.std() == pytest.approx(std, rel=0.05)
    assert np.corrcoef(late[:-1].ravel(), late[1:].ravel())[0, 1] == pytest.approx(correlation, abs=0.03)
    assert abs(late.mean()) < 0.1 * std


def test_vector_environments_draw_one_force_each():
    machine = machine_for_disturbances(MACHINE.with_effects(EFFECTS["constant_force"].at("x", size=1.0)))
    assert [e.label for e in machine.effects] == ["constant_force@x", "constant_force@y"]
    env = VectorDisturbanceWrapper(
        HFrameVectorEnv(20, machine=machine, max_episode_steps=4), "pulses", rate=1e6
    )
    env.reset(seed=1)
    for step in range(8):
        info = env.step(np.zeros((20, 2), np.float32))[-1]
        assert info["disturbance_N"].shape == (20, 2)
        assert info["disturbance_N"].any() == (step not in (0, 5))  # the first force of an episode is none
    rows = [list(machine.parameters).index(f"constant_force@{axis}.size") for axis in "xy"]
    lanes = env.unwrapped.batch.simulator.parameters[:, rows].transpose(0, 2, 1).reshape(-1, 2)[:20]
    np.testing.assert_array_equal(lanes, env._forces.forces + np.array([1.0, 0.0]))
