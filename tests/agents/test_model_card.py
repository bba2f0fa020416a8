"""The card of an agent as a page."""

import json

import pytest

from hframe_gym.agents import shipped_agent_folder
from hframe_gym.agents.model_card import render_card


@pytest.mark.parametrize(("name", "task"), [("ppo-seed0", "reach"), ("residual-seed2", "track")])
def test_the_page_of_a_shipped_agent_is_what_its_card_gives(name, task):
    folder = shipped_agent_folder(name, task)
    card = json.loads((folder / "card.json").read_text("utf-8"))
    assert render_card(card) == (folder / "README.md").read_text("utf-8")


def test_the_page_states_scores_failures_and_curve():
    card = json.loads((shipped_agent_folder("ppo-seed0", "reach") / "card.json").read_text("utf-8"))
    page = render_card(card)
    success = 100 * card["scores"]["reach"]["success"]["0.2mm"]
    assert f"| 0.2mm | {success:.1f} % |" in page
    failures = card["failures"]["reach"]["0.05mm"]["episodes"]
    assert f"0.05mm: {failures} of 512 episodes" in page
    assert f"| {card['curve'][-1]['steps']} |" in page
    del card["scores"], card["failures"]
    assert "## Scores" not in render_card(card)
