"""Recipes: what is in the files, and rates that change over a run."""

import pytest
from hframe_gym.agents.recipe import Linear, load_recipe


@pytest.mark.parametrize(("remaining", "rate"), [(1.0, 1e-3), (0.5, 6e-4), (0.0, 2e-4), (-0.1, 2e-4)])
def test_rate_goes_from_first_to_last_and_stays(remaining, rate):
    assert Linear(1e-3, 2e-4)(remaining) == pytest.approx(rate)


def test_pairs_in_a_recipe_are_rates():
    recipe = load_recipe("ppo", "reach")
    first, last = recipe.algorithm["learning_rate"]
    assert recipe.settings["learning_rate"] == Linear(first, last)
    assert recipe.settings["gamma"] == recipe.algorithm["gamma"]


def test_recipes_are_listed_when_one_is_missing():
    with pytest.raises(ValueError, match=r"ppo on reach, ppo on track, .*, sac_her on reach"):
        load_recipe("ppo", "juggle")
