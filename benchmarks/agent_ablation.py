"""What do the parts of the recipe `apg` contribute? Trainings with one part changed each, of the same length.

    python -m benchmarks.agent_ablation [--steps 400000] [--seeds 1] [--only NAME ...] [--out FOLDER]

Every variant is trained by `hframe_gym.agents.train`, and the agent that is kept is scored on 512 episodes of
seed 0; the scores of the shipped agents use other ones. Short trainings show what learns fast, not what ends
best. The variants of `OFF_POLICY` compare the algorithms SAC, TQC and CrossQ; run them by `--only`. `--steps`
does not apply to them: one step costs several times as much as with the others, because the weights change
every few steps. `--out` keeps the agents, for example for `hframe evaluate FOLDER --protocol reach-v1`.
Results are added to results/agent_ablation.json, which keeps variants that are not run again.
"""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.agents import ratio
from benchmarks.results_file import write_results
from hframe_gym.agents import Agent, Recipe, load_recipe, train
from hframe_gym.evaluation import BANDS, BOUND_BAND, Scenario, rollout, settling_times, stored_bounds
from tools.command_line import command_line
from tools.repository import RESULTS

SCENARIO = Scenario(episodes=512, seed=0)
NAME = "agent_ablation"


def _without(table: str, *keys: str) -> Callable[[Recipe], Recipe]:
    """Return a function that removes keys of a table of a recipe."""
    return lambda recipe: replace(
        recipe, **{table: {key: value for key, value in getattr(recipe, table).items() if key not in keys}}
    )


def _with(table: str, **values: Any) -> Callable[[Recipe], Recipe]:
    """Return a function that changes values in a table of a recipe."""
    return lambda recipe: replace(recipe, **{table: {**getattr(recipe, table), **values}})


def _as_crossq(recipe: Recipe) -> Recipe:
    """Return a recipe of SAC for CrossQ, which has no target networks."""
    return replace(_without("algorithm", "tau")(recipe), kind="crossq")


def _outputs_are_voltages(recipe: Recipe) -> Recipe:
    """Return the recipe of SAC without the parts of `apg_mix`, with settings that were chosen for it.

    The policy's outputs are the two voltages, scaled by the distance to the goal; nothing is held, nothing
    estimated.
    """
    changed = _with("env", num_envs=32)(
        replace(recipe, steps=160_000, actuation={"least": 0.06}, features={})
    )
    return _with(
        "algorithm",
        learning_rate=[1e-3, 5e-5],
        buffer_size=160_000,
        learning_starts=3_000,
        gradient_steps=4,
        target_entropy=-2.0,
    )(changed)


def _voltages_of_crossq(recipe: Recipe) -> Recipe:
    """Return the recipe of SAC for CrossQ, without the parts of `apg_mix`."""
    return _as_crossq(_outputs_are_voltages(recipe))


def _many_environments(recipe: Recipe) -> Recipe:
    """Return the same recipe with the same number of updates, each from twice as many new steps."""
    changed = _with(
        "algorithm", gradient_steps=8, batch_size=512, learning_starts=12_000, buffer_size=320_000
    )
    return replace(_with("env", num_envs=128)(changed(_voltages_of_crossq(recipe))), steps=320_000)


def _parts_of_apg(recipe: Recipe) -> Recipe:
    """Return the recipe of SAC for CrossQ, with the actuation and features of the recipe `apg`."""
    other = load_recipe("apg", "reach")
    changed = _voltages_of_crossq(recipe)
    return replace(changed, actuation=other.actuation, features=other.features, steps=120_000)


VARIANTS: dict[str, tuple[str, Callable[[Recipe], Recipe]]] = {
    "apg": ("apg", lambda recipe: recipe),
    "without the voltages of transfers as features": ("apg", _without("features", "transfers")),
    "without estimates of friction, masses and belts": ("apg", _without("actuation", "estimates")),
    "without a held action": ("apg", _without("actuation", "hold_m")),
    "derivative by the state not discounted": ("apg", _with("algorithm", discount=1.0)),
    "derivative by the state limited a hundred times less": ("apg", _with("algorithm", limit=300.0)),
    "without averaged weights": ("apg", _with("algorithm", averaging=0.0)),
    "PPO": ("ppo", lambda recipe: recipe),
}
OFF_POLICY: dict[str, tuple[str, Callable[[Recipe], Recipe]]] = {
    "SAC, outputs are voltages": ("sac", _outputs_are_voltages),
    "TQC, outputs are voltages": ("sac", lambda recipe: replace(_outputs_are_voltages(recipe), kind="tqc")),
    "CrossQ, outputs are voltages": ("sac", _voltages_of_crossq),
    "CrossQ, outputs are voltages, 128 environments, batches of 512": ("sac", _many_environments),
    "CrossQ, estimates and held action of apg": ("sac", _parts_of_apg),
    "CrossQ, 120000 steps": ("crossq", lambda recipe: replace(recipe, steps=120_000)),
    "SAC": ("sac", lambda recipe: recipe),
    "TQC": ("tqc", lambda recipe: recipe),
    "CrossQ": ("crossq", lambda recipe: recipe),
}
GROUPS = {"variants": VARIANTS, "off_policy": OFF_POLICY}


def score(agent: Agent) -> dict[str, Any]:
    """Return the success rate by band and the mean settling time over the mean bound, with 95 % interval."""
    episodes = rollout(agent, SCENARIO)
    bounds = stored_bounds(SCENARIO).times_s
    assert bounds is not None
    by_band = {
        name: settling_times(episodes.goal_error, episodes.time_s, band) for name, band in BANDS.items()
    }
    return {
        "success": {name: float(np.mean(success)) for name, (_, success) in by_band.items()},
        "over_bound": ratio(by_band[BOUND_BAND][0][None], bounds),
    }


def run(variant: str, steps: int, seed: int, out: Path | None) -> dict[str, Any]:
    """Train a variant, score the agent that it keeps, and keep its folder if `out` is given."""
    name, change = (VARIANTS | OFF_POLICY)[variant]
    recipe = change(load_recipe(name, "reach"))
    if variant in VARIANTS:
        recipe = replace(recipe, steps=steps)
    began = time.process_time()
    with tempfile.TemporaryDirectory() as temporary:
        folder = out / f"{variant.replace(', ', '_').replace(' ', '_')}-seed{seed}" if out else temporary
        card = train(recipe, seed=seed, out=folder, log=lambda line: None, force=True)
        cpu_s = time.process_time() - began
        scores = score(Agent.load(folder))
    return {
        "seed": seed,
        "steps": card["curve"][-1]["steps"],
        "kept": card["kept"],
        "cpu_s": round(cpu_s, 1),
        **scores,
    }


def main() -> None:
    """Train and score the variants, and write the results after each."""
    parser = command_line(__doc__)
    parser.add_argument("--steps", type=int, default=400_000)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--only", nargs="+", choices=VARIANTS | OFF_POLICY, default=list(VARIANTS))
    parser.add_argument("--out", type=Path, help="keep the agents in subfolders of this folder")
    arguments = parser.parse_args()
    file = Path(RESULTS) / f"{NAME}.json"
    previous = json.loads(file.read_text()) if file.exists() else {}
    results = {group: previous.get(group, {}) for group in GROUPS}
    for variant in arguments.only:
        runs = [run(variant, arguments.steps, seed, arguments.out) for seed in range(arguments.seeds)]
        print(variant, json.dumps(runs), flush=True)
        for group, variants in GROUPS.items():
            known = results[group] | ({variant: runs} if variant in variants else {})
            results[group] = {name: known[name] for name in variants if name in known}
        write_results(NAME, {"episodes": SCENARIO.episodes, **results}, seed=SCENARIO.seed)


if __name__ == "__main__":
    main()
