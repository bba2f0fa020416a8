"""Identify a plant from its recordings, once: the machines are kept in the folder of the results.

A folder of an identification holds the answer of `hframe identify` and `recordings.json` with a hash of the
recordings to which it belongs and of the code that identified them. A plant is identified again if either has
changed. Searches are complete: one that ends after a given processor time finds less on a slower processor,
so that an entry's scores would depend on the computer.
"""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.row_cache import source_key
from hframe_gym.files import write_text
from hframe_gym.identification import identify, write_result
from hframe_gym.machine import Machine
from hframe_gym.recordings import Recording, load_machine


class Identified(NamedTuple):
    """Machines of one identification.

    Attributes:
        refitted: The declared machine with its own parameters refitted.
        corrected: The same with the effects that were found, and the covariance of the parameters.
        verdict: "effect_found", "no_effect" or "unexplained".
        found: Labels name@site of the effects.
        left: Error left on held-out runs, in multiples of the sensors' noise; None if the simulation
            diverges.
        cpu_s: Processor time of the identification, s.
        held_out: Names of the runs to which nothing was fitted.
    """

    refitted: Machine
    corrected: Machine
    verdict: str
    found: tuple[str, ...]
    left: float | None
    cpu_s: float
    held_out: tuple[str, ...]


def identified(recordings: Sequence[Recording], declared: Machine, folder: Path) -> Identified:
    """Identify a plant, or load what an earlier call has identified from equal recordings.

    Args:
        folder: Folder of the identification; made if it does not exist.
    """
    note = folder / "recordings.json"
    known = json.loads(note.read_text("utf-8")) if note.is_file() else {}
    key = _key(recordings)
    if known.get("sha256") != key:
        began = time.process_time()
        write_result(identify(recordings, declared, budget=math.inf), folder)
        known = {"sha256": key, "cpu_s": round(time.process_time() - began, 1)}
        write_text(note, json.dumps(known) + "\n")
    report = json.loads((folder / "report.json").read_text("utf-8"))
    return Identified(
        load_machine(folder / "before.json"),
        load_machine(folder / "machine.json"),
        report["verdict"],
        tuple(f"{e['name']}@{e['site']}" for e in report["effects"]),
        report.get("left"),
        known["cpu_s"],
        tuple(report["runs"]["held_out"]),
    )


def _key(recordings: Sequence[Recording]) -> str:
    """Return a hash of recordings and of the code that identifies them."""
    digest = hashlib.sha256(source_key().encode())
    for recording in recordings:
        digest.update(recording.name.encode())
        for values in (recording.time_s, recording.inputs, recording.outputs):
            digest.update(np.ascontiguousarray(np.round(values, 9), np.float64).tobytes())
    return digest.hexdigest()
