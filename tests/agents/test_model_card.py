"""Ranking of the rows of a learning curve, what the terminal shows of them, and the card of an agent as a page."""

import json

import pytest

from hframe_gym.agents import shipped_agent_folder
from hframe_gym.agents.model_card import progress_line, ranking_cost, render_card

LENGTH_S = 1.5  # of an evaluation episode
EPISODES = 256


def reaching_row(settled_1mm, settled_02mm, final_error_mm, time_s=0.3):
    """Return a row in which the given numbers of episodes settle in each band after `time_s`."""
    fraction_1mm, fraction_02mm = settled_1mm / EPISODES, settled_02mm / EPISODES
    return {
        "steps": 1000,
        "seconds": 12.0,
        "success_1mm": fraction_1mm,
        "settling_s_1mm": LENGTH_S - (LENGTH_S - time_s) * fraction_1mm,
        "success_0.2mm": fraction_02mm,
        "settling_s_0.2mm": LENGTH_S - (LENGTH_S - time_s) * fraction_02mm,
        "success_0.05mm": 0.0,
        "settling_s_0.05mm": LENGTH_S,
        "final_error_mm": final_error_mm,
    }


@pytest.mark.parametrize(
    ("better", "worse"),
    [
        pytest.param(reaching_row(18, 0, 3.1), reaching_row(1, 1, 31.7), id="one lucky episode does not decide"),
        pytest.param(reaching_row(0, 0, 4.1), reaching_row(0, 0, 23.0), id="nothing settles: final error decides"),
        pytest.param(reaching_row(256, 8, 0.43), reaching_row(100, 8, 0.43), id="more settle within 1 mm"),
        pytest.param(reaching_row(256, 240, 0.08), reaching_row(256, 8, 0.43), id="more settle within 0.2 mm"),
        pytest.param(reaching_row(256, 256, 0.05), reaching_row(256, 256, 0.04, 0.31), id="faster, equal otherwise"),
    ],
)
def test_ranking_with_a_fixed_goal(better, worse):
    assert ranking_cost(better) < ranking_cost(worse)


def test_ranking_along_a_path_counts_a_tool_that_stays_at_its_start_as_bad():
    follower = {"contour_rms_mm": 0.1, "tracking_rms_mm": 0.5, "tracking_max_mm": 1.0}
    unmoved = {"contour_rms_mm": 0.0, "tracking_rms_mm": 35.0, "tracking_max_mm": 50.0}
    assert ranking_cost(follower) < ranking_cost(unmoved)


def test_progress_line_names_the_bands():
    line = progress_line(reaching_row(256, 128, 0.2))
    assert "100.0 % within 1mm, 50.0 % within 0.2mm, 0.0 % within 0.05mm; settles to 0.2mm in 0.900 s" in line


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
