"""Build report.html, one self-contained page about an identification result, from the files of its folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...files import output_batch
from ...web_page import number, write_page
from .content.document import ChannelErrors, Report, compared_machines
from .content.result_curves import ResultCurves
from .content.saved_result import load_result
from .plots.correlations import error_correlations
from .plots.held_out_curves import page_curves, worst_first
from .plots.panels import report_panels, save_plots, slow_fractions
from .units import percent, readable_unit
from .words.answers import answers
from .words.instructions import next_steps
from .words.remainder import drifts, largest_position_error, tone_of_remainder
from .words.rows import correlation_rows, effect_rows, inseparable_rows, parameter_rows

_HEADINGS = {
    "effect_found": "Missing effects found",
    "no_effect": "No missing effect found",
    "unexplained": "Unexplained error",
}
# What is left, by the tone of the page.
_LEFT = {"good": "", "neutral": ", a small error is left", "warning": ", a large error is left"}


def build_report(folder: Path, final_folder: Path | None = None) -> Path:
    """Draw the plots of an identification result and write report.html.

    Args:
        folder: Folder that `hframe identify` wrote. The page is written there, the plots to its subfolder
            plots/. All files appear together; within a `with output_batch(folder)` block of the caller, at
            the end of the block.
        final_folder: Folder that the commands on the page name, if the files are moved there later. Default:
            `folder`.

    Returns:
        Path of report.html.

    Raises:
        InputError: If the folder holds no result, or a file of it is damaged or cannot be written; the
            message names the file.
        ImportError: If a library of the extra ``report`` is missing.
    """
    saved = load_result(folder)
    report, machine, curves = saved.report, saved.machine, saved.curves
    tone = tone_of_remainder(report)
    runs = worst_first(report, curves)
    panels = report_panels(report, curves, machine, saved.declared, runs)
    effects = effect_rows(report, machine)
    steps = next_steps(saved, final_folder or folder, effects, runs)
    values = {
        "title": f"Identification of {saved.declared.name}",
        "declared_name": saved.declared.name,
        "report": report,
        "heading": _heading(report, tone),
        "tone": tone,
        "answers": answers(saved, effects, runs, steps[0].text),
        "tiles": _tiles(report),
        "channels": [_channel_row(report, channel) for channel in report.channels],
        "force": _force_row(report),
        "plain": _plain_sentence(report),
        "machines": compared_machines(report),
        "pair": _pair(report),
        "runs": [_run_row(report, curves, run) for run in runs],
        "curves": page_curves(report, curves),
        "effects": effects,
        "parameters": parameter_rows(machine, saved.declared),
        "correlations": correlation_rows(machine),
        "determined": inseparable_rows(report, machine),
        "whiteness": [
            {"run": run, "channels": error_correlations(curves, run, report.channels, machine.input_channels)}
            for run in runs
        ],
        "steps": steps,
        "slow": slow_fractions(curves.coverage),
        "panels": panels,
    }
    try:
        with output_batch(folder):
            save_plots(panels, folder / "plots")
            write_page(folder / "report.html", "hframe_gym.identification.report", "report.html.j2", values)
    except OSError as error:
        raise InputError(f"{error.filename or folder}: cannot be written ({error.strerror})") from None
    return folder / "report.html"


def _heading(report: Report, tone: str) -> str:
    """Return the heading of the page: the verdict, how much is left, and whether the search was complete."""
    left = "" if report.verdict == "unexplained" else _LEFT[tone]
    unfinished = "; the search is not complete" if report.unfinished else ""
    return f"{_HEADINGS[report.verdict]}{left}{unfinished}"


def _tiles(report: Report) -> list[dict[str, str]]:
    """Return the key figures of the first screen: two errors, what the effects explain, and the data."""
    by_force, tiles = drifts(report), []
    for stage, label in _pair(report).items():
        evaluation = report.machines[stage]
        if by_force:
            value, note = f"{number(100 * (evaluation.force_error or 0.0))} %", "of the drives' force"
        else:
            ratio = number(evaluation.noise_ratio, "∞")
            value, note = f"{ratio} × noise", largest_position_error(evaluation)
        tiles.append({"name": f"Error {label}", "value": value, "note": note})
    if report.effects and report.explained is not None:
        note = "of the squared error beyond the noise"
        tiles.append({"name": "Explained", "value": f"{percent(report.explained)} %", "note": note})
    fitted, held_out = (len(runs) for runs in (report.runs.fitted, report.runs.held_out))
    note = "runs fitted + held out for the errors"
    return [*tiles, {"name": "Recordings", "value": f"{fitted} + {held_out}", "note": note}]


def _pair(report: Report) -> dict[str, str]:
    """Return the last two machines, with their labels: what was gained by the last step."""
    return dict([item for item in compared_machines(report).items() if item[0] != "plain"][-2:])


def _channel_row(report: Report, channel: str) -> dict[str, Any]:
    """Return a channel's errors for each machine, in one readable unit and in multiples of the noise."""
    row: dict[str, Any] = {"name": channel}
    errors = {key: evaluation.channels[channel] for key, evaluation in report.machines.items()}
    factor, unit = readable_unit(channel, errors["before"].rmse or 0.0)
    absent = "diverges" if any(error.rmse is not None for error in errors.values()) else "not measured"
    for key, error in errors.items():
        rmse, ratio = error.rmse, error.noise_ratio
        row[key] = {
            "size": absent if rmse is None else f"{number(factor * rmse)} {unit}",
            "ratio": "" if ratio is None else f"{number(ratio)} × noise",
            "motion": _percent_of_motion(error),
        }
    return row


def _percent_of_motion(error: ChannelErrors) -> str:
    """Return an error in percent of the motion, or "" if the channel does not move."""
    if error.percent_of_motion is None:
        return ""
    return f"{number(error.percent_of_motion)} % of motion"


def _force_row(report: Report) -> dict[str, str] | None:
    """Return the relative force error of each machine, None where there is none."""
    if report.after.force_error is None:
        return None
    errors = {key: evaluation.force_error for key, evaluation in report.machines.items()}
    return {s: "" if error is None else f"{100 * error:.2f} %" for s, error in errors.items()}


def _plain_sentence(report: Report) -> str:
    """Describe the plain fit, which stands beside the other machines."""
    if not (plain := report.plain):
        return ""
    terms = ", ".join(term.replace("_", " ").replace("@", " at ") for term in plain.terms)
    beside = f", with {terms}" if terms else ""
    delivered = " It is the machine that is delivered, because it predicts best." if plain.delivered else ""
    return (
        f"The plain fit has inertia and friction from the recordings alone{beside}, "
        f"and no effects.{delivered}"
    )


def _run_row(report: Report, curves: ResultCurves, run: str) -> dict[str, Any]:
    """Return the errors of one held-out run before and after, by channel in units of the noise."""

    def ratio(stage: str, j: int) -> str:
        noise = report.noise_of(report.channels[j])
        residual = curves.runs[run].errors[stage][:, j]
        residual = residual[np.isfinite(residual)]
        if noise is None or len(residual) == 0:
            return ""
        return number(float(np.sqrt(np.mean(residual**2))) / noise)

    return {
        "name": run,
        "errors": [f"{ratio('before', j)} → {ratio('after', j)}" for j in range(len(report.channels))],
    }
