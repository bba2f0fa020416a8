"""Record the rigs to disk: the runs as a user would have them, and the noise-free truth beside them.

A session is a folder with `runs/*.csv.gz`, `machine.json` (the declared machine), `truth.npz` (noise-free
measurements by run) and `session.json` (its origin). It is recorded again after the rig or the simulator's
source has changed.
"""

from __future__ import annotations

import ast
import gzip
import hashlib
import json
import re
import shutil
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from hframe_gym.files import write_text
from hframe_gym.machine import Machine
from hframe_gym.recordings import Recording, load_machine, load_recordings, save_machine
from tests import reference_simulator as reference
from tests.reference_simulator import Array
from tests.reference_simulator.sensors import noisy
from tests.rigs import excitation
from tests.rigs.cases import Case
from tests.rigs.excitation import record_runs

DEFAULT_FOLDER = "out/rigs"
FORMAT = 1  # of the folder; increase it to have every session recorded again
DURATION_S = 2.0
# A rig is at rest when its recording begins. The simulated stage starts with unstretched belts and needs time
# to settle.
SETTLING_S = 0.3
COLUMNS = "time_s,v1_V,v2_V,phi1_rad,phi2_rad,x_m,y_m"


@dataclass(frozen=True)
class Session:
    """Recorded rig.

    Attributes:
        case: The rig.
        folder: Folder of its files.
    """

    case: Case
    folder: Path

    def machine(self) -> Machine:
        """Load the declared machine."""
        return load_machine(self.folder / "machine.json")

    def recordings(self) -> list[Recording]:
        """Load the recorded runs."""
        return load_recordings(self.folder / "runs", self.machine())

    def truth(self) -> dict[str, Array]:
        """Load the noise-free measurements phi1, phi2, rad, x, y, m, shape (n, 4), by the name of the run."""
        with np.load(self.folder / "truth.npz") as file:
            return {name: file[name] for name in file.files}


def record_sessions(cases: Iterable[Case], folder: str | Path, jobs: int = 1) -> Iterator[Session]:
    """Yield the sessions of some rigs, recording those that are missing or out of date.

    Args:
        cases: Rigs to record.
        folder: Folder of all sessions.
        jobs: Number of processes.

    Yields:
        One session per rig, in order.
    """
    folder, cases = Path(folder), list(cases)
    if jobs < 2:
        yield from (record(case, folder) for case in cases)
        return
    with ProcessPoolExecutor(jobs) as pool:
        yield from pool.map(record, cases, [folder] * len(cases))


def record(case: Case, folder: Path) -> Session:
    """Return the session of one rig; record it if it is missing or out of date.

    Args:
        case: Rig to record.
        folder: Folder of all sessions.

    Returns:
        The recorded session.
    """
    session_folder = folder / re.sub(r"[^\w%@.-]+", "_", case.name)
    session, key = Session(case, session_folder), _key(case)
    note = session_folder / "session.json"
    if note.is_file() and json.loads(note.read_text())["key"] == key:
        return session
    folder.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=folder, prefix=".") as scratch:
        complete = Path(scratch) / "session"
        _write_session(case, complete, key)
        shutil.rmtree(session_folder, ignore_errors=True)
        complete.rename(session_folder)
    return session


def _write_session(case: Case, folder: Path, key: str) -> None:
    """Play, measure and write the runs of a rig."""
    (folder / "runs").mkdir(parents=True)
    rig, sensors = case.rig()
    rng = np.random.default_rng([case.seed, 2])
    runs = record_runs(
        case.seed,
        case.runs,
        DURATION_S + SETTLING_S,
        rig=rig,
        rest_s=SETTLING_S + 0.1,
        start_fraction=case.start_fraction,
    )
    first, truth = round(SETTLING_S * 1000), {}
    for index, run in enumerate(runs, start=1):
        ideal = sensors.ideal(run.time_s, run.positions, run.velocities)
        measured = noisy(ideal, rng)
        name = f"run_{index:02d}"
        truth[name] = ideal[first:]
        _write(folder / "runs" / f"{name}.csv.gz", run.time_s[first:], run.inputs[first:], measured[first:])
    np.savez_compressed(folder / "truth.npz", **truth)
    save_machine(load_machine("hframe"), folder / "machine.json")
    planted = {effect.label: effect.parameters for effect in case.hidden_effects}
    note = {"key": key, "name": case.name, "planted": planted, "rig": repr(rig)}
    write_text(folder / "session.json", json.dumps(note, indent=1) + "\n")


def _key(case: Case) -> str:
    """Return a hash of everything that determines a session."""
    origin = (FORMAT, case.rig(), case.seed, case.runs, case.start_fraction, DURATION_S, SETTLING_S)
    text = hashlib.sha256(repr(origin).encode())
    sources = [*sorted(Path(reference.__file__).parent.glob("*.py")), Path(excitation.__file__)]
    for source in sources:
        text.update(ast.dump(ast.parse(source.read_text())).encode())  # comments do not count
    return text.hexdigest()


def _write(path: Path, time_s: Array, inputs: Array, outputs: Array) -> None:
    """Write one run; the same run gives the same bytes."""
    lines = [COLUMNS]
    for t, volts, measured in zip(time_s, inputs, outputs, strict=True):
        fields = [f"{t:.3f}", *(f"{v:.3f}" for v in volts), *(f"{value + 0.0:.6f}" for value in measured)]
        lines.append(",".join(fields))
    path.write_bytes(gzip.compress(("\n".join(lines) + "\n").encode(), compresslevel=6, mtime=0))
