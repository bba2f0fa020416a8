"""Write the recordings of a drawn rig as a user would have them, and the truth beside them."""

from __future__ import annotations

import gzip
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hframe_gym.recordings import Recording
from tests.rigs.hidden_effects import CHANNELS


def write_session(
    folder: Path, recordings: Sequence[Recording], unseen: Sequence[Recording], truth: Mapping[str, Any]
) -> None:
    """Write `runs`, `unseen` and `truth.json` to a folder.

    Args:
        folder: Folder of the session; created if it does not exist.
        recordings: Runs to identify.
        unseen: Runs for the error of the answer, never to be fitted.
        truth: What the rig hides, for people.
    """
    for name, runs in (("runs", recordings), ("unseen", unseen)):
        (folder / name).mkdir(parents=True, exist_ok=True)
        for recording in runs:
            table = np.column_stack([recording.time_s, recording.inputs, recording.outputs])
            lines = [",".join(("time_s", "v1_V", "v2_V", *CHANNELS))]
            lines += [",".join(f"{value:.9g}" for value in row) for row in table]
            data = gzip.compress(("\n".join(lines) + "\n").encode(), mtime=0)
            (folder / name / f"{recording.name}.csv.gz").write_bytes(data)
    (folder / "truth.json").write_text(json.dumps(truth, indent=1) + "\n")
