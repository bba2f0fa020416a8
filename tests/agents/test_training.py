"""Training end to end on a small scale: learning, files, reproducibility and resuming after a kill."""

import io
import json
import random
import re
import subprocess
import sys
import time
import zipfile
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pytest
import torch

from hframe_gym.agents import Agent, load_recipe, train, train_seeds
from hframe_gym.agents.model_card import score_agent
from hframe_gym.controllers import CONTROLLERS
from hframe_gym.envs import TASKS, HFrameVectorEnv, Reach
from hframe_gym.errors import InputError
from hframe_gym.evaluation import Scenario, evaluate
from hframe_gym.machine import BUILTIN_MACHINES

pytestmark = pytest.mark.train

EPISODES = 32  # of an evaluation; enough here and faster than the 256 of a real run
SHORT_S = 0.2  # length of an episode of an evaluation: enough to compare scores, not to arrive


@pytest.fixture(autouse=True)
def short_evaluations(monkeypatch):
    """Evaluate on fewer and shorter episodes."""
    monkeypatch.setattr("hframe_gym.agents.training.EVALUATION_EPISODES", EPISODES)
    monkeypatch.setattr("hframe_gym.agents.training.Scenario", partial(Scenario, duration_s=SHORT_S))


@pytest.fixture
def whole_motions(monkeypatch, short_evaluations):
    """Let the motions of evaluations arrive, as in a real run; evaluate half as often."""
    monkeypatch.setattr("hframe_gym.agents.training.Scenario", Scenario)
    monkeypatch.setattr("hframe_gym.agents.training.EVALUATIONS_PER_RUN", 6)


def small(algorithm, **keywords):
    """Return a recipe for reach with few environments, few samples, and other keywords of its algorithm."""
    recipe = load_recipe(algorithm, "reach")
    few = {"n_steps": 16, "batch_size": 64} if "n_steps" in recipe.algorithm else {}
    few |= {"buffer_size": 4_000} if "buffer_size" in recipe.algorithm else {}
    return replace(recipe, env=recipe.env | {"num_envs": 16}, algorithm=recipe.algorithm | few | keywords)


def ignore(line):
    """Discard a line of the log."""


@pytest.mark.usefixtures("whole_motions")
def test_ppo_learns_and_the_best_agent_of_the_curve_is_saved(tmp_path):
    lines = []
    card = train("ppo", steps=200_000, out=tmp_path, log=lines.append)
    first, last = card["curve"][0], card["curve"][-1]
    assert last["final_error_mm"] < 0.2 * first["final_error_mm"]
    *evaluations, end = lines
    assert len(evaluations) == len(card["curve"]) > 5
    assert end.startswith(f"trained {last['steps']} steps, not 200000: ")
    assert json.loads((tmp_path / "card.json").read_text()) == card
    kept = next(row for row in card["curve"] if row["steps"] == card["kept"])
    assert kept["settling_s_1mm"] <= min(row["settling_s_1mm"] for row in card["curve"]) + 0.05
    scenario = Scenario(randomize="default", episodes=EPISODES, seed=1_000_000)
    assert score_agent(Agent.load(tmp_path), scenario).row.items() <= kept.items()


@pytest.mark.usefixtures("whole_motions")
@pytest.mark.parametrize("recipe", ["adapt", "adapt_mix"])
def test_adapt_starts_from_the_shipped_agent_with_the_given_randomization(tmp_path, recipe):
    machine = BUILTIN_MACHINES["hframe"]()
    heavier = machine.replace({"x.mass": 1.1 * machine.parameters["x.mass"]})
    card = train(recipe, heavier, steps=1, out=tmp_path, randomize="none", log=ignore)
    assert all(row["success_0.2mm"] > 0.95 for row in card["curve"])
    assert card["settings"]["env"]["randomize"] == "none"


def test_agents_are_scored_with_the_sensors_drives_and_randomization_of_the_recipe(tmp_path):
    recipe = load_recipe("residual", "reach")
    recipe = replace(recipe, env={"sensors": "rig", "drives": "rig", "num_envs": 32})
    card = train(recipe, steps=0, out=tmp_path, log=ignore)
    task = Reach(**recipe.task)
    ideal = Scenario(task=task, randomize="none", episodes=EPISODES, seed=1_000_000, duration_s=SHORT_S)
    agent, row = Agent.load(tmp_path), card["curve"][0]
    assert score_agent(agent, replace(ideal, sensors="rig", drives="rig")).row.items() <= row.items()
    for other in (
        {"sensors": "rig"},
        {"drives": "rig"},
        {"sensors": "rig", "drives": "rig", "randomize": "default"},
    ):
        assert not score_agent(agent, replace(ideal, **other)).row.items() <= row.items()
    assert "Randomization: `none`" in (tmp_path / "README.md").read_text()


def test_the_same_seed_gives_the_same_agent(tmp_path):
    weights = []
    for name in ("a", "b"):
        train(small("residual"), steps=512, seed=3, out=tmp_path / name, log=ignore)
        weights.append((tmp_path / name / "policy.safetensors").read_bytes())
    assert weights[0] == weights[1]


@pytest.mark.parametrize("task", ["reach", "track"])
def test_a_residual_policy_starts_as_its_base_controller(tmp_path, task):
    train("residual", task=task, steps=0, out=tmp_path, log=ignore)
    agent, base = Agent.load(tmp_path), CONTROLLERS.get("adaptive-pid")(BUILTIN_MACHINES["hframe"](), 0.01)
    envs = HFrameVectorEnv(6, task=task)
    observation, _ = envs.reset(seed=0)
    for _ in range(20):
        actions = agent.act(observation)
        assert np.array_equal(actions, base.act(observation))
        observation = envs.step(actions)[0]


def test_a_residual_policy_changes_the_action_by_its_authority_at_most(tmp_path):
    train(small("residual"), steps=256, out=tmp_path, log=ignore)
    agent = Agent.load(tmp_path)
    agent.policy.action_net.bias.data.fill_(100.0)  # far beyond the limit of the output
    base = CONTROLLERS.get("adaptive-pid")(BUILTIN_MACHINES["hframe"](), 0.01)
    observation, _ = HFrameVectorEnv(6).reset(seed=0)
    difference = np.abs(agent.act(observation) - base.act(observation))
    assert 0.0 < difference.max() <= agent.mapping.authority.most + 1e-6


def learning_curve(folder):
    """Return the rows that a run has written so far."""
    card = folder / "card.json"
    return json.loads(card.read_text())["curve"] if card.exists() else []


# Begins a run of many short evaluations.
_LONG_RUN = f"""
import sys
from functools import partial
from hframe_gym.agents import train, training
training.EVALUATION_EPISODES, training.EVALUATIONS_PER_RUN = {EPISODES}, 60
training.Scenario = partial(training.Scenario, duration_s={SHORT_S})
train('sac', steps=200_000, out=sys.argv[1], log=lambda line: None)
"""


def test_a_killed_run_resumes_from_its_checkpoint(tmp_path):
    with subprocess.Popen([sys.executable, "-c", _LONG_RUN, str(tmp_path)]) as process:
        deadline = time.monotonic() + 240.0
        while len(learning_curve(tmp_path)) < 2 and time.monotonic() < deadline and process.poll() is None:
            time.sleep(0.05)
        process.kill()
    before = learning_curve(tmp_path)
    assert before[-1]["steps"] > 0
    Agent.load(tmp_path)
    steps = before[-1]["steps"] + 320
    card = train("sac", steps=steps, out=tmp_path, resume=True, log=ignore)
    assert card["curve"][: len(before)] == before
    assert card["curve"][-1]["steps"] >= steps
    assert card["curve"][-1]["cpu_s"] >= before[-1]["cpu_s"]  # rounded: 320 steps may take less than 0.1 s


class _Killed(BaseException):
    """Stands for the end of a process."""


@pytest.mark.parametrize(
    ("algorithm", "steps"),
    [
        ("ppo", 1_500),
        ("sac_mix", 1_100),
        pytest.param("crossq", 1_600, marks=pytest.mark.slow),
        pytest.param("tqc", 1_600, marks=pytest.mark.slow),
        pytest.param("sac_her", 6_400, marks=pytest.mark.slow),
        pytest.param("residual", 1_500, marks=pytest.mark.slow),
    ],
)
def test_a_resumed_run_equals_an_unbroken_one_to_the_bit(tmp_path, monkeypatch, algorithm, steps):
    monkeypatch.setattr("hframe_gym.agents.training.SHORTEST_INTERVAL", 500)

    def kill(done, total):
        if done > 0.7 * total:
            raise _Killed

    whole, broken = tmp_path / "whole", tmp_path / "broken"
    recipe = load_recipe(algorithm, "reach")
    if not recipe.hindsight:  # which needs complete episodes
        few_updates = {"learning_starts": 320, "gradient_steps": 2}
        recipe = small(algorithm, **few_updates if "learning_starts" in recipe.algorithm else {})
    train(recipe, steps=steps, seed=4, out=whole, log=ignore)
    with pytest.raises(_Killed):
        train(recipe, steps=steps, seed=4, out=broken, log=ignore, progress=kill)
    resumed_from = learning_curve(broken)[-1]["steps"]
    assert 0 < resumed_from < steps
    random.seed(99)  # a new process would start with other states of the global generators
    np.random.seed(99)  # noqa: NPY002
    torch.manual_seed(99)
    train(recipe, steps=steps, seed=4, out=broken, log=ignore, resume=True)
    cards = [json.loads((folder / "card.json").read_text()) for folder in (whole, broken)]
    for row in [*cards[0]["curve"], *cards[1]["curve"]]:
        del row["seconds"], row["cpu_s"]
    assert cards[0] == cards[1]
    for file in ("policy.safetensors", "agent.json", "machine.json"):
        assert (whole / file).read_bytes() == (broken / file).read_bytes()
    with (
        zipfile.ZipFile(whole / "checkpoint.zip") as first,
        zipfile.ZipFile(broken / "checkpoint.zip") as second,
    ):
        for file in ("policy.pth", *(n for n in first.namelist() if n.endswith("optimizer.pth"))):
            weights = [torch.load(io.BytesIO(z.read(file)), weights_only=True) for z in (first, second)]
            assert_same(*weights)


def assert_same(first, second):
    """Compare nested dictionaries and lists of tensors bit by bit."""
    if isinstance(first, torch.Tensor):
        assert torch.equal(first, second)
    elif isinstance(first, dict):
        assert first.keys() == second.keys()
        for key in first:
            assert_same(first[key], second[key])
    elif isinstance(first, list | tuple):
        for a, b in zip(first, second, strict=True):
            assert_same(a, b)
    else:
        assert first == second


def test_resuming_an_empty_folder_is_refused(tmp_path):
    with pytest.raises(InputError, match="nothing to resume"):
        train("ppo", steps=10, out=tmp_path, resume=True)


def test_resuming_another_run_is_refused(untrained_agent):
    with pytest.raises(
        InputError, match=r"a run of ppo_reach on reach with seed 0, not of ppo_reach on reach with seed 1"
    ):
        train("ppo", steps=10, seed=1, out=untrained_agent, resume=True)


def test_resuming_on_another_machine_is_refused(untrained_agent):
    with pytest.raises(
        InputError, match=r"holds a run on the machine 'hframe', .* --machine \S+/machine\.json"
    ):
        train("ppo", "hframe-linear", steps=10, out=untrained_agent, resume=True)


def test_a_run_is_replaced_only_by_force(untrained_agent):
    before = (untrained_agent / "policy.safetensors").read_bytes()
    described = r"holds the agent ppo of machine 'hframe', seed 0, \d+ steps, "
    with pytest.raises(InputError, match=described + r".* continue the run with --resume, .* --force"):
        train("ppo", steps=1, out=untrained_agent, log=ignore)
    (untrained_agent / "card.json").write_text("{}")
    with pytest.raises(
        InputError, match=r"holds agent\.json, policy\.safetensors, card\.json, checkpoint\.zip, .* --force"
    ):
        train("ppo", "axis", steps=1, out=untrained_agent, log=ignore)
    assert (untrained_agent / "policy.safetensors").read_bytes() == before
    train("ppo", "axis", steps=1, out=untrained_agent, log=ignore, force=True)
    assert Agent.load(untrained_agent).machine.name == "axis"


def test_several_seeds_replace_no_run_without_force(untrained_agent):
    folder = untrained_agent.rename(untrained_agent.parent / "seed_0").parent
    command = re.escape(f"`hframe train ppo --seed 0 --resume --out {folder / 'seed_0'}`")
    with pytest.raises(
        InputError, match=rf"seed_0: holds the agent ppo.* continue the run alone with {command}"
    ):
        train_seeds("ppo", steps=1, seeds=(0, 1), out=folder, log=ignore)
    assert not (folder / "seed_1").exists()


@pytest.mark.parametrize(
    "hindrance", ["no checkpoint", "another seed", "another recipe", "another machine", "a damaged card"]
)
def test_a_run_that_cannot_be_resumed_is_refused_without_that_advice(hindrance, untrained_agent):
    if hindrance == "no checkpoint":  # the folder holds an agent that was copied
        (untrained_agent / "checkpoint.zip").unlink()
    if hindrance == "a damaged card":
        (untrained_agent / "card.json").write_text("{}")
    algorithm = "sac" if hindrance == "another recipe" else "ppo"
    seed = 1 if hindrance == "another seed" else 0
    machine = "axis" if hindrance == "another machine" else "hframe"
    with pytest.raises(InputError) as error:
        train(algorithm, machine, steps=1, seed=seed, out=untrained_agent, log=ignore)
    assert str(error.value).endswith(
        "training would replace; choose another folder, or replace it with --force"
    )


def test_a_recipe_that_continues_an_agent_of_two_axes_refuses_one_axis(tmp_path):
    message = (
        "recipe adapt_reach: .* ppo-seed0, which was trained on a machine with 2 axes.* has 1 axis.*train ppo"
    )
    with pytest.raises(InputError, match=message):
        train("adapt", "axis", steps=1, out=tmp_path, log=ignore)
    assert not list(tmp_path.rglob("*.json"))


@pytest.mark.parametrize("algorithm", ["apg", "apg_mix", "apg_plan", "sac"])
@pytest.mark.parametrize("run", [train, partial(train_seeds, seeds=(0, 1))], ids=["one seed", "two seeds"])
def test_a_recipe_whose_transfers_a_short_axis_lacks_is_refused_before_training(algorithm, run, tmp_path):
    axis = BUILTIN_MACHINES["axis"]()
    short = axis.replace(coordinates=(replace(axis.coordinates[0], range=(0.0, 0.125)),))
    with pytest.raises(InputError) as error:
        run(algorithm, short, out=tmp_path, log=ignore)
    assert str(error.value) == (
        f"recipe {algorithm}_reach: needs motions that last up to 27 control periods longer "
        "than the shortest one, but the longest in the workspace of machine 'axis' last 19 periods longer; "
        "choose a recipe without them: apg_predictive, ppo, residual, sac_her"
    )
    assert not list(tmp_path.rglob("*.json"))


@pytest.mark.parametrize("algorithm", ["apg_predictive", "ppo", "residual", "sac_her"])
def test_the_recipes_that_this_message_names_train_on_one_axis(algorithm, tmp_path):
    card = train(replace(small(algorithm), steps=1), "axis", out=tmp_path, log=ignore)
    assert card["machine"] == "axis"
    assert Agent.load(tmp_path).machine.name == "axis"


def test_a_misspelled_keyword_of_the_algorithm_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"recipe ppo_reach, tables algorithm and policy: .*'usesde'"):
        train(small("ppo", usesde=True), steps=1, out=tmp_path, log=ignore)


def test_an_unknown_task_is_refused(tmp_path):
    with pytest.raises(InputError, match="task 'juggle' is unknown"):
        train("ppo", task="juggle", out=tmp_path)


@dataclass(frozen=True)
class UserTask(Reach):
    """A task of the user that shows future goals."""

    shown: int = 0

    @property
    def ahead_s(self):
        """Times of the future goals, s."""
        return tuple(0.01 * (i + 1) for i in range(self.shown))


@pytest.fixture
def user_task():
    """Register a task without recipes and return its name."""
    TASKS.register("user-task")(UserTask)
    yield "user-task"
    TASKS.unregister("user-task")


@pytest.mark.parametrize("algorithm", ["ppo", "apg", "adapt"])
def test_a_task_without_recipes_is_trained_by_those_of_the_same_metrics(algorithm, tmp_path, user_task):
    recipe = replace(load_recipe(algorithm, user_task), steps=1)
    card = train(recipe, task=user_task, out=tmp_path, log=ignore)
    assert (card["name"], card["task"], card["recipe"]) == (algorithm, user_task, f"{algorithm}_reach")
    evaluate(str(tmp_path), task=user_task, episodes=2)


def test_runs_of_two_tasks_are_not_mixed(untrained_agent, user_task):
    with pytest.raises(
        InputError, match="a run of ppo_reach on reach with seed 0, not of ppo_reach on user-task"
    ):
        train("ppo", task=user_task, steps=10, out=untrained_agent, resume=True)
    with pytest.raises(InputError, match="would replace; choose another folder, or replace it with --force"):
        train("ppo", task=user_task, steps=1, out=untrained_agent, log=ignore)


def test_recipes_that_do_not_fit_a_task_of_the_user_are_refused(tmp_path, user_task):
    shows = {"shown": 3}
    recipe = replace(load_recipe("apg", "track"), task=shows)
    with pytest.raises(
        InputError, match=r"uses 10 future goals, but the task user-task shows 3 .*: ppo, residual"
    ):
        train(recipe, task=user_task, out=tmp_path, log=ignore)
    with pytest.raises(
        InputError, match=r"uses 10 future goals, but the task user-task shows 3 .*: ppo, residual"
    ):
        train_seeds(recipe, task=user_task, out=tmp_path, log=ignore, jobs=2)
    with pytest.raises(
        InputError, match=r"recipe adapt_reach: .* with 0 future goals, but the task user-task shows 3"
    ):
        train(replace(load_recipe("adapt", user_task), task=shows), task=user_task, out=tmp_path, log=ignore)
    with pytest.raises(InputError, match=r"recipe ppo_track, table task: .*keyword argument 'path'"):
        train(load_recipe("ppo", "track"), task=user_task, out=tmp_path, log=ignore)


@pytest.mark.parametrize("algorithm", ["ppo", "sac"])
def test_exploration_that_depends_on_the_state_trains_and_loads(tmp_path, algorithm):
    """The policy then holds samples that depend on its weights, which made a copy of it impossible."""
    recipe = load_recipe(algorithm, "reach")
    small = {"num_envs": 8, "max_episode_steps": 20}
    of_kind = {"ppo": {"batch_size": 256}, "sac": {"learning_starts": 64, "gradient_steps": 1}}
    keywords = {**recipe.algorithm, **of_kind[algorithm], "use_sde": True}
    card = train(
        replace(recipe, env=recipe.env | small, algorithm=keywords), steps=600, out=tmp_path, log=ignore
    )
    kept = next(row for row in card["curve"] if row["steps"] == card["kept"])
    scenario = Scenario(randomize="default", episodes=EPISODES, seed=1_000_000, duration_s=SHORT_S)
    assert score_agent(Agent.load(tmp_path), scenario).row.items() <= kept.items()
