"""Makes the shipped agents and scores them: agents/shipped/TASK/NAME-seedK.

    python -m benchmarks.agents train residual --task reach --seeds 0 1 2    # minutes a seed
    python -m benchmarks.agents score                                        # all there are -> results/agents.json

A shipped agent is what `hframe train` gives by its recipe, with scores and known failures on draws that no training
saw added to its card.  The recipes were chosen on other draws (those of the learning curves) than the scores are of.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from hframe_gym.agents import train
from hframe_gym.agents.agent import Agent
from hframe_gym.agents.card import write_card

from hframe_gym.control import ModelPID
from hframe_gym.evaluate import BANDS, Episodes, Trial, rollout, scores
from hframe_gym.evaluate.scorecard import settling
from hframe_gym.machine import BUILTIN

from .results_file import write_results

SHIPPED = Path(__file__).parents[1] / "agents" / "shipped"
FILES = ("agent.json", "machine.json", "policy.safetensors", "card.json")
TRIAL = {"episodes": 512, "seed": 1000}  # draws that nothing was chosen on
SHORTENED = 10  # failing draws that a card lists


def ship(name: str, task: str, seed: int) -> None:
    """Train one and put it into its place, whole."""
    with tempfile.TemporaryDirectory() as folder:
        train(name, task=task, seed=seed, out=folder)
        target = SHIPPED / task / f"{name}-seed{seed}"
        target.mkdir(parents=True, exist_ok=True)
        for file in FILES:
            shutil.copy(Path(folder) / file, target / file)
    judge(target)


def judge(folder: Path) -> dict[str, Any]:
    """Score the agent of a folder, write that into its card, and give the card."""
    card: dict[str, Any] = json.loads((folder / "card.json").read_text("utf-8"))
    run = rollout(Agent.load(folder), Trial(task=card["task"], randomize=card["settings"]["env"]["randomize"], **TRIAL))
    card["scores"] = {**TRIAL, **scores(run)}
    card["failures"] = failures(run)
    write_card(folder, card)
    return card


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
    results: dict[str, Any] = {}
    for task in sorted(path.name for path in SHIPPED.iterdir()):
        pid = rollout(ModelPID(BUILTIN["hframe"](), 0.01), Trial(task=task, **TRIAL))
        results[task] = {"pid": scores(pid)}
        for folder in sorted((SHIPPED / task).iterdir()):
            card = judge(folder)
            last = card["curve"][-1]
            cost = {key: last[key] for key in ("steps", "seconds", "cpu_s")}
            results[task][folder.name] = {**card["scores"], "failures": card["failures"], "training": cost}
            print(folder.name, json.dumps(card["scores"].get("settling_s", {}).get("0.2mm")), flush=True)
    write_results("agents", {**TRIAL, "tasks": results}, seed=TRIAL["seed"])


if __name__ == "__main__":
    main()
