"""Identification as a story: prepare, refit, propose, fit and judge until nothing passes, validate, report.

`preparation` prepares; `search` refits and repeats `propose`, `fit`, `evidence` and `judge`; `validate` and
`report` follow. `judge` decides, the others compute what it asks for.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Collection, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path

from ..errors import InputError
from ..line_log import LineLog
from ..machine import Machine
from ..operating_system import reused_memory
from ..parallel import single_threaded_linear_algebra
from ..preparation.dataset import Dataset
from ..preparation.runs.excerpt import representative_part
from ..preparation.runs.held_out import divide_runs
from ..preparation.runs.left_out import copied_runs, short_runs
from ..preparation.runs.moving import moving_runs, runs_that_should_move
from ..preparation.session import Session, prepare_session
from ..recordings import Recording, load_machine
from ..registry import load_plugins
from .budget import COMPARISON_PART, DEFAULT_SECONDS, LAST_STAGE_END, Budget, BudgetEndedError
from .fit.run_differences import RunDifferencesInWords, describe_run_differences
from .judge.criteria import SelectionCriteria
from .report.content.assembly import build_result
from .report.content.result import IdentificationResult
from .search.checked_search import find_effects
from .validate.evaluation import (
    HeldOutTests,
    describe_rounded_stamps,
    describe_unstable_motion,
    judged,
    with_certain_effects,
)
from .validate.simpler_machines import no_worse, reserve_time_after_search

_SILENT = (
    "Not used: nothing moves in {0}, although {1} starts to move with no more. "
    "Its sensor was not read, its drive was off, or something was blocked."
)


@reused_memory()
@single_threaded_linear_algebra()  # the result depends on no number of threads
def identify(
    recordings: Sequence[Recording],
    machine: Machine | str | Path,
    *,
    held_out: Sequence[str] = (),
    criteria: SelectionCriteria | None = None,
    log: LineLog | None = None,
    budget: float | Budget | None = None,
) -> IdentificationResult:
    """Identify the effects (deviations such as friction curves or backlash) that a machine's model lacks.

    The machine's parameters are fitted to the recordings; then effects are selected that reduce the remaining
    error. Three machines (declared, refitted, with effects) are simulated over the held-out runs, to which
    nothing was fitted.

    Args:
        recordings: Runs of one rig, at least two.
        machine: Machine as declared, or its name or file (`load_machine`).
        held_out: Names of the runs to evaluate on. Default: one of each four similar runs, see `hold_out`.
        criteria: Decision thresholds. Default: `SelectionCriteria()`.
        log: Called with a line of text after each part of the work. Default: nothing is reported.
        budget: Processor time that the identification may take, s (all threads together). When most of it is
            used up, the search ends, what it found is tested and evaluated as usual, and `unfinished` of the
            result says what it was doing; the refit is always completed. The result depends on the budget
            only then. 0: refit only; `math.inf`: no limit. Default: 120 s.

    Returns:
        Verdict ("effect_found", "no_effect", or "unexplained" if an error remains that no effect explains),
        the three machines with their errors on the held-out runs, and the selected effects.

    Raises:
        InputError: If the runs cannot be divided into fitted and held-out ones, a held-out name is unknown, a
            run has fewer than 20 rows, no sensor moves in the fitted runs, or an argument is of another type.
    """
    began = time.perf_counter()
    _require_types(recordings, held_out, criteria, budget)
    machine = load_machine(machine)
    load_plugins()  # the search tries their effects as well
    criteria, log = criteria or SelectionCriteria(), log or (lambda line: None)
    recordings = sorted(recordings, key=lambda recording: recording.name)  # no other order changes the result
    recordings, left_out = _without_useless_runs(recordings, held_out, log)

    budget = _budget(budget, recordings, log)

    # Prepare: which runs are fitted, and what of them can be used.
    held_names = divide_runs(recordings, held_out, machine)
    session = prepare_session(recordings, machine, log)
    machine = session.machine
    all_runs, statements = _without_silent_runs(session, held_names, log)

    tests = HeldOutTests(session, criteria)

    # Refit, then propose effects, fit them, gather evidence and judge it, until none passes: in the fitted
    # runs.
    found = find_effects(
        machine,
        all_runs,
        held_names,
        may_exchange=not held_out,
        criteria=criteria,
        log=log,
        budget=budget,
        before_search=partial(reserve_time_after_search, budget, tests),
    )
    found = found._replace(messages=(*left_out, *session.statements, *statements, *found.messages))

    # Validate: effects must be certain; held-out runs judge verdict and names; nothing worse than a plain fit
    # or the file is delivered.
    certain = with_certain_effects(found.outcome, criteria, log)
    judgment = judged(tests.of(found.held_out).evaluate(certain), found.differing, log)
    delivered = no_worse(judgment, found.plain, log, budget, differing=found.differing)
    unstable = describe_unstable_motion(delivered.evaluated)
    rounded = "" if unstable else describe_rounded_stamps(delivered.evaluated)
    causes = [cause for cause in (unstable, rounded) if cause]
    for cause in causes:
        log(cause)
    outcome = delivered.evaluated.outcome
    remarks = (*found.remarks, *causes, *delivered.remarks)
    differences = RunDifferencesInWords()
    puzzling = bool(remarks) or outcome.verdict == "unexplained"
    if puzzling and budget.has_time(COMPARISON_PART):
        runs = representative_part(found.comparable_runs(session.data), machine, every_run=True)
        # From the machine of the search: the one that is delivered may describe what the runs do not have in
        # common.
        with suppress(BudgetEndedError), budget.limiting(LAST_STAGE_END):
            differences = describe_run_differences(judgment.evaluated.outcome.after, runs, criteria)

    # Report.
    result = build_result(
        delivered, found, remarks, differences, budget, unstable=bool(unstable), rounded=bool(rounded)
    )
    log(f"verdict: {result.verdict}")
    for s in (s for s in result.effects if s.rivals):
        log(f"these runs cannot distinguish {s.effect.label} from {', '.join(s.rivals)}")
    return dataclasses.replace(result, seconds=time.perf_counter() - began)


def _require_types(recordings: object, held_out: object, criteria: object, budget: object) -> None:
    """Raise an InputError that says what to give in place of an argument of another type."""
    if isinstance(recordings, str | Path):
        raise InputError(
            f"identify needs recordings, not a path; call load_recordings({str(recordings)!r}, machine)"
        )
    if not isinstance(recordings, Collection) or not recordings:
        raise InputError("identify needs a list of two or more recordings, such as that of load_recordings")
    if isinstance(held_out, str):
        raise InputError(f"held_out is {held_out!r}; give a list of names: [{held_out!r}]")
    if not isinstance(criteria, SelectionCriteria | None):
        raise InputError(f"criteria is {criteria!r}; give SelectionCriteria(NAME=VALUE, ...)")
    if isinstance(budget, str):
        raise InputError(f"budget is {budget!r}; give seconds of processor time, or math.inf")


def _budget(budget: float | Budget | None, recordings: Sequence[Recording], log: LineLog) -> Budget:
    """Return the processor time that the identification may take, and log it."""
    if not isinstance(budget, Budget):
        budget = Budget(DEFAULT_SECONDS if budget is None else budget)
    if math.isfinite(budget.seconds):
        rows = sum(len(recording.time_s) for recording in recordings)
        log(f"{len(recordings)} runs, {rows} rows: at most about {budget.seconds:.0f} s of processor time")
    return budget


def _without_useless_runs(
    recordings: Sequence[Recording], held_out: Sequence[str], log: LineLog
) -> tuple[list[Recording], tuple[str, ...]]:
    """Return the runs without short ones and copies, with reasons; held-out runs of the user are kept."""
    short = {name: reason for name, reason in short_runs(recordings).items() if name not in held_out}
    useful = [recording for recording in recordings if recording.name not in short]
    reasons = short | copied_runs(useful, held_out)
    statements = tuple(f"Not used: {name} {reason}." for name, reason in reasons.items())
    for statement in statements:
        log(statement)
    return [recording for recording in recordings if recording.name not in reasons], statements


def _without_silent_runs(
    session: Session, held_names: Sequence[str], log: LineLog
) -> tuple[Dataset, tuple[str, ...]]:
    """Return the runs without those that should move but do not, and a sentence about each of these."""
    silent = runs_that_should_move(session.data, session.machine, moving_runs(session.recordings))
    not_fitted = {name: other for name, other in silent.items() if name not in held_names}
    statements = tuple(_SILENT.format(name, other) for name, other in not_fitted.items())
    for statement in statements:
        log(statement)
    names = [run.name for run in session.data.runs if run.name not in not_fitted]
    if not set(names) - set(held_names):
        raise InputError(f"no run is left to fit; hold out fewer, or record more. {' '.join(statements)}")
    return session.data.with_runs(names), statements
