"""Copy the example recordings and notebooks, which the repository and the wheel contain."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from ..errors import InputError

_PACKAGE = Path(__file__).resolve().parents[1]
_PARTS = ("README.md", "rig_a", "rig_b", "notebooks")  # those of the folder examples/ that the wheel contains


def examples_folder() -> Path:
    """Return the folder with the example recordings, in the installed package or the repository.

    Raise an InputError if there is none.
    """
    for folder in (_PACKAGE / "examples", _PACKAGE.parent / "examples"):
        if (folder / "rig_a").is_dir():
            return folder
    raise InputError(
        f"{_PACKAGE}: this installation has no examples; the repository has them in its folder examples"
    )


def copy_examples(out: str | Path) -> list[Path]:
    """Copy two example rigs with their description, and example notebooks, to a new folder; return the paths.

    Args:
        out: Folder to create; it must not exist, unless it is an empty folder. It appears complete or not at
            all.

    Raises:
        InputError: If `out` is a file or a folder that is not empty, or this installation has no examples.
        OSError: If the folder cannot be written.
    """
    target = Path(out)
    if target.exists() and not (target.is_dir() and not any(target.iterdir())):
        raise InputError(f"--out {target}: exists already and is not replaced; give the name of a new folder")
    source = examples_folder()
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=target.parent, prefix=f".{target.name}-") as temporary:
        complete = Path(temporary) / "examples"
        complete.mkdir()
        for name in _PARTS:
            if (source / name).is_dir():
                # Neither what a notebook wrote nor hidden files.
                shutil.copytree(source / name, complete / name, ignore=shutil.ignore_patterns("out", ".*"))
            else:
                shutil.copyfile(source / name, complete / name)
        if target.exists():
            target.rmdir()
        complete.rename(target)
    return [target / name for name in _PARTS]
