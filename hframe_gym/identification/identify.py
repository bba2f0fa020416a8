"""Identification as a story: prepare, refit and search, check on held-out runs, evaluate, judge, report.

Each step is a room of this package; `judge` decides, the others compute what it asks for.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from ..distributed import single_threaded_linear_algebra
from ..errors import InputError
from ..machine import Machine
from ..preparation.dataset import require_motion, require_rows, with_all_measurements
from ..preparation.session import prepare_session
from ..recordings import Recording
from ..registry import load_plugins
from .budget import Budget, default_budget
from .evidence.held_out import hold_out
from .evidence.tried_effects import Log
from .fit.run_differences import describe_run_differences
from .judge.criteria import SelectionCriteria
from .report.assembly import build_result, unexcited_effects
from .report.evaluation import HeldOutTest, judged
from .report.plain_comparison import at_least_plain
from .report.result import IdentificationResult, Unfinished
from .search.checked_search import (
    comparable_runs,
    hint_of_differing_runs,
    search_and_check,
    without_unconfirmed,
)
from .search.input_timing import with_input_timing


@single_threaded_linear_algebra()  # the result depends on no number of threads
def identify(
    recordings: Sequence[Recording],
    machine: Machine,
    *,
    held_out: Sequence[str] = (),
    criteria: SelectionCriteria | None = None,
    log: Log | None = None,
    budget: float | Budget | None = None,
) -> IdentificationResult:
    """Identify the effects (deviations such as friction curves or backlash) that a machine's model lacks.

    The machine's parameters are fitted to the recordings; then effects are selected that reduce the remaining error.
    Three machines (declared, refitted, with effects) are simulated over the held-out runs, to which nothing was fitted.

    Args:
        recordings: Runs of one rig (times, s; voltages, V; measurements, m or rad), at least two.
        machine: Machine as declared.
        held_out: Names of the runs to evaluate on. Default: one of each four similar runs, see `hold_out`.
        criteria: Decision thresholds. Default: `SelectionCriteria()`.
        log: Called with a line of text after each part of the work. Default: nothing is reported.
        budget: Processor time that the identification may take, s (all threads together). When most of it is used up,
            the search ends, what it found is tested and evaluated as usual, and `unfinished` of the result says what it
            was doing; the refit is always completed. The result depends on the budget only then. 0: refit only;
            `math.inf`: no limit. Default: a minute per core, more for long sessions (`budget.default_budget`).

    Returns:
        Verdict ("effect_found", "no_effect", or "unexplained" if an error remains that no effect explains), the three
        machines with their errors on the held-out runs, and the selected effects.

    Raises:
        InputError: If the runs cannot be divided into fitted and held-out ones, a held-out name is unknown, a run has
            fewer than 20 rows, no sensor moves in the fitted runs, or `recordings` is a path.
    """
    began = time.perf_counter()
    if isinstance(recordings, str | Path):
        raise InputError(
            f"identify needs recordings, not a path; call load_recordings({str(recordings)!r}, machine)"
        )
    load_plugins()  # the search tries their effects as well
    criteria, log = criteria or SelectionCriteria(), log or (lambda line: None)
    recordings = sorted(
        recordings, key=lambda recording: recording.name
    )  # the result depends on no other order
    require_rows(recordings)
    held_names = hold_out(recordings, held_out)
    require_motion([recording for recording in recordings if recording.name not in held_names])
    budget = _budget(budget, recordings, machine, log)

    # Prepare: what of the recordings can be fitted.
    session = prepare_session(recordings, machine, criteria, log)
    all_runs = session.data

    # Refit, propose, judge, repeat: in the fitted runs.
    search = partial(search_and_check, machine, all_runs, criteria=criteria, log=log, budget=budget)
    checked = search(held_names)
    complete = not checked.outcome.selected and not held_out and not checked.outcome.unfinished
    hint = hint_of_differing_runs(checked, search, log) if complete else ()

    # Validate: the held-out runs remove effects, and judge the names of those that are left.
    outcome = without_unconfirmed(checked.outcome, checked.agreeing, log)
    outcome = with_input_timing(outcome, checked.agreeing, criteria, log)
    validation = with_all_measurements(checked.held_out, session.usable)
    test = HeldOutTest(machine, session.ranges, validation, recordings, criteria)
    evaluated, reason = judged(test.evaluate(outcome), checked.differing, log)
    any_name = bool(evaluated.outcome.selected)
    plain, evaluated, delivered = at_least_plain(evaluated, checked.plain, log, budget)
    outcome = evaluated.outcome
    if any_name and not outcome.selected:
        reason = delivered

    # Report.
    remarks = (*checked.remarks, *hint, *((delivered,) if delivered and delivered != reason else ()))
    if remarks or outcome.verdict == "unexplained":
        remarks += describe_run_differences(outcome.after, comparable_runs(checked, all_runs), criteria)
    unfinished = (
        Unfinished(outcome.unfinished, budget.reason, budget.interrupted) if outcome.unfinished else None
    )
    result = build_result(evaluated, reason, unfinished, plain)
    remarks += unexcited_effects(result, outcome.after.bandwidth)
    log(f"verdict: {result.verdict}")
    for s in (s for s in result.effects if s.rivals):
        log(f"these runs cannot distinguish {s.effect.label} from {', '.join(s.rivals)}")
    result = dataclasses.replace(
        result, contradicting=checked.differing, excluded=(*remarks, *checked.messages)
    )
    return dataclasses.replace(result, seconds=time.perf_counter() - began)


def _budget(
    budget: float | Budget | None, recordings: Sequence[Recording], machine: Machine, log: Log
) -> Budget:
    """Return the processor time that the identification may take, and log it."""
    if not isinstance(budget, Budget):
        budget = Budget(default_budget(recordings, machine) if budget is None else budget)
    if math.isfinite(budget.seconds):
        rows = sum(len(recording.time_s) for recording in recordings)
        log(f"{len(recordings)} runs, {rows} rows: at most about {budget.seconds:.0f} s of processor time")
    return budget
