"""Recipes: contents of the files, and rates that change during a run."""

from dataclasses import replace

import pytest

from hframe_gym.agents import load_recipe, recipe_names
from hframe_gym.agents.recipe import LinearSchedule
from hframe_gym.envs import TASKS, Track
from hframe_gym.errors import InputError


@pytest.mark.parametrize(("remaining", "rate"), [(1.0, 1e-3), (0.5, 6e-4), (0.0, 2e-4), (-0.1, 2e-4)])
def test_schedule_is_linear_and_constant_after_the_end(remaining, rate):
    assert LinearSchedule(1e-3, 2e-4)(remaining) == pytest.approx(rate)


def test_pairs_in_a_recipe_become_schedules():
    recipe = load_recipe("ppo", "reach")
    first, last = recipe.algorithm["learning_rate"]
    assert recipe.algorithm_keywords["learning_rate"] == LinearSchedule(first, last)
    assert recipe.algorithm_keywords["gamma"] == recipe.algorithm["gamma"]


@pytest.mark.parametrize("name", recipe_names())
def test_every_recipe_loads(name):
    algorithm, task = name.rsplit("_", 1)
    recipe = load_recipe(algorithm, task)
    assert recipe.name == name
    assert recipe.steps > 0


def test_unknown_recipe_is_refused_with_a_list():
    with pytest.raises(
        InputError, match=r"no recipe for dqn on reach; .* ppo on reach, ppo on track, .*, sac_her on"
    ):
        load_recipe("dqn", "reach")


def test_a_task_without_recipes_has_those_of_the_task_with_the_same_metrics():
    @TASKS.register("user-path")
    class UserPath(Track):
        """A path of the user."""

    try:
        recipe = load_recipe("sac", "user-path")
        assert recipe == replace(load_recipe("sac", "track"), task={})
        with pytest.raises(
            InputError, match=r"no recipe for dqn on track \(the task user-path has the recipes of track"
        ):
            load_recipe("dqn", "user-path")
    finally:
        TASKS.unregister("user-path")


@pytest.mark.parametrize("option", ["machine", "task", "normalize", "flat", "error"])
def test_options_that_training_sets_or_policies_cannot_observe_are_refused(option):
    recipe = load_recipe("ppo", "reach")
    with pytest.raises(InputError, match=f"recipe ppo_reach: env has the option {option}"):
        replace(recipe, env={**recipe.env, option: True})


def test_noise_that_depends_on_the_state_is_an_option_of_the_algorithm():
    recipe = load_recipe("ppo", "reach")
    with pytest.raises(InputError, match="recipe ppo_reach: policy has use_sde; move it to algorithm"):
        replace(recipe, policy={**recipe.policy, "use_sde": True})
