"""Result files of `gap-v1`: one JSON file per entry, with all episodes' values, from which scores follow.

A file names the protocol and its digest, the entry with a hash of its source, and the versions of the
packages. It is written after every plant, so that a run that ends early continues where it ended. Reading it
checks schema, digest and checksum, and that no move is much faster than its bound.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.gap.bounds import stored_bounds
from benchmarks.gap.control_loop import DURATION_S
from benchmarks.gap.entries import GapEntry, sha256_of
from benchmarks.gap.protocol import DIGEST, EPISODES, NAME, PARTS
from hframe_gym.errors import InputError
from hframe_gym.evaluation import result_versions
from hframe_gym.files import write_text
from tests.reference_simulator import Array
from tools.repository import ROOT

SCHEMA = 1
SETTLED = "settling_s.0.2mm"
RESAMPLES, BOOTSTRAP_SEED = 4000, 0
# A move is impossible if it takes less than this part of its bound, minus a sample of 1 ms. The bound leaves
# out effects that the optimization does not support; one that drives, such as a magnet, can make a move a
# little faster.
_POSSIBLE, _SAMPLE_S = 0.9, 1.1e-3


def new_content(name: str, entry: type[GapEntry], seed: int) -> dict[str, Any]:
    """Return the content of a file without plants."""
    return {
        "schema": SCHEMA,
        "protocol": NAME,
        "digest": DIGEST,
        "seed": seed,
        "entry": {
            "name": entry.name or name,
            "track": entry.track,
            "knowledge": entry.knowledge,
            "learned": entry.learned,
            "sha256": sha256_of(entry),
        },
        "versions": result_versions(),
        "plants": [],
    }


def kept_rows(before: dict[str, Any], sha256: str) -> list[dict[str, Any]]:
    """Return the rows of an earlier file for one of the present code; each says what scored it.

    Args:
        before: Content of the earlier file.
        sha256: Hash of the entry as it is now.

    Returns:
        The rows. One without a commit has the "version" of its file, and one that another source of the entry
        has scored the hash "sha256" of that source.
    """
    rows = []
    for row in before["plants"]:
        scored = {key: value for key, value in row.items() if key != "sha256"}
        if not row.get("commit"):
            scored.setdefault("version", before["versions"]["hframe_gym"])
        source = row.get("sha256", before["entry"]["sha256"])
        rows.append(scored if source == sha256 else {**scored, "sha256": source})
    return rows


def commit() -> str | None:
    """Return this checkout's commit, with "-dirty" where files differ from it; None if it is no checkout."""
    git = shutil.which("git")
    if git is None:
        return None
    command = [git, "describe", "--always", "--dirty", "--abbrev=8", "--exclude=*"]
    described = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    return described.stdout.strip() or None


def write(path: Path, content: dict[str, Any]) -> None:
    """Write a result file, completely or not at all.

    Args:
        content: Its content; the checksum is added.
    """
    ordered = dict(content, plants=sorted(content["plants"], key=lambda row: row["plant"]))
    ordered.pop("checksum", None)
    head = json.dumps({**ordered, "plants": [], "checksum": _checksum(ordered)}, indent=1)
    rows = ",\n".join("  " + json.dumps(row) for row in ordered["plants"])
    write_text(path, head.replace('"plants": []', f'"plants": [\n{rows}\n ]') + "\n")


def _checksum(content: dict[str, Any]) -> str:
    """Return a hash of a content without its checksum."""
    plain = {key: value for key, value in content.items() if key != "checksum"}
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()


def read(path: Path) -> dict[str, Any]:
    """Read a result file and check it.

    Raises:
        InputError: If it is no result file of this protocol, was edited, or holds what is impossible.
    """
    try:
        content = json.loads(path.read_text("utf-8"))
        found = {
            key: content[key]
            for key in ("schema", "protocol", "digest", "checksum", "plants", "entry", "seed")
        }
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{path}: no result file of {NAME} ({error}); write it with python -m benchmarks.gap"
        ) from None
    if (found["schema"], found["protocol"], found["digest"]) != (SCHEMA, NAME, DIGEST):
        raise InputError(
            f"{path}: schema {found['schema']}, protocol {found['protocol']}, digest {found['digest']}: "
            f"it must be {SCHEMA}, {NAME}, {DIGEST}; it was scored on other plants or episodes"
        )
    if found["checksum"] != _checksum(content):
        raise InputError(
            f"{path}: the checksum does not fit: the file was edited after the run; run it again"
        )
    bounds = stored_bounds(found["seed"])
    for row in found["plants"]:
        if "refused" in row:
            continue
        for part, columns in row["values"].items():
            if part not in PARTS or any(len(column) != EPISODES[part] for column in columns.values()):
                raise InputError(
                    f"{path}: plant {row['plant']}: {part} must hold {EPISODES.get(part, 0)} episodes"
                )
        least = bounds.get(row["plant"])
        times = np.array(row["values"]["reach"][SETTLED], np.float64)
        impossible = np.zeros(len(times), bool) if least is None else times < _POSSIBLE * least - _SAMPLE_S
        if least is not None and impossible.any():
            draw = int(np.flatnonzero(impossible)[0])
            raise InputError(
                f"{path}: plant {row['plant']}: move {draw} takes {times[draw]:g} s, "
                f"less than the shortest possible time, {least[draw]:.4f} s"
            )
    return dict(content)


class PlantScore(NamedTuple):
    """Scores of an entry on a plant.

    Attributes:
        settling_s: Settling times within 0.2 mm, s, shape (B,); an episode that does not settle counts 1.5 s.
        success: Fraction of moves that settle.
        over_bound: Mean settling time over the mean bound, of the moves with a bound; NaN if none has one.
        circle_mm: Distances to the path of the circle, rms, mm, shape (B,).
        square_mm: Distances to the path of the square, rms, mm, shape (B,).
        belt_force_N: Largest belt force of all episodes, N.
        saturated: Fraction of commands at the voltage limit.
        left: Fraction of episodes that leave the workspace.
    """

    settling_s: Array
    success: float
    over_bound: float
    circle_mm: Array
    square_mm: Array
    belt_force_N: float
    saturated: float
    left: float


def plant_scores(content: dict[str, Any]) -> dict[int, PlantScore]:
    """Compute the scores of an entry by the number of the plant, without the plants that it refuses.

    Args:
        content: Content of a result file.
    """
    bounds, scores = stored_bounds(content["seed"]), {}
    for row in content["plants"]:
        if "refused" in row:
            continue
        values = row["values"]
        column = values["reach"][SETTLED]
        settling = np.array([DURATION_S if value is None else value for value in column])
        least = bounds.get(row["plant"], np.full(len(settling), np.nan))
        known = np.isfinite(least)
        every = {
            key: np.concatenate([values[part][key] for part in PARTS])
            for key in ("belt_force_N", "saturated", "left_workspace")
        }
        scores[row["plant"]] = PlantScore(
            settling,
            float(np.mean([value is not None for value in column])),
            float(settling[known].mean() / least[known].mean()) if known.any() else float("nan"),
            np.array(values["circle"]["path_rms_mm"]),
            np.array(values["square"]["path_rms_mm"]),
            float(every["belt_force_N"].max()),
            float(every["saturated"].mean()),
            float(every["left_workspace"].mean()),
        )
    return scores


def interval(values: Sequence[float] | Array) -> tuple[float, float, float]:
    """Return the mean of values with its 95 % bootstrap interval.

    Args:
        values: Values by plant, shape (n,), or by seed and plant, shape (seeds, n): both are drawn.

    Returns:
        Mean, lower and upper limit; NaN without values.
    """
    array = np.atleast_2d(np.array(values, np.float64))
    if not array.size:
        return (float("nan"),) * 3
    rng, (seeds, count) = np.random.default_rng(BOOTSTRAP_SEED), array.shape
    plant, seed = (rng.integers(n, size=(RESAMPLES, n)) for n in (count, seeds))
    means = array[seed[:, :, None], plant[:, None, :]].mean(axis=(1, 2))
    low, high = np.quantile(means, [0.025, 0.975])
    return float(array.mean()), float(low), float(high)


class Comparison(NamedTuple):
    """How often an entry is better than another, in one part.

    Attributes:
        better: Number of plants on which its mean is lower.
        clearly_better: Number of those on which the 95 % interval of the paired difference excludes zero.
        worse: Number of plants on which its mean is higher.
        clearly_worse: Number of those on which the interval excludes zero.
        ratio: Mean over plants of the ratio of the means, with its 95 % interval.
        plants: Number of plants.
    """

    better: int
    clearly_better: int
    worse: int
    clearly_worse: int
    ratio: tuple[float, float, float]
    plants: int


def compare(contents: Sequence[dict[str, Any]], others: Sequence[dict[str, Any]], part: str) -> Comparison:
    """Compare an entry with another, episode by episode on every plant that both have.

    Args:
        contents: Result files of the entry, one per seed of its agent.
        others: Result files of the other entry: one for each of the same seeds, or a single one.
        part: "reach" (settling times), "circle" or "square" (distances to the path).

    Returns:
        The comparison, of means over the seeds; below 1 the entry is better.
    """
    field = {"reach": "settling_s", "circle": "circle_mm", "square": "square_mm"}[part]
    mine, theirs = ([plant_scores(content) for content in files] for files in (contents, others))
    counts, ratios = [0, 0, 0, 0], []
    for index in sorted(set.intersection(*(set(scores) for scores in (*mine, *theirs)))):
        a, b = (np.array([getattr(scores[index], field) for scores in of]) for of in (mine, theirs))
        ratios.append(a.mean(axis=1) / b.mean(axis=1))
        difference = a.mean(axis=0) - b.mean(axis=0)
        mean, low, high = interval(difference)
        counts[0] += mean < 0.0
        counts[1] += high < 0.0
        counts[2] += mean > 0.0
        counts[3] += low > 0.0
    return Comparison(*map(int, counts), interval(np.transpose(ratios)), len(ratios))
