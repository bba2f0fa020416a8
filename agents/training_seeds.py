"""Training of several seeds at a time, in local processes or on Ray."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..files import files_of, newest, output_batch, write_files
from ..line_log import LineLog
from ..machine import Machine
from ..parallel import map_tasks
from ..recordings import load_machine
from .agent_files import RESUME_FILES, refuse_to_replace
from .checkpoint_signature import sign_checkpoint
from .optional_dependencies import require_training_packages
from .recipe import Recipe, build_task, load_recipe, require_transfers
from .training import Progress, train


def train_seeds(
    algorithm: str | Recipe,
    machine: str | Path | Machine = "hframe",
    task: str = "reach",
    *,
    steps: int | None = None,
    seeds: Sequence[int] = (0, 1, 2),
    randomize: str | None = None,
    out: str | Path = "agents",
    force: bool = False,
    log: LineLog = print,
    progress: Progress = lambda done, total: None,
    jobs: int = 1,
    ray: str | None = None,
    show_curves: bool = True,
) -> dict[int, dict[str, Any]]:
    """Train one agent per seed, several at a time; each is equal, bit for bit, to the result of `train`.

    Worker processes train on one core each in temporary folders. The calling process writes an agent when its
    training is complete; if the calling process ends before, incomplete runs are lost. A run whose worker
    dies starts again. Arguments that are not described are those of `train`.

    Args:
        seeds: Seeds, all different, one agent each.
        out: Folder for the agents: the agent of seed N in its folder seed_N, a single one in `out` itself.
        log: Function that receives one line of text when a run is complete.
        progress: Function that receives the number of complete runs and of all runs, after each run.
        jobs: Number of worker processes, and so of seeds that are trained at a time, for local processes.
        ray: Ray runs the workers instead: "local" starts it on this machine, "auto" is the running cluster
            that this machine belongs to, "HOST:PORT" the head node of a cluster. Default: local processes.
        show_curves: Whether a worker prints a line after each evaluation.

    Returns:
        Contents of each agent's card.json, by seed: recipe, package versions and learning curve.

    Raises:
        InputError: If an argument is wrong, a folder holds a run or is being written, or the cluster is out
            of reach.
        ImportError: If the extra `agents` is not installed, or the extra `ray` if the argument `ray` is
            given.
    """
    recipe = algorithm if isinstance(algorithm, Recipe) else load_recipe(algorithm, task)
    require_training_packages(recipe.kind)
    declared = load_machine(machine)
    build_task(recipe, task, declared.axis_unit)  # both raise errors before any worker starts
    require_transfers(recipe, declared, task)
    folders, done = _run_folders(Path(out), recipe.name, task, declared.name, seeds, force), 0

    def write(index: int, trained: tuple[dict[str, Any], dict[str, bytes]]) -> None:
        nonlocal done
        done += 1
        _write_run(folders[index], trained[1])
        log(f"seed {seeds[index]}: wrote {folders[index]} ({done} of {len(seeds)})")
        progress(done, len(seeds))

    run = partial(_train_in_worker, recipe, declared, task, steps, randomize, show_curves)
    results = map_tasks(run, seeds, jobs=jobs, ray=ray, completed=write)
    return {seed: card for seed, (card, _) in zip(seeds, results, strict=True)}


def _run_folders(
    out: Path, recipe: str, task: str, machine: str, seeds: Sequence[int], force: bool
) -> list[Path]:
    """Return the folder of each seed's run; refuse equal seeds, and a run that may not be replaced."""
    if len(set(seeds)) < len(seeds):
        raise InputError(f"seeds {', '.join(map(str, seeds))}: one is given twice")
    folders = [out / f"seed_{seed}" for seed in seeds] if len(seeds) > 1 else [out]
    for seed, folder in zip(seeds, folders, strict=True) if not force else ():
        refuse_to_replace(folder, recipe, task, machine, seed, alone=False)
    return folders


def _write_run(folder: Path, files: dict[str, bytes]) -> None:
    """Write the files of a run that a worker trained."""
    with output_batch(folder):
        write_files(folder, files)
        for name in files.keys() & RESUME_FILES[1:]:  # another installation signs with another key
            sign_checkpoint(newest(folder / name))


def _train_in_worker(
    recipe: Recipe,
    machine: Machine,
    task: str,
    steps: int | None,
    randomize: str | None,
    show_curve: bool,
    seed: int,
) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Train one seed in a temporary folder; return its card and all files."""

    def log(line: str) -> None:
        if show_curve:
            print(f"seed {seed}: {line}", flush=True)

    def run(folder: Path) -> dict[str, Any]:
        return train(recipe, machine, task, steps=steps, seed=seed, randomize=randomize, out=folder, log=log)

    return files_of(run)
