"""Result files of protocols: write, read and validate them.

A protocol is a fixed benchmark. Its parts are tasks that are scored separately; its draws are the episodes
(start, goal and machine parameters) that all entries, that is, controllers or agents, face. A result file
names the protocol and its digest, the entry with its hash, and the versions of the packages. It holds the
values of every draw, and the scores that follow from them.

Reading a file checks the schema, the digest, the checksum and the number of draws. No draw may be faster than
its stored time-optimal bound, or have values that no motion has. The scores are computed again. A file that
was edited, or that belongs to another machine or other draws, is refused. Only running the entry again
(`compare_draws`) shows that the values are true.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ...errors import InputError
from ...files import write_text
from ..metrics import BANDS, BOUND_BAND
from ..package_versions import result_versions
from ..runner import SAMPLES_PER_PERIOD
from .entries import Entry
from .protocol import Draws, Protocol, get_protocol
from .scores import DIGITS, part_scores, protocol_bounds

SCHEMA = 2
ROUNDING = 1e-6  # s or mm; the values of draws are rounded to 6 decimals
GRID_TOLERANCE = 1e-2  # of the time between two samples; settling times are multiples of it
TOLERANCE = 1e-6  # relative, of scores that are computed again when a file is read


class _Strict(BaseModel):
    """Table of a file in which unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


# Without characters that would end a cell of the leaderboard's table.
_Text = Annotated[str, Field(max_length=120, pattern=r"^[^|<>`\n]*$")]
# Processor time in the unit that the key names; null where it is not known.
_Cost = Annotated[float, Field(ge=0.0)] | None


class EntryTable(_Strict):
    """What was scored: name, kind, hash, what it observes and knows, what it costs; see `Entry`."""

    name: Annotated[str, Field(min_length=1, max_length=60, pattern=r"^[^|<>`\n]+$")]
    kind: Literal["controller", "agent"]
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    algorithm: _Text
    observes: Literal["state", "measurements", "Kalman estimates"]
    model: _Text
    training_steps: Annotated[int, Field(ge=0)] | None
    training_cpu_s: _Cost
    control_us: _Cost


class ResultFile(_Strict):
    """Content of a result file.

    Attributes:
        schema_version: Version of the format; the key in the file is `schema`.
        protocol: Name of the protocol.
        digest: Digest of the protocol's settings and draws.
        entry: What was scored.
        about: Free text of the submitter: how the entry was made, where to find it.
        versions: Versions of the packages on which the scores depend.
        checksum: SHA-256 of everything but `about` and the scores, which follow from the draws.
        scores: Scores by part and metric.
        draws: Values of every draw by part and metric; null for a draw that does not settle.
    """

    schema_version: Literal[2] = Field(alias="schema")
    protocol: str
    digest: str
    entry: EntryTable
    about: Annotated[str, Field(max_length=500)] = ""
    versions: dict[str, str]
    checksum: str
    scores: dict[str, dict[str, Any]]
    draws: dict[str, dict[str, list[float | None]]]


def result_content(protocol: Protocol, entry: Entry, draws: Mapping[str, Draws]) -> dict[str, Any]:
    """Build the content of a result file, a `ResultFile` with an empty `about`: an entry's scores.

    Args:
        protocol: The protocol of the draws.
        entry: The controller or agent that was scored.
        draws: Values of all episodes of the protocol ("draws"): by part (task) and by metric, such as
            `final_error_mm`, a list with one value per episode, mm or s.
    """
    content = {
        "schema": SCHEMA,
        "protocol": protocol.name,
        "digest": protocol.digest,
        "entry": entry._asdict(),
        "about": "",
        "versions": result_versions(),
        "scores": {part: part_scores(values, protocol.duration_s) for part, values in draws.items()},
        "draws": {part: dict(values) for part, values in draws.items()},
    }
    return {**content, "checksum": checksum(content)}


def checksum(content: Mapping[str, Any]) -> str:
    """Compute the SHA-256 of a result file's content, which detects accidental edits after the run.

    It covers the protocol with its digest, the entry, the versions and the draws. Someone who edits the draws
    on purpose can compute it again; only a repetition of the run reveals that.
    """
    covered = {key: content[key] for key in ("protocol", "digest", "entry", "versions", "draws")}
    return hashlib.sha256(json.dumps(covered, sort_keys=True).encode()).hexdigest()


def result_file_name(content: Mapping[str, Any]) -> str:
    """Return the name of a result file, PROTOCOL_ENTRY.json, for example "reach-v1_adaptive-pid.json".

    In the name of the entry, characters other than letters, digits, "-" and "." become "-".
    """
    safe = "".join(c if c.isalnum() or c in "-." else "-" for c in content["entry"]["name"])
    return f"{content['protocol']}_{safe}.json"


def write_result(folder: str | Path, content: Mapping[str, Any]) -> Path:
    """Write the result of `result_content` to PROTOCOL_ENTRY.json in a folder; return the path of the file.

    The folder is created if necessary. An existing file is replaced, or unchanged if writing fails.

    Args:
        content: The result; `about` may be added to it.
    """
    path = Path(folder) / result_file_name(content)
    head = {key: value for key, value in content.items() if key != "draws"}
    lines = [
        f"  {json.dumps(part)}: {{\n"
        + ",\n".join(f"   {json.dumps(metric)}: {json.dumps(column)}" for metric, column in values.items())
        + "\n  }"
        for part, values in content["draws"].items()
    ]
    text = (
        json.dumps(head, indent=1, allow_nan=False)[:-2]
        + ',\n "draws": {\n'
        + ",\n".join(lines)
        + "\n }\n}\n"
    )
    write_text(path, text)
    return path


def read_result(path: str | Path) -> ResultFile:
    """Read a result file (scores of a controller or agent in a protocol) and check its consistency.

    Raises:
        InputError: If the file is not a result file, names an unknown protocol, or lacks the digest (hash),
            parts (tasks), metrics or number of draws (episodes) of this protocol. Also if it was edited
            (checksum), or its scores do not follow from its values of the draws.
        OSError: If the file cannot be read.
    """
    try:
        result = ResultFile.model_validate_json(Path(path).read_bytes())
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the file"
        raise InputError(
            f"{path}: {where}: {first['msg']}; write it with hframe evaluate --protocol"
        ) from None
    try:
        protocol = get_protocol(result.protocol)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    if result.digest != protocol.digest:
        raise InputError(
            f"{path}: digest {result.digest} is not that of protocol {protocol.name} ({protocol.digest}): "
            "it was scored on another machine or other draws"
        )
    if result.checksum != checksum(result.model_dump(by_alias=True)):
        raise InputError(
            f"{path}: checksum does not fit: protocol, entry, versions or draws were edited after the run; "
            f"run it again with hframe evaluate --protocol {protocol.name}"
        )
    _check_draws(Path(path), result, protocol)
    return result


def _check_draws(path: Path, result: ResultFile, protocol: Protocol) -> None:
    """Raise InputError unless all parts and draws are there and the scores follow from them."""
    if set(result.draws) != set(protocol.parts):
        raise InputError(
            f"{path}: draws has the parts {', '.join(result.draws)}, not {', '.join(protocol.parts)}"
        )
    for part, values in result.draws.items():
        settling = [f"settling_s.{band}" for band in BANDS]
        path_metrics = ["contour_rms_mm", "contour_max_mm", "tracking_rms_mm"]
        expected = [*settling, "final_error_mm"] if protocol.parts[part].metrics == "reach" else path_metrics
        if list(values) != expected:
            raise InputError(f"{path}: draws.{part} has {', '.join(values)}, not {', '.join(expected)}")
        for metric, column in values.items():
            may_be_null = metric in settling  # a draw need not settle
            valid = all(may_be_null if value is None else value >= 0.0 for value in column)
            if len(column) != protocol.draws or not valid:
                raise InputError(
                    f"{path}: draws.{part}.{metric}: "
                    f"must hold {protocol.draws} values that are not negative (null only for a settling time)"
                )
        check = _check_moves if protocol.parts[part].metrics == "reach" else _check_paths
        check(f"{path}: draws.{part}", values, protocol)
        if not _close(result.scores.get(part), part_scores(values, protocol.duration_s)):
            raise InputError(f"{path}: scores.{part} do not follow from the draws; write the file again")


def _impossible(where: str, draw: int, reason: str) -> InputError:
    """Return the error for a draw whose values cannot be those of a motion."""
    return InputError(f"{where}: draw {draw} is impossible: {reason}")


def _check_paths(where: str, values: Draws, protocol: Protocol) -> None:
    """Raise InputError if the errors of a draw cannot be those along a path: no mean exceeds its maximum."""
    rms, largest, tracking = (np.array(values[name], np.float64) for name in values)
    for draw in np.flatnonzero((rms > largest + ROUNDING) | (rms > tracking + ROUNDING))[:1]:
        reason = f"a contour error of {rms[draw]:g} mm rms exceeds its maximum or the tracking error"
        raise _impossible(where, int(draw), reason)


def _check_moves(where: str, values: Draws, protocol: Protocol) -> None:
    """Raise InputError if the settling times of a draw cannot be those of its move to a point.

    They are samples of the episode, agree with the error at its end, are no shorter for a narrower band than
    for a wider one, and no shorter than any controller permits.
    """
    sample_s = protocol.period / SAMPLES_PER_PERIOD
    error = np.array(values["final_error_mm"], np.float64)
    wider_band = np.zeros(len(error))  # settling times, s
    for band, radius in BANDS.items():
        name = f"settling_s.{band}"
        column = values[name]
        times = np.array([np.nan if time is None else time for time in column], np.float64)
        beyond = error - 1e3 * radius  # mm; an error that is rounded to the radius may be on either side
        off_grid = np.abs(times / sample_s - np.rint(times / sample_s)) > GRID_TOLERANCE
        for draw in np.flatnonzero(off_grid | (times > protocol.duration_s + ROUNDING))[:1]:
            raise _impossible(where, int(draw), f"{name} = {times[draw]:g} s is no sample of the episode")
        for draw in np.flatnonzero(np.where(np.isnan(times), beyond < -ROUNDING, beyond > ROUNDING))[:1]:
            reason = f"{name} is {column[draw]} and the error at the end is {error[draw]:g} mm"
            raise _impossible(where, int(draw), reason)
        for draw in np.flatnonzero(times < wider_band)[:1]:
            raise _impossible(
                where, int(draw), f"it settles within {band} before it settles within the wider band"
            )
        wider_band = np.fmax(wider_band, times)
        for shortest_s in protocol_bounds(protocol.name).values() if radius <= BANDS[BOUND_BAND] else ():
            for draw in np.flatnonzero(times < shortest_s - sample_s)[:1]:
                bound = f"{times[draw]:g} s is less than the shortest possible time, {shortest_s[draw]:.4f} s"
                raise _impossible(where, int(draw), f"{name} = {bound}")


def _close(given: Any, computed: Any) -> bool:
    """Return whether nested scores are equal within `TOLERANCE`."""
    if isinstance(computed, Mapping):
        return (
            isinstance(given, Mapping)
            and set(given) == set(computed)
            and all(_close(given[key], computed[key]) for key in computed)
        )
    if isinstance(computed, list):
        return isinstance(given, list) and len(given) == len(computed) and all(map(_close, given, computed))
    return isinstance(given, int | float) and math.isclose(
        given, computed, rel_tol=TOLERANCE, abs_tol=10.0**-DIGITS
    )
