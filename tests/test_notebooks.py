"""The notebooks of examples/: their files, the names that they import, and whether they run."""

from __future__ import annotations

import ast
import importlib
import os
import re
from pathlib import Path
from typing import Any

import pytest

import hframe_gym
from hframe_gym.recordings import copy_examples

nbformat = pytest.importorskip("nbformat")
nbclient = pytest.importorskip("nbclient")

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "examples" / "notebooks").glob("*.ipynb"))
MAX_BYTES = 500_000
MAX_CELL_LINES = 25
MAX_SECONDS = 600  # of a cell; on two free cores a whole notebook takes less than two minutes
PRIVATE_PATH = re.compile(r"/(?:home|root|tmp|Users|work|usr|opt|var)/|[A-Z]:\\\\")

pytestmark = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def read(path: Path) -> Any:
    return nbformat.read(path, as_version=4)


def code_cells(path: Path) -> list[Any]:
    return [cell for cell in read(path).cells if cell.cell_type == "code"]


def tree(path: Path) -> ast.Module:
    """Return the syntax tree of a notebook's code, without IPython's magic commands."""
    lines = "\n".join(cell.source for cell in code_cells(path)).splitlines()
    return ast.parse("\n".join(line for line in lines if not line.startswith("%")))


def test_the_file_is_a_small_valid_notebook_without_private_paths(path: Path) -> None:
    nbformat.validate(read(path))
    text = path.read_text("utf-8")
    assert PRIVATE_PATH.findall(text) == []
    assert len(text.encode()) < MAX_BYTES


def test_every_cell_is_short_and_was_run_in_order_without_an_error(path: Path) -> None:
    cells = code_cells(path)
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    kinds = [output.output_type for cell in cells for output in cell.outputs]
    assert "error" not in kinds
    assert [output.text for cell in cells for output in cell.outputs if output.get("name") == "stderr"] == []
    assert sum("image/png" in output.get("data", {}) for cell in cells for output in cell.outputs) >= 3
    assert max(len(cell.source.splitlines()) for cell in cells) <= MAX_CELL_LINES


def test_the_names_that_it_uses_are_public(path: Path) -> None:
    imported = 0
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("hframe_gym"):
            module = importlib.import_module(node.module or "")
            for alias in node.names:
                imported += 1
                assert hasattr(module, alias.name), f"{node.module} has no {alias.name}"
                assert alias.name in getattr(module, "__all__", [alias.name]), f"{node.module}.{alias.name}"
        elif (
            isinstance(node, ast.Attribute)
            and isinstance(node.value, ast.Name)
            and node.value.id == "hframe_gym"
        ):
            imported += 1
            assert node.attr in hframe_gym.__all__
    assert imported >= 3


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # those of the Jupyter packages are not ours
def test_it_runs_in_a_copy_of_the_examples(path: Path, tmp_path: Path) -> None:
    copy_examples(tmp_path / "examples")
    copy = tmp_path / "examples" / "notebooks" / path.name
    notebook = read(copy)
    search_path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    client = nbclient.NotebookClient(
        notebook,
        timeout=MAX_SECONDS,
        kernel_name="python3",
        resources={"metadata": {"path": str(copy.parent)}},
    )
    client.execute(env={**os.environ, "PYTHONPATH": search_path})
    stored = [len(cell.outputs) > 0 for cell in code_cells(path)]
    assert [len(cell.outputs) > 0 for cell in notebook.cells if cell.cell_type == "code"] == stored
