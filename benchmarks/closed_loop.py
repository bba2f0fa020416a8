"""Does the corrected machine make better controllers?  Driven on the rig that it was identified from.

    python -m benchmarks.closed_loop                             # all rigs: identify, train, drive (an hour)
    python -m benchmarks.closed_loop --rigs 'cogging@motor1 full'    # this one anew, the others as they were

Each rig of the independent simulator has one undeclared effect, or three, and parameters 5 to 20 % off.  From its
recordings `identify` makes three machines: as declared, refitted (before), corrected (after).  From each alone are made
the model-based PID, the one that adapts, and two learned controllers of three seeds: PPO that goes on from the shipped
agent, and PPO's correction on that machine's adaptive PID, from nothing.  Then they drive the rig itself through the
same episodes, with the full state every 10 ms: to points, and the PIDs along circles too.

Training takes the same recipe, steps and seeds for all machines: on the declared and refitted one with the default
randomisation, for nobody knows how far off they are; on the corrected with what its file leaves uncertain.  Differences
are of pairs, the same episode and seed, with 95 % bootstrap intervals over the episodes, each the mean of its seeds.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from hframe_gym.agents import train
from hframe_gym.agents.agent import Agent
from hframe_gym.agents.recipe import load_recipe

from benchmarks.closed_loop_plots import draw
from benchmarks.results_file import RESULTS, write_results
from benchmarks.rig_loop import PERIOD_S, Driven, drive
from hframe_gym.controllers import CONTROLLERS, Controller
from hframe_gym.envs import Reach, Track
from hframe_gym.evaluation.metrics import BANDS, JUDGED, mean_with_interval, settling
from hframe_gym.identification import identify
from hframe_gym.identification.result_output import write_answer
from hframe_gym.machine import Machine
from hframe_gym.recordings import load_machine
from tests.reference_simulator import Array
from tests.rigs.rigs import cases
from tests.rigs.sessions import DEFAULT_FOLDER, Session, record

KEPT = Path("out/closed_loop")
RIGS = (
    "stribeck_friction@x full",
    "dead_band@motor1 full",
    "input_delay@drives full",
    "cogging@motor1 full",
    "stribeck_friction@x + input_delay@drives + cable_spring@y",
    "eccentric_pulley@motor2 full",
    "cable_spring@x full",
    "constant_force@y full",
    "belt_play@belts full",
)
STAGES = {"declared": "default", "before": "default", "machine": "identified"}  # files of an answer: randomisation
NAMES = {"declared": "declared", "before": "refitted", "machine": "corrected"}
LEARNED = {"ppo": ("adapt", 200_000), "residual": ("residual", 100_000)}  # recipe and steps
SEED, EPISODES = 2000, 24  # of starts and goals
AGENTS = (0, 1, 2)  # seeds
REACH, TRACK = Reach(), Track()
SETTLED = f"settling_s_{JUDGED}"
BUILT = ("pid", "adaptive-pid")
CIRCLE = ", circle"
# What decides: less of it, in which success may not be lower.
DECIDES = {
    **dict.fromkeys(BUILT, SETTLED),
    **{name + CIRCLE: "contour_rms_mm" for name in BUILT},
    **dict.fromkeys(LEARNED, SETTLED),
}


def machines(session: Session) -> dict[str, Machine]:
    """The three machines of a rig, from the last identification where it was done."""
    folder = KEPT / session.folder.name
    if not (folder / "report.json").is_file():
        write_answer(identify(session.recordings(), session.machine()), folder)
    return {stage: load_machine(folder / f"{stage}.json") for stage in STAGES}


def trained(name: str, steps: int, machine: Machine, randomize: str, folder: Path, seed: int) -> Agent:
    """An agent by a recipe on a machine; from the folder where that was done."""
    recipe, card = load_recipe(name, "reach"), folder / "card.json"
    recipe = replace(recipe, steps=steps, env={**recipe.env, "randomize": randomize})
    made = json.loads(card.read_text()) if card.is_file() else None
    if made is None or made["settings"] != recipe.as_dict() or made["curve"][-1]["steps"] < steps:
        train(recipe, machine, seed=seed, out=folder, say=lambda line: None)
    return Agent.load(folder)


def controllers(session: Session, seeds: tuple[int, ...]) -> Iterator[tuple[str, str, Controller]]:
    """What drives, by a key of `DECIDES`, the machine that it was made from, and itself; learned ones once a seed."""
    for stage, machine in machines(session).items():
        # The declared machine is the same for all rigs, and so are its agents.
        of = KEPT / ("declared" if stage == "declared" else session.folder.name)
        for kind in BUILT:
            for course in ("", CIRCLE):
                yield kind + course, NAMES[stage], CONTROLLERS[kind](machine, PERIOD_S)
        for kind, (recipe, steps) in LEARNED.items():
            for seed in seeds:
                place = of / f"{recipe}-{stage}-{seed}"
                yield kind, NAMES[stage], trained(recipe, steps, machine, STAGES[stage], place, seed)


def numbers(run: Driven) -> dict[str, Array]:
    """What is compared, (B,) each: success in each band, time to settle in it, s, and error at the end, mm; along a
    path root mean square and largest distance from it, mm."""
    if run.contour is not None:
        rms = 1e3 * np.sqrt(np.mean(run.contour**2, axis=1))
        return {"contour_rms_mm": rms, "contour_max_mm": 1e3 * run.contour.max(axis=1)}
    found = {"final_error_mm": 1e3 * run.error[:, -1]}
    for name, band in BANDS.items():
        times, success = settling(run.error, run.time_s, band)
        found |= {f"success_{name}": success.astype(np.float64), f"settling_s_{name}": times}
    return found


def compared(session: Session, episodes: int, seeds: tuple[int, ...]) -> dict[str, Any]:
    """One rig: scores by controller and machine, and what the corrected machine gains over the others."""
    rig, declared = session.case.rig()[0], session.machine()
    found: dict[str, dict[str, list[dict[str, Array]]]] = {kind: {} for kind in DECIDES}
    for kind, name, controller in controllers(session, seeds):
        task = TRACK if kind.endswith(CIRCLE) else REACH
        run = numbers(drive(controller, rig, declared, task, episodes, SEED))
        found[kind].setdefault(name, []).append(run)
    report = json.loads((KEPT / session.folder.name / "report.json").read_text())
    return {
        "hides": " + ".join(p.label for p in session.case.planted),
        "found": [f"{e['name']}@{e['site']}" for e in report["effects"]],
        **{kind: _with_gains(by) for kind, by in found.items()},
    }


def _with_gains(by: dict[str, list[dict[str, Array]]]) -> dict[str, Any]:
    """Scores by machine, and the corrected one's less those of each other; of learned controllers the means by seed."""
    mean = {name: {key: np.mean([run[key] for run in runs], axis=0) for key in runs[0]} for name, runs in by.items()}
    gains = {name: {key: mean["corrected"][key] - v for key, v in of.items()} for name, of in mean.items()}
    del gains["corrected"]
    found: dict[str, Any] = {
        what: {name: {key: mean_with_interval(v, SEED) for key, v in of.items()} for name, of in rows.items()}
        for what, rows in (("scores", mean), ("gain", gains))
    }
    if any(len(runs) > 1 for runs in by.values()):
        found["by_seed"] = {
            name: [{key: float(np.mean(v)) for key, v in run.items()} for run in runs] for name, runs in by.items()
        }
    return found


def better(row: dict[str, Any], kind: str, over: str) -> bool:
    """Whether the corrected machine's controller is better beyond doubt, and succeeds no less."""
    gain = row[kind]["gain"][over]
    return gain[DECIDES[kind]]["ci95"][1] < 0.0 and gain.get(f"success_{JUDGED}", {"mean": 0.0})["mean"] >= 0.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigs", nargs="+", default=list(RIGS), metavar="NAME")
    parser.add_argument("--episodes", type=int, default=EPISODES)
    parser.add_argument("--seeds", type=int, nargs="+", default=list(AGENTS), help="of the agents")
    given = parser.parse_args()
    file = RESULTS / "closed_loop.json"
    before = json.loads(file.read_text()) if file.is_file() else {"rigs": {}}
    comparable = all(before.get(key) == getattr(given, key) for key in ("episodes", "seeds"))
    rows = {name: row for name, row in before["rigs"].items() if comparable}
    for name in given.rigs:
        session = record(cases()[name], Path(DEFAULT_FOLDER))
        rows[name] = row = compared(session, given.episodes, tuple(given.seeds))
        print(f"{name}: found {', '.join(row['found']) or 'nothing'}", flush=True)
        for kind, key in DECIDES.items():
            shown = []
            for machine, scores in row[kind]["scores"].items():
                success = scores.get(f"success_{JUDGED}")
                shown.append(
                    f"{machine} {scores[key]['mean']:.4f}" + (f" ({100 * success['mean']:.0f} %)" if success else "")
                )
            low, high = row[kind]["gain"]["declared"][key]["ci95"]
            print(f"  {kind:20s} {key:17s} {', '.join(shown)}; over declared {low:.4f} to {high:.4f}", flush=True)
        wins = {
            f"{kind} over {over}": [n for n, r in rows.items() if kind in r and better(r, kind, over)]
            for kind in DECIDES
            for over in ("declared", "refitted")
        }
        # After each: what is stopped leaves what it had.
        content = {"episodes": given.episodes, "seeds": given.seeds, "decides": DECIDES, "better": wins, "rigs": rows}
        write_results("closed_loop", content, seed=SEED)
    print(json.dumps(wins, indent=1))
    draw(rows, DECIDES)


if __name__ == "__main__":
    main()
