"""Test the summary of the results on random rigs with rows that were made up."""

import numpy as np
import pytest

from benchmarks.random_rigs_plots import draw
from benchmarks.random_rigs_summary import NOTHING, OTHERS, UNEXPLAINED, summary


def _hidden(family, size, identified, absorbed=False):
    label = f"{family}@x"
    return {"label": label, "family": family, "size": size, "identified": identified, "absorbed": absorbed}


def _row(index, hidden=(), extra=(), kind="library", residue="", z=(), verdict="effect_found", after=1.0):
    named = [
        {"label": f"{h['family']}@x", "family": h["family"], "extra": False}
        for h in hidden
        if h["identified"]
    ]
    named += [{"label": f"{family}@y", "family": family, "extra": True} for family in extra]
    errors = {name: {"mean": value, "worst": value} for name, value in (("after", after), ("true", 1.0))}
    return {
        "rig": f"1_{index:04d}",
        "kind": kind,
        "residue": residue,
        "hidden": list(hidden),
        "verdict": verdict,
        "named": named,
        "complete": all(h["identified"] for h in hidden),
        "extra": [f"{family}@y" for family in extra],
        "unseen": errors,
        "intervals": [{"name": "x.mass", "relative_std": 0.01, "z": value, "effect": False} for value in z],
        "stable": True,
        "consistency": 0.01,
        "seconds": {"wall": 10.0 + index, "cpu": 5.0},
    }


ROWS = [
    _row(0, kind="none", verdict="no_effect", z=(0.5, -0.9, 1.5, 3.0)),
    _row(1, kind="none", residue="hysteresis", extra=("cogging",), after=2.0),
    _row(2, [_hidden("presliding", 0.05, False)], verdict="no_effect"),
    _row(3, [_hidden("presliding", 0.04, False)], verdict="unexplained"),
    _row(4, [_hidden("presliding", 0.3, True)]),
    _row(5, [_hidden("presliding", 0.9, True), _hidden("gain_mismatch", 0.5, True, absorbed=True)]),
    _row(6, [_hidden("presliding", 0.8, False)], extra=("cogging", "belt_play")),
    _row(7, [_hidden("belt_damping", 0.8, True)], kind="off-form"),
]


def test_summary_counts_names_and_false_names():
    content = summary(ROWS)
    assert content["rigs"] == 8
    assert content["names"]["clean"] == {"rigs": 6, "right": 3, "effects": 5, "identified": 2}
    assert content["names"]["residue"]["right"] == 0
    assert content["false_names"]["clean"]["which"] == {"1_0006": ["cogging@y", "belt_play@y"]}
    assert content["false_names"]["by_residue"]["hysteresis"]["with_false_name"] == 1
    assert content["confusion"]["presliding"] == {
        NOTHING: 1, UNEXPLAINED: 1, "presliding": 2, "cogging": 1, "belt_play": 1,
    }  # fmt: skip
    assert content["confusion"][OTHERS] == {"cogging": 1}
    assert content["seconds"]["wall"] == {"median": 13.5, "most": 17.0}


def test_detection_size_lies_between_missed_and_identified_sizes():
    found = summary([r for r in ROWS if r["rig"] != "1_0006"])["detection"]["presliding"]
    assert 0.05 < found["half"] < 0.3
    assert summary(ROWS)["detection"]["presliding"]["count"] == 5
    assert "gain_mismatch" not in summary(ROWS)["detection"]
    above = summary([r for r in ROWS if r["rig"] != "1_0006"])["names"]["above_detection"]
    assert above == {"effects": 2, "identified": 2}


def test_effects_without_a_trace_are_no_missed_ones():
    missed = _hidden("presliding", 0.95, False) | {"trace": 3.0}
    found, names = (summary([*ROWS, _row(8, [missed])])[key] for key in ("detection", "names"))
    assert found["presliding"] == summary(ROWS)["detection"]["presliding"] | {"without_trace": [0.95]}
    assert names["above_detection"] == summary(ROWS)["names"]["above_detection"]


def test_effects_above_the_median_size_count_in_all_rigs_with_effects_of_the_library():
    above = summary(ROWS)["names"]["above_median_size"]
    assert above == {"effects": 2, "identified": 1, "size": 0.3}


def test_effects_without_a_trace_in_the_runs_count_separately():
    unseen = _hidden("presliding", 0.9, False) | {"trace": 0.0}
    rows = [*ROWS, _row(8, [unseen], verdict="no_effect", after=50.0)]
    content = summary(rows)
    assert content["names"]["without_trace"]["effects"] == 1
    assert content["names"]["above_median_size"]["effects"] == 2
    assert content["unseen"]["over_truth"] == summary(ROWS)["unseen"]["over_truth"]
    assert content["unseen"]["clean_over_truth"] != summary(ROWS)["unseen"]["clean_over_truth"]
    rows[-1]["hidden"][0]["trace"] = 1e4
    assert summary(rows)["names"]["above_median_size"]["effects"] == 3


def test_rigs_in_closed_loop_are_grouped_by_the_changes_of_the_voltages_in_a_row_of_the_log():
    rows = [row | {"updates": updates} for row, updates in zip(ROWS[:6], (1, 2, 4, 5, 10, 20), strict=True)]
    logs = summary(rows)["logs"]
    assert {name: found["rigs"] for name, found in logs.items()} == {"1": 1, "2 to 5": 3, "8 to 20": 2}
    assert (logs["2 to 5"]["right"], logs["2 to 5"]["with_false_name"]) == (0, 1)
    assert logs["2 to 5"]["over_truth"]["within"] == pytest.approx(2 / 3)
    assert summary(ROWS)["logs"] == {}


def test_coverage_and_errors():
    content = summary(ROWS)
    machine = content["coverage"]["clean, machine"]
    assert (machine["parameters"], machine["68"], machine["95"]) == (4, 0.5, 0.75)
    assert content["coverage"]["clean, effects"] == {"parameters": 0}
    assert content["unseen"]["residue_over_truth"]["within"] == 0.0
    rng = np.random.default_rng(0)
    many = summary([_row(i, kind="none", z=tuple(rng.standard_normal(50))) for i in range(40)])["coverage"]
    assert many["clean, machine"]["95"] == pytest.approx(0.95, abs=0.02)


def test_figures_are_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr("benchmarks.random_rigs_plots.FIGURES", tmp_path)
    draw(ROWS, summary(ROWS), "random_rigs_1")
    assert len(list(tmp_path.glob("random_rigs_1_*.png"))) == 4
