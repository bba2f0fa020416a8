"""Ranking of the rows of a learning curve, what the terminal shows of them, and an agent's card as a page."""

import json

import numpy as np
import pytest

from hframe_gym.agents import shipped_agent_folder
from hframe_gym.agents.model_card import episode_costs, improves, progress_line, render_card
from hframe_gym.evaluation import Episodes

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


def reaching_episodes(settled, final_error_mm, time_s=0.3):
    """Return episodes, `settled` of which jump to a final error at `time_s`; the others stay 30 mm off."""
    time = np.linspace(0.0, LENGTH_S, 151)
    error = np.full((EPISODES, len(time), 1), 0.03)
    error[:settled, time >= time_s] = 1e-3 * final_error_mm
    return Episodes(time, error, np.zeros_like(error), None, *np.zeros((4, EPISODES)))


@pytest.mark.parametrize(
    ("better", "worse"),
    [
        pytest.param(
            reaching_episodes(256, 3.1), reaching_episodes(1, 0.1), id="one lucky episode does not decide"
        ),
        pytest.param(
            reaching_episodes(256, 4.1), reaching_episodes(0, 0.0), id="nothing settles: final error decides"
        ),
        pytest.param(reaching_episodes(256, 0.4), reaching_episodes(100, 0.4), id="more settle within 1 mm"),
        pytest.param(
            reaching_episodes(256, 0.1), reaching_episodes(256, 0.4), id="they settle within 0.2 mm"
        ),
        pytest.param(
            reaching_episodes(256, 0.04), reaching_episodes(256, 0.06), id="they settle within 0.05 mm"
        ),
        pytest.param(
            reaching_episodes(256, 0.05), reaching_episodes(256, 0.04, 0.31), id="faster, equal otherwise"
        ),
    ],
)
def test_the_better_agent_is_kept_with_a_fixed_goal(better, worse):
    assert improves(episode_costs(better), episode_costs(worse))
    assert not improves(episode_costs(worse), episode_costs(better))


def test_an_agent_that_is_better_in_one_episode_only_does_not_replace_another():
    lucky, kept = reaching_episodes(101, 0.04), reaching_episodes(100, 0.04)
    assert episode_costs(lucky).mean() < episode_costs(kept).mean()
    assert not improves(episode_costs(lucky), episode_costs(kept))
    assert improves(episode_costs(reaching_episodes(104, 0.04)), episode_costs(kept))
    assert improves(episode_costs(kept), None)


def test_along_a_path_a_tool_that_stays_at_its_start_is_bad():
    def episodes(contour_mm, tracking_mm):
        position = np.full((4, 10, 2), 1e-3 * tracking_mm / np.sqrt(2.0))
        return Episodes(
            np.arange(10.0),
            position,
            np.zeros_like(position),
            np.full((4, 10), 1e-3 * contour_mm),
            *np.zeros((4, 4)),
        )

    np.testing.assert_allclose(episode_costs(episodes(0.1, 0.5)), 0.6)
    assert improves(episode_costs(episodes(0.1, 0.5)), episode_costs(episodes(0.0, 35.0)))


def test_progress_line_names_the_bands():
    line = progress_line(reaching_row(256, 128, 0.2))
    assert "100.0 % within 1mm, 50.0 % within 0.2mm, 0.0 % within 0.05mm; settles to 0.2mm in 0.900 s" in line


def test_progress_line_has_no_time_where_nothing_settles():
    line = progress_line(reaching_row(256, 0, 0.2))
    assert line.endswith("0.0 % within 0.2mm, 0.0 % within 0.05mm; none settles to 0.2mm")


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
    settling_s = card["scores"]["reach"]["settling_s"]["0.05mm"]
    assert f" % | {settling_s['mean']:.3f} |" in page
    card["scores"]["reach"]["success"]["0.05mm"] = 0.0  # the times are then the length of the episodes
    assert "| 0.05mm | 0.0 % | - | - | - |" in render_card(card)
    del card["scores"], card["failures"]
    assert "## Scores" not in render_card(card)
