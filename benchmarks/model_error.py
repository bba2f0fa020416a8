"""How much does a controller or an agent gain from an exact model? Moves on more and more different machines.

    python -m benchmarks.model_error [--draws 128] [--only NAME ...] [--train | --machines]

The model is the declared machine of gap-v1. The simulated machine is this machine itself (`exact`), one with
other parameters (`parameters`, the randomization "default"), or one that also has two undeclared effects on
average (`effects`, those of hard-v1). The true state is observed, so that no state estimator takes part. The
draws are the same for all, and no agent was selected on them.

`--train` also trains the recipe `ppo_mix` on machines that hardly differ from the model, as identification
leaves them (`NEARLY_EXACT`), a minute of processor time: does PPO use an exact model if it meets no other?
The trained agent is kept in out/model_error.

In these conditions an exact model is that of the agents' training. An identified machine is another one.
`--machines` therefore compares the declared model with an exact one on machines with the parameters of plants
of gap-v1, of another seed than the published ones and without effects, sensors, estimators or errors of
identification.

Results are added to results/model_error.json or model_error_machines.json, which keep rows that are not run
again.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.gap.plants import declared_machine, draw_plant
from benchmarks.gap.results import interval
from benchmarks.results_file import write_results
from hframe_gym.agents import Agent, load_recipe, shipped_agent_folder, train
from hframe_gym.arrays import Array
from hframe_gym.controllers import CONTROLLERS, Controller
from hframe_gym.envs.randomization.domain_randomization import RANDOMIZATION_PRESETS
from hframe_gym.evaluation import Scenario, rollout, settling_times
from hframe_gym.evaluation.undeclared_effects import effect_rules, with_absent_effects
from hframe_gym.machine import BUILTIN_MACHINES, Machine
from tools.command_line import command_line
from tools.repository import RESULTS, ROOT

NAME = "model_error"
SEED, BAND_M = 5_000_000, 2e-4
CONDITIONS = ("exact", "parameters", "effects")
CONTROLLED = ("pid", "predictive")
AGENTS = ("ppo_mix", "residual", "sac_mix", "apg_mix", "apg_plan")  # seed 0 of the shipped agents
TRAINED = "ppo_mix, trained on nearly exact machines"
# About the standard deviations of identified parameters; friction is identified worst.
NEARLY_EXACT = [
    {"parameter": "*.EA", "distribution": ["normal", 1.0, 0.02]},
    {"parameter": "*.rest_length", "distribution": ["normal", 1.0, 0.02]},
    {"parameter": "*.coulomb", "distribution": ["normal", 1.0, 0.1]},
    {"parameter": "*.mass", "distribution": ["normal", 1.0, 0.03]},
]
TRAINING_STEPS = 500_000
# Plants without undeclared effects, whose parameters differ from the declared ones by 5 to 20 %; every fourth
# has none.
MACHINES_SEED, MACHINES = 52_000, range(0, 24, 4)


def scenario(condition: str, draws: int) -> Scenario:
    """Return the moves of a condition, one of `CONDITIONS`.

    Args:
        draws: Number of moves.
    """
    machine, randomize = BUILTIN_MACHINES["hframe"](), "none" if condition == "exact" else "default"
    settings = Scenario(machine, "reach", randomize, episodes=draws, seed=SEED, drives="rig")
    if condition != "effects":
        return settings
    return dataclasses.replace(
        settings,
        machine=with_absent_effects(machine),
        randomize=(*RANDOMIZATION_PRESETS["default"], *effect_rules()),
    )


def controller(name: str, model: Machine) -> Controller:
    """Return a controller or an agent with a machine as its model."""
    if name in CONTROLLERS:
        return CONTROLLERS.get(name)(model, Scenario.period)
    folder = trained_agent() if name == TRAINED else shipped_agent_folder(f"{name}-seed0", "reach")
    return Agent.load(folder, model)


def trained_agent() -> Path:
    """Return the folder of the agent that is trained on nearly exact machines; train it if there is none."""
    folder = ROOT / "out" / NAME / "ppo_mix"
    if not (folder / "done").is_file():
        recipe = load_recipe("ppo_mix", "reach")
        recipe = dataclasses.replace(
            recipe, steps=TRAINING_STEPS, env={**recipe.env, "randomize": NEARLY_EXACT}
        )
        train(recipe, declared_machine(), out=folder, force=True)
        (folder / "done").touch()
    return folder


def settling_s(name: str, model: Machine, settings: Scenario) -> Array:
    """Return the times until the tool stays within 0.2 mm, s, shape (draws,); 1.5 s if it never does."""
    episodes = rollout(controller(name, model), settings)
    return settling_times(episodes.goal_error, episodes.time_s, BAND_M)[0]


def row(name: str, draws: int) -> dict[str, Any]:
    """Score a controller or an agent.

    Returns:
        By condition the mean settling time, s, with its 95 % interval; "gain": by which fraction an exact
        model is faster than one that lacks parameters and effects, with its interval, paired by draw.
    """
    times = {
        condition: settling_s(name, declared_machine(), scenario(condition, draws))
        for condition in CONDITIONS
    }
    exact, effects = times["exact"], times["effects"]
    gain = interval((effects - exact) / effects.mean())
    return {condition: interval(values) for condition, values in times.items()} | {"gain": gain}


def row_of_machines(name: str, draws: int) -> dict[str, Any]:
    """Score a controller or an agent on machines that differ from the declared one.

    Args:
        draws: Number of moves on each machine.

    Returns:
        Of the "declared" and the "exact" model, the mean settling time, s, with its 95 % interval over the
        machines. "gain": mean over the machines of the fraction by which the exact model is faster;
        "median_gain": the same of the medians over the moves. "failed": number of moves that do not settle,
        with each model.
    """
    times: dict[str, list[Array]] = {"declared": [], "exact": []}
    for index in MACHINES:
        machine = draw_plant(MACHINES_SEED, index).near_machine
        settings = Scenario(machine, "reach", "none", episodes=draws, seed=SEED + index, drives="rig")
        times["declared"].append(settling_s(name, declared_machine(), settings))
        times["exact"].append(settling_s(name, machine, settings))
    declared, exact = (np.stack(of) for of in times.values())  # (machines, draws)
    by_median = [np.median(of, axis=1) for of in (declared, exact)]
    return {
        "declared": interval(declared.mean(axis=1)),
        "exact": interval(exact.mean(axis=1)),
        "gain": interval(1.0 - exact.mean(axis=1) / declared.mean(axis=1)),
        "median_gain": interval(1.0 - by_median[1] / by_median[0]),
        "failed": [int((of >= Scenario.duration_s).sum()) for of in (declared, exact)],
    }


def main() -> None:
    """Score what the command line asks for, and write the results."""
    parser = command_line(__doc__)
    parser.add_argument("--draws", type=int, default=128)
    parser.add_argument("--only", nargs="*", metavar="NAME")
    parser.add_argument("--train", action="store_true")
    parser.add_argument("--machines", action="store_true", help="compare models on machines that differ")
    arguments = parser.parse_args()
    names = arguments.only or [*CONTROLLED, *AGENTS]
    result, score = (f"{NAME}_machines", row_of_machines) if arguments.machines else (NAME, row)
    path = RESULTS / f"{result}.json"
    rows = json.loads(path.read_text("utf-8"))["rows"] if path.is_file() else {}
    for name in [*names, *([TRAINED] if arguments.train else [])]:
        rows[name] = score(name, arguments.draws)
        print(name, {key: np.round(values, 4).tolist() for key, values in rows[name].items()}, flush=True)
        write_results(result, {"draws": arguments.draws, "rows": rows}, seed=SEED)


if __name__ == "__main__":
    main()
