"""Does the identified machine give better controllers? They run on the rig from which it was identified.

    python -m benchmarks.corrected_control                                # all rigs: two hours
    python -m benchmarks.corrected_control --rigs 'cogging@motor1 full'   # only this rig; the others stay
    python -m benchmarks.corrected_control --controllers apg_mix          # only these; the others stay

Each rig of the independent simulator has one or three undeclared effects and parameters that are 5 to 20 %
off. From its recordings `identify` gives three machines: declared, refitted (before) and corrected (after).
Each machine alone is the basis of the model-based PID, the adaptive PID and the predictive controller, and of
learned controllers with three seeds each:

ppo       PPO that continues from the shipped agent
apg_mix   analytic policy gradient that continues from the shipped agent of the same seed; the linear feedback
          laws that it weights are those of the machine
residual  a PPO correction of that machine's adaptive PID, from scratch

All of them control the rig through the same episodes, with the full state every 10 ms: to points or along
circles, the controllers that are not learned both.

Training uses the same recipe, steps and seeds for all machines; the steps are fewer than those of shipped
agents. The declared and the refitted machine have the default randomization, because their error is unknown;
the corrected one has the uncertainty of its file. Differences are paired (same episode and seed) with 95 %
bootstrap intervals over the episodes, each the mean over its seeds. Seeds and versions are in
results/corrected_control.json.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.corrected_control_plots import draw
from benchmarks.results_file import write_results
from benchmarks.rig_loop import PERIOD_S, Driven, drive
from hframe_gym.agents import Agent, load_recipe, train
from hframe_gym.arrays import Array
from hframe_gym.controllers import CONTROLLERS, Controller
from hframe_gym.envs import Reach, Track
from hframe_gym.evaluation import BANDS, BOUND_BAND, mean_with_interval, settling_times
from hframe_gym.identification import identify, write_result
from hframe_gym.machine import Machine
from hframe_gym.recordings import load_machine
from tests.rigs.cases import select_cases
from tests.rigs.recording_sessions import DEFAULT_FOLDER, Session, record
from tools.command_line import command_line
from tools.repository import RESULTS

CACHE = Path("out/corrected_control")
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
# File of the identification result: randomization.
STAGES = {"declared": "default", "before": "default", "machine": "identified"}
NAMES = {"declared": "declared", "before": "refitted", "machine": "corrected"}
SEED, EPISODES = 2000, 24  # seed of starts and goals, number of episodes
AGENTS = (0, 1, 2)  # seeds
REACH, TRACK = Reach(), Track()
SETTLED = f"settling_s_{BOUND_BAND}"
DESIGNED = ("pid", "adaptive-pid", "predictive")
CIRCLE = ", circle"


class Training(NamedTuple):
    """How a learned controller is trained.

    Attributes:
        recipe: First part of the name of the recipe.
        steps: Environment steps.
        start: Shipped agent from which training starts, with {seed} for the seed; empty for random weights.
        seeds: Largest number of seeds.
    """

    recipe: str
    steps: int
    start: str = ""
    seeds: int = len(AGENTS)


LEARNED = {
    "ppo": Training("adapt", 200_000, "ppo"),
    "apg_mix": Training("adapt_mix", 150_000, "apg_mix-seed{seed}", seeds=1),
    "residual": Training("residual", 100_000),
}
# The decisive score of each controller: lower is better, if the success rate is not lower.
DECIDES = {
    **dict.fromkeys(DESIGNED, SETTLED),
    **{name + CIRCLE: "contour_rms_mm" for name in DESIGNED},
    **dict.fromkeys(LEARNED, SETTLED),
}


def machines(session: Session) -> dict[str, Machine]:
    """Return the three machines of a rig; identify it if that has not been done."""
    folder = CACHE / session.folder.name
    if not (folder / "report.json").is_file():
        write_result(identify(session.recordings(), session.machine()), folder)
    return {stage: load_machine(folder / f"{stage}.json") for stage in STAGES}


def trained(training: Training, machine: Machine, randomize: str, folder: Path, seed: int) -> Agent:
    """Return an agent that was trained on a machine; train it if that has not been done.

    Args:
        folder: Folder of the agent, with its card.
    """
    recipe, card = load_recipe(training.recipe, "reach"), folder / "card.json"
    environment = {**recipe.env, "randomize": randomize}
    recipe = replace(recipe, steps=training.steps, env=environment, start=training.start.format(seed=seed))
    present = json.loads(card.read_text()) if card.is_file() else None
    if (
        present is None
        or present["settings"] != recipe.as_dict()
        or present["curve"][-1]["steps"] < training.steps
    ):
        train(recipe, machine, seed=seed, out=folder, log=lambda line: None, force=True)
    return Agent.load(folder)


def controllers(
    session: Session, kinds: Sequence[str], seeds: Sequence[int]
) -> Iterator[tuple[str, str, Controller, dict[str, float]]]:
    """Yield the controllers of a rig, learned ones once per seed.

    Args:
        kinds: Keys of `DECIDES`.

    Yields:
        Key of `DECIDES`, name of the machine, controller, and of a learned one the steps and the processor
        time, s, of its training and the step at which it was kept.
    """
    for (stage, machine), kind in itertools.product(machines(session).items(), kinds):
        if kind not in LEARNED:
            yield kind, NAMES[stage], CONTROLLERS.get(kind.removesuffix(CIRCLE))(machine, PERIOD_S), {}
            continue
        training = LEARNED[kind]
        # The declared machine is the same for all rigs, and so are its agents.
        agents = CACHE / ("declared" if stage == "declared" else session.folder.name)
        for seed in seeds[: training.seeds]:
            folder = agents / f"{training.recipe}-{stage}-{seed}"
            agent = trained(training, machine, STAGES[stage], folder, seed)
            card = json.loads((folder / "card.json").read_text())
            cost = {
                "steps": card["curve"][-1]["steps"],
                "cpu_s": card["curve"][-1]["cpu_s"],
                "kept": card["kept"],
            }
            yield kind, NAMES[stage], agent, cost


def score(run: Driven) -> dict[str, Array]:
    """Return the scores of each episode, shape (episodes,) each.

    Returns:
        Along a path: rms and maximum contour error, mm. Otherwise: final error, mm, and per band success and
        settling time, s.
    """
    if run.contour is not None:
        rms = 1e3 * np.sqrt(np.mean(run.contour**2, axis=1))
        return {"contour_rms_mm": rms, "contour_max_mm": 1e3 * run.contour.max(axis=1)}
    scores = {"final_error_mm": 1e3 * run.error[:, -1]}
    for name, band in BANDS.items():
        times, success = settling_times(run.error, run.time_s, band)
        scores |= {f"success_{name}": success.astype(np.float64), f"settling_s_{name}": times}
    return scores


def compare_machines(
    session: Session, kinds: Sequence[str], episodes: int, seeds: Sequence[int]
) -> dict[str, Any]:
    """Return the results of a rig: scores by controller and machine, and differences to the corrected one."""
    rig, declared = session.case.rig()[0], session.machine()
    scores: dict[str, dict[str, list[dict[str, Array]]]] = {kind: {} for kind in kinds}
    trainings: dict[str, dict[str, list[dict[str, float]]]] = {kind: {} for kind in kinds}
    for kind, name, controller, cost in controllers(session, kinds, seeds):
        task = TRACK if kind.endswith(CIRCLE) else REACH
        run = score(drive(controller, rig, declared, task, episodes, SEED))
        scores[kind].setdefault(name, []).append(run)
        trainings[kind].setdefault(name, []).append(cost)
    report = json.loads((CACHE / session.folder.name / "report.json").read_text())
    return {
        "hides": " + ".join(hidden.label for hidden in session.case.hidden_effects),
        "found": [f"{e['name']}@{e['site']}" for e in report["effects"]],
        **{
            kind: _with_gains(by_machine) | ({"training": trainings[kind]} if kind in LEARNED else {})
            for kind, by_machine in scores.items()
        },
    }


def _with_gains(by_machine: dict[str, list[dict[str, Array]]]) -> dict[str, Any]:
    """Return means and intervals of the scores by machine, and of differences from the corrected machine."""
    mean = {
        name: {key: np.mean([run[key] for run in runs], axis=0) for key in runs[0]}
        for name, runs in by_machine.items()
    }
    gains = {
        name: {key: mean["corrected"][key] - v for key, v in scores.items()} for name, scores in mean.items()
    }
    del gains["corrected"]
    results: dict[str, Any] = {
        what: {
            name: {key: mean_with_interval(v, SEED) for key, v in scores.items()}
            for name, scores in rows.items()
        }
        for what, rows in (("scores", mean), ("gain", gains))
    }
    if any(len(runs) > 1 for runs in by_machine.values()):
        results["by_seed"] = {
            name: [{key: float(np.mean(v)) for key, v in run.items()} for run in runs]
            for name, runs in by_machine.items()
        }
    return results


def better(row: dict[str, Any], kind: str, over: str) -> bool:
    """Return whether the corrected machine's controller is significantly better and succeeds as often."""
    gain = row[kind]["gain"][over]
    return (
        gain[DECIDES[kind]]["ci95"][1] < 0.0
        and gain.get(f"success_{BOUND_BAND}", {"mean": 0.0})["mean"] >= 0.0
    )


def _print_row(row: dict[str, Any], kinds: Sequence[str]) -> None:
    """Print the decisive scores of a rig by controller and machine."""
    for kind in kinds:
        key, by_machine = DECIDES[kind], []
        for machine, scores in row[kind]["scores"].items():
            success = scores.get(f"success_{BOUND_BAND}")
            by_machine.append(
                f"{machine} {scores[key]['mean']:.4f}"
                + (f" ({100 * success['mean']:.0f} %)" if success else "")
            )
        low, high = row[kind]["gain"]["declared"][key]["ci95"]
        print(
            f"  {kind:22s} {key:17s} {', '.join(by_machine)}; minus declared {low:.4f} to {high:.4f}",
            flush=True,
        )


def main() -> None:
    """Evaluate the rigs that the command line names, write the results and draw the figure."""
    parser = command_line(__doc__)
    parser.add_argument("--rigs", nargs="+", default=list(RIGS), metavar="NAME")
    parser.add_argument(
        "--controllers", nargs="+", default=list(DECIDES), choices=list(DECIDES), metavar="NAME"
    )
    parser.add_argument("--episodes", type=int, default=EPISODES)
    parser.add_argument("--seeds", type=int, nargs="+", default=list(AGENTS), help="seeds of the agents")
    arguments = parser.parse_args()
    try:
        rigs = {case.name: case for case in select_cases(arguments.rigs)}
    except ValueError as error:
        parser.error(str(error))
    file = RESULTS / "corrected_control.json"
    previous = json.loads(file.read_text()) if file.is_file() else {"rigs": {}}
    comparable = all(previous.get(key) == getattr(arguments, key) for key in ("episodes", "seeds"))
    rows = {name: row for name, row in previous["rigs"].items() if comparable}
    for name, case in rigs.items():
        session = record(case, Path(DEFAULT_FOLDER))
        row = compare_machines(session, arguments.controllers, arguments.episodes, arguments.seeds)
        rows[name] = rows.get(name, {}) | row
        print(f"{name}: identified {', '.join(row['found']) or 'nothing'}", flush=True)
        _print_row(row, arguments.controllers)
        wins = {
            f"{kind} over {over}": [n for n, r in rows.items() if kind in r and better(r, kind, over)]
            for kind in DECIDES
            for over in ("declared", "refitted")
        }
        # Write after each rig, so that an interrupted run leaves its results.
        content = {
            "episodes": arguments.episodes,
            "seeds": arguments.seeds,
            "decides": DECIDES,
            "better": wins,
            "rigs": rows,
        }
        write_results("corrected_control", content, seed=SEED)
    print(json.dumps(wins, indent=1))
    draw(rows, DECIDES)


if __name__ == "__main__":
    main()
