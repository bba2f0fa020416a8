"""Which settings of PPO are good on `reach`? Optuna's TPE over short trainings from random weights.

    python -m benchmarks.hyperparameters --trials 24 [--steps 300000]
    python -m benchmarks.hyperparameters --trials 24 --batch 8 --jobs 2    # or --ray [ADDRESS]

A trial trains by the recipe ppo_reach with other settings: learning rate, discount, batches, epochs, noise of
the exploration (also gSDE, which depends on the state), and what the policy knows: the integral of the error,
estimates of the parameters, voltages of feedback laws that it weights. The objective is the cost by which a
training run chooses the agent to keep (`episode_costs`), on the 256 episodes of the learning curves. The seed
of the trials is not reported elsewhere. A short training shows what learns fast, not what ends best, so the
result is used only where complete trainings confirm it. The trials of a batch are drawn before any of them is
trained: the study depends on the size of a batch, not on the number of workers.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from functools import partial
from typing import Any

import optuna

from benchmarks.results_file import write_results
from hframe_gym.agents import Recipe, load_recipe, train
from hframe_gym.agents.model_card import SECONDS_PER_MM
from hframe_gym.evaluation import BANDS
from hframe_gym.parallel import LOCAL_RAY, map_tasks
from tools.command_line import command_line

STEPS = 300_000
SEED = 100  # the agents of the package have the seeds 0 to 9
FEATURES = [0, 1, 2, 4, 6, 9, 12, 16, 21, 27]  # periods beyond the shortest transfer
LAWS = [0, 4, 12]


def suggest_recipe(trial: optuna.Trial, steps: int) -> Recipe:
    """Return the recipe with the settings of a trial."""
    recipe = load_recipe("ppo", "reach")
    rate = trial.suggest_float("learning_rate", 2e-4, 3e-3, log=True)
    knowledge = trial.suggest_categorical("knowledge", ["geometry", "estimates", "laws"])
    algorithm = {
        **recipe.algorithm,
        "learning_rate": [rate, 0.02 * rate],
        "gamma": 1.0 - trial.suggest_float("one_less_gamma", 0.02, 0.1, log=True),
        "batch_size": trial.suggest_categorical("batch_size", [256, 512, 1024]),
        "n_epochs": trial.suggest_int("n_epochs", 4, 12),
        "use_sde": trial.suggest_categorical("use_sde", [False, True]),
    }
    actuation = {
        "least": trial.suggest_float("least", 0.03, 0.2, log=True),
        "integral": trial.suggest_categorical("integral", [False, True]),
    }
    if knowledge != "geometry":
        actuation["estimates"] = True
    if knowledge == "laws":
        actuation["transfers"] = LAWS
    return replace(
        recipe,
        steps=steps,
        algorithm=algorithm,
        actuation=actuation,
        features={} if knowledge == "geometry" else {"transfers": FEATURES},
        policy={**recipe.policy, "log_std_init": trial.suggest_float("log_std_init", -2.5, -0.5)},
    )


def trained_cost(recipe: Recipe) -> dict[str, float]:
    """Train; return the mean cost of the last agent's episodes, s, its scores and the processor time, s."""
    with tempfile.TemporaryDirectory() as folder:
        row = train(recipe, seed=SEED, out=folder, log=lambda line: None)["curve"][-1]
    cost = sum(row[f"settling_s_{band}"] for band in BANDS) + SECONDS_PER_MM * row["final_error_mm"]
    scores = {
        f"{score}_{band}": row[f"{score}_{band}"] for band in BANDS for score in ("success", "settling_s")
    }
    return {"cost": cost, "cpu_s": row["cpu_s"], **scores}


def content(study: optuna.Study, steps: int) -> dict[str, Any]:
    """Return the state of the study as plain data."""
    done = [t for t in study.trials if t.value is not None]
    importance = optuna.importance.get_param_importances(study) if len(done) > 4 else {}
    return {
        "steps": steps,
        "objective": "mean cost of the episodes, s",
        "best": {"value": study.best_value, **study.best_params},
        "importance": {name: float(value) for name, value in importance.items()},
        "trials": [{"value": t.value, **t.user_attrs, **t.params} for t in done],
    }


def main() -> None:
    """Run the study and write its state after every batch of trials."""
    parser = command_line(__doc__)
    parser.add_argument("--trials", type=int, default=24)
    parser.add_argument("--steps", type=int, default=STEPS, help="environment steps of a trial")
    parser.add_argument("--batch", type=int, default=1, help="number of trials that are drawn together")
    parser.add_argument("--jobs", type=int, default=1, help="number of parallel processes")
    parser.add_argument(
        "--ray", nargs="?", const=LOCAL_RAY, metavar="ADDRESS", help="run on Ray; default: a local one"
    )
    arguments = parser.parse_args()
    study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=SEED, n_startup_trials=8))
    # The recipe is the first trial, for comparison.
    recipe = load_recipe("ppo", "reach")
    first = {
        "learning_rate": recipe.algorithm["learning_rate"][0],
        "one_less_gamma": 1.0 - recipe.algorithm["gamma"],
        "batch_size": recipe.algorithm["batch_size"],
        "n_epochs": recipe.algorithm["n_epochs"],
        "use_sde": False,
        "log_std_init": recipe.policy["log_std_init"],
        "knowledge": "geometry",
        "least": recipe.actuation["least"],
        "integral": recipe.actuation.get("integral", False),
    }
    study.enqueue_trial(first)
    while len(study.trials) < arguments.trials:
        count = min(arguments.batch, arguments.trials - len(study.trials))
        trials = [study.ask() for _ in range(count)]
        recipes = list(map(partial(suggest_recipe, steps=arguments.steps), trials))
        results = map_tasks(trained_cost, recipes, jobs=arguments.jobs, ray=arguments.ray)
        for trial, result in zip(trials, results, strict=True):
            for name, value in result.items():
                trial.set_user_attr(name, value)
            study.tell(trial, result["cost"])
            print(trial.number, result, trial.params, flush=True)
        write_results("hyperparameters_ppo_reach", content(study, arguments.steps), seed=SEED)


if __name__ == "__main__":
    main()
