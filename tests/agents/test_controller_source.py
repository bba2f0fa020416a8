"""Agents as controllers: shipped agents by name, agents by folder, and the warning on another machine."""

import shutil
import warnings

import pytest

from hframe_gym.agents import Agent, AgentSource, shipped_agent_folder, shipped_agent_names
from hframe_gym.envs import Reach
from hframe_gym.errors import InputError
from hframe_gym.evaluation import Scenario, get_protocol, make_controller, make_entry


@pytest.mark.parametrize(("name", "expected"), [("ppo", "ppo-seed0"), ("sac-seed2", "sac-seed2")])
@pytest.mark.parametrize("task", ["reach", "track"])
def test_shipped_agents_are_found_by_name_and_by_prefix(name, expected, task):
    folder = shipped_agent_folder(name, task)
    assert (folder.name, folder.parent.name) == (expected, task)


def test_names_of_the_shipped_agents():
    assert shipped_agent_names() == (
        "apg",
        "apg_mix",
        "apg_plan",
        "apg_predictive",
        "apg_wide",
        "ppo",
        "ppo_mix",
        "residual",
        "sac",
        "sac_mix",
    )


def test_unknown_shipped_agent_is_refused_with_a_list():
    with pytest.raises(
        InputError,
        match="no shipped agent 'pp' for the task reach; choose one of: apg-seed0, apg_mix-seed0, ",
    ):
        shipped_agent_folder("pp", "reach")


@pytest.mark.parametrize(
    ("name", "task", "message"),
    [
        (
            "apg_predictive",
            "reach",
            r"apg_predictive: was trained for the task track, not for reach; choose the task ",
        ),
        (
            "apg_plan-seed1",
            "track",
            r"for the task reach, not for track; .* a shipped agent of track \(apg, .*, sac\), or",
        ),
    ],
)
def test_an_agent_of_another_task_is_refused_with_the_task_of_its_training(name, task, message):
    with pytest.raises(InputError, match=message):
        make_controller(name, Scenario(task=task))
    with pytest.raises(InputError, match=message):
        shipped_agent_folder(name, task)
    with pytest.raises(InputError, match=message):
        make_entry(name, get_protocol(f"{task}-v1"), "reach" if task == "reach" else "square")


def test_agents_for_a_task_of_the_user():
    class Elsewhere(Reach):
        """A task for which no agent was shipped."""

    with pytest.raises(
        InputError, match="for the task reach and for track, not for elsewhere; choose the task reach"
    ):
        make_controller("ppo", Scenario(task=Elsewhere()))
    with pytest.raises(InputError, match=r"'pp' is unknown; .* \(none was shipped for the task elsewhere\)"):
        make_controller("pp", Scenario(task=Elsewhere()))


def test_agents_are_controllers_by_name_and_by_folder(tmp_path):
    copy = shutil.copytree(shipped_agent_folder("sac-seed1", "track"), tmp_path / "copy")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        by_name = make_controller("sac-seed1", Scenario(task="track"))
        by_folder = make_controller(str(copy), Scenario(task="track"))
    assert isinstance(by_name, Agent)
    assert by_name.card == by_folder.card
    assert by_name.card["task"] == "track"


@pytest.mark.parametrize(
    ("scenario", "text"),
    [
        (Scenario(machine="hframe-linear"), "trained on machine 'hframe', evaluated on 'hframe-linear'"),
        (Scenario(period=0.002), "trained with a control period of 0.01 s, evaluated at 0.002 s"),
    ],
)
def test_another_machine_or_period_than_in_training_gives_one_warning(scenario, text):
    with pytest.warns(UserWarning, match=text) as caught:
        make_controller("ppo", scenario)
    assert len(caught) == 1


def test_other_names_are_left_to_other_sources_and_listed(tmp_path):
    assert AgentSource.make("no-such-agent", Scenario()) is None
    choices = r"pid.*a shipped agent \(apg, apg_mix, .*, sac_mix, or one of them by NAME-seedN\)"
    with pytest.raises(InputError, match=f"controller 'out/no': there is no such folder; choose {choices}"):
        make_controller("out/no", Scenario())
    with pytest.raises(InputError, match=f"'no-such-agent' is unknown; choose {choices}"):
        make_controller("no-such-agent", Scenario())


def test_a_folder_without_an_agent_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"is not an agent: agent\.json is missing"):
        make_controller(str(tmp_path), Scenario())


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, r"is not an agent: agent\.json is missing"),
        ("[]", r"agent\.json: schema is None"),
        ('{"schema": 2}', r"agent\.json: entries are missing: name, task"),
        ("{", r"agent\.json: is not valid JSON"),
    ],
)
def test_files_of_a_damaged_agent_are_refused_with_its_file(tmp_path, content, message):
    folder = shutil.copytree(shipped_agent_folder("ppo", "reach"), tmp_path / "copy")
    (folder / "agent.json").unlink()
    if content is not None:
        (folder / "agent.json").write_text(content)
    with pytest.raises(InputError, match=message):
        AgentSource.files(str(folder), Scenario())


def test_files_state_the_sensors_of_the_training():
    files = AgentSource.files("ppo", Scenario())
    assert (files.name, files.sensors) == ("ppo-seed0", "state")
    assert {file.name for file in files.files} == {"agent.json", "machine.json", "policy.safetensors"}


def test_a_machine_of_another_number_of_axes_is_refused_with_the_machine_of_the_training(tmp_path):
    with pytest.raises(
        InputError, match=r"ppo: was trained on .* 2 axes.*'axis' has 1 axis.*--machine hframe\)"
    ):
        make_controller("ppo", Scenario(machine="axis"))
    with pytest.warns(UserWarning, match="evaluated on 'hframe-order20'"):  # observes the same coordinates
        make_controller("ppo", Scenario(machine="hframe-order20"))
    copy = shutil.copytree(shipped_agent_folder("ppo", "reach"), tmp_path / "copy")
    with pytest.raises(InputError, match=r"--machine \S+/copy/machine\.json\)"):
        make_controller(str(copy), Scenario(machine="axis"))
