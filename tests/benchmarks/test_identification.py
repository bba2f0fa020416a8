"""Test the cache of the identification benchmark, its behavior on exceptions, and what it writes."""

import json

import pytest

from benchmarks import identification
from tests.rigs.cases import Case, cases

CASE = Case("short", "none", "none", "", (), runs=2)
ROW = {
    "group": "none",
    "score": "right",
    "before": 2.0,
    "after": 1.0,
    "truth_um": {"before": 30.0, "after": 1.0},
    "parameter_error": {"belt_play@belts.d": 0.01},
    "seconds": 3.0,
    "cpu_seconds": 4.0,
}


@pytest.fixture
def counted(tmp_path, monkeypatch):
    """Replace identification by a counter; return the list of its calls."""
    calls = []

    def identify(recordings, machine, budget):
        calls.append(len(recordings))
        return len(calls)

    monkeypatch.setattr(identification, "CACHE", tmp_path / "cache")
    monkeypatch.setattr(identification, "identify", identify)
    monkeypatch.setattr(
        identification, "score_session", lambda session, answer: {"rig": session.case.name, "answer": answer}
    )
    (tmp_path / "cache").mkdir()
    return calls


def test_result_is_cached_as_long_as_the_source_is_the_same(counted, tmp_path):
    first = identification.identify_case(CASE, str(tmp_path / "rigs"), "source", resume=False)
    assert identification.identify_case(CASE, str(tmp_path / "rigs"), "source", resume=False) == first
    assert counted == [2]
    assert identification.identify_case(CASE, str(tmp_path / "rigs"), "other", resume=True) == first
    assert identification.identify_case(CASE, str(tmp_path / "rigs"), "other", resume=False)["answer"] == 2


def test_exception_gives_a_row_that_is_not_cached(counted, tmp_path, monkeypatch):
    def crash(recordings, machine, budget):
        raise KeyError("bridge")

    with monkeypatch.context() as broken:
        broken.setattr(identification, "identify", crash)
        row = identification.identify_case(CASE, str(tmp_path / "rigs"), "source", resume=False)
    assert "KeyError: 'bridge'" in row["failed"]
    assert "CRASHED" in identification.line(row)
    assert "failed" not in identification.identify_case(CASE, str(tmp_path / "rigs"), "source", resume=False)


def test_only_complete_sets_are_written(tmp_path, monkeypatch):
    written = {}
    monkeypatch.setattr(
        identification, "write_results", lambda name, content, seed: written.update({name: content})
    )
    count = sum(case.group == "none" for case in cases().values())
    identification.write([ROW] * (count - 1))
    assert written == {}
    wrong = ROW | {"score": "false alarm", "after": 5.0}
    identification.write([ROW] * (count - 1) + [wrong])
    summary = written["identification_none"]["summary"]
    assert summary["scores"]["false alarm"] == 1
    assert summary["scores"]["right"] == count - 1
    assert summary["median"]["after"] == 1.0
    json.dumps(written)
