"""What to do after an identification: what to record, what to measure, and which controller to try."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ....controllers import TextbookPID, shorter_period, suited_controllers
from ....envs import EnvConfig
from ....envs.workspace import workspace_of
from ....errors import InputError
from ....machine import BUILTIN_MACHINES, Machine
from ....operating_system import quoted
from ....web_page import NextStep, number
from ...judge.criteria import SelectionCriteria
from ..content.document import Report
from ..content.saved_result import SavedResult
from ..diagnostics.inseparable_parameters import sum_text
from .rows import EffectRow
from .verdict import complete_log, hidden_effects

_NO_DIRECTION = (
    "Add a sensor that shows the direction of the motion, such as an encoder with two channels: without one, "
    "the force that the model lacks is not seen. Then record the runs again and identify with them."
)
# Of an effect and another one that explains as much.
_NO_EXPERIMENT = (
    "No experiment is proposed: no tested run within rated values and travel reliably distinguishes"
)
_EQUIVALENT = "No recording can distinguish"
_SHORTER_PERIODS_S = (0.005, 0.002, 0.001, 0.0005)  # control periods at which a textbook PID is tried
_MOTIONS = {  # by the quantity of a variable: the run that shows a dependence on it
    "velocity": (
        "move {} at six or more constant speeds in both directions, from the slowest to the top speed"
    ),
    "position": "move {} slowly and at constant speed over its full travel, several times in both directions",
    "path": "repeat the same motion for several minutes without a pause",
    "acceleration": "accelerate {} with several {commands} from the same place, in both directions",
    "current": "accelerate {} with {commands} from small ones to the largest, in both directions",
    "torque": "accelerate {} with {commands} from small ones to the largest, in both directions",
    "load": "accelerate {} with {commands} from small ones to the largest, in both directions",
    "heat": "begin cold, and repeat the same motion until its error does not change any more",
    "time": "begin cold, and repeat the same motion until its error does not change any more",
    "dwell": "let {} rest for different times, from tenths of a second to a minute, before each start",
}
_MEASUREMENTS = (  # by the ending of a parameter's name, those first that are measured most easily
    (".rest_length", "measure it with a ruler"),
    (".mass", "weigh the part, or compute its inertia from its drawing"),
    (
        ".Ke",
        "take it from the data sheet of the motor, or turn the motor by "
        "hand and measure its voltage and speed",
    ),
    (".Kt", "take it from the data sheet of the motor"),
    (".R", "measure it with an ohmmeter"),
    (".EA", "take it from the data sheet of the belt, or load the belt and measure how much it stretches"),
)


def next_steps(
    saved: SavedResult, folder: Path, effects: Sequence[EffectRow], runs: Sequence[str]
) -> list[NextStep]:
    """Return what to do next, the most important step first: what to record, control, correct and measure.

    Args:
        saved: The saved result.
        folder: Folder of the result that the commands name.
        effects: The effects that were found, as rows of the page (`effect_rows`).
        runs: Names of the held-out runs, the worst first.

    Returns:
        Steps, each with a sentence or more (`text`) and a command line or "" (`command`).
    """
    report, machine = saved.report, saved.machine
    findings = []
    if report.warnings:
        text = f"Read the findings about the recordings ({len(report.warnings)}) in the section Recordings."
        findings = [NextStep(text)]
    steps = [*_complete_log(saved, folder), *_recordings(saved, folder, effects)]
    if (
        report.left or 0.0
    ) > SelectionCriteria().max_noise_ratio_explained and report.verdict != "unexplained":
        steps.append(
            NextStep(
                f"Look at {runs[0]}, the run with the largest error, "
                "where measured and simulated curves part."
            )
        )
    if report.proposed_formulas:
        text = "A formula is proposed in place of the table; review it and write it as an effect."
        steps.append(NextStep(text, f"hframe effects new NAME --from {folder}"))
    measurements = [*_declarations(report), *_measurements(report)]
    if report.verdict == "unexplained":
        return [*_continued(saved, folder), *steps, *measurements, *findings]
    control = _control(report.verdict, machine, folder, bool(effects))
    return [*steps, control, *_continued(saved, folder), *measurements, *findings]


def _complete_log(saved: SavedResult, folder: Path) -> list[NextStep]:
    """Return the step that records what a log slower than its controller lacks, if it may hide effects."""
    report = saved.report
    if report.unknown_voltages is None or not hidden_effects(report):
        return []
    advice = complete_log(report.unknown_voltages)
    text = (
        f"{advice[:1].upper()}{advice[1:]}, and identify again: "
        "this log may hide effects that change the motion by as much as is left."
    )
    return [NextStep(text, _again(saved, folder))]


def _recordings(saved: SavedResult, folder: Path, effects: Sequence[EffectRow]) -> list[NextStep]:
    """Return what to record: a proposed experiment, or runs that show what the missing force depends on."""
    report = saved.report
    if report.next_experiment:
        why, file = report.next_experiment.why, report.next_experiment.file
        commands = saved.machine.commands_in_words
        text = f"{why} Apply the {commands} of {folder / file}, record the run, and identify again with it."
        return [NextStep(text, _again(saved, folder))]
    if report.verdict == "unexplained" and not saved.machine.shows_direction:
        return [NextStep(_NO_DIRECTION, _again(saved, folder))]
    if report.verdict == "unexplained":
        text = (
            "Look for a physical cause of the dependence in the section Residual force. "
            f"Record runs that isolate it: {_isolating(report, saved.machine.commands_in_words)}. "
            "Then identify again with them."
        )
        return [NextStep(text, _again(saved, folder))]
    for effect in (e for e in effects if e.rivals):
        return [NextStep(f"{_NO_EXPERIMENT} {effect.name} at {effect.site} from {effect.rivals[0]}.")]
    for effect in (e for e in effects if e.equivalent):
        return [NextStep(f"{_EQUIVALENT} {effect.name} at {effect.site} from {effect.equivalent[0]}.")]
    return []


def _continued(saved: SavedResult, folder: Path) -> list[NextStep]:
    """Return the step that repeats a search that ended early."""
    if not saved.report.unfinished:
        return []
    text = "The search ended early: repeat it without a limit. Ctrl-C ends it with what was found until then."
    return [NextStep(text, f"{_again(saved, folder)} --budget inf")]


def _isolating(report: Report, commands: str) -> str:
    """Return the run that isolates the variable on which the missing force depends most."""
    for dependence in report.residual.depends_on[:1]:
        quantity, _, name = dependence.variable.partition(" of ")
        if quantity in _MOTIONS:
            return _MOTIONS[quantity].format(name or "the machine", commands=commands)
    return "move slowly and fast, one axis at a time, over the full travel"


def _declarations(report: Report) -> list[NextStep]:
    """Return the step that declares friction which the machine file does not have."""
    values = [
        f"{friction.parameter} {number(friction.value)} {friction.unit}"
        for friction in report.undeclared_friction
    ]
    return [NextStep(f"Declare the friction in declared.json: {', '.join(values)}.")] if values else []


def _measurements(report: Report) -> list[NextStep]:
    """Return the parameters that a user should measure, as recordings determine only sums with them."""
    steps = []
    for group in report.not_separable:
        found = [(name, how) for end, how in _MEASUREMENTS for name in group.parameters if name.endswith(end)]
        name, how = found[0] if found else (group.parameters[0], "measure it by itself")
        sums = " and ".join(sum_text(entry.weights) for entry in group.determined) or "nothing of them"
        text = (
            f"If you need {' and '.join(group.parameters)} one by one, determine {name} ({how}), write it to "
            f"declared.json, and identify again: these runs determine only {sums}."
        )
        steps.append(NextStep(text))
    return steps


def _control(verdict: str, machine: Machine, folder: Path, has_effects: bool) -> NextStep:
    """Return the step that uses the machine: a controller with its control period, or a simulation."""
    which = "corrected" if has_effects else "refitted"
    command = next_command(verdict, machine, folder)
    if not command.startswith("hframe evaluate"):
        text = (
            f"Simulate the {which} machine with other inputs (it has no workspace in which a controller is "
            "evaluated)."
        )
        return NextStep(
            text,
            f"hframe simulate --machine {quoted(str(folder / 'machine.json'))} "
            "--inputs RUN.csv --out OUT.csv",
        )
    period = shorter_period(machine, EnvConfig.period) or EnvConfig.period
    if machine.drive_laws:
        text = f"Try set points on the {which} machine: set-point streams trajectories to its drives."
        return NextStep(text, command)
    text = (
        f"Design and compare controllers on the {which} machine, pid first, with a control period of "
        f"{number(1e3 * period)} ms.{_textbook_period(machine, period)}"
    )
    argument = "" if period == EnvConfig.period else f", period={period:g}"
    return NextStep(f'{text} In Python: gym.make("HFrame-v0", machine=...{argument}).', command)


def _textbook_period(machine: Machine, period: float) -> str:
    """Return a sentence about the control periods, from `period` down, that a textbook PID permits.

    It has no model of the belts.
    """
    tried = [period, *(shorter for shorter in _SHORTER_PERIODS_S if shorter < period)]
    try:
        stable = next((p for p in tried if TextbookPID(machine, p).concern() is None), None)
    except InputError:  # the controller cannot control such a machine
        return ""
    if stable is None:
        return f" A textbook PID is unstable at {number(1e3 * tried[-1])} ms and more."
    if stable == period:
        return " A textbook PID is stable at this period as well."
    return f" A textbook PID needs {number(1e3 * stable)} ms or less."


def _again(saved: SavedResult, folder: Path) -> str:
    """Return the command that identifies further runs of the same machine."""
    known = saved.declared == BUILTIN_MACHINES["hframe"]()
    machine = "" if known else f" --machine {quoted(str(folder / 'declared.json'))}"
    return f"hframe identify RUNS{machine} --out {quoted(str(folder))}"


def _has_workspace(machine: Machine) -> bool:
    """Return whether controllers can be evaluated on a machine."""
    try:
        workspace_of(machine)
    except InputError:
        return False
    return True


def next_command(verdict: str, machine: Machine, folder: Path) -> str:
    """Return the command that an identification proposes to the user as the next one.

    Args:
        verdict: "effect_found", "no_effect" or "unexplained".
        machine: Corrected or refitted machine, with its uncertainty where it is known.
        folder: Folder of the result.

    Returns:
        Command line that evaluates a controller on the machine, with a control period at which the belts can
        be damped. For the verdict "unexplained", or a machine for which there are no controllers (it has no
        tool that moves within a declared range), a command that opens the report, which shows what the
        residual depends on and what to record next.
    """
    if verdict == "unexplained" or not _has_workspace(machine):
        return f"hframe report {quoted(str(folder))} --open"
    machine_file, out = (quoted(str(folder / name)) for name in ("machine.json", "control"))
    randomize = " --randomize identified" if machine.uncertainty else ""
    shorter = shorter_period(machine, EnvConfig.period)
    period = "" if shorter is None else f" --period {shorter:g}"
    controller = suited_controllers(machine)[0]
    return f"hframe evaluate {controller} --machine {machine_file}{randomize}{period} --html --out {out}"
