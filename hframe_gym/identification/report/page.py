"""Build report.html, one self-contained page about an identification result, from the files of its folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...atomic_files import output_batch
from ...effects.smooth_table import TABLE_FAMILY
from ...errors import InputError
from ...machine import Machine
from ...web_page import number, write_page
from ..fit.parameter_diagnostics import parameter_doubts, sum_text
from ..judge.criteria import SelectionCriteria
from .curves import channel_noise, page_curves, worst_first
from .instructions import next_steps
from .plots import readable_unit, report_panels, save_plots, slow_fractions
from .result import STAGES, reason_of_remainder
from .saved_result import load_result

Array = NDArray[np.float64]
_HEADINGS = {
    "effect_found": "Missing effects found",
    "no_effect": "No missing effect found",
    "unexplained": "Unexplained error",
}
_LEFT = {
    "good": "",
    "neutral": ", a small error is left",
    "warning": ", a large error is left",
}  # by tone of the page
# Error in percent of the motion that is small: a feed-forward control by the machine removes the other 99 %.
_SMALL_PERCENT_OF_MOTION = 1.0
_NOTICEABLE_ERROR = 1.3  # Remaining error over noise that the report calls unexplained.
_DIVERGES = "infinitely many (its simulation diverges)"
_DEVIATING = (
    "Only {} deviate{}: the other sensors agree with the simulation, although they would show an error of the motion. "
    "The cause lies at this sensor, its mounting or frame, or in an elastic part between it and the motors."
)
_CLEARLY_BETTER = (
    0.9  # Fraction of the refitted machine's error below which that of the declared one is mentioned.
)
_MAX_NOISE_RATIO = (
    50.0  # Simulation error over noise beyond which the simulation drifted, if a force error exists.
)


def build_report(folder: Path, final_folder: Path | None = None) -> Path:
    """Draw the plots of an identification result and write report.html.

    Args:
        folder: Folder that `hframe identify` wrote. The page is written there, the plots to its subfolder plots/. All
            files appear together; within a `with output_batch(folder)` block of the caller, at the end of the block.
        final_folder: Folder that the commands on the page name, if the files are moved there later. Default: `folder`.

    Returns:
        Path of report.html.

    Raises:
        InputError: If the folder holds no result, or a file of it is damaged or cannot be written; the message names
            the file.
        ImportError: If a library of the extra ``report`` is missing.
    """
    saved = load_result(folder)
    report, machine, curves = saved.report, saved.machine, saved.curves
    channels = list(machine.output_channels)
    tone = tone_of_remainder(report)
    runs = worst_first(report, curves, channels)
    panels, effects = report_panels(report, curves, machine, runs), _effect_rows(report, machine)
    values = {
        "title": f"Identification of {saved.declared.name}",
        "declared_name": saved.declared.name,
        "report": report,
        "heading": _HEADINGS[report["verdict"]] + ("" if report["verdict"] == "unexplained" else _LEFT[tone]),
        "tone": tone,
        "sentence": verdict_sentence(report, channels),
        "tiles": _tiles(report, channels),
        "channels": [_channel_row(report, c) for c in channels],
        "force": _force_row(report),
        "plain": _plain_sentence(report),
        "delivered": not report["effects"] and report["after"]["held_out"] != report["before"]["held_out"],
        "runs": [_run_row(report, curves, channels, run) for run in runs],
        "curves": page_curves(report, curves, channels),
        "effects": effects,
        "parameters": _parameter_rows(machine, saved.declared),
        "determined": _determined_sums(report, machine),
        "left": _remaining_error(report),
        "steps": next_steps(saved, final_folder or folder, effects, runs),
        "slow": slow_fractions(curves),
        "panels": panels,
    }
    try:
        with output_batch(folder):
            save_plots(panels, folder / "plots")
            write_page(folder / "report.html", "hframe_gym.identification.report", "report.html.j2", values)
    except OSError as error:
        raise InputError(f"{error.filename or folder}: cannot be written ({error.strerror})") from None
    return folder / "report.html"


def tone_of_remainder(report: Mapping[str, Any]) -> str:
    """Return the tone of the page, which follows from the error that is left and not from the names that were found.

    Args:
        report: Content of report.json.

    Returns:
        "good" if noise explains the error and the noise is small against the motion; "neutral" if the error is at most
        1 % of the motion of every channel; "warning" if it is larger, or the simulation diverges. An error that the
        verdict calls unexplained is never "good".
    """
    criteria, left = SelectionCriteria(), report.get("left")
    errors = report["after"]["held_out"].values()
    percents = [e["percent_of_motion"] for e in errors if isinstance(e, dict) and e.get("percent_of_motion")]
    largest = max(percents, default=0.0)
    if left is None:
        return "warning"
    at_noise = left <= criteria.max_noise_ratio_explained and largest <= 100.0 * criteria.max_motion_error
    if at_noise and report["verdict"] != "unexplained":
        return "good"
    return "neutral" if percents and largest <= _SMALL_PERCENT_OF_MOTION else "warning"


def verdict_sentence(report: Mapping[str, Any], channels: Sequence[str]) -> str:
    """Describe in words the verdict and the error on the held-out runs, which were not fitted.

    The error is the simulation error in units of the sensors' noise, root mean square over the channels. If that is
    above 50, the simulation drifts; the relative error of the drives' force is then stated if the report contains it.

    Args:
        report: Content of report.json.
        channels: Names of the machine's output channels.

    Returns:
        One or more English sentences.
    """
    by_force = _drifts(report, channels)
    unit = "% of the drives' force" if by_force else "times the sensors' noise"
    errors = {
        stage: 100 * report[stage]["held_out"]["force_error"]
        if by_force
        else _noise_ratio(report, stage, channels)
        for stage in STAGES
    }
    before, after = (number(errors[stage], _DIVERGES) for stage in ("before", "after"))
    declared, refitted = errors["declared"], errors["before"]
    if declared is not None and refitted is not None and declared < _CLEARLY_BETTER * refitted:
        before += (
            f" (with the declared parameters: {number(declared)})"  # The refit minimizes short predictions.
        )
    if report["verdict"] == "effect_found":
        names = ", ".join(f"{e['name'].replace('_', ' ')} at {e['site']}" for e in report["effects"])
        single = len(report["effects"]) == 1
        change = "rises" if (errors["after"] or 0.0) > (refitted or np.inf) else "falls"  # None: it diverges
        subject, pronoun = ("an effect", "it") if single else (f"{len(report['effects'])} effects", "them")
        found = (
            f"The machine has {subject} that its model lacks: {names}. With {pronoun}, the error on the held-out runs "
            f"{change} from {before} to {after} {unit}.{_remainder(report)}"
        )
        return " ".join([*_left_in_words(report), found, *_unfinished(report)])
    if report["verdict"] == "no_effect":
        remainder = _remainder(report)
        start = f"No effect {'was found' if remainder else 'is missing'}: with refitted parameters, the error of the"
        found = f"{start} declared model on the held-out runs is {before} {unit}.{remainder}"
        return " ".join([found, *([] if remainder else _left_in_words(report)), *_unfinished(report)])
    text = f"The error of the refitted model on the held-out runs is {before} {unit}, and no known effect explains it."
    why = [f"Why no other verdict is given: {report['reason']}."] if report.get("reason") else []
    parts = [
        text,
        *_left_in_words(report),
        *why,
        *_dependence_sentences(report),
        *_nearest(report),
        *_unfinished(report),
    ]
    return " ".join(parts)


def _left_in_words(report: Mapping[str, Any]) -> list[str]:
    """Return a sentence about the error that is left in the user's terms, if it is known."""
    errors = report["after"]["held_out"]
    motions = [
        e["percent_of_motion"] for e in errors.values() if isinstance(e, dict) and e.get("percent_of_motion")
    ]
    force = report["after"].get("missing_force_percent")
    if report.get("left") is None or not (motions or force):
        return []
    parts = [f"{number(report['left'])} times the sensors' noise, {_largest_position_error(errors)}"]
    if motions:
        parts.append(f"{number(max(motions))} % of the motion of the channel where that is most")
    if force:
        parts.append(f"a missing force of {number(force)} % of that of the drives")
    return [f"Left on the held-out runs: {'; '.join(parts)}."]


def _nearest(report: Mapping[str, Any]) -> list[str]:
    """Return a sentence about the effects of the library that describe a part of the missing force."""
    labels = (report.get("hint") or {}).get("nearest")
    return (
        [f"The nearest effects of the library, which are no causes: {', '.join(labels)}."] if labels else []
    )


def _unfinished(report: Mapping[str, Any]) -> list[str]:
    """Return a sentence about a search that ended early."""
    unfinished = report.get("unfinished")
    return (
        [f"The search is not complete: {unfinished['reason']} ({unfinished['stage']})."] if unfinished else []
    )


def _noise_ratio(report: Mapping[str, Any], stage: str, channels: Sequence[str]) -> float | None:
    """Return the error in multiples of the noise, rms over the channels as of `left`; None if the machine diverges."""
    errors = report[stage]["held_out"]
    measured = [errors[c]["noise_ratio"] for c in channels if errors[c]["noise_ratio"] is not None]
    return float(np.sqrt(np.mean(np.square(measured)))) if measured else None


def _drifts(report: Mapping[str, Any], channels: Sequence[str]) -> bool:
    """Return whether the simulation drifts, so that the error of the drives' force describes the machine better."""
    ratio = _noise_ratio(report, "after", channels)
    return "force_error" in report["after"]["held_out"] and ratio is not None and ratio > _MAX_NOISE_RATIO


def _remainder(report: Mapping[str, Any]) -> str:
    """Return a sentence about the error that the machine of the verdict leaves, "" if it is the sensors' noise."""
    if (left := report.get("left")) is None or left < _NOTICEABLE_ERROR:
        return ""
    error = (
        f"{number(left)} times the sensors' noise ({_largest_position_error(report['after']['held_out'])})"
    )
    if not (runs := report.get("contradicting", [])):
        return f" An error of {error} is left{reason_of_remainder(report)}."
    subject = f"{' and '.join(runs)} contradict{'s' if len(runs) == 1 else ''}"
    others = report.get("left_in_others")
    elsewhere = "" if others is None else f" On the other held-out runs, it is {number(others)} times."
    return f" An error of {error} is left, because {subject} the fitted runs (see the warnings).{elsewhere}"


def _tiles(report: Mapping[str, Any], channels: Sequence[str]) -> list[dict[str, str]]:
    """Return the key figures of the first screen: two errors, what the effects explain, and the data."""
    by_force = _drifts(report, channels)
    stages = ("declared", "Error as declared"), ("before", "Error refitted")
    tiles = []
    for stage, name in (
        (("before", "Error before"), ("after", "Error after")) if report["effects"] else stages
    ):
        errors = report[stage]["held_out"]
        if by_force:
            value, note = f"{number(100 * errors['force_error'])} %", "of the drives' force"
        else:
            ratio = number(_noise_ratio(report, stage, channels), "∞")
            value, note = f"{ratio} × noise", _largest_position_error(errors)
        tiles.append({"name": name, "value": value, "note": note})
    if report["effects"] and report.get("explained") is not None:
        note = "of the squared error beyond the noise"
        tiles.append({"name": "Explained", "value": f"{_percent(report['explained'])} %", "note": note})
    fitted, held_out = (len(report["runs"][kind]) for kind in ("fitted", "held_out"))
    note = "runs fitted + held out for the errors"
    return [*tiles, {"name": "Recordings", "value": f"{fitted} + {held_out}", "note": note}]


def _largest_position_error(errors: Mapping[str, Any]) -> str:
    """Return the largest rms error of the position channels, or of all channels if there is no position."""
    measured = {c: e["rmse"] for c, e in errors.items() if isinstance(e, dict) and e["rmse"] is not None}
    positions = {c: rmse for c, rmse in measured.items() if c.endswith("_m")} or measured
    if not positions:
        return "diverges, or not measured"
    channel = max(positions, key=lambda c: positions[c])
    factor, unit = readable_unit(channel, positions[channel])
    return f"{number(factor * positions[channel])} {unit} rms at {channel}"


def _channel_row(report: Mapping[str, Any], channel: str) -> dict[str, Any]:
    """Return the errors of one channel for each machine, in one readable unit and in multiples of the noise."""
    row: dict[str, Any] = {"name": channel}
    errors = {stage: report[stage]["held_out"][channel] for stage in _machines(report)}
    factor, unit = readable_unit(channel, errors["before"]["rmse"] or 0.0)
    absent = "diverges" if any(error["rmse"] is not None for error in errors.values()) else "not measured"
    for stage, error in errors.items():
        rmse, ratio = error["rmse"], error["noise_ratio"]
        row[stage] = {
            "size": absent if rmse is None else f"{number(factor * rmse)} {unit}",
            "ratio": "" if ratio is None else f"{number(ratio)} × noise",
            "motion": _percent_of_motion(error),
        }
    return row


def _percent_of_motion(error: Mapping[str, Any]) -> str:
    """Return an error in percent of the motion, or "" if the channel does not move."""
    percent = error.get("percent_of_motion")
    return "" if percent is None else f"{number(percent)} % of motion"


def _force_row(report: Mapping[str, Any]) -> dict[str, str] | None:
    """Return the relative force error of each machine, None where there is none."""
    if "force_error" not in report["after"]["held_out"]:
        return None
    errors = {s: report[s]["held_out"].get("force_error") for s in _machines(report)}
    return {s: "" if error is None else f"{100 * error:.2f} %" for s, error in errors.items()}


def _machines(report: Mapping[str, Any]) -> list[str]:
    """Return the keys of the machines in a report, with the plain fit if there is one."""
    return [*STAGES, *(["plain"] if report.get("plain") else [])]


def _plain_sentence(report: Mapping[str, Any]) -> str:
    """Describe the plain fit, which stands beside the other machines."""
    if not (plain := report.get("plain")):
        return ""
    terms = ", ".join(term.replace("_", " ").replace("@", " at ") for term in plain["terms"])
    beside = f", with {terms}" if terms else ""
    delivered = (
        " It is the machine that is delivered, because it predicts best." if plain["delivered"] else ""
    )
    return f"The plain fit has inertia and friction from the recordings alone{beside}, and no effects.{delivered}"


def _run_row(
    report: Mapping[str, Any], curves: Mapping[str, Array], channels: list[str], run: str
) -> dict[str, Any]:
    """Return the errors of one held-out run before and after, by channel in units of the noise."""

    def ratio(stage: str, j: int) -> str:
        noise = channel_noise(report, channels[j])
        residual = curves[f"{run}/{stage}"][:, j]
        residual = residual[np.isfinite(residual)]
        if noise is None or len(residual) == 0:
            return ""
        return f"{float(np.sqrt(np.mean(residual**2))) / noise:.3g}"

    return {
        "name": run,
        "errors": [f"{ratio('before', j)} → {ratio('after', j)}" for j in range(len(channels))],
    }


def _effect_rows(report: Mapping[str, Any], machine: Machine) -> list[dict[str, Any]]:
    """Return the effects, largest held-out gain first, with formula and parameters; a table is drawn instead."""
    definitions = {e.label: e.definition for e in machine.effects}
    rows = []
    for e in sorted(report["effects"], key=lambda e: -e["held_out_gain"]):
        definition = definitions[f"{e['name']}@{e['site']}"]
        table = definition.family == TABLE_FAMILY
        size = (
            ""
            if e["size"] is None
            else f"Its force is {number(100 * e['size'])} % of the drives' force (rms)."
        )
        parameters = [
            {
                "name": key,
                "value": f"{p['value']:.5g}",
                "std": "" if p["std"] is None else f"± {p['std']:.2g}",
                "unit": "" if p["unit"] == "1" else p["unit"],
            }
            for key, p in e["parameters"].items()
        ]
        rows.append(
            {
                "name": e["name"].replace("_", " "),
                "site": e["site"],
                "formula": definition.formula,
                "table": table,
                "parameters": [] if table else parameters,
                "size": size,
                "gain": _gain_sentence(e["held_out_gain"]),
                "rivals": [r for r in e["rivals"] if r not in definition.equivalent],
                "equivalent": [r for r in e["rivals"] if r in definition.equivalent],
            }
        )
    return rows


def _gain_sentence(gain: float) -> str:
    """Return what an effect does to the squared error of the held-out runs; a negative gain makes it larger."""
    if gain < 0.0:
        return f"It increases the squared error of the held-out runs by {-100 * gain:.3g} %."
    return f"It removes {_percent(gain)} % of the squared error of the held-out runs."


def _percent(fraction: float) -> str:
    """Return a fraction in percent; values that would round to 100 are "more than 99.9"."""
    return "more than 99.9" if fraction > 0.9995 else f"{100 * fraction:.3g}"


def _remaining_error(report: Mapping[str, Any]) -> list[str]:
    """Return sentences about the error that the machine of the verdict leaves on the held-out runs."""
    machine, left = "corrected" if report["effects"] else "refitted", report.get("left")
    ratio = "" if left is None else f" ({number(left)} times the noise, root mean square over the channels)"
    text = f"The remaining error of the {machine} machine is {{}} the sensors' noise{ratio}{{}}."
    if report["residual"]["white"]:
        return [text.format("consistent with", "")]
    correlated = ", but it is correlated in time: a small systematic part is left"
    small = left is not None and left < _NOTICEABLE_ERROR
    sentences = [text.format("about as large as", correlated) if small else text.format("larger than", "")]
    return sentences + (
        _dependence_sentences(report) if report["verdict"] == "no_effect" else []
    )  # or said already


def _dependence_sentences(report: Mapping[str, Any]) -> list[str]:
    """Return a sentence about sensors that deviate alone, or about the variable that explains most of the force."""
    if sensors := report["residual"].get("sensors"):
        return [_DEVIATING.format(" and ".join(sensors), "s" if len(sensors) == 1 else "")]
    sentences = []
    for d in report["residual"]["depends_on"][:1]:
        component = d.get("component") or d["coordinate"]
        where = f"on {d['coordinate']}" if component == d["coordinate"] else f"(most likely at {component})"
        sentences.append(
            f"The force that the model lacks {where} depends most on {d['variable']}, which explains "
            f"{100 * d['share']:.0f} % of its variance."
        )
    return sentences


def _parameter_rows(machine: Machine, declared: Machine) -> list[dict[str, str]]:
    """Return every identified parameter except a table's, with its standard deviation and the reasons to doubt it."""
    if machine.uncertainty is None:
        return []
    doubts = parameter_doubts(machine, declared)
    tables = tuple(f"{e.label}." for e in machine.effects if e.definition.family == TABLE_FAMILY)
    rows = []
    for name in (n for n in machine.uncertainty.names if not n.startswith(tables)):
        rows.append(
            {
                "name": name,
                "declared": f"{declared.parameters[name]:.4g}" if name in declared.parameters else "",
                "value": f"{machine.parameters[name]:.5g}",
                "std": f"{machine.uncertainty.std(name):.2g}",
                "unit": machine.unit(name),
                "doubt": "; ".join(doubts[name]),
            }
        )
    return rows


def _determined_sums(report: Mapping[str, Any], machine: Machine) -> list[dict[str, str]]:
    """Return the parameters that the data do not separate, with what they determine of each set."""
    rows = []
    for group in report["not_separable"]:
        sums = [
            f"{sum_text(entry['weights'])} = {entry['value']:.5g} ± {entry['std']:.2g} "
            f"{machine.unit(next(iter(entry['weights'])))}"
            for entry in group["determined"]
        ]
        rows.append({"names": ", ".join(group["parameters"]), "sums": "; ".join(sums) or "no combination"})
    return rows
