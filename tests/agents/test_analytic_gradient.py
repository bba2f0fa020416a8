"""Analytic policy gradient: derivatives of one period, of a whole episode, and a short training."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from hframe_gym.agents import Agent, load_recipe, train
from hframe_gym.agents.agent import policy_keywords
from hframe_gym.agents.analytic_gradient import AnalyticPolicyGradient
from hframe_gym.agents.differentiable_episode import SimulatedPeriod, distance_cost
from hframe_gym.agents.features import feature_parameters
from hframe_gym.agents.model_card import score_agent
from hframe_gym.agents.residual_action import ResidualAction
from hframe_gym.agents.sb3_adapters import ResidualActionVecEnv
from hframe_gym.controllers import MotionModel
from hframe_gym.dynamics import simulate, simulate_batch
from hframe_gym.effects import EFFECTS
from hframe_gym.envs.sb3_vec_env import HFrameVecEnv
from hframe_gym.errors import InputError
from hframe_gym.evaluation import Scenario
from hframe_gym.machine import BUILTIN_MACHINES

MACHINE = BUILTIN_MACHINES["hframe"]()
PERIOD = 0.01
MODEL = MotionModel(MACHINE)


def moving_states(count):
    """Return states of the nominal machine that move fast enough for friction not to reverse in a period."""
    generator = np.random.default_rng(0)
    state = MODEL.goal_state(generator.uniform(-0.05, 0.05, (count, 2)))
    state[:, 4:] = generator.uniform(0.4, 0.6, (count, 2)) * [1.0, 0.5] @ MODEL.rigid.T
    return state, np.tile(list(MACHINE.parameters.values()), (count, 1))


def test_derivatives_agree_with_the_linear_model_of_the_motion():
    state, parameters = moving_states(16)
    volts = np.full((16, 2), 2.0)
    period = SimulatedPeriod(MACHINE, PERIOD)
    motions = period.simulate(state, volts, volts, parameters)
    outputs = period.outputs(motions)
    rows = [period.gradients(motions, np.tile(row, (16, 1))) for row in np.eye(outputs.shape[1])]
    # (entries, B, outputs)
    derivatives = np.stack([np.hstack(row[:2]) for row in rows], axis=2).transpose(1, 0, 2)
    A, B, _ = MODEL.discretize(MODEL.tool_position(state).mean(axis=0), PERIOD)
    expected = np.hstack([A, B]).T  # (entries of state and voltages, entries of the next state)
    scale = np.repeat([1e-3, 0.05], 4) / np.repeat([1e-3, 0.05, 1.0], [4, 4, 2])[:, None]
    error = (derivatives[:, :, :8].mean(axis=1) - expected) / scale
    # Back-EMF, belts and friction are linear here; the operating point differs between the states.
    assert np.abs(error).max() < 0.08
    assert np.abs(outputs[:, -2:] - outputs[:, :2]).max() < 1e-12


def with_dead_time(seconds):
    """Return the nominal machine with a dead time of its drives."""
    return MACHINE.with_effects(EFFECTS["input_delay"].at("drives", d=seconds))


def test_a_dead_time_applies_the_voltages_of_the_period_before():
    machine, voltages = with_dead_time(3e-3), np.random.default_rng(1).uniform(-6.0, 6.0, (5, 1, 2))
    parameters = np.array([list(machine.parameters.values())])
    period, state = SimulatedPeriod(machine, PERIOD), MODEL.goal_state(np.zeros((1, 2)))
    times = np.arange(6) * PERIOD
    start = state / np.tile(machine.travel_per_unit, 2)
    inputs = np.concatenate([np.zeros((1, 1, 2)), voltages]).transpose(1, 0, 2)
    # One period of 0 V first: before the first sample, its voltage acts.
    expected = simulate_batch(
        machine, np.arange(7) * PERIOD, np.append(inputs, inputs[:, -1:], axis=1), start=start
    )
    last = np.zeros((1, 2))
    for k in range(len(times) - 1):
        state = period.outputs(period.simulate(state, voltages[k], last, parameters))[:, :8]
        last = voltages[k]
        tool = MODEL.tool_position(state)[0]
        assert np.abs(tool - expected.positions[0, k + 2, :2]).max() < 2e-6
    assert np.abs(tool).max() > 1e-3


def test_stiff_belts_have_the_steps_that_they_need():
    """With steps of 1 ms, such belts leave an error of 40 um after one period."""
    stiff = {name: 100.0 * MACHINE.parameters[name] for name in MACHINE.parameters if name.endswith(".EA")}
    machine = MACHINE.replace(stiff)
    state, volts = MODEL.goal_state(np.zeros((1, 2))), np.array([[5.0, 2.0]])
    period = SimulatedPeriod(machine, PERIOD)
    motions = period.simulate(state, volts, volts, np.array([list(machine.parameters.values())]))
    outputs = period.outputs(motions)
    run = simulate(machine, [0.0, PERIOD], np.tile(volts, (2, 1)))
    np.testing.assert_allclose(MODEL.tool_position(outputs[:, :8])[0], run.positions[-1, :2], atol=2e-6)
    gradients = period.gradients(motions, np.ones_like(outputs))
    assert all(np.isfinite(part).all() for part in gradients)


def test_a_dead_time_beyond_a_period_is_rejected():
    with pytest.raises(InputError, match=r"dead time of 0\.011 s"):
        SimulatedPeriod(with_dead_time(0.011), PERIOD)


def test_the_cost_rewards_every_decade_of_distance():
    costs = distance_cost(torch.tensor([0.0, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 10.0])).numpy()
    assert costs[0] == 0.0
    assert costs[-1] == pytest.approx(1.0, abs=0.02)
    assert np.diff(costs).min() > 0.04


def build(actuation=None, task="reach", machine=MACHINE, **settings):
    """Return an algorithm with few periods, whose derivatives are neither limited nor discounted."""
    actuation = {"least": 0.5, "hold_m": 5e-4, "estimates": True} if actuation is None else actuation
    environment = HFrameVecEnv(8, task=task, randomize="none", machine=machine)
    if actuation:
        environment = ResidualActionVecEnv(environment, ResidualAction(machine, PERIOD, **actuation))
    chosen = {"periods": 4, "skipped": 0, "discount": 1.0, "limit": np.inf, "averaging": 0.5, **settings}
    keywords = policy_keywords({"net_arch": [16]}, feature_parameters(MACHINE))
    algorithm = AnalyticPolicyGradient(
        "MultiInputPolicy",
        environment,
        lambda _: 1e-3,
        seed=0,
        device="cpu",
        policy_kwargs=keywords,
        **chosen,
    )
    if not actuation.get("base"):
        with torch.no_grad():  # enough voltage to overcome friction
            algorithm._trained.action_net.bias[:2] += torch.tensor([0.5, 0.3])
    return algorithm


BANK = {"least": 0.1, "transfers": [0, 2, 6, 12, 20, 24]}
PLANS = {"least": 0.1, "estimates": True, "plans": [3, 5, 12, 24]}


@pytest.mark.parametrize(
    ("actuation", "task", "machine"),
    [
        (None, "reach", MACHINE),
        (None, "track", MACHINE),
        (BANK, "reach", MACHINE),
        (PLANS, "reach", MACHINE),
        ({"base": "predictive", "least": 0.5}, "track", MACHINE),
        (None, "reach", with_dead_time(6e-3)),
    ],
    ids=["reach", "track", "weighted transfers", "weighted plans", "with a base", "dead time"],
)
def test_the_gradient_of_an_episode_predicts_how_its_cost_changes(actuation, task, machine):
    algorithm = build(actuation, task, machine)
    environment = algorithm.env.venv

    def costs():
        environment.seed(5)
        return algorithm._episode_costs(0).mean()

    parameters = [
        p for n, p in algorithm._trained.named_parameters() if "policy_net" in n or "action_net" in n
    ]
    gradients = torch.autograd.grad(costs(), parameters)
    length = torch.sqrt(sum((g**2).sum() for g in gradients))
    change = {}
    # With a base the errors, whose rms enters the cost, are of the size of the change.
    step = 2e-4 if algorithm.mapping.base else 0.02
    for sign in (1.0, -1.0):
        with torch.no_grad():
            for parameter, gradient in zip(parameters, gradients, strict=True):
                parameter += sign * step * gradient / length
        change[sign] = costs().item()
        with torch.no_grad():
            for parameter, gradient in zip(parameters, gradients, strict=True):
                parameter -= sign * step * gradient / length
    slope = (change[1.0] - change[-1.0]) / (2.0 * step)
    assert slope == pytest.approx(length.item(), rel=0.1)


def test_the_first_policy_is_its_base():
    algorithm = build({"base": "predictive", "least": 0.5}, "track")
    observation = algorithm.env.reset()
    outputs, _ = algorithm.policy.predict(observation, deterministic=True)
    assert not outputs.any()
    np.testing.assert_allclose(algorithm.mapping.action(outputs), observation["base_action"], atol=1e-7)


@pytest.mark.parametrize("actuation", [BANK, PLANS], ids=["transfers", "plans"])
def test_the_policy_that_is_trained_acts_as_the_one_that_is_saved(actuation):
    algorithm = build(actuation)
    observation = algorithm.env.reset()
    algorithm.policy.load_state_dict(algorithm._trained.state_dict())
    outputs, _ = algorithm.policy.predict(observation, deterministic=True)
    entries = {key: torch.from_numpy(np.asarray(values)) for key, values in observation.items()}
    trained = algorithm._action(entries).detach().numpy()
    np.testing.assert_allclose(algorithm.mapping.action(outputs), np.clip(trained, -1.0, 1.0), atol=1e-5)


def test_the_derivative_by_the_state_is_limited_in_every_episode():
    def norm(**settings):
        algorithm = build(**settings)
        algorithm.env.venv.seed(5)
        algorithm._episode_costs(0).mean().backward()
        return algorithm._trained.action_net.weight.grad.norm().item()

    assert norm(limit=1e-4) < 0.2 * norm()
    assert norm(discount=0.0) < norm()


@pytest.mark.parametrize("actuation", [{"base": "pid"}, {}], ids=["base", "none"])
def test_a_mapping_without_derivatives_is_rejected(actuation):
    with pytest.raises(InputError, match=r"an \[actuation\] without a base controller"):
        build(actuation)


@pytest.mark.train
def test_a_short_training_reaches_the_goal_and_resumes(tmp_path, monkeypatch):
    monkeypatch.setattr("hframe_gym.agents.training.EVALUATION_EPISODES", 32)
    monkeypatch.setattr("hframe_gym.agents.training.EVALUATIONS_PER_RUN", 3)
    recipe = load_recipe("apg", "reach")
    recipe = replace(recipe, env={**recipe.env, "num_envs": 64})
    card = train(recipe, steps=64_000, out=tmp_path, log=lambda line: None)
    assert card["curve"][0]["success_1mm"] < 0.1
    assert card["curve"][-1]["success_1mm"] > 0.5
    agent = Agent.load(tmp_path)
    kept = next(row for row in card["curve"] if row["steps"] == card["kept"])
    assert score_agent(agent, Scenario(episodes=32, seed=1_000_000)).row.items() <= kept.items()
    steps = card["curve"][-1]["steps"] + 64
    resumed = train(recipe, steps=steps, out=tmp_path, resume=True, log=lambda line: None)
    assert resumed["curve"][: len(card["curve"])] == card["curve"]
    assert resumed["curve"][-1]["steps"] >= steps
