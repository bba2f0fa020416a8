"""Test the rows of public recordings, which are written by hand, and what their tables make of them."""

from __future__ import annotations

from typing import Any

import pytest

from tools.tables.real_recordings import KINDS, MACHINES, SOURCE, above, ratios, recordings, summary
from tools.tables.result_tables import load_results


def row(recording: str, delivered: list[float], to_beat: list[float], **more: Any) -> dict[str, Any]:
    errors = {
        "declared": [1234.5],
        "plain": None,
        "refitted": [2.0],
        "delivered": delivered,
        "to_beat": to_beat,
    }
    texts = {"log": "100 Hz", "source": "owner/name", "describe": "`motor`", "measured": "1a2b3c4d"}
    given = {
        "recording": recording,
        "kind": "motor",
        "verdict": "unexplained",
        "unit": "rad",
        "cpu_seconds": 9.0,
    }
    return {**given, **texts, "errors": errors, **more}


def results(*rows: dict[str, Any]) -> dict[str, Any]:
    return {"kinds": {"motor": "Motors"}, "recordings": list(rows)}


def test_a_recording_counts_with_its_worst_coordinate() -> None:
    content = results(row("one", [1.0], [4.0]), row("two", [1.0, 3.0], [2.0, 2.0], cause="it sticks"))
    assert ratios(content["recordings"][1]) == [0.5, 1.5]
    assert "| Motors | 2 | 1 | 1 | 0.88 | 1.50 |" in summary(content)
    assert above(content).splitlines()[2:] == ["| two | motors | 0.500, 1.500 | it sticks |"]


def test_a_recording_worse_than_the_fit_to_beat_needs_a_cause() -> None:
    with pytest.raises(KeyError, match="cause"):
        above(results(row("one", [3.0], [2.0])))


def test_errors_of_a_machine_that_was_not_measured_are_left_out() -> None:
    text = recordings(results(row("one", [1.0], [4.0], verdict=["cogging"], note="It ripples.")), "motor")
    assert "| one | `cogging` | rad | 1234 | - | 2 | 1 | 4 | 0.25 | 9 s | 1a2b3c4d |" in text
    assert text.endswith("- **one**: 100 Hz (owner/name). Described as `motor`. It ripples.")


def test_rows_are_complete() -> None:
    content = load_results(SOURCE)
    names = [r["recording"] for r in content["recordings"]]
    assert len(set(names)) == len(names)
    assert tuple(content["kinds"]) == KINDS
    for r in content["recordings"]:
        assert r["kind"] in KINDS, r["recording"]
        assert tuple(r["errors"]) == MACHINES, r["recording"]
        assert {len(values) for values in r["errors"].values() if values} == {len(ratios(r))}, r["recording"]
