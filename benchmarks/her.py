"""Can an agent learn from the sparse reward? SAC with hindsight on `reach`, reward 0 within 5 mm, else -1.

    python -m benchmarks.her [--seeds 3]

The agents are trained by the recipe sac_her_reach and evaluated on episodes that no training used: the
fraction of the episodes that end within 5 mm and stay there. The requirement is 90 %. Settings, seeds and
versions are in results/her.json.
"""

from __future__ import annotations

import tempfile
from typing import Any

import numpy as np

from benchmarks.results_file import write_results
from hframe_gym.agents import Agent, train
from hframe_gym.evaluation import Scenario, rollout, settling_times
from tools.command_line import command_line

BAND = 5e-3  # m, the band of the recipe's reward
BAR = 0.9
EPISODES = 512
EVALUATION_SEED = 0


def train_and_evaluate(seed: int) -> dict[str, Any]:
    """Train an agent with a seed, evaluate it, and return the results."""
    with tempfile.TemporaryDirectory() as folder:
        card = train("sac_her", seed=seed, out=folder)
        agent = Agent.load(folder)
    run = rollout(agent, Scenario(episodes=EPISODES, seed=EVALUATION_SEED))
    error = run.goal_error
    times, success = settling_times(error, run.time_s, BAND)
    last = card["curve"][-1]
    first = next((row for row in card["curve"] if row["success"] > BAR), None)
    return {
        "seed": seed,
        "success_5mm": float(success.mean()),
        "settling_s_5mm": float(times.mean()),
        "final_error_mm": {
            "median": float(1e3 * np.median(error[:, -1])),
            "max": float(1e3 * error[:, -1].max()),
        },
        "steps": last["steps"],
        "seconds": last["seconds"],
        "cpu_s": last["cpu_s"],
        "steps_to_bar": first and first["steps"],
        "settings": card["settings"],
        "curve": card["curve"],
    }


def main() -> None:
    """Train and evaluate one agent per seed."""
    parser = command_line(__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    runs: list[dict[str, Any]] = []
    for seed in range(parser.parse_args().seeds):
        runs.append(train_and_evaluate(seed))
        print({k: v for k, v in runs[-1].items() if k not in ("curve", "settings")}, flush=True)
        # Write after each seed, so that a job that is stopped leaves its results.
        write_results("her", {"bar": BAR, "episodes": EPISODES, "runs": runs}, seed=EVALUATION_SEED)


if __name__ == "__main__":
    main()
