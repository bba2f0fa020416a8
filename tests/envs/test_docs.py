"""The examples in docs/environment.md run."""

import re
from itertools import takewhile
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from hframe_gym.envs import HFrameEnv, Sensors
from hframe_gym.machine import Belt, Coordinate, Drive, Machine, Sensor

PAGE = Path(__file__).parents[2] / "docs" / "environment.md"


def test_examples_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # videos of an earlier run would be overwritten, with a warning
    namespace = {}
    examples = re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    assert len(examples) == 14
    for example in examples:
        exec(example.replace("4096", "4"), namespace)
    assert namespace["critic_input"].shape == (len(namespace["env"].unwrapped.privileged_entries),)
    assert 2.5e-6 <= namespace["noise"] <= 1e-5
    _, info = namespace["hop"].reset(seed=0)
    assert info["parameters"]["task.distance"] in (0.025, 0.1)
    fast, fast_envs = namespace["fast"], namespace["fast_envs"]
    assert steps_of(fast) == fast_envs.max_episode_steps == 750
    assert steps_of(gym.make("HFrame-v0", period=0.002)) == 150


def steps_of(env):
    """Return the number of steps until an episode is truncated."""
    env.reset(seed=0)
    steps, truncated = 0, False
    while not truncated:
        *_, truncated, _ = env.step(np.zeros(2, np.float32))
        steps += 1
    return steps


def table(heading):
    """Return the cells of the rows of a table of the page, without its heading and rule."""
    lines = PAGE.read_text("utf-8").partition(f"| {heading} |")[2].splitlines()[2:]
    return [
        [cell.strip() for cell in line.strip("|").split(" | ")]
        for line in takewhile(lambda line: line[:1] == "|", lines)
    ]


@pytest.mark.parametrize("reward", ["dense", "progress"])
@pytest.mark.parametrize("task", ["reach", "track"])
@pytest.mark.parametrize("randomize", ["none", "default"])
def test_the_table_of_info_lists_its_keys(reward, task, randomize):
    conditions = {
        "always": True,
        'tasks with a path (`metrics = "track"`)': task == "track",
        "with `randomize`": randomize != "none",
        "only with the reward `progress`, the default with `normalize=True`": reward == "progress",
        "only with the reward `progress` and a goal that moves": reward == "progress" and task == "track",
    }
    documented = {
        key.strip("`") for key, _, when in table("key of `info` | value | present") if conditions[when]
    }
    env = HFrameEnv(task=task, reward=reward, randomize=randomize)
    _, info = env.reset(seed=0)
    assert set(info) == documented
    assert set(env.step(np.zeros(2, np.float32))[4]) == documented


BELT = Machine(
    name="belt-axis",
    coordinates=(
        Coordinate("x", mass=2.0, viscous=8.0, coulomb=3.0, range=(-0.2, 0.2)),
        Coordinate("phi", mass=2e-4, viscous=1e-3, coulomb=0.01, kind="rotary", radius=0.012),
    ),
    belts=(Belt("belt", 2e4, 0.5, {"x": 1.0, "phi": -1.0}),),
    drives=(
        Drive("motor", "u_V", "phi", Kt=0.08, Ke=0.08, resistance=1.0, gear_ratio=2.0, rated_voltage=24.0),
    ),
    sensors=(Sensor("phi_rad", {"phi": 1.0}, resolution=1e-3, kind="encoder"),),
)


@pytest.mark.parametrize(
    ("machine", "sensors", "names"),
    [
        ("axis", "state", ["x", "x velocity"]),
        ("axis", "machine", ["x", "x velocity"]),
        ("axis", Sensors(encoders=None), ["x", "x velocity"]),
        ("axis", Sensors(lasers=None), ["x", "x velocity"]),
        (BELT, "state", ["x", "phi", "x velocity", "phi velocity"]),
        (BELT, "rig", ["x", "phi", "x velocity", "phi velocity"]),
        (BELT, "machine", ["phi", "phi velocity"]),
    ],
)
def test_the_observation_of_one_axis_is_that_of_the_table(machine, sensors, names):
    rows = {
        row[0]
        for row in table(
            "key | a drive that acts on the axis itself, such as the preset `axis` | a carriage "
            "on a belt with a motor pulley"
        )
    }
    env = HFrameEnv(machine=machine, sensors=sensors, privileged=True, randomize="default")
    assert [entry.name for entry in env.entries] == names
    assert set(env.observation_space) == {row.partition("`")[2].partition("`")[0] for row in rows}
    assert {space.shape for key, space in env.observation_space.items() if key.endswith("goal")} == {(1,)}
    assert env.action_space.shape == (1,)
    state = ["x", "x velocity"] if machine == "axis" else ["x", "phi", "x velocity", "phi velocity"]
    assert [entry.name for entry in env.privileged_entries][: len(state)] == state
