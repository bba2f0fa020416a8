"""Tables of docs/leaderboard.md and docs/bound.md from benchmarks/leaderboard and the stored bounds.

    python -m tools.tables.leaderboard --check FILE...               # are the files valid?
    python -m tools.tables.leaderboard --rerun FILE [--as ENTRY]     # do its numbers come out again?

`python -m tools.tables` writes the pages. Every file is validated; one that is not valid stops the
generation. In each part of a protocol the entries are sorted by their mean, and compared draw by draw with
the best controller that is not learned. Agents whose names differ only in the seed of their training
(`NAME-seed0`, `NAME-seed1`) get a further row with intervals over draws and seeds.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hframe_gym.arrays import Array
from hframe_gym.errors import InputError
from hframe_gym.evaluation import (
    EFFECT_FAMILIES,
    PROTOCOLS,
    Entry,
    Protocol,
    ResultFile,
    compare_draws,
    fill_unsettled,
    get_protocol,
    make_entry,
    paired_ratio,
    protocol_bounds,
    read_result,
    run_protocol,
)
from hframe_gym.registry import load_plugins
from tools.repository import ROOT
from tools.tables.result_tables import markdown, with_interval

FOLDER = ROOT / "benchmarks" / "leaderboard"
BANDS = ("1mm", "0.2mm", "0.05mm")
ABOUT = ("learned by", "observes", "uses of the model", "million steps", "training, s", "control, us")


def results() -> list[ResultFile]:
    """Read the result files of the leaderboard, one per protocol and entry, sorted by file name."""
    return [read_result(path) for path in sorted(FOLDER.glob("*.json"))]


def protocol_section(name: str, entries: Sequence[ResultFile]) -> str:
    """Format the tables of a protocol, one per part.

    Args:
        entries: Results of any protocols.

    Returns:
        Markdown text.
    """
    protocol = get_protocol(name)
    of_protocol = [entry for entry in entries if entry.protocol == name]
    if not of_protocol:
        return "No results yet."
    texts = []
    for part, task in protocol.parts.items():
        metric = "settling_s.0.2mm" if task.metrics == "reach" else "contour_rms_mm"
        values = {id(e): fill_unsettled(e.draws[part][metric], protocol.duration_s) for e in of_protocol}
        ranked = sorted(of_protocol, key=lambda e: float(values[id(e)].mean()))
        best = next((e for e in ranked if e.entry.kind == "controller"), None)
        bounds = protocol_bounds(name) if task.metrics == "reach" else {}
        bounds = {kind: times for kind, times in bounds.items() if np.isfinite(times).any()}
        rows = []
        for entry in ranked:
            against = (
                _ratio(paired_ratio(values[id(entry)], values[id(best)]))
                if best and best is not entry
                else "1"
            )
            cells = (
                _move_cells(entry, part, values[id(entry)], bounds)
                if task.metrics == "reach"
                else _path_cells(entry, part)
            )
            rows.append([_name(entry), *_about_cells(entry), *cells, against])
        rows += [
            [f"**{recipe}, {len(seeds)} seeds**", *[""] * len(ABOUT), *(f"**{cell}**" for cell in cells)]
            for recipe, seeds in _trained_repeatedly(ranked).items()
            for cells in [
                _cells_over_seeds(seeds, part, metric, bounds, values[id(best)] if best else None, protocol)
            ]
        ]
        reference = f"over {best.entry.name}" if best else "over the best controller"
        header = (
            _move_header(bounds) if task.metrics == "reach" else ["contour error, rms, mm", "maximum, mm"]
        )
        texts.append(f"**{part}**\n\n{markdown(['entry', *ABOUT, *header, reference], rows)}")
    return "\n\n".join(texts)


def _name(entry: ResultFile) -> str:
    """Return name and first digits of the hash."""
    return f"`{entry.entry.name}` {entry.entry.sha256[:8]}"


def _about_cells(entry: ResultFile) -> list[str]:
    """Return what the entry learned by, observes and knows, and its costs; empty cells are unknown."""
    about = entry.entry
    steps, cpu_s, control_us = about.training_steps, about.training_cpu_s, about.control_us
    return [
        about.algorithm or "not learned",
        about.observes,
        about.model,
        "" if steps is None else f"{steps / 1e6:.3g}",
        "" if cpu_s is None else f"{cpu_s:.0f}",
        "" if control_us is None else f"{control_us:.3g}",
    ]


def _move_header(bounds: Mapping[str, Array]) -> list[str]:
    """Return the titles of the columns of moves."""
    known = {kind: int(np.isfinite(times).sum()) for kind, times in bounds.items()}
    titles = {"free": "over the bound", "held": "over the 10 ms bound"}
    return [
        *(f"within {band.replace('mm', ' mm')}" for band in BANDS),
        "until 0.2 mm, s",
        *(f"{titles[kind]} ({count} draws)" for kind, count in known.items()),
    ]


def _move_cells(entry: ResultFile, part: str, times: Array, bounds: Mapping[str, Array]) -> list[str]:
    """Return the cells of an entry in a part of moves."""
    scores = entry.scores[part]
    success = [f"{100 * scores[f'settling_s.{band}']['success']:.1f} %" for band in BANDS]
    return [
        *success,
        _mean(scores["settling_s.0.2mm"]),
        *(_ratio(paired_ratio(times, bound)) for bound in bounds.values()),
    ]


def _path_cells(entry: ResultFile, part: str) -> list[str]:
    """Return the cells of an entry in a part with a path."""
    return [_mean(entry.scores[part][metric], 4) for metric in ("contour_rms_mm", "contour_max_mm")]


def _trained_repeatedly(entries: Sequence[ResultFile]) -> dict[str, list[ResultFile]]:
    """Return the agents by the name of their recipe, where there are several that differ in the seed."""
    by_recipe: dict[str, list[ResultFile]] = {}
    for entry in entries:
        recipe, _, seed = entry.entry.name.rpartition("-seed")
        if recipe and seed.isdecimal() and entry.entry.kind == "agent":
            by_recipe.setdefault(recipe, []).append(entry)
    return {recipe: seeds for recipe, seeds in by_recipe.items() if len(seeds) > 1}


def _cells_over_seeds(
    seeds: Sequence[ResultFile],
    part: str,
    metric: str,
    bounds: Mapping[str, Array],
    best: Array | None,
    protocol: Protocol,
) -> list[str]:
    """Return the cells of a recipe's agents of S seeds: means, with intervals over the draws and the seeds.

    Args:
        seeds: Results of the S agents.
        metric: Criterion of the part.
        bounds: Shortest settling times of the draws by kind, s, shape (B,); empty for paths.
        best: Criterion of the best controller by draw, shape (B,), or None.
    """

    def by_seed(name: str) -> Array:
        """Return the values of a metric, shape (S, B)."""
        return np.stack([fill_unsettled(entry.draws[part][name], protocol.duration_s) for entry in seeds])

    def mean(name: str, digits: int) -> str:
        """Format the mean of a metric with its interval."""
        values = by_seed(name)
        score = paired_ratio(values, np.ones(values.shape[1]))
        return _mean(score, digits) if score else ""

    against = _ratio(paired_ratio(by_seed(metric), best)) if best is not None else ""
    if protocol.parts[part].metrics != "reach":
        return [mean(metric, 4), mean("contour_max_mm", 4), against]
    success = [np.mean([e.scores[part][f"settling_s.{band}"]["success"] for e in seeds]) for band in BANDS]
    ratios = [_ratio(paired_ratio(by_seed(metric), bound)) for bound in bounds.values()]
    return [*(f"{100 * share:.1f} %" for share in success), mean(metric, 3), *ratios, against]


def _mean(score: Mapping[str, Any], digits: int = 3) -> str:
    """Format a mean with its interval."""
    return with_interval(score["mean"], *score["ci95"], decimals=digits)


def _ratio(ratio: Mapping[str, Any] | None) -> str:
    """Format a ratio with its interval."""
    return "" if ratio is None else _mean(ratio)


def bounds_table() -> str:
    """Format the bounds of the protocols with free and with held voltages.

    Returns:
        Markdown table: protocol, draws with both bounds, their means, and the ratio with its interval.
    """
    rows = []
    for name in PROTOCOLS:
        bounds = protocol_bounds(name)
        both = np.isfinite(bounds["free"] + bounds["held"]) if bounds else np.zeros(0, np.bool_)
        if both.any():
            free, held = bounds["free"][both], bounds["held"][both]
            ratio = paired_ratio(held, free)
            means = (f"{1e3 * times.mean():.1f}" for times in (free, held))
            rows.append([f"`{name}`", f"{len(free)} of {len(both)}", *means, _ratio(ratio)])
    return markdown(
        ["protocol", "draws with both", "free voltages, ms", "held over 10 ms, ms", "ratio of means"], rows
    )


def effects_table() -> str:
    """Format the distribution of the undeclared effects of hard-v1.

    Returns:
        Markdown table: effect, sites with the range of the size, other parameters.
    """
    rows = []
    for family in EFFECT_FAMILIES:
        sites: dict[tuple[float, float], list[str]] = {}
        for site, limits in family.ranges.items():
            sites.setdefault(limits, []).append(site)
        sign = "+-" if family.signed else ""
        sizes = "; ".join(
            f"{', '.join(names)}: {sign}{low:.3g} to {high:.3g}" for (low, high), names in sites.items()
        )
        others = ", ".join([*family.others, *(f"{name} = {value:g}" for name, value in family.fixed.items())])
        rows.append([f"[`{family.name}`](effects.md#{family.name})", family.size, sizes, others or "none"])
    return markdown(["effect", "size", "sites and range, SI", "other parameters"], rows)


def leaderboard_page(text: str, entries: Sequence[ResultFile]) -> str:
    """Replace the tables of a page.

    Args:
        text: Page as it is.
        entries: All results.

    Returns:
        Page with the tables between `<!-- leaderboard: NAME -->` and `<!-- end -->` written anew.
    """

    def section(match: re.Match[str]) -> str:
        name = match[1]
        tables = {"effects": effects_table, "bounds": bounds_table}
        content = tables[name]() if name in tables else protocol_section(name, entries)
        return f"<!-- leaderboard: {name} -->\n{content}\n<!-- end -->"

    return re.sub(r"<!-- leaderboard: ([\w-]+) -->.*?<!-- end -->", section, text, flags=re.DOTALL)


def rerun(path: Path, name: str | None = None) -> tuple[bool, str]:
    """Run the entry of a result file again and compare every draw.

    Args:
        name: Controller, agent or folder to run. Default: the file's name of the entry, as `hframe evaluate`
            takes it.

    Returns:
        reproduced: Whether the file's numbers came out again, by an entry with the same weights.
        text: One line that says so.

    Raises:
        InputError: If the file is not valid, or the entry is unknown.
    """
    result = read_result(path)
    protocol = get_protocol(result.protocol)

    def swapped(entry: Entry) -> tuple[bool, str]:
        found = f"{entry.name} has the hash {entry.sha256[:8]}, not that of the file"
        return False, f"{path}: swapped weights: {found}"

    load_plugins()
    present = make_entry(name or result.entry.name, protocol, next(iter(protocol.parts)))[0]
    if present.kind == "agent" and len(protocol.parts) == 1 and present.sha256 != result.entry.sha256:
        return swapped(present)
    entry, draws = run_protocol(name or result.entry.name, protocol)
    if entry.kind == "agent" and entry.sha256 != result.entry.sha256:
        return swapped(entry)
    compared = compare_draws(result, draws)
    verdict = "reproduced" if compared.reproduced else "NOT reproduced"
    worst = f"; largest difference: {compared.worst}" if compared.worst else ""
    source = "" if entry.sha256 == result.entry.sha256 else "; the source has changed since"
    return (
        compared.reproduced,
        f"{path}: {verdict}: {compared.equal} of {compared.values} values are equal{worst}{source}",
    )


def main() -> int:
    """Check or repeat submissions; return the exit status."""
    parser = argparse.ArgumentParser(description="Check and repeat submissions to the leaderboard.")
    action = parser.add_mutually_exclusive_group(required=True)
    action.add_argument("--check", nargs="+", type=Path, metavar="FILE", help="validate result files")
    action.add_argument(
        "--rerun", type=Path, metavar="FILE", help="run the entry again and compare every draw"
    )
    parser.add_argument(
        "--as", dest="entry", help="controller, agent or folder, if its name in the file does not do"
    )
    arguments = parser.parse_args()
    try:
        if arguments.rerun:
            reproduced, text = rerun(arguments.rerun, arguments.entry)
            print(text)
            return 0 if reproduced else 1
        for path in arguments.check:
            read_result(path)
            print(f"{path}: valid")
    except (InputError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
