"""Tables of docs/real_machines.md and docs/real_recordings.md.

They show the rows of benchmarks/results/real_recordings.json, which are written by hand. A row has
`recording`, `log`, `source`, how to `describe` the machine, the commit that was `measured`, the `verdict`
(a word, or the list of named effects), the errors of the machines in `unit` (one number for each
coordinate, or null), and `cpu_seconds`. It may have a `note`. If the delivered error is larger than that of
the fit to beat, it has the `cause`.
"""

from __future__ import annotations

from functools import partial
from statistics import median
from typing import Any

from tools.tables.result_tables import markdown, table

SOURCE = "real_recordings"
KINDS = ("motor", "wheel", "joint", "axis", "pendulum")
MACHINES = ("declared", "plain", "refitted", "delivered", "to_beat")
CLEARLY_BETTER = 0.8  # fraction of the error of the fit to beat that the summary counts as clearly better


def ratios(row: dict[str, Any]) -> list[float]:
    """Return the delivered error over that of the fit to beat, dimensionless, per coordinate."""
    errors = row["errors"]
    return [ours / theirs for ours, theirs in zip(errors["delivered"], errors["to_beat"], strict=True)]


def _worst(row: dict[str, Any]) -> float:
    """Return the largest ratio of a recording."""
    return max(ratios(row))


def _error(values: list[float] | None) -> str:
    """Format the errors of a machine with three digits and without exponents."""
    return "-" if values is None else ", ".join(f"{v:.3g}" if abs(v) < 1000 else f"{v:.0f}" for v in values)


def _verdict(row: dict[str, Any]) -> str:
    """Format the verdict, or the named effects, as code."""
    verdict = row["verdict"]
    return ", ".join(f"`{name}`" for name in ([verdict] if isinstance(verdict, str) else verdict))


@table("real_recordings_summary", source=SOURCE)
def summary(results: dict[str, Any]) -> str:
    """Count the recordings of each kind of machine by the ratio to the fit to beat."""
    groups = {
        title: [r for r in results["recordings"] if r["kind"] == kind]
        for kind, title in results["kinds"].items()
    }
    groups["**all**"] = results["recordings"]
    rows = []
    for title, members in groups.items():
        found = [_worst(row) for row in members]
        kept = sum(ratio <= 1.0 for ratio in found)
        better = sum(ratio < CLEARLY_BETTER for ratio in found)
        rows.append(
            [title, f"{len(found)}", f"{kept}", f"{better}", f"{median(found):.2f}", f"{max(found):.2f}"]
        )
    return markdown(
        ["machines", "recordings", "ratio at most 1", f"below {CLEARLY_BETTER:g}", "median ratio", "worst"],
        rows,
    )


@table("real_recordings_above", source=SOURCE)
def above(results: dict[str, Any]) -> str:
    """List the recordings on which the delivered machine is worse than the fit to beat, the worst first.

    Raises:
        KeyError: If such a recording has no cause.
    """
    rows = sorted((r for r in results["recordings"] if _worst(r) > 1.0), key=_worst, reverse=True)
    cells = [
        [
            r["recording"],
            results["kinds"][r["kind"]].lower(),
            ", ".join(f"{q:.3f}" for q in ratios(r)),
            r["cause"],
        ]
        for r in rows
    ]
    return markdown(["recording", "among", "ratio", "cause"], cells, ":--")


def recordings(results: dict[str, Any], kind: str) -> str:
    """Format the recordings of a kind: errors of the machines, how each was described and what it shows."""
    rows = [row for row in results["recordings"] if row["kind"] == kind]
    cells = []
    for r in rows:
        errors = [_error(r["errors"][machine]) for machine in MACHINES]
        seconds = "-" if r["cpu_seconds"] is None else f"{r['cpu_seconds']:.0f} s"
        ratio = ", ".join(f"{q:.2f}" for q in ratios(r))
        cells.append([r["recording"], _verdict(r), r["unit"], *errors, ratio, seconds, r["measured"]])
    header = [
        "recording",
        "verdict",
        "unit",
        "declared",
        "plain fit",
        "refitted",
        "delivered",
        "to beat",
        "ratio",
        "processor time",
        "measured at",
    ]
    notes = []
    for r in rows:
        text = f"- **{r['recording']}**: {r['log']} ({r['source']}). Described as {r['describe']}."
        notes.append(f"{text} {r.get('note', '')}".rstrip())
    return f"{markdown(header, cells)}\n\n" + "\n".join(notes)


for _kind in KINDS:
    table(f"{SOURCE}_{_kind}", source=SOURCE)(partial(recordings, kind=_kind))
