"""Tests of the result files of protocols: scores, validation, repeated runs and the leaderboard."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hframe_gym.errors import InputError
from hframe_gym.evaluation import (
    PROTOCOLS,
    Entry,
    Protocol,
    checksum,
    compare_draws,
    fill_unsettled,
    make_entry,
    paired_ratio,
    protocol_bounds,
    read_result,
    result_content,
    run_protocol,
    write_result,
)
from hframe_gym.evaluation.protocols import part_scores
from tests.evaluation.protocols.small_protocols import small
from tools.tables.leaderboard import leaderboard_page, protocol_section, rerun
from tools.tables.leaderboard import results as stored_results

pytestmark = pytest.mark.integration


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> Protocol:
    """Return a short reach-v1 that has taken the place of the protocol of this name."""
    protocol = small("reach-v1")
    monkeypatch.setitem(PROTOCOLS, "reach-v1", protocol)
    return protocol


def test_two_runs_give_the_same_bytes(tmp_path: Path) -> None:
    protocol = small("reach-v1")
    first, second = (
        write_result(tmp_path / folder, result_content(protocol, *run_protocol("textbook-pid", protocol)))
        for folder in ("a", "b")
    )
    assert first.name == "reach-v1_textbook-pid.json"
    contents = [json.loads(path.read_bytes()) for path in (first, second)]
    for content in contents:  # the processor time of a run is measured, and the checksum covers it
        assert content["entry"].pop("control_us") > 0.0
        assert len(content.pop("checksum")) == 64
    assert json.dumps(contents[0]) == json.dumps(contents[1])


ERRORS: list[float | None] = [0.01, 0.02, 3.0, 0.01]  # mm, of draws of which the third does not settle


@pytest.fixture
def content(short: Protocol, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Return the content of a valid result file of the short protocol."""
    for module in ("hframe_gym.evaluation.protocols.result_file", "tools.tables.leaderboard"):
        # The stored ones are of other draws.
        monkeypatch.setattr(f"{module}.protocol_bounds", lambda name: {})
    times: list[float | None] = [0.1, 0.2, None, 0.3]
    values: dict[str, list[float | None]] = {
        f"settling_s.{band}": times for band in ("1mm", "0.2mm", "0.05mm")
    }
    return result_content(
        short, Entry("mine", "agent", "a" * 64), {"reach": values | {"final_error_mm": ERRORS}}
    )


def test_scores_follow_from_the_draws(content: dict[str, Any], tmp_path: Path) -> None:
    score = content["scores"]["reach"]["settling_s.0.2mm"]
    assert score["success"] == 0.75
    # a failure counts the length of the episode
    assert score["mean"] == pytest.approx((0.1 + 0.2 + 0.3 + 0.3) / 4)
    result = read_result(write_result(tmp_path, content))
    assert result.entry.name == "mine"
    assert fill_unsettled(result.draws["reach"]["settling_s.0.2mm"], 0.3).tolist() == [0.1, 0.2, 0.3, 0.3]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda c: c["scores"]["reach"]["settling_s.0.2mm"].update(mean=0.05),
            "do not follow from the draws",
        ),
        (lambda c: c["draws"]["reach"]["settling_s.1mm"].pop(), "must hold 4 values"),
        (lambda c: c["draws"]["reach"].pop("final_error_mm"), "not settling_s.1mm"),
        (lambda c: c.update(digest="0" * 16), "other draws"),
        (lambda c: c.update(protocol="reach-v9"), "choose one of reach-v1"),
        (lambda c: c.update(rank=1), "rank: Extra inputs"),
        (lambda c: c["entry"].update(sha256="abc"), "entry.sha256"),
        (lambda c: c["draws"]["reach"].update(final_error_mm=[None] * 4), "null only for a settling time"),
        (
            lambda c: c["draws"]["reach"]["settling_s.1mm"].__setitem__(1, 0.2003),
            "draw 1 is impossible.*no sample",
        ),
        (
            lambda c: c["draws"]["reach"]["settling_s.1mm"].__setitem__(3, 0.4),
            "draw 3 is impossible.*no sample",
        ),
        (
            lambda c: c["draws"]["reach"]["settling_s.0.05mm"].__setitem__(0, 0.09),
            "draw 0 is impossible: it settles",
        ),
        (
            lambda c: c["draws"]["reach"]["settling_s.0.05mm"].__setitem__(2, 0.1),
            "draw 2.*the error at the end is 3 mm",
        ),
    ],
)
def test_a_file_that_is_not_valid_is_refused_by_name(
    content: dict[str, Any], change: Any, message: str, tmp_path: Path
) -> None:
    content = json.loads(json.dumps(content))
    change(content)
    content["checksum"] = checksum(content)
    path = write_result(tmp_path, content) if "reach" in content["draws"] else tmp_path / "x.json"
    with pytest.raises(InputError, match=message) as error:
        read_result(path)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def test_an_error_that_is_rounded_to_the_edge_of_a_band_is_possible(
    content: dict[str, Any], tmp_path: Path
) -> None:
    content = json.loads(json.dumps(content))  # whose bands share one list
    for settled in (0.2, None):
        content["draws"]["reach"]["settling_s.0.05mm"][1] = settled
        content["draws"]["reach"]["final_error_mm"][1] = 0.05
        content["scores"]["reach"] = part_scores(content["draws"]["reach"], 0.3)
        content["checksum"] = checksum(content)
        read_result(write_result(tmp_path, content))


def test_edited_draws_are_refused(content: dict[str, Any], tmp_path: Path) -> None:
    """The scores of the edited draws are right, and every value is possible."""
    content = json.loads(json.dumps(content))
    for band in ("1mm", "0.2mm", "0.05mm"):
        content["draws"]["reach"][f"settling_s.{band}"][3] = 0.11
    content["scores"]["reach"] = part_scores(content["draws"]["reach"], 0.3)
    with pytest.raises(InputError, match=r"checksum does not fit: .* draws were edited after the run"):
        read_result(write_result(tmp_path, content))


def test_a_file_from_another_machine_is_refused(content: dict[str, Any], tmp_path: Path) -> None:
    light = dataclasses.replace(PROTOCOLS["reach-v1"], machine="corexy")
    foreign = {**content, "digest": light.compute_digest()}
    with pytest.raises(InputError, match="it was scored on another machine or other draws"):
        read_result(write_result(tmp_path, {**foreign, "checksum": checksum(foreign)}))


def test_draws_below_their_stored_bound_are_refused(tmp_path: Path) -> None:
    """A file with 0.2 s for every draw was ranked first, at 0.779 of the bound."""
    protocol_bounds.cache_clear()
    protocol = PROTOCOLS["reach-v1"]
    values: dict[str, list[float | None]] = {
        f"settling_s.{band}": [0.2] * 512 for band in ("1mm", "0.2mm", "0.05mm")
    }
    whole = result_content(
        protocol, Entry("fast", "controller", "a" * 64), {"reach": values | {"final_error_mm": [0.0] * 512}}
    )
    with pytest.raises(
        InputError, match=r"draw \d+ is impossible: .* 0\.2 s is less than the shortest possible time"
    ):
        read_result(write_result(tmp_path, whole))


def test_all_stored_results_are_valid() -> None:
    protocol_bounds.cache_clear()
    assert len(stored_results()) > 30


def test_a_submission_is_run_again(short: Protocol, content: dict[str, Any], tmp_path: Path) -> None:
    entry, draws = run_protocol("pid", short)
    file = write_result(tmp_path, result_content(short, entry, draws))
    reproduced, text = rerun(file)
    assert reproduced
    assert text == f"{file}: reproduced: 16 of 16 values are equal"
    for band in ("1mm", "0.2mm", "0.05mm"):  # consistent, and with the right checksum: only a run can tell
        draws["reach"][f"settling_s.{band}"][1] = 0.15
        draws["reach"]["final_error_mm"][1] = 0.0
    reproduced, text = rerun(write_result(tmp_path, result_content(short, entry, draws)))
    assert not reproduced
    assert "NOT reproduced: 12 of 16 values are equal; largest difference: reach, draw 1, " in text


def test_a_repeated_run_may_differ_by_rounding_only(
    short: Protocol, content: dict[str, Any], tmp_path: Path
) -> None:
    result = read_result(write_result(tmp_path, content))
    again = json.loads(json.dumps(content["draws"]))
    again["reach"]["settling_s.0.2mm"][0] = 0.102
    again["reach"]["final_error_mm"][0] = 0.0105
    assert compare_draws(result, again).reproduced
    again["reach"]["settling_s.0.2mm"][0] = 0.103
    assert not compare_draws(result, again).reproduced


def test_edited_draws_do_not_look_like_rounding(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Rounding moves settling times both ways, edits one way: 20 of 512 draws that settle 60 ms earlier."""
    monkeypatch.setattr("hframe_gym.evaluation.protocols.result_file.protocol_bounds", lambda name: {})
    rng, protocol = np.random.default_rng(0), PROTOCOLS["reach-v1"]
    times = np.round(rng.uniform(0.2, 0.4, 512), 3)
    moved = np.zeros(512)
    moved[:20] = 0.06
    signs = np.where(np.arange(512) % 2, 1.0, -1.0)

    def draws(values: Any) -> dict[str, Any]:
        columns = {f"settling_s.{band}": np.round(values, 3).tolist() for band in ("1mm", "0.2mm", "0.05mm")}
        return {"reach": {**columns, "final_error_mm": [0.01] * 512}}

    content = result_content(protocol, Entry("mine", "agent", "a" * 64), draws(times - moved))
    result = read_result(write_result(tmp_path, content))
    assert not compare_draws(result, draws(times)).reproduced
    assert compare_draws(result, draws(times - moved + signs * moved)).reproduced


def test_swapped_weights_are_found_by_a_repeated_run(
    short: Protocol, content: dict[str, Any], tmp_path: Path
) -> None:
    pytest.importorskip("stable_baselines3")
    entry = make_entry("ppo-seed0", short, "reach")[0]
    file = write_result(tmp_path, result_content(short, entry, content["draws"]))
    reproduced, text = rerun(file, "ppo-seed1")
    assert not reproduced
    assert "swapped weights: ppo-seed1 has the hash" in text


def test_the_leaderboard_ranks_entries_and_compares_them_draw_by_draw(
    content: dict[str, Any], tmp_path: Path
) -> None:
    slower = json.loads(json.dumps(content)) | {
        "entry": {"name": "pid", "kind": "controller", "sha256": "b" * 64}
    }
    content["entry"] |= {
        "algorithm": "ppo",
        "training_steps": 1500000,
        "training_cpu_s": 61.4,
        "model": "belt geometry",
    }
    entries = []
    for entry, factor in ((slower, 0.75), (content, 0.5)):
        values = {
            m: [None if v is None else factor * v for v in c] for m, c in entry["draws"]["reach"].items()
        }
        whole = result_content(PROTOCOLS["reach-v1"], Entry(**entry["entry"]), {"reach": values})
        entries.append(read_result(write_result(tmp_path, whole)))
    text = protocol_section("reach-v1", entries)
    rows = text.splitlines()[4:]
    assert rows[0].startswith("| `mine` aaaaaaaa | ppo | state | belt geometry | 1.5 | 61 |  | 75.0 %")
    assert rows[1].startswith("| `pid` bbbbbbbb | not learned | state | not stated |  |  |  | 75.0 %")
    assert rows[1].endswith("| 1 |")
    page = leaderboard_page("a\n<!-- leaderboard: reach-v1 -->\nold\n<!-- end -->\nb", entries)
    assert "old" not in page
    assert text in page
    assert protocol_section("hard-v1", entries) == "No results yet."


def test_agents_of_several_seeds_get_a_row_with_intervals_over_draws_and_seeds(
    content: dict[str, Any], tmp_path: Path
) -> None:
    times: list[float | None] = [0.1, 0.15, 0.1, 0.05]
    entries = []
    for name, factor in (("mine-seed0", 1.0), ("mine-seed1", 2.0), ("alone-seed0", 1.0)):
        values: dict[str, list[float | None]]
        values = {metric: [factor * time for time in times if time] for metric in content["draws"]["reach"]}
        values["final_error_mm"] = [0.01] * 4
        whole = result_content(PROTOCOLS["reach-v1"], Entry(name, "agent", "a" * 64), {"reach": values})
        entries.append(read_result(write_result(tmp_path, whole)))
    rows = protocol_section("reach-v1", entries).splitlines()[4:]
    assert [row.split("|")[1].strip() for row in rows if "seeds" in row] == ["**mine, 2 seeds**"]
    assert "| **0.150 (" in rows[-1]


def test_the_interval_over_seeds_contains_the_spread_over_seeds() -> None:
    bound = np.linspace(1.0, 2.0, 64)
    seeds = np.stack([factor * bound for factor in (1.0, 1.1, 1.5)])
    of_one, of_all = paired_ratio(seeds[0], bound), paired_ratio(seeds, bound)
    assert of_one is not None
    assert of_all is not None
    assert of_one["ci95"] == pytest.approx([1.0, 1.0])
    assert of_all["mean"] == pytest.approx(1.2)
    assert of_all["ci95"] == pytest.approx([1.0, 1.5])  # three of the same seed: one resampling in 27
    assert paired_ratio(seeds[:1], bound) == of_one


def test_ratios_use_the_draws_with_a_known_bound() -> None:
    ratio = paired_ratio(np.array([2.0, 4.0, 100.0]), np.array([1.0, 2.0, np.nan]))
    assert ratio is not None
    assert (ratio["mean"], ratio["draws"]) == (2.0, 2)
    assert paired_ratio(np.ones(2), np.full(2, np.nan)) is None


def test_stored_bounds_belong_to_the_draws() -> None:
    protocol_bounds.cache_clear()
    for name in PROTOCOLS:
        bounds = protocol_bounds(name)
        assert bool(bounds) == ("reach" in PROTOCOLS[name].parts)
        if bounds:
            both = np.isfinite(bounds["held"])
            assert np.all(bounds["held"][both] >= bounds["free"][both] - 1e-4)
