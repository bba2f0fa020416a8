"""Tasks for worker processes, which import this module and nothing slow with it."""

from __future__ import annotations

import os
import time
from pathlib import Path

import numpy as np

from hframe_gym.errors import InputError
from hframe_gym.files import output_batch, write_text


def draw(seed: int, folder: Path | None = None, dies: int = -1, times: int = 1) -> tuple[int, bytes]:
    """Return a seed and numbers drawn from it; the task `dies` kills its worker the first `times` times."""
    numbers = np.random.default_rng(seed).standard_normal(1000).tobytes()
    if folder is not None:
        with (folder / f"started_{seed}").open("a") as file:
            file.write(f"{os.getpid()}\n")
        if seed == dies and len((folder / f"started_{seed}").read_text().split()) <= times:
            os._exit(9)  # as if it had been killed: nothing is cleaned up
    return seed, numbers


def threads_of(_: int) -> tuple[str, str]:
    """Return the numbers of threads that a worker may use."""
    return os.environ["HFRAME_THREADS"], os.environ["OMP_NUM_THREADS"]


def fail(seed: int) -> int:
    """Return seed 0, fail for seed 1, and sleep for ten minutes for every other."""
    if seed == 1:
        raise InputError("seed 1: is wrong")
    time.sleep(0 if seed < 1 else 600)
    return seed


def write_repeatedly(folder: Path, writer: int) -> tuple[int, int]:
    """Write a file and a batch that other processes write too; return how many were written and refused."""
    whole = refused = 0
    for _ in range(100):
        write_text(folder / "same.txt", f"{writer}" * 1000)
        text = (folder / "same.txt").read_text()
        whole += len(text) == 1000 and len(set(text)) == 1
        try:
            with output_batch(folder / "batch"):
                for name in ("a", "b"):
                    write_text(folder / "batch" / name, f"{writer}")
        except InputError:  # another process has locked the folder
            refused += 1
    return whole, refused


def announce(folder: str) -> None:
    """Write a file with the number of this process, and sleep for ten minutes."""
    (Path(folder) / f"worker_{os.getpid()}").touch()
    time.sleep(600)
