"""Sessions of the benchmark's rigs on disk: the runs as a user would have them, and the truth beside them.

A session is a folder: ``runs/*.csv.gz``, ``machine.json`` (as declared), ``truth.npz`` (noise-free readings by run) and
``session.json`` (what it was made from). It is made again when the rig or the simulator's source has changed.
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

from hframe_gym.atomic_files import write_text
from hframe_gym.machine import Machine
from hframe_gym.recordings import Recording, load_machine, load_recordings, save_machine
from tests import reference_simulator as reference
from tests.reference_simulator import Array
from tests.reference_simulator.sensors import noisy
from tests.rigs import excitation
from tests.rigs.excitation import runs
from tests.rigs.rigs import Case

DEFAULT_FOLDER = "out/rigs"
FORMAT = 1  # of the folder: a change here makes every session again
DURATION_S = 2.0
# A rig has come to rest when its recording begins; the simulated one starts with unstretched belts and gets time.
SETTLING_S = 0.3
COLUMNS = "time_s,v1_V,v2_V,phi1_rad,phi2_rad,x_m,y_m"


@dataclass(frozen=True)
class Session:
    """A recorded rig."""

    case: Case
    folder: Path

    def machine(self) -> Machine:
        return load_machine(self.folder / "machine.json")

    def recordings(self) -> list[Recording]:
        return load_recordings(self.folder / "runs", self.machine())

    def truth(self) -> dict[str, Array]:
        """Noise-free readings (n, 4) of phi1, phi2, x, y, by run."""
        with np.load(self.folder / "truth.npz") as file:
            return {name: file[name] for name in file.files}


def recorded(cases: Iterable[Case], folder: str | Path, jobs: int = 1) -> Iterator[Session]:
    """The sessions of these rigs, recorded now where that has not been done."""
    folder, cases = Path(folder), list(cases)
    if jobs < 2:
        yield from (record(case, folder) for case in cases)
        return
    with ProcessPoolExecutor(jobs) as pool:
        yield from pool.map(record, cases, [folder] * len(cases))


def record(case: Case, folder: Path) -> Session:
    """One rig's session, from the folder's copy if that is still right."""
    place = folder / re.sub(r"[^\w%@.-]+", "_", case.name)
    session, key = Session(case, place), _key(case)
    note = place / "session.json"
    if note.is_file() and json.loads(note.read_text())["key"] == key:
        return session
    folder.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=folder, prefix=".") as scratch:
        whole = Path(scratch) / "session"
        _make(case, whole, key)
        shutil.rmtree(place, ignore_errors=True)
        whole.rename(place)
    return session


def _make(case: Case, place: Path, key: str) -> None:
    (place / "runs").mkdir(parents=True)
    rig, sensors = case.rig()
    rng = np.random.default_rng([case.seed, 2])
    made = runs(
        case.seed, case.runs, DURATION_S + SETTLING_S, rig=rig, rest_s=SETTLING_S + 0.1, start_share=case.start_share
    )
    first, truth = round(SETTLING_S * 1000), {}
    for index, run in enumerate(made, start=1):
        ideal = sensors.ideal(run.time_s, run.positions, run.velocities)
        reading = noisy(ideal, rng)
        name = f"run_{index:02d}"
        truth[name] = ideal[first:]
        _write(place / "runs" / f"{name}.csv.gz", run.time_s[first:], run.inputs[first:], reading[first:])
    np.savez_compressed(place / "truth.npz", **truth)
    save_machine(load_machine("hframe"), place / "machine.json")
    planted = {p.label: p.truth for p in case.planted}
    note = {"key": key, "name": case.name, "planted": planted, "rig": repr(rig)}
    write_text(place / "session.json", json.dumps(note, indent=1) + "\n")


def _key(case: Case) -> str:
    """Hash of all that a session follows from."""
    made_from = (FORMAT, case.rig(), case.seed, case.runs, case.start_share, DURATION_S, SETTLING_S)
    text = hashlib.sha256(repr(made_from).encode())
    sources = [*sorted(Path(reference.__file__).parent.glob("*.py")), Path(excitation.__file__)]
    for source in sources:
        text.update(ast.dump(ast.parse(source.read_text())).encode())  # a comment changes nothing
    return text.hexdigest()


def _write(path: Path, time_s: Array, inputs: Array, outputs: Array) -> None:
    lines = [COLUMNS]
    for t, volts, read in zip(time_s, inputs, outputs, strict=True):
        fields = [f"{t:.3f}", *(f"{v:.3f}" for v in volts), *(f"{o + 0.0:.6f}" for o in read)]
        lines.append(",".join(fields))
    path.write_bytes(gzip.compress(("\n".join(lines) + "\n").encode(), compresslevel=6, mtime=0))
