"""How good are the shipped agents? Train them to agents/shipped/TASK/NAME-seedK, and score them.

    python -m benchmarks.agents train residual --task reach --seeds 0 1 2    # minutes per seed
    python -m benchmarks.agents score                                        # all shipped agents: agents.json
    python -m benchmarks.agents score --recipes apg                          # those of a recipe, others kept

A shipped agent is the result of `hframe train` with its recipe. Its card also lists scores and failures on
episodes that no training used. The recipes were chosen on other episodes (those of the learning curves) than
those of the scores.

`score` also compares each agent with the model-based PID on the same episodes, per seed and over all seeds of
a recipe: on `reach` the mean settling time over the mean physical bound, on `track` the mean contour error
over that of the PID, for each path. Intervals are 95 % bootstraps over pairs of the same episode; for a
recipe the bootstrap also resamples its seeds.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import bootstrap

from benchmarks.results_file import write_results
from hframe_gym.agents import Agent, train
from hframe_gym.agents.model_card import write_card
from hframe_gym.arrays import Array
from hframe_gym.controllers import CONTROLLERS, Controller
from hframe_gym.envs import TaskLike, Track
from hframe_gym.evaluation import (
    BANDS,
    BOOTSTRAP_RESAMPLES,
    BOUND_BAND,
    Episodes,
    Scenario,
    rollout,
    score_episodes,
    settling_times,
    stored_bounds,
)
from hframe_gym.machine import BUILTIN_MACHINES
from tools.command_line import command_line
from tools.repository import RESULTS, ROOT

SHIPPED = ROOT / "agents" / "shipped"
FILES = ("agent.json", "machine.json", "policy.safetensors", "card.json")
TRIAL: dict[str, Any] = {"episodes": 512, "seed": 1000}  # episodes that no choice was based on
TRIALS: dict[str, dict[str, TaskLike]] = {
    "reach": {"reach": "reach"},
    "track": {path: Track(path=path, size=0.05, speed=0.3) for path in ("circle", "square")},
}
LISTED = 10  # number of failed episodes that a card lists


def ship(name: str, task: str, seed: int) -> None:
    """Train one agent, copy it to agents/shipped completely, and score it."""
    with tempfile.TemporaryDirectory() as folder:
        train(name, task=task, seed=seed, out=folder)
        target = SHIPPED / task / f"{name}-seed{seed}"
        target.mkdir(parents=True, exist_ok=True)
        for file in FILES:
            shutil.copy(Path(folder) / file, target / file)
    write_scores(target, drive(Agent.load(target), task))


def drive(controller: Controller, task: str) -> dict[str, Episodes]:
    """Return the episodes of a controller by the name of the scenario, for all scenarios of a task."""
    return {name: rollout(controller, Scenario(task=which, **TRIAL)) for name, which in TRIALS[task].items()}


def write_scores(folder: Path, runs: Mapping[str, Episodes]) -> dict[str, Any]:
    """Write scores and failures to the card in an agent's folder, and return the card."""
    card: dict[str, Any] = json.loads((folder / "card.json").read_text("utf-8"))
    card["scores"] = {name: {**TRIAL, **scores(name, run)} for name, run in runs.items()}
    card["failures"] = {name: failures(run) for name, run in runs.items()}
    write_card(folder, card)
    return card


def scores(name: str, run: Episodes) -> dict[str, Any]:
    """Return the scores of episodes of the scenario of a name in `TRIALS`."""
    return score_episodes(run, stored_bounds(scenario(name)).times_s)


def scenario(name: str) -> Scenario:
    """Return the scenario of a name in `TRIALS`."""
    return Scenario(task=next(named[name] for named in TRIALS.values() if name in named), **TRIAL)


def failures(run: Episodes) -> dict[str, Any]:
    """Return, by band, the number of failed episodes and the environment seeds of the first ones."""
    error = run.goal_error
    failed_by_band = {}
    for name, band in BANDS.items():
        # A constant goal must be reached and kept; a path must never be left.
        failed = (
            ~settling_times(error, run.time_s, band)[1]
            if run.contour is None
            else run.contour.max(axis=1) > band
        )
        seeds = TRIAL["seed"] + np.flatnonzero(failed)
        failed_by_band[name] = {"episodes": len(seeds), "seeds": seeds[:LISTED].tolist()}
    return failed_by_band


def criterion(run: Episodes) -> Array:
    """Return the criterion of each episode: settling time, s, or rms contour error, m; shape (episodes,)."""
    if run.contour is not None:
        return np.asarray(np.sqrt(np.mean(run.contour**2, axis=1)))
    return settling_times(run.goal_error, run.time_s, BANDS[BOUND_BAND])[0]


def ratio(numerator: Array, denominator: Array) -> dict[str, Any]:
    """Return the ratio of two means with its 95 % bootstrap interval over episodes and seeds.

    Args:
        numerator: Criterion by seed and episode, shape (seeds, episodes).
        denominator: Criterion of the other by episode, shape (episodes,).

    Returns:
        The ratio ("mean") and its interval ("ci95").
    """
    seeds = np.arange(len(numerator))

    def resampled(episodes: Array, chosen: Array) -> Any:
        picked = episodes.astype(int)
        return numerator[np.ix_(chosen.astype(int), picked)].mean() / denominator[picked].mean()

    interval = bootstrap(
        (np.arange(len(denominator)), seeds if len(seeds) > 1 else np.zeros(2)),
        resampled,
        n_resamples=BOOTSTRAP_RESAMPLES,
        vectorized=False,
        method="percentile",
        rng=np.random.default_rng(TRIAL["seed"]),
    ).confidence_interval
    return {
        "mean": float(numerator.mean() / denominator.mean()),
        "ci95": [float(interval.low), float(interval.high)],
    }


def score(
    task: str, recipes: Sequence[str] | None = None, previous: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Score the controllers and shipped agents of a task; compare each recipe with the PID and the bound.

    Args:
        recipes: Names of recipes whose agents are scored; None for all, with the controllers.
        previous: Earlier result, from which the other rows are taken.

    Returns:
        Scores by agent (`agents`), and ratios by scenario and recipe (`compared`).
    """
    agents: dict[str, Any] = {
        name: row
        for name, row in (previous["agents"].items() if previous else ())
        if name.rpartition("-seed")[0] not in (recipes or ())  # also of agents that are no longer shipped
    }
    rows: dict[str, dict[str, list[Array]]] = {name: {} for name in TRIALS[task]}
    for kind in ("pid", "adaptive-pid") if recipes is None else ("pid",):
        runs = drive(CONTROLLERS.get(kind)(BUILTIN_MACHINES["hframe"](), 0.01), task)
        agents[kind] = {"scores": {name: scores(name, run) for name, run in runs.items()}}
        for name, run in runs.items():
            rows[name][kind] = [criterion(run)]
    for folder in sorted((SHIPPED / task).iterdir()):
        if recipes is not None and folder.name.rpartition("-seed")[0] not in recipes:
            continue
        runs = drive(Agent.load(folder), task)
        card = write_scores(folder, runs)
        last = card["curve"][-1]
        cost = {key: last[key] for key in ("steps", "seconds", "cpu_s")}
        agents[folder.name] = {"scores": card["scores"], "failures": card["failures"], "training": cost}
        for name, run in runs.items():
            rows[name].setdefault(card["name"], []).append(criterion(run))
        print(folder.name, {name: f"{criterion(run).mean():.4g}" for name, run in runs.items()}, flush=True)
    compared = {
        name: {
            **(previous["compared"][name] if previous else {}),
            **{
                recipe: compare(np.stack(values), by_recipe["pid"][0], stored_bounds(scenario(name)).times_s)
                for recipe, values in by_recipe.items()
            },
        }
        for name, by_recipe in rows.items()
    }
    ordered = sorted(agents, key=lambda name: (name not in CONTROLLERS, name == "adaptive-pid", name))
    return {"agents": {name: agents[name] for name in ordered}, "compared": compared}


def compare(values: Array, pid: Array, bound_s: Array | None) -> dict[str, Any]:
    """Return the ratios of a recipe's criterion to that of the PID and to the bound.

    Args:
        values: Criterion by seed and episode, shape (seeds, episodes).
        pid: Criterion of the PID, shape (episodes,).
        bound_s: Lower bound of the settling time, s, shape (episodes,), or None if there is none.

    Returns:
        The ratios over all seeds, and by seed.
    """
    others = {"over_pid": pid} | ({} if bound_s is None else {"over_bound": bound_s})
    return {
        name: {**ratio(values, other), "by_seed": [ratio(one[None], other) for one in values]}
        for name, other in others.items()
    }


def main() -> None:
    """Train or score agents."""
    parser = command_line(__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    training = commands.add_parser("train")
    training.add_argument("name")
    training.add_argument("--task", default="reach")
    training.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    scoring = commands.add_parser("score")
    scoring.add_argument(
        "--recipes", nargs="+", help="score the agents of these recipes only; keep the other results"
    )
    arguments = parser.parse_args()
    if arguments.command == "train":
        for seed in arguments.seeds:
            ship(arguments.name, arguments.task, seed)
        return
    previous = json.loads((RESULTS / "agents.json").read_text("utf-8"))["tasks"] if arguments.recipes else {}
    tasks = {
        path.name: score(path.name, arguments.recipes, previous.get(path.name))
        if not arguments.recipes or any(any(path.glob(f"{name}-seed*")) for name in arguments.recipes)
        else previous[path.name]
        for path in sorted(SHIPPED.iterdir())
    }
    write_results("agents", {**TRIAL, "tasks": tasks}, seed=TRIAL["seed"])


if __name__ == "__main__":
    main()
