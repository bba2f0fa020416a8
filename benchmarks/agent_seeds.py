"""How much does an agent depend on the seed of its training? Scores and learning curves of ten trainings.

    python -m benchmarks.agent_seeds ppo_mix [sac ...] [--seeds 0 1 2 ...] [--jobs 1] [--out out/agents/reach]

It trains on the task `reach` from random weights and scores each agent on the 512 episodes of the protocol
reach-v1, which no choice was based on (`benchmarks.agents.TRIAL`). Agents that the package ships were trained
by the same command, and are not trained again. A run that was interrupted goes on with the next call. Entries
of gap-v1 use the agents that were trained (`agent_folder`). Results are added to results/agent_seeds.json,
which keeps recipes that are not run again; docs/figures/agent_seeds.png shows the learning curves, measured
on 256 other episodes.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from benchmarks.agents import SHIPPED, TRIAL, criterion, drive, ratio, scenario, scores
from benchmarks.results_file import save_figure, write_results
from hframe_gym.agents import Agent, Recipe, load_recipe, shipped_agent_folder, train
from hframe_gym.agents.agent_files import read_training_card
from hframe_gym.errors import InputError
from hframe_gym.evaluation import stored_bounds
from hframe_gym.parallel import map_tasks
from tools.command_line import command_line
from tools.repository import FIGURES, RESULTS, ROOT

NAME, TASK = "agent_seeds", "reach"
COLORS = ("#1b6ca8", "#c4513d", "#3b7d4f", "#8a5fa8")
CURVES = {"settling_s_0.2mm": "mean time until 0.2 mm, s", "success_0.05mm": "within 0.05 mm, %"}
TRAINED = ROOT / "out" / "agents"  # agents of seeds that the package does not ship: TASK/NAME-seedN
SLOWEST_S = 0.5  # s, upper end of the axis: untrained agents need the length of an episode


def trained(run: tuple[Recipe, int, Path]) -> Path:
    """Return the folder of a recipe and seed's complete agent; train it, or go on, where there is none."""
    recipe, seed, folder = run
    shipped = SHIPPED / TASK / f"{recipe.name.removesuffix(f'_{TASK}')}-seed{seed}"
    for there in (shipped, folder):
        if complete(there, recipe):
            return there
    train(recipe, task=TASK, seed=seed, out=folder, resume=began(folder, recipe), log=lambda line: None)
    return folder


def began(folder: Path, recipe: Recipe) -> bool:
    """Return whether a folder holds a run with the present settings of a recipe, complete or not."""
    file = folder / "card.json"
    settings = json.loads(json.dumps(recipe.as_dict()))  # as they are in a card
    return file.is_file() and bool(read_training_card(file)["settings"] == settings)


def complete(folder: Path, recipe: Recipe) -> bool:
    """Return whether a folder holds a complete run with the present settings of a recipe."""
    if not began(folder, recipe):
        return False
    return bool(read_training_card(folder / "card.json")["curve"][-1]["steps"] >= recipe.steps)


def agent_folder(name: str, task: str) -> Path:
    """Find the folder of an agent: the one that the package ships, or one of another seed in out/agents.

    Args:
        name: Name of the agent with the seed of its training, for example "ppo_mix-seed4".
        task: Name of the task, "reach" or "track".

    Raises:
        InputError: If there is no such agent; the message says how to train it.
    """
    if (SHIPPED / task / name).is_dir():
        return shipped_agent_folder(name, task)
    recipe, _, seed = name.rpartition("-seed")
    folder = TRAINED / task / name
    if not complete(folder, load_recipe(recipe, task)):
        place = folder.relative_to(ROOT) if folder.is_relative_to(ROOT) else folder
        raise InputError(
            f"no agent {name!r} of the task {task}: the package ships none of this seed, and {place} holds "
            f"no complete one; train it: hframe train {recipe} --task {task} --seed {seed} --out {place}"
        )
    return folder


def summary(folders: Sequence[Path], seeds: Sequence[int]) -> dict[str, Any]:
    """Score the agents of a recipe.

    Returns:
        `over_bound`: ratio of the mean settling time to the mean bound, over all seeds and `by_seed`, with
        intervals over episodes (and seeds). `agents`: cost, scores and learning curve of each.
    """
    bounds = stored_bounds(scenario(TASK)).times_s
    assert bounds is not None
    times, agents = [], []
    for folder, seed in zip(folders, seeds, strict=True):
        run = drive(Agent.load(folder), TASK)[TASK]
        card = read_training_card(folder / "card.json")
        last = card["curve"][-1]
        scored = scores(TASK, run)
        times.append(criterion(run))
        agents.append(
            {
                "seed": seed,
                **{key: last[key] for key in ("steps", "cpu_s")},
                "kept": card["kept"],
                "versions": card["versions"],
                **{key: scored[key] for key in ("success", "settling_s")},
                "curve": card["curve"],
            }
        )
    over_bound = {**ratio(np.stack(times), bounds), "by_seed": [ratio(t[None], bounds) for t in times]}
    return {"over_bound": over_bound, "agents": agents}


def draw(recipes: dict[str, Any]) -> None:
    """Draw the learning curves of all recipes: median over the seeds, and the range from best to worst."""
    figure, axes = plt.subplots(1, len(CURVES), figsize=(9, 3.2), layout="constrained")
    for (name, result), color in zip(recipes.items(), COLORS, strict=False):
        curves = [agent["curve"] for agent in result["agents"]]
        cpu_s = np.median([[row["cpu_s"] for row in curve] for curve in curves], axis=0)
        for axis, (score, title) in zip(axes, CURVES.items(), strict=True):
            factor = 100.0 if title.endswith("%") else 1.0
            values = factor * np.array([[row[score] for row in curve] for curve in curves])
            axis.plot(cpu_s, np.median(values, axis=0), color=color, label=f"{name}, seeds: {len(curves)}")
            axis.fill_between(cpu_s, values.min(axis=0), values.max(axis=0), color=color, alpha=0.2, lw=0)
            axis.set_xlabel("processor time, s (median over the seeds)")
            axis.set_ylabel(title)
    axes[0].set_ylim(0.25, SLOWEST_S)
    axes[1].set_ylim(0.0, 101.0)
    axes[1].legend(frameon=False, loc="lower right")
    save_figure(figure, FIGURES / f"{NAME}.png")


def main() -> None:
    """Train and score the recipes, and write the results after each."""
    parser = command_line(__doc__)
    parser.add_argument("recipes", nargs="+", help="names of recipes without the task, for example ppo_mix")
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(10)))
    parser.add_argument("--jobs", type=int, default=1, help="number of parallel processes")
    parser.add_argument("--out", type=Path, default=TRAINED / TASK, help="folder of the agents")
    arguments = parser.parse_args()
    file = RESULTS / f"{NAME}.json"
    results = json.loads(file.read_text("utf-8"))["recipes"] if file.exists() else {}
    for name in arguments.recipes:
        recipe = load_recipe(name, TASK)
        runs = [(recipe, seed, arguments.out / f"{name}-seed{seed}") for seed in arguments.seeds]
        results[name] = summary(list(map_tasks(trained, runs, jobs=arguments.jobs)), arguments.seeds)
        print(name, json.dumps(results[name]["over_bound"]), flush=True)
        write_results(NAME, {**TRIAL, "recipes": results}, seed=TRIAL["seed"])
    draw(results)


if __name__ == "__main__":
    main()
