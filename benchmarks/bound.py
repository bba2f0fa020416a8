"""How near the controllers come to the least time that any could settle in, and how sure that time is.

python -m benchmarks.bound             # the bounds of the draws that `benchmarks.controllers` is judged on: 20 minutes
python -m benchmarks.bound --seed 0    # those of another seed as well

The bounds go into the package (hframe_gym/evaluate/bounds.py), a few draws at a time; those that are there are kept.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import hframe_gym.evaluation
import numpy as np
from numpy.typing import NDArray

from benchmarks.controllers import BAND, EPISODES, RUNS, SEED
from benchmarks.results_file import write_results
from hframe_gym.atomic_files import write_text
from hframe_gym.controllers.time_optimal import TURNING, TimeOptimalMotion, TimeOptimalReach
from hframe_gym.dynamics.simulation import simulate_batch
from hframe_gym.evaluation import BANDS, Scenario, make_controller, rollout
from hframe_gym.evaluation.bound_times import FILE, EpisodeDraws, digests, drawn
from hframe_gym.evaluation.metrics import mean_with_interval, ratio_of_means, settling
from hframe_gym.machine import rest_state

Array = NDArray[np.float64]
STORE = Path(hframe_gym.evaluation.__file__).parent / FILE
AT_ONCE = 8  # draws between two writes
CHECKED = 12  # draws, for the errors of the discretisation
FINE = 5e-5  # s, step of the replay


def solve(draws: EpisodeDraws, seed: int, task: str) -> list[dict[str, Any]]:
    """The rows of all draws, of which those of the store are taken as they are; the store is kept up to date."""
    there = {row["draw"]: row for row in _stored()}
    problem = TimeOptimalReach(draws.machine, band=BANDS[BAND])
    rows = []
    for b, digest in enumerate(digests(draws)):
        if digest not in there:
            found = problem.solve(draws.start[b], draws.goal[b], draws.parameters[b])
            row = {"seed": seed + b, "draw": digest, "time_s": None, "status": found.status}
            if found.solved:
                row["time_s"] = round(found.time_s, 7)
                row["replay_mm"] = [round(1e3 * off, 4) for off in replay(draws, b, found)]
            there[digest] = row
            print(json.dumps(row), flush=True)
        rows.append(there[digest])
        if b % AT_ONCE == AT_ONCE - 1 or b == len(draws.goal) - 1:
            _store(list(there.values()), draws.machine.name, task)
    return rows


def _stored() -> list[dict[str, Any]]:
    return list(json.loads(STORE.read_text())["draws"]) if STORE.exists() else []


def _store(rows: list[dict[str, Any]], machine: str, task: str) -> None:
    lines = ",\n".join(json.dumps(row) for row in sorted(rows, key=lambda row: row["seed"]))
    head = json.dumps({"schema": 1, "machine": machine, "task": task, "randomize": "default", "band_m": BANDS[BAND]})
    write_text(STORE, f'{head[:-1]}, "draws": [\n{lines}\n]}}\n')


def replay(draws: EpisodeDraws, b: int, found: TimeOptimalMotion) -> tuple[float, float]:
    """How far the tool is from the goal at T, and the farthest from then on, m, when the exact stage is given the
    voltages that were found, without feedback."""
    time_s = np.union1d(found.edges_s, np.arange(0.0, found.edges_s[-1], FINE))
    held = np.searchsorted(found.edges_s, time_s, side="right") - 1
    volts = found.volts[np.minimum(held, len(found.volts) - 1)]
    start = rest_state(draws.machine, draws.start[b])
    parameters = draws.parameters[b : b + 1]
    motion = simulate_batch(draws.machine, time_s, volts, parameters=parameters, start=start, longest_step=FINE)
    off = np.linalg.norm(motion.positions[0][:, :2] - draws.goal[b], axis=1)
    arrived = time_s >= found.time_s
    return float(off[arrived][0]), float(off[arrived].max())


def refined(draws: EpisodeDraws) -> dict[str, Any]:
    """What twice the intervals, friction that turns over at a third of the speed, and other first guesses change in T,
    ms, and how far beside the goal the replay then ends, mm; of the first draws."""
    base = TimeOptimalReach(draws.machine, band=BANDS[BAND])
    variants: dict[str, tuple[TimeOptimalReach, float]] = {
        "as stored": (base, 1.0),
        "intervals x 2": (TimeOptimalReach(draws.machine, band=BANDS[BAND], intervals=(120, 40)), 1.0),
        "turning / 3": (TimeOptimalReach(draws.machine, band=BANDS[BAND], turning=TURNING / 3.0), 1.0),
        "guess x 1.6": (base, 1.6),
        "guess x 0.7": (base, 0.7),
    }
    first: list[TimeOptimalMotion] = []
    answer: dict[str, Any] = {}
    for name, (problem, guess) in variants.items():
        found = [problem.solve(draws.start[b], draws.goal[b], draws.parameters[b], [guess]) for b in range(CHECKED)]
        first = first or found
        both = [b for b in range(CHECKED) if first[b].solved and found[b].solved]
        change = np.array([1e3 * (found[b].time_s - first[b].time_s) for b in both])
        answer[name] = {
            "draws": len(both),
            "mean_ms": float(change.mean()),
            "least_ms": float(change.min()),
            "most_ms": float(change.max()),
            "replay_at_T_mm": float(np.mean([1e3 * replay(draws, b, found[b])[0] for b in both])),
        }
        print(name, answer[name], flush=True)
    return answer


def compare(bound: Array, seed: int) -> dict[str, Any]:
    """Settling times of the built controllers over the bound, of the draws whose bound is known."""
    there = np.isfinite(bound)
    answer: dict[str, Any] = {}
    for label, (name, period, sensors) in RUNS.items():
        trial = Scenario("hframe", "reach", "default", sensors, len(bound), seed, period)
        run = rollout(make_controller(name, trial), trial)
        off = np.linalg.norm(run.position - run.goal, axis=2)
        times, success = settling(off, run.time_s, BANDS[BAND])
        ratio = times[there] / bound[there]
        answer[label] = {
            "success": float(success.mean()),
            "mean_s": float(times.mean()),
            "mean_of_ratios": mean_with_interval(ratio, seed),
            "ratio_of_means": ratio_of_means(times[there], bound[there], seed),
            "least_ratio": float(ratio.min()),
            "median_ratio": float(np.median(ratio)),
            "late_ms": float(1e3 * np.mean(times[there] - bound[there])),
        }
        print(label, answer[label], flush=True)
    return answer


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--episodes", type=int, default=EPISODES)
    given = parser.parse_args()
    trial = Scenario("hframe", "reach", "default", "state", given.episodes, given.seed)
    draws = drawn(trial)
    rows = solve(draws, given.seed, "reach")
    bound = np.array([np.nan if row["time_s"] is None else row["time_s"] for row in rows])
    solved = [row for row in rows if row["time_s"] is not None]
    miss = np.array([row["replay_mm"] for row in solved])
    content = {
        "episodes": given.episodes,
        "band": BAND,
        "unsolved": [{"seed": row["seed"], "status": row["status"]} for row in rows if row["time_s"] is None],
        "bound_s": {"mean": float(np.nanmean(bound)), "median": float(np.nanmedian(bound))},
        "replay_mm": {
            name: dict(zip(("median", "p95", "most"), np.quantile(column, [0.5, 0.95, 1.0]).tolist(), strict=True))
            for name, column in zip(("at_T", "from_T_on"), miss.T, strict=True)
        },
        "refined": refined(draws),
        "controllers": compare(bound, given.seed),
    }
    name = "bound" if given.seed == SEED else f"bound_seed{given.seed}"
    print(f"wrote {write_results(name, content, seed=given.seed)}")


if __name__ == "__main__":
    main()
