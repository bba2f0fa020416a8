"""How PPO's settings on `reach` were looked for: Optuna's TPE over short trainings from scratch.

    python -m benchmarks.hyperparameters --trials 24

A trial trains by the recipe ppo_reach with settings of its own and is judged by the logarithm of the median error at
the end, on the 256 draws of the learning curves.  A short training tells what learns fast, not what ends best: what is
found is used only where whole trainings confirm it.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from dataclasses import replace
from typing import Any

import optuna
from hframe_gym.agents import train
from hframe_gym.agents.recipe import Recipe, load_recipe

from benchmarks.results_file import write_results

STEPS = 300_000
SEED = 0


def suggested(trial: optuna.Scenario) -> Recipe:
    """The recipe with a trial's settings."""
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


def judged(trial: optuna.Scenario) -> float:
    """Logarithm (base 10) of the median error at the end, mm."""
    with tempfile.TemporaryDirectory() as folder:
        card = train(suggested(trial), seed=SEED, out=folder, say=lambda line: None)
    return math.log10(card["curve"][-1]["final_error_mm"])


def content(study: optuna.Study) -> dict[str, Any]:
    """What the study has found so far, plain data."""
    done = [t for t in study.trials if t.value is not None]
    importance = optuna.importance.get_param_importances(study) if len(done) > 4 else {}
    return {
        "steps": STEPS,
        "objective": "log10 of the median error at the end, mm",
        "best": {"value": study.best_value, **study.best_params},
        "importance": {name: float(share) for name, share in importance.items()},
        "trials": [{"value": t.value, **t.params} for t in done],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=24)
    study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=SEED, n_startup_trials=8))
    given = parser.parse_args()
    # The recipe as it was first, so that what is found is beside it.
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

    def kept(study: optuna.Study, trial: optuna.trial.FrozenTrial) -> None:
        print(trial.number, trial.value, trial.params, flush=True)
        write_results("hyperparameters_ppo_reach", content(study), seed=SEED)

    study.optimize(judged, n_trials=given.trials, callbacks=[kept])


if __name__ == "__main__":
    main()
