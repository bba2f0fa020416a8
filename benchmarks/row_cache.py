"""Rows of results, one for each rig, which are kept in files, so that an interrupted benchmark continues."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import hframe_gym
from hframe_gym.files import write_text
from hframe_gym.parallel import map_tasks
from tools.repository import ROOT

# Packages on which no identification depends; all others count, so that a new one does as well.
INDEPENDENT = (
    *("agents", "app", "cli", "controllers", "data_validation", "differentiable"),
    *("envs", "evaluation", "exporters"),
)
Row = dict[str, Any]
Item = TypeVar("Item")


def source_key(*further: str) -> str:
    """Return a hash of all sources on which an identification can depend.

    Args:
        further: Other files on which a row depends, and folders of Python files, relative to the repository.
            Tests do not count.
    """
    package, text = Path(hframe_gym.__file__).parent, hashlib.sha256()
    for name in INDEPENDENT:
        if not (package / name).is_dir():
            raise FileNotFoundError(f"{package / name}: no such package; correct INDEPENDENT")
    for source in sorted(package.rglob("*.py")):
        if source.relative_to(package).parts[0] not in INDEPENDENT:
            text.update(source.read_bytes())
    for path in (ROOT / name for name in further):
        for source in sorted(path.glob("*.py")) if path.is_dir() else [path]:
            if not source.name.startswith("test_"):
                text.update(source.read_bytes())
    return text.hexdigest()


@dataclass(frozen=True)
class RowCache:
    """Rows in the files of a folder, which are valid as long as what they depend on is the same.

    Attributes:
        folder: Folder of the files, one for each rig.
        key: Hash of what the rows depend on, such as `source_key`.
        resume: Whether rows are valid although that has changed.
    """

    folder: Path
    key: str
    resume: bool = False

    def row(self, name: str) -> Row | None:
        """Return the row of a rig; None if there is no valid one."""
        file = self.folder / f"{name}.json"
        if not file.is_file():
            return None
        kept: dict[str, Any] = json.loads(file.read_text("utf-8"))
        return kept["row"] if self.resume or kept["key"] == self.key else None

    def keep(self, name: str, row: Row) -> None:
        """Write the row of a rig, unless its identification failed."""
        if "failed" not in row:
            self.folder.mkdir(parents=True, exist_ok=True)
            content = json.dumps({"key": self.key, "row": row}, indent=1)
            write_text(self.folder / f"{name}.json", content + "\n")

    def complete(
        self,
        compute: Callable[[Item], Row],
        items: Mapping[str, Item],
        *,
        jobs: int = 1,
        ray: str | None = None,
    ) -> Iterator[Row]:
        """Yield the rows of some rigs, in order; those that are not valid are computed, and kept.

        Args:
            compute: Function that returns the row of a rig.
            items: Its argument for each rig, by name.
            jobs: Number of parallel processes.
            ray: Address of a Ray cluster; None for local processes.
        """
        rows = {name: self.row(name) for name in items}
        missing = [name for name, row in rows.items() if row is None]
        computed = map_tasks(
            compute,
            [items[name] for name in missing],
            jobs=jobs,
            ray=ray,
            completed=lambda position, row: self.keep(missing[position], row),
        )
        yield from (next(computed) if row is None else row for row in rows.values())
