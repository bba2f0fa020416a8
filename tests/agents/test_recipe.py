"""Recipes: contents of the files, and rates that change during a run."""

from dataclasses import replace

import pytest

from hframe_gym.agents import Recipe, load_recipe, recipe_names
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


def test_a_file_states_what_differs_from_a_recipe_of_the_package(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text('base = "ppo"\nsteps = 5000\n[algorithm]\nuse_sde = true\n', "utf-8")
    base = load_recipe("ppo", "reach")
    expected = replace(base, name="mine", steps=5000, algorithm={**base.algorithm, "use_sde": True})
    assert load_recipe(str(file), "reach") == expected


def test_a_complete_recipe_is_read_from_a_file(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text('kind = "sac"\nsteps = 10\n[env]\n[algorithm]\ngamma = 0.9\n[policy]\n', "utf-8")
    assert load_recipe(str(file), "reach") == Recipe("mine", "sac", 10, {}, {"gamma": 0.9}, {})


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("steps = ", "is no valid TOML: Invalid value"),
        ("stepps = 10", "stepps is no entry of a recipe, .* did you mean 'steps'"),
        ('steps = "10"', "steps is '10', it must be a whole number"),
        ("algorithm = 3", r"algorithm is 3, it must be a table \[algorithm\]"),
        ("steps = 10", 'kind is missing; state it, or the recipe that this one changes: base = "ppo"'),
        ('base = "dqn"', "there is no recipe for dqn on reach"),
    ],
)
def test_a_file_that_is_no_recipe_is_refused_with_its_entry(tmp_path, content, message):
    file = tmp_path / "mine.toml"
    file.write_text(content, "utf-8")
    with pytest.raises(InputError, match=message):
        load_recipe(str(file), "reach")


def test_a_missing_file_is_refused_by_name(tmp_path):
    with pytest.raises(InputError, match=r"none\.toml: cannot be read"):
        load_recipe(str(tmp_path / "none.toml"), "reach")
