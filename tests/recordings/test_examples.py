"""The copy of the examples that `hframe examples` writes."""

from __future__ import annotations

from pathlib import Path

import pytest

from hframe_gym.errors import InputError
from hframe_gym.machine import Machine
from hframe_gym.recordings import copy_examples, examples, examples_folder, load_recordings


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_the_copy_has_both_rigs_the_notebooks_and_nothing_else(tmp_path: Path, hframe: Machine) -> None:
    paths = copy_examples(tmp_path / "new" / "examples")
    assert {path.name for path in paths} == {"README.md", "rig_a", "rig_b", "notebooks"}
    copied, source = files(tmp_path / "new" / "examples"), files(examples_folder())
    assert copied == {name: source[name] for name in copied}
    assert sum(name.endswith(".csv.gz") for name in copied) == 16
    assert sum(name.endswith(".ipynb") for name in copied) == 3
    assert len(copied) == 20
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["examples"]  # no temporary folder
    run = load_recordings(tmp_path / "new" / "examples" / "rig_b", hframe)[0]
    assert run.outputs.shape == (2500, 4)


def test_an_existing_folder_is_not_replaced_unless_it_is_empty(tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("mine")
    for existing in (tmp_path / "full", tmp_path / "full" / "mine.txt"):
        with pytest.raises(InputError, match="exists already and is not replaced"):
            copy_examples(existing)
    assert files(tmp_path) == {"full/mine.txt": b"mine"}
    (tmp_path / "empty").mkdir()
    copy_examples(tmp_path / "empty")
    assert (tmp_path / "empty" / "rig_a" / "run_01.csv.gz").is_file()


def test_an_installation_without_examples_says_where_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(examples, "_PACKAGE", tmp_path / "hframe_gym")
    with pytest.raises(InputError, match="has no examples; the repository has them in its folder examples"):
        copy_examples(tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_files_that_a_notebook_wrote_are_not_copied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    copy_examples(tmp_path / "examples")
    for hidden in ("out", ".ipynb_checkpoints"):
        (tmp_path / "examples" / "notebooks" / hidden).mkdir()
        (tmp_path / "examples" / "notebooks" / hidden / "file").write_text("")
    monkeypatch.setattr(examples, "_PACKAGE", tmp_path / "hframe_gym")
    copy_examples(tmp_path / "copy")
    assert len(files(tmp_path / "copy")) == 20
