"""Which hyperparameters of PPO are good on `reach`? Optuna's TPE over short trainings from scratch.

    python -m benchmarks.hyperparameters --trials 24
    python -m benchmarks.hyperparameters --trials 24 --batch 8 --jobs 2    # or --ray [ADDRESS]

A trial trains by the recipe ppo_reach with varied hyperparameters. Its objective is the logarithm of the median final
error on the 256 episodes of the learning curves. A short training shows what learns fast, not what ends best, so the
result is used only where complete trainings confirm it. The trials of a batch are drawn before any of them is trained:
the study depends on the size of a batch, not on the number of workers.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from dataclasses import replace
from typing import Any

import optuna

from benchmarks.results_file import write_results
from hframe_gym.agents import Recipe, load_recipe, train
from hframe_gym.distributed import LOCAL_RAY, map_tasks

STEPS = 300_000
SEED = 0


def suggest_recipe(trial: optuna.Trial) -> Recipe:
    """Return the recipe with the hyperparameters of a trial."""
    recipe = load_recipe("ppo", "reach")
    rate = trial.suggest_float("learning_rate", 2e-4, 3e-3, log=True)
    algorithm = {
        **recipe.algorithm,
        "learning_rate": [rate, 0.02 * rate],
        "gamma": 1.0 - trial.suggest_float("one_less_gamma", 5e-3, 0.1, log=True),
        "ent_coef": trial.suggest_float("ent_coef", 1e-6, 1e-2, log=True),
        "n_epochs": trial.suggest_int("n_epochs", 3, 12),
        "target_kl": trial.suggest_float("target_kl", 0.01, 0.1, log=True),
    }
    actuation = {**recipe.actuation, "least": trial.suggest_float("least", 0.03, 0.2, log=True)}
    return replace(recipe, algorithm=algorithm, actuation=actuation, steps=STEPS)


def final_error(recipe: Recipe) -> float:
    """Train and return the logarithm (base 10) of the median final error in mm."""
    with tempfile.TemporaryDirectory() as folder:
        card = train(recipe, seed=SEED, out=folder, log=lambda line: None)
    return math.log10(card["curve"][-1]["final_error_mm"])


def content(study: optuna.Study) -> dict[str, Any]:
    """Return the state of the study as plain data."""
    done = [t for t in study.trials if t.value is not None]
    importance = optuna.importance.get_param_importances(study) if len(done) > 4 else {}
    return {
        "steps": STEPS,
        "objective": "log10 of the median final error, mm",
        "best": {"value": study.best_value, **study.best_params},
        "importance": {name: float(value) for name, value in importance.items()},
        "trials": [{"value": t.value, **t.params} for t in done],
    }


def main() -> None:
    """Run the study and write its state after every trial."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--trials", type=int, default=24)
    parser.add_argument("--batch", type=int, default=1, help="number of trials that are drawn together")
    parser.add_argument("--jobs", type=int, default=1, help="number of parallel processes")
    parser.add_argument(
        "--ray", nargs="?", const=LOCAL_RAY, metavar="ADDRESS", help="run on Ray; default: a local one"
    )
    study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=SEED, n_startup_trials=8))
    arguments = parser.parse_args()
    # The recipe is the first trial, for comparison.
    first = load_recipe("ppo", "reach").algorithm
    study.enqueue_trial(
        {
            "learning_rate": first["learning_rate"][0],
            "one_less_gamma": 1.0 - first["gamma"],
            "ent_coef": 1e-6,
            "n_epochs": first["n_epochs"],
            "target_kl": first["target_kl"],
            "least": load_recipe("ppo", "reach").actuation["least"],
        }
    )

    while len(study.trials) < arguments.trials:
        trials = [study.ask() for _ in range(min(arguments.batch, arguments.trials - len(study.trials)))]
        recipes = [suggest_recipe(trial) for trial in trials]
        values = map_tasks(final_error, recipes, jobs=arguments.jobs, ray=arguments.ray)
        for trial, value in zip(trials, values, strict=True):
            study.tell(trial, value)
            print(trial.number, value, trial.params, flush=True)
            write_results("hyperparameters_ppo_reach", content(study), seed=SEED)


if __name__ == "__main__":
    main()
