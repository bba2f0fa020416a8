"""How precise are the programs of docs/with_your_library.md, after how many steps and what processor time?

    python -m benchmarks.library_programs ["CleanRL style" ...] [--steps 25000 50000 ...] [--seeds 0 1]
                                          [--repeat]

It executes the page's own code: the first program of each section, in a process of its own, with other values
of its constant STEPS. Every number of steps is a training from the start, so the curve shows what a program
of that length reaches. Its policy then drives 256 episodes without noise; the error is the distance to the
goal at their end. Programs whose library is not installed are left out. Runs that
results/library_programs.json holds are not repeated; the results are written, and
docs/figures/library_programs.png is drawn, after each run.
"""

from __future__ import annotations

import argparse
import ast
import importlib.util
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.results_file import save_figure, write_results
from hframe_gym.envs import EnvConfig, HFrameVectorEnv
from hframe_gym.evaluation import installed_versions
from tools.code_blocks import read_blocks
from tools.command_line import command_line
from tools.repository import FIGURES, RESULTS, ROOT

NAME, PAGE = "library_programs", ROOT / "docs" / "with_your_library.md"
EPISODES, EPISODE_S = 256, 1.5
EVALUATION_SEED = 1_000_000
BANDS_MM = (1.0, 0.2)
STEPS = (15_000, 50_000, 150_000)
TICKS_S, TICKS_MM = (2, 5, 10, 20, 50), (0.1, 0.2, 0.4, 1, 2, 4)  # of the figure
ACCEPTED_MM = 0.4  # median error that every program has to reach
Variables = dict[str, Any]  # of a program, by name
Policy = Callable[[Any], Any]  # batch of observations to actions without noise


class Program(NamedTuple):
    """Where a library's program is, and how to drive with what it leaves.

    Attributes:
        package: Distribution whose version the results state.
        module: Module that must be importable.
        policy: Function from the program's variables to its `Policy`.
        flat: Whether it observes one array instead of a dict.
    """

    package: str
    module: str
    policy: Callable[[Variables], Policy]
    flat: bool = True


def _of_stable_baselines3(variables: Variables) -> Policy:
    """Return the policy of the model `ppo`."""
    return lambda observation: variables["ppo"].predict(observation, deterministic=True)[0]


def _of_cleanrl(variables: Variables) -> Policy:
    """Return the mean of the network `actor`."""
    torch = variables["torch"]
    return lambda observation: variables["actor"](torch.as_tensor(observation)).numpy()


def _of_torchrl(variables: Variables) -> Policy:
    """Return the deterministic action of the module `policy`."""
    from tensordict import TensorDict
    from torchrl.envs.utils import ExplorationType, set_exploration_type

    torch = variables["torch"]

    def policy(observation: Any) -> Any:
        batch = TensorDict({"observation": torch.as_tensor(observation)}, batch_size=len(observation))
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            return variables["policy"](batch)["action"].numpy()

    return policy


def _of_tianshou(variables: Variables) -> Policy:
    """Return the mean action of the object `policy`, which is evaluated as deterministic."""
    from tianshou.data import Batch

    policy = variables["policy"].eval()
    return lambda observation: policy.map_action(policy(Batch(obs=observation, info={})).act.numpy())


def _of_skrl(variables: Variables) -> Policy:
    """Return the mean action of the runner's agent."""
    torch, agent = variables["torch"], variables["runner"].agent
    agent.enable_models_training_mode(False)

    def policy(observation: Any) -> Any:
        inputs = {"observations": torch.as_tensor(observation, device=agent.device)}
        _, outputs = agent.policy.act(inputs, role="policy")
        return outputs["mean_actions"].cpu().numpy()

    return policy


PROGRAMS = {
    "Stable-Baselines3": Program("stable-baselines3", "stable_baselines3", _of_stable_baselines3, flat=False),
    "CleanRL style": Program("torch", "torch", _of_cleanrl),
    "TorchRL": Program("torchrl", "torchrl", _of_torchrl),
    "Tianshou": Program("tianshou", "tianshou", _of_tianshou),
    "skrl": Program("skrl", "skrl", _of_skrl),
}


def code_of(section: str, page: str) -> ast.Module:
    """Return the first Python program of a section of the page.

    Args:
        page: Page in Markdown.

    Raises:
        LookupError: If the page has no such section, or the section no Python block.
    """
    _, heading, rest = page.partition(f"\n## {section}\n")
    text = re.split(r"^## ", rest, maxsplit=1, flags=re.MULTILINE)[0]
    blocks = [block for block in read_blocks(text) if block.language == "python"]
    if not heading or not blocks:
        raise LookupError(f"{PAGE.name} has no Python program in a section {section!r}")
    return ast.parse(blocks[0].code)


def with_steps(program: ast.Module, steps: int) -> ast.Module:
    """Return a program with another value of its constant STEPS.

    Raises:
        LookupError: If it does not assign STEPS a number, alone or first in a tuple.
    """
    for statement in program.body:
        if isinstance(statement, ast.Assign):
            target, value = statement.targets[0], statement.value
            if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
                target, value = target.elts[0], value.elts[0]
            if isinstance(target, ast.Name) and target.id == "STEPS" and isinstance(value, ast.Constant):
                value.value = steps
                return program
    raise LookupError("the program does not assign STEPS a number")


def split_imports(program: ast.Module) -> tuple[ast.Module, ast.Module]:
    """Split a program into its imports, which processor times exclude, and the rest."""
    imports = [s for s in program.body if isinstance(s, ast.Import | ast.ImportFrom)]
    rest = [s for s in program.body if not isinstance(s, ast.Import | ast.ImportFrom)]
    return ast.Module(imports, []), ast.Module(rest, [])


def final_distance_mm(policy: Policy, flat: bool) -> NDArray[np.float64]:
    """Return the distances to the goal at the end of the evaluation episodes, mm, shape (EPISODES,)."""
    envs = HFrameVectorEnv(EPISODES, max_episode_steps=None, normalize=True, error=True, flat=flat)
    observation, info = envs.reset(seed=EVALUATION_SEED)
    for _ in range(round(EPISODE_S / EnvConfig.period)):
        observation, _, _, _, info = envs.step(np.asarray(policy(observation), np.float64))
    return 1e3 * np.asarray(info["distance_m"])


def run(section: str, steps: int, seed: int) -> dict[str, Any]:
    """Train by a program in this process and score its policy.

    Args:
        steps: Environment steps of the training.
        seed: Seed of PyTorch and NumPy, from which programs draw that name none.
    """
    import torch

    program = PROGRAMS[section]
    imports, training = split_imports(with_steps(code_of(section, PAGE.read_text("utf-8")), steps))
    variables: Variables = {"__name__": "__main__"}
    exec(compile(imports, PAGE, "exec"), variables)
    HFrameVectorEnv(1, normalize=True, error=True).reset(seed=0)  # loads the compiled simulator
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    np.random.seed(seed)  # noqa: NPY002 (libraries draw from it)
    began = time.process_time()
    exec(compile(training, PAGE, "exec"), variables)
    cpu_s = time.process_time() - began
    with torch.no_grad():
        distance = final_distance_mm(program.policy(variables), program.flat)
    within = {f"within_{band:g}mm": float(np.mean(distance <= band)) for band in BANDS_MM}
    return {
        "steps": steps,
        "seed": seed,
        "cpu_s": round(cpu_s, 1),
        "median_mm": float(np.median(distance)),
        **within,
    }


def run_apart(section: str, steps: int, seed: int) -> dict[str, Any]:
    """Do what `run` does in a process of its own, in an empty folder, with one thread per library.

    Raises:
        subprocess.CalledProcessError: If the program fails; its messages are on the terminal.
    """
    paths = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
    settings = {"PYTHONPATH": paths, "OMP_NUM_THREADS": "1", "CUDA_VISIBLE_DEVICES": ""}
    command = [sys.executable, "-m", "benchmarks.library_programs", section]
    with tempfile.TemporaryDirectory() as folder:
        row = Path(folder) / "row.json"
        options = ["--steps", str(steps), "--seeds", str(seed), "--row", str(row)]
        subprocess.run(
            [*command, *options], cwd=folder, env=os.environ | settings, check=True, stdout=subprocess.DEVNULL
        )
        return dict(json.loads(row.read_text("utf-8")))


def draw(programs: dict[str, Any]) -> None:
    """Draw the median error, mm, against the processor time, s: median over the seeds, and runs as points."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axis = plt.subplots(figsize=(7.2, 3.6), layout="constrained")
    for section, result in programs.items():
        by_steps: dict[int, list[dict[str, Any]]] = {}
        for row in result["runs"]:
            by_steps.setdefault(row["steps"], []).append(row)
        cpu_s, medians = (
            [np.median([row[key] for row in by_steps[steps]]) for steps in sorted(by_steps)]
            for key in ("cpu_s", "median_mm")
        )
        (line,) = axis.loglog(cpu_s, medians, label=section)
        axis.plot(
            [row["cpu_s"] for row in result["runs"]],
            [row["median_mm"] for row in result["runs"]],
            "o",
            ms=3,
            alpha=0.5,
            color=line.get_color(),
        )
    axis.plot([], [], "o", ms=3, alpha=0.5, color="gray", label="single runs")
    axis.axhline(ACCEPTED_MM, color="gray", lw=0.8, ls="--", label=f"{ACCEPTED_MM:g} mm")
    for set_ticks, ticks in ((axis.set_xticks, TICKS_S), (axis.set_yticks, TICKS_MM)):
        set_ticks(ticks, [f"{tick:g}" for tick in ticks])
    axis.minorticks_off()
    axis.set_xlabel("processor time of one core, s")
    axis.set_ylabel("median distance to the goal, mm")
    figure.legend(loc="outside right upper", edgecolor="none")  # beside the axis: curves fill all of it
    save_figure(figure, FIGURES / f"{NAME}.png")


def main() -> None:
    """Run the programs whose libraries are installed, and write the results after each run."""
    parser = command_line(__doc__)
    parser.add_argument("sections", nargs="*", default=list(PROGRAMS), help="sections of the page")
    parser.add_argument("--steps", type=int, nargs="+", default=list(STEPS))
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--repeat", action="store_true", help="repeat runs that the results hold")
    parser.add_argument("--row", type=Path, help=argparse.SUPPRESS)  # of one run, in its own process
    arguments = parser.parse_args()
    if arguments.row:
        (section,), (steps,), (seed,) = arguments.sections, arguments.steps, arguments.seeds
        arguments.row.write_text(json.dumps(run(section, steps, seed)), "utf-8")
        return
    file = RESULTS / f"{NAME}.json"
    programs: dict[str, Any] = json.loads(file.read_text("utf-8"))["programs"] if file.exists() else {}
    for section in arguments.sections:
        program = PROGRAMS[section]
        if importlib.util.find_spec(program.module) is None:
            print(f"{section}: {program.package} is not installed", flush=True)
            continue
        for steps in arguments.steps:
            for seed in arguments.seeds:
                version = installed_versions((program.package,))[program.package]
                held = programs.get(section, {"runs": []})["runs"]
                others = [row for row in held if (row["steps"], row["seed"]) != (steps, seed)]
                if len(others) < len(held) and not arguments.repeat:
                    continue
                row = run_apart(section, steps, seed)
                print(section, json.dumps(row), flush=True)
                runs = sorted([*others, row], key=lambda r: (r["steps"], r["seed"]))
                programs[section] = {"package": program.package, "version": version, "runs": runs}
                write_results(NAME, {"episodes": EPISODES, "programs": programs}, seed=EVALUATION_SEED)
                draw(programs)


if __name__ == "__main__":
    main()
