"""Test which rows of a benchmark are kept, and by which sources they are valid."""

import shutil
from pathlib import Path

import pytest

import hframe_gym
from benchmarks.row_cache import INDEPENDENT, RowCache, source_key


def test_only_rows_that_are_missing_are_computed(tmp_path):
    computed = []

    def compute(index):
        computed.append(index)
        return {"failed": "KeyError"} if index == 2 else {"index": index}

    rigs = {f"rig_{index}": index for index in range(3)}
    rows = list(RowCache(tmp_path / "new", "sources").complete(compute, rigs))
    assert rows == [{"index": 0}, {"index": 1}, {"failed": "KeyError"}]
    again = RowCache(tmp_path / "new", "sources").complete(compute, {"rig_3": 3, **rigs})
    assert list(again) == [{"index": 3}, *rows]
    assert computed == [0, 1, 2, 3, 2]


def test_rows_of_other_sources_are_valid_on_request_only(tmp_path):
    RowCache(tmp_path, "sources").keep("rig", {"index": 0})
    assert RowCache(tmp_path, "others").row("rig") is None
    assert RowCache(tmp_path, "others", resume=True).row("rig") == {"index": 0}


def test_the_key_depends_on_further_sources_but_tests():
    of_rigs = source_key("tests/rigs")
    assert len({source_key(), of_rigs, source_key("benchmarks/scoring.py")}) == 3
    assert source_key("tests/rigs", "tests/benchmarks/test_row_cache.py") == of_rigs


def test_the_key_depends_on_the_sources_that_identification_uses(tmp_path, monkeypatch):
    used = (
        "dynamics/physics",
        "effects",
        "identification/judge",
        "machine",
        "preparation",
        "recordings/logs",
    )
    package = Path(hframe_gym.__file__).parent
    for name in (*used, *INDEPENDENT):
        assert (package / name).is_dir(), name
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "module.py").write_text("x = 1\n")
    monkeypatch.setattr(hframe_gym, "__file__", str(tmp_path / "__init__.py"))
    keys = [source_key()]
    for name in used:
        (tmp_path / name / "module.py").write_text("x = 2\n")
        keys.append(source_key())
    assert len(set(keys)) == 1 + len(used)
    for name in INDEPENDENT:
        (tmp_path / name / "module.py").write_text("x = 2\n")
    assert source_key() == keys[-1]
    shutil.rmtree(tmp_path / INDEPENDENT[0])
    with pytest.raises(FileNotFoundError, match=r"correct INDEPENDENT"):
        source_key()
