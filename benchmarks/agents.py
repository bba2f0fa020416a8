"""Makes the shipped agents and scores them: agents/shipped/TASK/NAME-seedK.

    python -m benchmarks.agents train residual --task reach --seeds 0 1 2    # minutes a seed
    python -m benchmarks.agents score                                        # all there are -> results/agents.json

A shipped agent is what `hframe train` gives by its recipe, with scores and known failures on draws that no training
saw added to its card.  The recipes were chosen on other draws (those of the learning curves) than the scores are of.

`score` also compares each with the model-based PID on the same draws, seed by seed and all seeds of a recipe together:
mean settling time over mean physical bound on `reach`, mean contour error over the PID's along each path of `track`.
Intervals are 95 % bootstraps over pairs of the same draw; of a recipe the pairs of all its seeds, seeds drawn as well.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from hframe_gym.agents import train
from hframe_gym.agents.agent import Agent
from hframe_gym.agents.model_card import write_card
from numpy.typing import NDArray
from scipy.stats import bootstrap

from benchmarks.results_file import write_results
from hframe_gym.controllers import CONTROLLERS, Controller
from hframe_gym.envs import Track
from hframe_gym.envs.tasks import TaskLike
from hframe_gym.evaluation import BANDS, Episodes, Scenario, rollout, scores
from hframe_gym.evaluation.bound_times import known_bounds
from hframe_gym.evaluation.metrics import JUDGED, RESAMPLES, settling
from hframe_gym.machine import BUILTIN_MACHINES

Array = NDArray[np.float64]
SHIPPED = Path(__file__).parents[1] / "agents" / "shipped"
FILES = ("agent.json", "machine.json", "policy.safetensors", "card.json")
TRIAL: dict[str, Any] = {"episodes": 512, "seed": 1000}  # draws that nothing was chosen on
TRIALS: dict[str, dict[str, TaskLike]] = {
    "reach": {"reach": "reach"},
    "track": {path: Track(path=path, size=0.05, speed=0.3) for path in ("circle", "square")},
}
SHORTENED = 10  # failing draws that a card lists


def ship(name: str, task: str, seed: int) -> None:
    """Train one and put it into its place, whole."""
    with tempfile.TemporaryDirectory() as folder:
        train(name, task=task, seed=seed, out=folder)
        target = SHIPPED / task / f"{name}-seed{seed}"
        target.mkdir(parents=True, exist_ok=True)
        for file in FILES:
            shutil.copy(Path(folder) / file, target / file)
    write_scores(target, drive(Agent.load(target), task))


def drive(controller: Controller, task: str) -> dict[str, Episodes]:
    """The episodes of a controller on the draws of all that its task is judged on."""
    return {name: rollout(controller, Scenario(task=which, **TRIAL)) for name, which in TRIALS[task].items()}


def write_scores(folder: Path, runs: Mapping[str, Episodes]) -> dict[str, Any]:
    """Write scores and failures into the card of an agent's folder, and give the card."""
    card: dict[str, Any] = json.loads((folder / "card.json").read_text("utf-8"))
    card["scores"] = {name: {**TRIAL, **scores(run, known_bounds(trial(name)))} for name, run in runs.items()}
    card["failures"] = {name: failures(run) for name, run in runs.items()}
    write_card(folder, card)
    return card


def trial(name: str) -> Scenario:
    """What `name` of `TRIALS` is judged on."""
    return Scenario(task=next(named[name] for named in TRIALS.values() if name in named), **TRIAL)


def failures(run: Episodes) -> dict[str, Any]:
    """By band: how many episodes fail it, and the first few environment seeds of such."""
    error = np.linalg.norm(run.position - run.goal, axis=2)
    found = {}
    for name, band in BANDS.items():
        # A goal that stands must be reached and kept; a path must never be left.
        bad = ~settling(error, run.time_s, band)[1] if run.contour is None else run.contour.max(axis=1) > band
        seeds = TRIAL["seed"] + np.flatnonzero(bad)
        found[name] = {"episodes": len(seeds), "seeds": seeds[:SHORTENED].tolist()}
    return found


def judged(run: Episodes) -> Array:
    """What each episode is compared by (B,): s to settle in the band of the bound, or m off the path, rms."""
    if run.contour is not None:
        return np.asarray(np.sqrt(np.mean(run.contour**2, axis=1)))
    return settling(np.linalg.norm(run.position - run.goal, axis=2), run.time_s, BANDS[JUDGED])[0]


def ratio(of: Array, over: Array) -> dict[str, Any]:
    """Mean of `of` (seeds, B) over the mean of `over` (B,), and its interval over draws and seeds."""
    seeds = np.arange(len(of))

    def resampled(draws: Array, chosen: Array) -> Any:
        return of[np.ix_(chosen.astype(int), draws.astype(int))].mean() / over[draws.astype(int)].mean()

    interval = bootstrap(
        (np.arange(len(over)), seeds if len(seeds) > 1 else np.zeros(2)),
        resampled,
        n_resamples=RESAMPLES,
        vectorized=False,
        method="percentile",
        rng=np.random.default_rng(TRIAL["seed"]),
    ).confidence_interval
    return {"mean": float(of.mean() / over.mean()), "ci95": [float(interval.low), float(interval.high)]}


def score(task: str) -> dict[str, Any]:
    """Scores of what learns nothing and of every shipped agent, and by recipe the ratios to the PID and the bound."""
    agents: dict[str, Any] = {}
    rows: dict[str, dict[str, list[Array]]] = {name: {} for name in TRIALS[task]}
    for kind in ("pid", "adaptive-pid"):
        runs = drive(CONTROLLERS[kind](BUILTIN_MACHINES["hframe"](), 0.01), task)
        agents[kind] = {"scores": {name: scores(run, known_bounds(trial(name))) for name, run in runs.items()}}
        for name, run in runs.items():
            rows[name][kind] = [judged(run)]
    for folder in sorted((SHIPPED / task).iterdir()):
        runs = drive(Agent.load(folder), task)
        card = write_scores(folder, runs)
        last = card["curve"][-1]
        cost = {key: last[key] for key in ("steps", "seconds", "cpu_s")}
        agents[folder.name] = {"scores": card["scores"], "failures": card["failures"], "training": cost}
        for name, run in runs.items():
            rows[name].setdefault(card["name"], []).append(judged(run))
        print(folder.name, {name: f"{judged(run).mean():.4g}" for name, run in runs.items()}, flush=True)
    compared = {
        name: {recipe: compare(np.stack(of), by["pid"][0], known_bounds(trial(name))) for recipe, of in by.items()}
        for name, by in rows.items()
    }
    return {"agents": agents, "compared": compared}


def compare(of: Array, pid: Array, bound_s: Array | None) -> dict[str, Any]:
    """Ratios of a recipe's episodes (seeds, B) to the PID's (B,) and to the bound: all seeds, and each."""
    others = {"over_pid": pid} | ({} if bound_s is None else {"over_bound": bound_s})
    return {
        name: {**ratio(of, other), "by_seed": [ratio(one[None], other) for one in of]} for name, other in others.items()
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    training = commands.add_parser("train")
    training.add_argument("name")
    training.add_argument("--task", default="reach")
    training.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    commands.add_parser("score")
    wanted = parser.parse_args()
    if wanted.command == "train":
        for seed in wanted.seeds:
            ship(wanted.name, wanted.task, seed)
        return
    tasks = {path.name: score(path.name) for path in sorted(SHIPPED.iterdir())}
    write_results("agents", {**TRIAL, "tasks": tasks}, seed=TRIAL["seed"])


if __name__ == "__main__":
    main()
