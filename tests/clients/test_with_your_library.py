"""Run the blocks of docs/with_your_library.md with installed libraries, and provoke its error messages.

Each section is one program in a process of its own: its Python blocks with a small number of steps, then the
checks below. `pip install '.[clients]'` installs all libraries but RLlib, which needs an environment of its
own.
"""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "with_your_library.md").read_text("utf-8")
SECTIONS = dict(re.findall(r"^## ([^\n]+)\n(.*?)(?=^## |\Z)", PAGE, re.MULTILINE | re.DOTALL))
REFUSALS = "What does not work"
TIMEOUT_S = 600

IN_ACTION_SPACE = """
import numpy as np
def check(action, low=-1.0, high=1.0):
    action = np.asarray(action)
    assert action.shape[-1] == 2 and np.isfinite(action).all(), action
    assert (low <= action).all() and (action <= high).all(), action
"""


class Client(NamedTuple):
    """How to run a section.

    Attributes:
        modules: Modules that the section needs, with the name of the package that provides each.
        steps: Value of the constant STEPS.
        checks: Python code that runs after the blocks of the section.
    """

    modules: dict[str, str]
    steps: int = 0
    checks: str = ""


TORCH = {"torch": "torch"}
SB3 = {"stable_baselines3": "stable-baselines3"}
CLIENTS = {
    "Gymnasium": Client(
        {},
        checks="""
assert observation.shape == (4, 12)
native.reset(seed=0), wrapped.reset(seed=0)
for _ in range(151):
    native_step = native.step(native.action_space.sample())
    wrapped_step = wrapped.step(wrapped.action_space.sample())
assert native_step[0]["observation"].shape == (64, 8)
""",
    ),
    "Stable-Baselines3": Client(
        SB3,
        15_360,
        IN_ACTION_SPACE
        + """
assert ppo.num_timesteps >= STEPS and sac.num_timesteps == STEPS
observation = env.reset()
check(PPO.load("ppo", device="cpu").predict(observation)[0]), check(sac.predict(sparse.reset())[0])
relabeled = sac.replay_buffer.sample(64).rewards.numpy()
assert set(np.unique(relabeled)) <= {-1.0, 0.0} and (relabeled == 0.0).any(), "no goal was relabeled"
""",
    ),
    "SB3-Contrib": Client(
        {"sb3_contrib": "sb3-contrib"},
        300,
        IN_ACTION_SPACE
        + """
assert min(model.num_timesteps for model in (tqc, recurrent, crossq)) >= STEPS
observation = gym.make("HFrame-v0", normalize=True).reset(seed=0)[0]
check(tqc.predict(observation)[0])
check(crossq.predict(np.concatenate([observation[key] for key in sorted(observation)]))[0])
check(recurrent.predict(rig.reset())[0])
""",
    ),
    "RL Baselines3 Zoo": Client(
        {"rl_zoo3": "rl_zoo3", "requests": "requests", "moviepy": "moviepy"},
        4096,
        """
from pathlib import Path
assert Path("logs/ppo/HFrame-v0_1/HFrame-v0.zip").is_file()
assert list(Path("logs").rglob("*.mp4"))
""",
    ),
    "TorchRL": Client(
        {"torchrl": "torchrl"},
        8192,
        IN_ACTION_SPACE
        + """
from torchrl.envs import check_env_specs
assert all(torch.isfinite(p).all() for p in loss.parameters())
rollout = env.rollout(200, policy, break_when_any_done=False)  # past the end of the episodes
check(rollout["action"].detach().numpy())
assert rollout["next", "done"].sum() == 32
check_env_specs(env)
""",
    ),
    "Tianshou": Client(
        {"tianshou": "tianshou"},
        4096,
        IN_ACTION_SPACE
        + """
from tianshou.data import Batch
assert result.timing.total_time > 0.0 and np.isfinite(result.best_reward)
check(policy.map_action(policy(Batch(obs=np.stack([env.reset(seed=0)[0]]), info={})).act.detach().numpy()))
""",
    ),
    "skrl": Client(
        {"skrl": "skrl"},
        8192,
        """
import torch
assert all(torch.isfinite(p).all() for p in runner.agent.policy.parameters())
""",
    ),
    "CleanRL style": Client(
        TORCH,
        12288,
        """
assert all(torch.isfinite(p).all() for p in parameters)
assert len(distances_m) == 2, "two ends of all episodes in 384 steps"
""",
    ),
    "RLlib": Client(
        {"ray": "ray[rllib]"},
        4096,
        """
assert results["num_env_steps_sampled_lifetime"] >= STEPS
assert abs(results["env_runners"]["episode_return_mean"]) < 10.0, "ln of distance at start / at the end"
""",
    ),
    "Minari data sets": Client(
        {"minari": "minari", "h5py": "h5py", **SB3}, 2, "assert len(rewards) == 150\n"
    ),
}


class Refusal(NamedTuple):
    """A call that the page says does not work.

    Attributes:
        section: Section of the library.
        code: Python program that raises the error.
    """

    section: str
    code: str


IMPORT = "import gymnasium as gym, hframe_gym\n"
REFUSED = {
    "NormalizeObservation wrapper requires the observation space to have a shape": Refusal(
        "Gymnasium", "gym.wrappers.NormalizeObservation(gym.make('HFrame-v0'))"
    ),
    "Cannot use vector_entry_point vectorization mode with the wrappers argument": Refusal(
        "Gymnasium", "gym.make_vec('HFrame-v0', 2, wrappers=[gym.wrappers.TimeAwareObservation])"
    ),
    "Custom vector environment can be passed arguments only through kwargs": Refusal(
        "Gymnasium", "gym.make_vec('HFrame-v0', 2, vector_kwargs={'autoreset_mode': 'SameStep'})"
    ),
    "'TimeLimit' object has no attribute 'compute_reward'": Refusal(
        "Stable-Baselines3",
        "from stable_baselines3.common.env_checker import check_env\n"
        "check_env(gym.make('HFrame-v0').unwrapped); check_env(gym.make('HFrame-v0'))",
    ),
    "Policy MultiInputPolicy unknown": Refusal(
        "SB3-Contrib", "from sb3_contrib import CrossQ\nCrossQ('MultiInputPolicy', gym.make('HFrame-v0'))"
    ),
    "KeyError: 'HFrame-v0'": Refusal(
        "RL Baselines3 Zoo",
        "from rl_zoo3.exp_manager import ExperimentManager\n"
        "gym.registry.pop('HFrame-v0')  # record_video does not import hframe_gym\n"
        "ExperimentManager.is_atari('HFrame-v0')",
    ),
    "The auto-reset mode must be one of SAME_STEP or DISABLED": Refusal(
        "TorchRL", "from torchrl.envs import GymWrapper\nGymWrapper(gym.make_vec('HFrame-v0', 2))"
    ),
    "generator raised StopIteration": Refusal(
        "TorchRL",
        "from torchrl.envs import GymWrapper\n"
        "same_step = gym.vector.AutoresetMode.SAME_STEP\n"
        "def run(**keywords):\n"
        "    env = GymWrapper(gym.make_vec('HFrame-v0', 2, **keywords))\n"
        "    env.rollout(200, break_when_any_done=False)\n"
        "try:\n"
        "    run(vectorization_mode='sync', vector_kwargs={'autoreset_mode': same_step})\n"
        "except RuntimeError:  # Gymnasium's vector fails as well\n"
        "    run(autoreset_mode='SameStep')",
    ),
    "'Dict' object has no attribute 'n'": Refusal(
        "Tianshou",
        "from tianshou.highlevel.env import EnvFactoryRegistered, VectorEnvType\n"
        "EnvFactoryRegistered(task='HFrame-v0', venv_type=VectorEnvType.DUMMY).create_envs(1, 1)",
    ),
    "'dict' object has no attribute 'shape'": Refusal(
        "skrl",
        re.sub(
            r"HFrameFlat",
            "HFrame",
            "\n".join(re.findall(r"```python\n(.*?)```", SECTIONS["skrl"], re.DOTALL)),
        ),
    ),
    "No default encoder config for obs space=Dict(": Refusal(
        "RLlib",
        "from ray.rllib.algorithms.ppo import PPOConfig\n"
        "from ray.tune.registry import register_env\n"
        "register_env('hframe', lambda options: gym.make('HFrame-v0'))\n"
        "PPOConfig().environment('hframe').env_runners(num_env_runners=0).build_algo()",
    ),
}


def require(section: str) -> None:
    """Skip a test if a package of a section is not installed."""
    for module, package in CLIENTS[section].modules.items():
        if importlib.util.find_spec(module) is None:
            pytest.skip(f"{package} is not installed; docs/with_your_library.md says how")


def run(command: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a command in a folder, with this checkout of the package and one thread per library."""
    paths = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
    # RLlib's and SB3's processes would otherwise compete for the cores.
    settings = {"PYTHONPATH": paths, "OMP_NUM_THREADS": "1", "SDL_VIDEODRIVER": "dummy"}
    return subprocess.run(
        command,
        cwd=folder,
        env={**os.environ, **settings},
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )


def test_every_section_with_code_is_run() -> None:
    assert {title for title, text in SECTIONS.items() if "```" in text} == set(CLIENTS)


def test_every_error_of_the_page_is_provoked() -> None:
    rows = [row.split("|")[1:-1] for row in SECTIONS[REFUSALS].splitlines() if row.startswith("| ")][1:]
    stated = {error.strip().strip("`"): library.strip() for library, _, error, _ in rows}
    assert stated == {error: refusal.section for error, refusal in REFUSED.items()}


@pytest.mark.slow
@pytest.mark.parametrize("section", CLIENTS)
def test_section_runs(section: str, tmp_path: Path) -> None:
    require(section)
    client = CLIENTS[section]
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    commands = "\n".join(re.findall(r"```sh\n(.*?)```", SECTIONS[section], re.DOTALL))
    if commands:
        functions = (
            f'set -e\npython() {{ "{sys.executable}" "$@"; }}\nhframe() {{ python -m hframe_gym "$@"; }}\n'
        )
        short = re.sub(r"-n 150000\b", f"-n {client.steps}", commands)
        short = re.sub(r"--episodes \d+", f"--episodes {client.steps}", short)
        done = run(["bash", "-c", functions + short], tmp_path)
        assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    blocks = "\n".join(re.findall(r"```python\n(.*?)```", SECTIONS[section], re.DOTALL))
    if blocks or client.checks:
        short, replaced = re.subn(
            r"^(STEPS.*? = )[\d_]+", rf"\g<1>{client.steps}", blocks, flags=re.MULTILINE
        )
        assert replaced == ("STEPS" in blocks)
        program = tmp_path / "program.py"
        program.write_text(short + "\n" + client.checks)
        done = run([sys.executable, str(program)], tmp_path)
        if "The current node timed out during startup" in done.stderr:
            pytest.skip("Ray did not start within its fixed limit of 30 s: this machine is too busy")
        assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]


@pytest.mark.slow
@pytest.mark.parametrize("error", REFUSED)
def test_what_does_not_work_raises_the_stated_error(error: str, tmp_path: Path) -> None:
    section, code = REFUSED[error]
    require(section)
    done = run([sys.executable, "-c", IMPORT + code], tmp_path)
    assert done.returncode == 1, "it works now: correct docs/with_your_library.md"
    last = done.stderr.replace("`", "").strip().splitlines()[-40:]
    assert any(error in line for line in last), done.stderr[-3000:]
