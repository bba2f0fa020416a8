"""How close do the controllers come to the minimum settling time, and how accurate is that bound?

    python -m benchmarks.bound             # bounds of the episodes of `benchmarks.controllers`: 20 minutes
    python -m benchmarks.bound --seed 0    # those of another seed as well

The time-optimal bounds are stored in the package (hframe_gym/evaluation/bound_times_data/), a few episodes at
a time; stored ones are not computed again. Compared: the controllers of `benchmarks.controllers` on the same
episodes. The accuracy of the bound is tested by an open-loop replay on the exact stage and by refined
discretizations. Seed and versions are in results/bound.json.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

import hframe_gym.evaluation
from benchmarks.controllers import BAND, EPISODES, RUNS, SEED
from benchmarks.results_file import write_results
from hframe_gym.arrays import Array
from hframe_gym.controllers.planning.time_optimal import (
    SMOOTHED_REVERSAL_SPEED,
    TimeOptimalMotion,
    TimeOptimalReach,
)
from hframe_gym.dynamics import simulate_batch
from hframe_gym.evaluation import (
    BANDS,
    EpisodeConditions,
    Scenario,
    condition_digests,
    episode_conditions,
    make_controller,
    mean_with_interval,
    ratio_of_means,
    rollout,
    settling_times,
)
from hframe_gym.evaluation.stored_bounds import BOUNDS_FILE
from hframe_gym.files import write_text
from hframe_gym.machine import rest_state
from tools.command_line import command_line

STORE = Path(hframe_gym.evaluation.__file__).parent / BOUNDS_FILE
WRITE_EVERY = 8  # episodes
CHECKED = 12  # episodes on which the discretization error is measured
REPLAY_STEP = 5e-5  # s


def solve(conditions: EpisodeConditions, seed: int, task: str) -> list[dict[str, Any]]:
    """Return the bounds of all episodes; compute and store those that the package does not have.

    Args:
        conditions: Starts, goals and parameters of the episodes.
        seed: Seed of the first episode.

    Returns:
        One row per episode: seed, digest, bound, status and the errors of the replay.
    """
    stored = {row["draw"]: row for row in _stored()}
    problem = TimeOptimalReach(conditions.machine, band=BANDS[BAND])
    rows = []
    for b, digest in enumerate(condition_digests(conditions)):
        if digest not in stored:
            motion = problem.solve(conditions.start[b], conditions.goal[b], conditions.parameters[b])
            row = {"seed": seed + b, "draw": digest, "time_s": None, "status": motion.status}
            if motion.solved:
                row["time_s"] = round(motion.time_s, 7)
                row["replay_mm"] = [round(1e3 * error, 4) for error in replay(conditions, b, motion)]
            stored[digest] = row
            print(json.dumps(row), flush=True)
        rows.append(stored[digest])
        if b % WRITE_EVERY == WRITE_EVERY - 1 or b == len(conditions.goal) - 1:
            _store(list(stored.values()), conditions.machine.name, task)
    return rows


def _stored() -> list[dict[str, Any]]:
    """Load the rows of the package."""
    return list(json.loads(STORE.read_text())["draws"]) if STORE.exists() else []


def _store(rows: list[dict[str, Any]], machine: str, task: str) -> None:
    lines = ",\n".join(json.dumps(row) for row in sorted(rows, key=lambda row: row["seed"]))
    head = json.dumps(
        {"schema": 1, "machine": machine, "task": task, "randomize": "default", "band_m": BANDS[BAND]}
    )
    write_text(STORE, f'{head[:-1]}, "draws": [\n{lines}\n]}}\n')


def replay(conditions: EpisodeConditions, b: int, plan: TimeOptimalMotion) -> tuple[float, float]:
    """Apply the optimal voltages to the exact stage without feedback.

    Args:
        conditions: Starts, goals and parameters of the episodes.
        b: Number of the episode.

    Returns:
        Distance of the tool from the goal at the bound, and the largest distance from then on, m.
    """
    time_s = np.union1d(plan.edges_s, np.arange(0.0, plan.edges_s[-1], REPLAY_STEP))
    held = np.searchsorted(plan.edges_s, time_s, side="right") - 1
    volts = plan.volts[np.minimum(held, len(plan.volts) - 1)]
    start = rest_state(conditions.machine, conditions.start[b])
    parameters = conditions.parameters[b : b + 1]
    motion = simulate_batch(
        conditions.machine, time_s, volts, parameters=parameters, start=start, longest_step=REPLAY_STEP
    )
    error = np.linalg.norm(motion.positions[0][:, :2] - conditions.goal[b], axis=1)
    arrived = time_s >= plan.time_s
    return float(error[arrived][0]), float(error[arrived].max())


def discretization_error(conditions: EpisodeConditions) -> dict[str, Any]:
    """Measure how the bound changes with twice the intervals, sharper friction and other initial guesses.

    Args:
        conditions: Starts, goals and parameters of the episodes, of which the first `CHECKED` are used.

    Returns:
        By variant: changes of the bound, ms, and the error of the replay at the bound, mm.
    """
    base = TimeOptimalReach(conditions.machine, band=BANDS[BAND])
    variants: dict[str, tuple[TimeOptimalReach, float]] = {
        "as stored": (base, 1.0),
        "intervals x 2": (TimeOptimalReach(conditions.machine, band=BANDS[BAND], intervals=(120, 40)), 1.0),
        "turning / 3": (
            TimeOptimalReach(
                conditions.machine, band=BANDS[BAND], reversal_speed=SMOOTHED_REVERSAL_SPEED / 3.0
            ),
            1.0,
        ),
        "guess x 1.6": (base, 1.6),
        "guess x 0.7": (base, 0.7),
    }
    first: list[TimeOptimalMotion] = []
    results: dict[str, Any] = {}
    for name, (problem, guess) in variants.items():
        motions = [
            problem.solve(conditions.start[b], conditions.goal[b], conditions.parameters[b], [guess])
            for b in range(CHECKED)
        ]
        first = first or motions
        both = [b for b in range(CHECKED) if first[b].solved and motions[b].solved]
        change = np.array([1e3 * (motions[b].time_s - first[b].time_s) for b in both])
        results[name] = {
            "draws": len(both),
            "mean_ms": float(change.mean()),
            "least_ms": float(change.min()),
            "most_ms": float(change.max()),
            "replay_at_T_mm": float(np.mean([1e3 * replay(conditions, b, motions[b])[0] for b in both])),
        }
        print(name, results[name], flush=True)
    return results


def compare(bound: Array, seed: int) -> dict[str, Any]:
    """Compare the controllers' settling times with the bound, on the episodes whose bound is known.

    Args:
        bound: Bounds, s, shape (episodes,); NaN where unknown.
        seed: Seed of the first episode.
    """
    known = np.isfinite(bound)
    results: dict[str, Any] = {}
    for label, (name, period, sensors) in RUNS.items():
        scenario = Scenario("hframe", "reach", "default", sensors, len(bound), seed, period)
        run = rollout(make_controller(name, scenario), scenario)
        times, success = settling_times(run.goal_error, run.time_s, BANDS[BAND])
        ratio = times[known] / bound[known]
        results[label] = {
            "success": float(success.mean()),
            "mean_s": float(times.mean()),
            "mean_of_ratios": mean_with_interval(ratio, seed),
            "ratio_of_means": ratio_of_means(times[known], bound[known], seed),
            "least_ratio": float(ratio.min()),
            "median_ratio": float(np.median(ratio)),
            "late_ms": float(1e3 * np.mean(times[known] - bound[known])),
        }
        print(label, results[label], flush=True)
    return results


def main() -> None:
    """Compute bounds, compare the controllers and write the results."""
    parser = command_line(__doc__)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--episodes", type=int, default=EPISODES)
    arguments = parser.parse_args()
    scenario = Scenario("hframe", "reach", "default", "state", arguments.episodes, arguments.seed)
    conditions = episode_conditions(scenario)
    rows = solve(conditions, arguments.seed, "reach")
    bound = np.array([np.nan if row["time_s"] is None else row["time_s"] for row in rows])
    solved = [row for row in rows if row["time_s"] is not None]
    miss = np.array([row["replay_mm"] for row in solved])
    content = {
        "episodes": arguments.episodes,
        "band": BAND,
        "unsolved": [{"seed": row["seed"], "status": row["status"]} for row in rows if row["time_s"] is None],
        "bound_s": {"mean": float(np.nanmean(bound)), "median": float(np.nanmedian(bound))},
        "replay_mm": {
            name: dict(
                zip(("median", "p95", "most"), np.quantile(column, [0.5, 0.95, 1.0]).tolist(), strict=True)
            )
            for name, column in zip(("at_T", "from_T_on"), miss.T, strict=True)
        },
        "refined": discretization_error(conditions),
        "controllers": compare(bound, arguments.seed),
    }
    name = "bound" if arguments.seed == SEED else f"bound_seed{arguments.seed}"
    print(f"wrote {write_results(name, content, seed=arguments.seed)}")


if __name__ == "__main__":
    main()
