"""Result files of protocols: write, read and validate them, and compare entries draw by draw.

A protocol is a fixed benchmark; its parts are tasks that are scored separately; its draws are the episodes (start, goal
and machine parameters) that all entries, that is, controllers or agents, face. A result file names the protocol and its
digest, the entry with its hash, and the versions of the packages. It holds the values of every draw, and the scores
that follow from them. Reading it checks the schema, the digest, a checksum and the number of draws, that no draw is
faster than its stored bound or contradicts itself, and computes the scores again, so that a file that was edited or
belongs to another machine or other draws is refused. Only running it again (`compare_draws`) shows that it is true.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ..arrays import Array
from ..errors import InputError
from ..files import write_text
from .metrics import BANDS, BOUND_BAND, ratio_of_means, stored_bounds
from .package_versions import result_versions
from .protocol_entries import Entry
from .protocols import Draws, Protocol, get_protocol
from .runner import SAMPLES_PER_PERIOD

SCHEMA = 2
BOOTSTRAP_SEED = 0
BOUNDS_FOLDER = "bound_times_data"
DIGITS = 9  # decimals of scores, s and mm
ROUNDING = 1e-6  # s and mm, of the values of draws, which have 6 decimals
GRID_TOLERANCE = 1e-2  # of a sample
# Differences of a run that is repeated elsewhere: two samples of 1 ms, and 1 um and 1 % of an error in mm.
REPEATED_S, REPEATED_MM, REPEATED_FRACTION = 2.1e-3, 1e-3, 1e-2
# Fraction of draws that may differ by more; standard deviations of a sum of differences with random signs; fraction of
# a mean, for differences below the tolerances.
REPEATED_DRAWS, REPEATED_SIGMAS, REPEATED_MEAN = 0.12, 2.0, 0.002
TOLERANCE = 1e-6  # relative, of scores that are computed again when a file is read


class _Strict(BaseModel):
    """Table of a file in which unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


_Text = Annotated[str, Field(max_length=120, pattern=r"^[^|<>`\n]*$")]
_Cost = Annotated[float, Field(ge=0.0)] | None


class EntryTable(_Strict):
    """What was scored: name, kind, hash, what it observes and knows, what it costs; `Entry` documents the fields."""

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
    """Build the content of a result file, a `ResultFile` without `about`: the scores of an entry in a protocol.

    Args:
        entry: Name, kind and hash of the controller or agent.
        draws: Values of all episodes of the protocol ("draws"): by part (task) and by metric, such as `final_error_mm`,
            a list with one value per episode, mm or s.
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
    """Compute the SHA-256 by which a result file shows that it was not edited after the run.

    It covers the protocol with its digest, the entry, the versions and the draws. It protects against mistakes; whoever
    computes it anew is found by running the entry again.
    """
    covered = {key: content[key] for key in ("protocol", "digest", "entry", "versions", "draws")}
    return hashlib.sha256(json.dumps(covered, sort_keys=True).encode()).hexdigest()


def part_scores(values: Draws, duration_s: float) -> dict[str, Any]:
    """Compute the scores of one part of a protocol (a task) from the metrics of its single draws (episodes).

    Args:
        values: Values of the B draws by metric, e.g. `final_error_mm`, mm, or `settling_s.1mm`, s, None if not settled.
        duration_s: Length of an episode, s, which counts as the settling time of a draw that does not settle.

    Returns:
        By metric `mean`, `ci95` (95 % interval of the mean, bootstrap over the draws) and `median`, in the unit of the
        metric; for a settling time also `success`, the fraction of draws that settle, 0 to 1.
    """
    scores: dict[str, Any] = {}
    for metric, column in values.items():
        numbers = fill_unsettled(column, duration_s)
        mean = ratio_of_means(numbers, np.ones(len(numbers)), BOOTSTRAP_SEED)
        limits = [round(limit, DIGITS) for limit in mean["ci95"]]
        scores[metric] = {"mean": round(mean["mean"], DIGITS), "ci95": limits}
        scores[metric]["median"] = round(float(np.median(numbers)), DIGITS)
        if metric.startswith("settling_s."):
            scores[metric]["success"] = float(np.mean([value is not None for value in column]))
    return scores


def fill_unsettled(column: list[float | None], duration_s: float) -> Array:
    """Return a metric's values as an array, shape (B,), with the length of an episode for draws that do not settle.

    Args:
        column: B settling times, s, None for a draw that does not settle; values of another metric are not changed.
        duration_s: Length of an episode, s.
    """
    return np.array([duration_s if value is None else value for value in column], np.float64)


def result_file_name(content: Mapping[str, Any]) -> str:
    """Return the name of a result file, PROTOCOL_ENTRY.json, for example "reach-v1_adaptive-pid.json".

    In the name of the entry, characters other than letters, digits, "-" and "." become "-".
    """
    safe = "".join(c if c.isalnum() or c in "-." else "-" for c in content["entry"]["name"])
    return f"{content['protocol']}_{safe}.json"


def write_result(folder: str | Path, content: Mapping[str, Any]) -> Path:
    """Write the result of `result_content` to PROTOCOL_ENTRY.json in a folder; return the path of the file.

    If this fails, an existing file stays unchanged.
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
    """Read a result file (scores of a controller or agent in a protocol) and check that its scores are consistent.

    Raises:
        InputError: If the file is not a result file, names an unknown protocol, or lacks the digest (hash), parts
            (tasks), metrics or number of draws (episodes) of this protocol. Also if its scores do not follow from its
            values of the draws.
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
            f"{path}: digest {result.digest} is not that of protocol {protocol.name} ({protocol.digest}): it was "
            "scored on another machine or other draws"
        )
    if result.checksum != checksum(result.model_dump(by_alias=True)):
        raise InputError(
            f"{path}: checksum does not fit: protocol, entry, versions or draws were edited after the run; run it "
            f"again with hframe evaluate --protocol {protocol.name}"
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
            valid = all(metric in settling if v is None else v >= 0.0 for v in column)
            if len(column) != protocol.draws or not valid:
                raise InputError(
                    f"{path}: draws.{part}.{metric}: must hold {protocol.draws} values that are not negative (null "
                    "only for a settling time)"
                )
        _check_possible(path, part, values, protocol)
        if not _close(result.scores.get(part), part_scores(values, protocol.duration_s)):
            raise InputError(f"{path}: scores.{part} do not follow from the draws; write the file again")


def _check_possible(path: Path, part: str, values: Draws, protocol: Protocol) -> None:
    """Raise InputError if the values of a draw cannot be those of a motion; the message names the draw."""

    def refuse(draw: int, reason: str) -> None:
        raise InputError(f"{path}: draws.{part}: draw {draw} is impossible: {reason}")

    sample_s = protocol.period / SAMPLES_PER_PERIOD
    if protocol.parts[part].metrics != "reach":
        rms, largest, tracking = (np.array(values[name], np.float64) for name in values)
        for draw in np.flatnonzero((rms > largest + ROUNDING) | (rms > tracking + ROUNDING))[:1]:
            refuse(
                int(draw),
                f"a contour error of {rms[draw]:g} mm rms exceeds its maximum or the tracking error",
            )
        return
    error = np.array(values["final_error_mm"], np.float64)
    before = np.zeros(len(error))
    for band, radius in BANDS.items():
        column = values[f"settling_s.{band}"]
        times = np.array([np.nan if time is None else time for time in column], np.float64)
        off_grid = np.abs(times / sample_s - np.rint(times / sample_s)) > GRID_TOLERANCE
        for draw in np.flatnonzero(off_grid | (times > protocol.duration_s + ROUNDING))[:1]:
            refuse(int(draw), f"settling_s.{band} = {times[draw]:g} s is no sample of the episode")
        beyond = error - 1e3 * radius  # mm; an error that is rounded to the radius may be on either side
        for draw in np.flatnonzero(np.where(np.isnan(times), beyond < -ROUNDING, beyond > ROUNDING))[:1]:
            refuse(
                int(draw),
                f"settling_s.{band} is {column[draw]} and the error at the end is {error[draw]:g} mm",
            )
        for draw in np.flatnonzero(times < before)[:1]:
            refuse(int(draw), f"it settles within {band} before it settles within the wider band")
        before = np.fmax(before, times)
        if radius <= BANDS[BOUND_BAND]:
            for times_s in protocol_bounds(protocol.name).values():
                for draw in np.flatnonzero(times < times_s - sample_s)[:1]:
                    reason = (
                        f"{times[draw]:g} s is less than the shortest possible time, {times_s[draw]:.4f} s"
                    )
                    refuse(int(draw), f"settling_s.{band} = {reason}")


class Comparison(NamedTuple):
    """How the values of a run that was repeated differ from those of a file.

    Attributes:
        values: Number of values that were compared.
        equal: Number of those that are equal.
        worst: Description of the largest difference; empty if all are equal.
        reproduced: Whether all differences are within what other processors and package versions explain.
    """

    values: int
    equal: int
    worst: str
    reproduced: bool


def compare_draws(result: ResultFile, draws: Mapping[str, Draws]) -> Comparison:
    """Compare the draws of a result file with those of a run that was repeated.

    Sums are rounded differently on other processors. Friction, estimators and plans amplify this, and a draw that ends
    near the edge of a band may be in it here and outside there. Repeated on another processor, `apg_plan` differed by
    more than the tolerances in 2 of 512 draws of reach-v1, and `adaptive-pid` in 53 of 512 of hard-v1; such differences
    go both ways, and means moved by 0.8 % at most. A file is therefore reproduced if the values of few draws differ by
    more than the tolerances, and if the differences of a metric add up to no more than those of random signs do. Draws
    that were edited improve, all of them: more than a handful are found.
    """
    protocol = get_protocol(result.protocol)
    count = equal = 0
    largest, worst, reproduced = 0.0, "", True
    for part, columns in draws.items():
        for metric, column in columns.items():
            given = result.draws[part][metric]
            before, after = (fill_unsettled(values, protocol.duration_s) for values in (given, column))
            if metric.startswith("settling_s."):
                allowed = np.full(len(before), REPEATED_S)
            else:
                allowed = REPEATED_MM + REPEATED_FRACTION * np.maximum(before, after)
            sizes = np.abs(after - before) / allowed
            count += len(given)
            equal += sum(old == new for old, new in zip(given, column, strict=True))
            differences = after - before
            expected = REPEATED_SIGMAS * np.sqrt(np.sum(differences**2)) + REPEATED_MEAN * before.sum()
            reproduced &= int((sizes > 1.0).sum()) <= int(REPEATED_DRAWS * len(given))
            reproduced &= abs(differences.sum()) <= expected
            draw = int(sizes.argmax())
            if sizes[draw] > largest:
                largest = float(sizes[draw])
                worst = f"{part}, draw {draw}, {metric}: {given[draw]} in the file, {column[draw]} now"
    return Comparison(count, int(equal), worst, bool(reproduced))


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


@cache
def protocol_bounds(name: str) -> dict[str, Array]:
    """Load the shortest possible settling times of the moves to a fixed goal in a protocol (part "reach").

    They are times to settle within 0.2 mm; `benchmarks.protocol_bounds` computes them.

    Returns:
        Times of two kinds, s, shape (draws,), NaN where unknown: `free`, for voltages that may change at any time, and
        `held`, for voltages that are constant over each control period. Empty for a protocol without such moves.

    Raises:
        InputError: If there is no such protocol.
        ValueError: If the stored times belong to other draws (episodes) than the protocol has.
    """
    protocol = get_protocol(name)
    if "reach" not in protocol.parts:
        return {}
    bounds = {"free": np.full(protocol.draws, np.nan), "held": np.full(protocol.draws, np.nan)}
    known = stored_bounds(protocol.scenario("reach")).times_s
    if known is not None:
        bounds["free"] = known
    file = resources.files("hframe_gym.evaluation") / BOUNDS_FOLDER / f"{name}.json"
    if not file.is_file():
        return bounds
    content = json.loads(file.read_text("utf-8"))
    if content["digest"] != protocol.digest:
        raise ValueError(f"{file}: the bounds belong to other draws of {name}")
    for row in content["draws"]:
        for kind in bounds:
            if row.get(f"{kind}_s") is not None:
                bounds[kind][row["draw"]] = row[f"{kind}_s"]
    return bounds


def paired_ratio(values: Array, others: Array) -> dict[str, Any] | None:
    """Compute the ratio of the means of two quantities over the same draws (episodes), for example time / bound.

    Args:
        values: Values of the numerator in B draws, all known, shape (B,); for S agents that differ in the seed of their
            training, shape (S, B).
        others: Values of the denominator in the same draws, for example shortest possible times, in the same unit,
            shape (B,), NaN where unknown.

    Returns:
        `mean`: mean of `values` divided by mean of `others`, over the draws in which `others` is known; `ci95`: [lower,
        upper limit] of its 95 % confidence interval, by a bootstrap over draws and agents; `draws`: number of draws in
        which `others` is known. None if it is known in none.
    """
    both = np.isfinite(others)
    if not both.any():
        return None
    return ratio_of_means(values[..., both], others[both], BOOTSTRAP_SEED) | {"draws": int(both.sum())}
