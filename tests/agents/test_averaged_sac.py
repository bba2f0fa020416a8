"""SAC with an average of its actor: what is averaged, what is evaluated, and what a file of it keeps."""

import copy

import pytest
import torch

from hframe_gym.agents.recipe import LinearSchedule

pytest.importorskip("stable_baselines3")
from hframe_gym.agents.averaged_sac import AveragedSAC
from hframe_gym.agents.weight_average import update_average


def sac(**keywords):
    """Return a small model on a pendulum."""
    return AveragedSAC(
        "MlpPolicy",
        "Pendulum-v1",
        policy_kwargs={"net_arch": [8]},
        learning_starts=4,
        batch_size=4,
        seed=0,
        device="cpu",
        **keywords,
    )


def weights(policy):
    return torch.cat([values.flatten() for values in policy.actor.parameters()]).detach()


def test_an_average_forgets_its_first_weights_and_keeps_the_fraction_later():
    average, trained = torch.nn.Linear(1, 1), torch.nn.Linear(1, 1)
    trained.weight.data.fill_(1.0)
    average.weight.data.fill_(0.0)
    update_average(average, trained, 0.9, 1)
    assert average.weight.item() == pytest.approx(0.9)
    average.weight.data.fill_(0.0)
    update_average(average, trained, 0.9, 1000)
    assert average.weight.item() == pytest.approx(0.1)


def test_the_evaluated_policy_lies_between_the_past_and_the_present_actor():
    model = sac(averaging=0.5).learn(16)  # after nine updates the fraction is 0.5
    past, first = weights(model.evaluated_policy), copy.deepcopy(weights(model.policy))
    assert not torch.equal(past, first)
    model.learn(1, reset_num_timesteps=False)
    assert not torch.equal(weights(model.policy), first)
    middle = 0.5 * (past + weights(model.policy))
    torch.testing.assert_close(weights(model.evaluated_policy), middle)


def test_without_averaging_the_actor_itself_is_evaluated():
    model = sac().learn(8)
    assert model.evaluated_policy is model.policy


def test_a_file_keeps_the_average_and_the_schedule(tmp_path):
    model = sac(averaging=0.5, target_entropy=LinearSchedule(-1.0, -3.0)).learn(8)
    assert model.target_entropy == -3.0
    model.save(tmp_path / "model.zip")
    loaded = AveragedSAC.load(tmp_path / "model.zip", device="cpu")
    assert torch.equal(weights(loaded.evaluated_policy), weights(model.evaluated_policy))
    assert not torch.equal(weights(loaded.evaluated_policy), weights(loaded.policy))
    assert loaded.entropy_schedule == model.entropy_schedule


def test_the_critics_alone_learn_at_first():
    model = sac(critic_steps=8)
    first = weights(model.policy)
    model.learn(8)
    assert torch.equal(weights(model.policy), first)
    assert model.log_ent_coef.item() == 0.0
    assert not torch.equal(next(model.critic.parameters()), next(sac().critic.parameters()))
    model.learn(1, reset_num_timesteps=False)
    assert not torch.equal(weights(model.policy), first)
    assert model.log_ent_coef.item() != 0.0
