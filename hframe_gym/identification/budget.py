"""The budget of a search: processor time after which it ends with the best machine so far.

A search asks the active budget between trial fits and between the iterations of a fit (`spend`). When the
time is used up, or the user interrupts, `BudgetEndedError` unwinds the search. `search_effects` catches it
and returns the best machine so far, which then goes through the same validation and verdict as that of a
complete search. Without an active budget, as in a fit outside a search, `spend` does nothing.

Some stages must deliver a machine, such as the plain fit. In them (`limiting(delivers=True)`) nothing
unwinds: a fit asks `goes_on` after each iteration, and ends with its best parameters so far.

The measure is the processor time of this process, all threads together, so that a search does not lose the
time in which other programs run. A second does less on a slower processor, in several threads, or where other
programs share caches and clock: the same identification took 4 s on one day and up to 7.6 s on another. A
result depends on the budget only if the budget ends; report.json then has the key "unfinished".
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from typing import NamedTuple

from ..errors import InputError
from ..machine import Machine

DEFAULT_SECONDS = 120.0  # of processor time, whatever the number of cores; an engineer waits a minute or two
# Part of the budget after which no second search begins: with other held-out runs, or with another number of
# voltage changes between the rows.
SECOND_SEARCH_PART = 0.6
COMPARISON_PART = 0.85  # part after which no comparison of the runs with each other begins
LAST_STAGE_END = (
    0.9  # part after which no stage goes on; simulations of held-out runs and report take some seconds
)
# Part of the budget for the plain fit, at most. It must be delivered, because no machine may be worse. With
# 15 % of 30 s, that of a position drive had no weight, and left 24.6 instead of 9.0 times the noise on unseen
# runs.
PLAIN_FIT_PART = 0.3
# Part of the budget for what follows the last stage, at most; without a search, it would say little.
_LARGEST_RESERVE = 0.5
# Least part of a normal session that is fitted, however small the budget: two runs of 5 s of a stage.
_LEAST_SESSION_PART = 0.25
# Part of the budget after which the last fit ends that must be delivered, whatever took the time before.
_LAST_FIT_END = 0.95
# Part of the budget for each stage after the search. In complete identifications, tests and final fits took
# 5 to 20 %; a description takes 10 s for its first effect.
_STAGE_PART = 0.15

# What the search does, processor time since the identification began, and the whole budget, s.
Progress = Callable[[str, float, float], None]


class StageEnds(NamedTuple):
    """Fractions of the budget after which the stages of an identification end.

    Attributes:
        search: Search for effects.
        tests: Tests of the effects that a search found before it ended early; untested effects are not named.
        last_fit: Last fit of the machine without effects, if the tests took all of their time.
        all_rows: Fit to all rows, after a search in some of them.
    """

    search: float
    tests: float
    last_fit: float
    all_rows: float


def stage_ends(machine: Machine, *, in_part: bool = False) -> StageEnds:
    """Return when each stage of an identification must end, so that the later stages have time.

    The last stage ends at 0.9 of the budget. From there backward, 0.15 is kept for each of a description of
    the remaining error (machines without belts only, of which a search that ends early rarely names the
    cause), a fit to all rows (`in_part`) and the tests of what a search found.

    Args:
        machine: Machine to identify.
        in_part: Whether the search uses only some of the rows, so that a fit to all rows follows.

    Returns:
        Ends as fractions of the budget, dimensionless, counted from the start of the identification.
    """
    all_rows = LAST_STAGE_END - (0.0 if machine.belts else _STAGE_PART)
    tests = all_rows - (_STAGE_PART if in_part else 0.0)
    return StageEnds(tests - _STAGE_PART, tests, min(tests + _STAGE_PART, _LAST_FIT_END), all_rows)


class BudgetEndedError(Exception):
    """The budget of a search ended, or the user interrupted it."""


class Budget:
    """Processor time that an identification may take, and what has been used of it.

    Attributes:
        seconds: Processor time, s; infinite if the search has no limit.
        doing: What the search does or did last, in words.
        interrupted: Whether the user asked the search to end.
        searching: Whether a search is in progress that can end early.
        delivers: Whether the present stage ends with the best parameters so far instead of unwinding.
        error: Chi-squared per sample (mean squared residual in units of the noise) of the best machine so
            far, dimensionless; None before the first fit.
    """

    def __init__(
        self,
        seconds: float = math.inf,
        *,
        spent: float = 0.0,
        afterwards: float = 0.0,
        clock: Callable[[], float] = time.process_time,
        progress: Progress | None = None,
    ) -> None:
        """Start the clock.

        Args:
            seconds: Processor time, s.
            spent: Part of it that was spent before, such as for reading the recordings, s.
            afterwards: Part that follows the identification, such as for a report page, s.
            clock: Function that returns the time that was spent, s, with any zero.
            progress: Called with what the search does, the time spent and the budget, s, at each step of the
                search.

        Raises:
            InputError: If the budget is negative or not a number.
        """
        if not seconds >= 0.0:
            raise InputError(f"budget {seconds}: must be a number of seconds of processor time, 0 or more")
        self.seconds, self.doing, self.interrupted, self.searching = seconds, "", False, False
        self.error: float | None = None
        self._clock, self._progress = clock, progress
        self._ended: float | None = None  # time spent when the search ended
        self._part = 1.0  # of the budget, after which the present stage ends
        self.delivers = False
        self._afterwards = afterwards
        self.reserve(0.0)
        self._tests_part = math.inf  # of the budget, after which the tests end that follow the present stage
        self._tests = 0.0  # s, for these tests
        self._began = clock() - spent

    @property
    def spent(self) -> float:
        """Processor time used so far, s, including time before this object was created."""
        return self._clock() - self._began

    @property
    def reason(self) -> str:
        """Why the search ended early, in words: the user interrupted it, or its budget ended."""
        if self.interrupted:
            return (
                f"interrupted after {self.spent if self._ended is None else self._ended:.0f} "
                "s of processor time"
            )
        return f"the budget of {self.seconds:.0f} s of processor time ended"

    def stop(self) -> None:
        """Ask the search to end at its next step, with the best machine so far."""
        self.interrupted = True

    def check(self, doing: str = "") -> None:
        """Raise `BudgetEndedError` if the time of the present stage is used up; otherwise report progress.

        Args:
            doing: What the search does next, in words. Default: the same as at the last call.

        Raises:
            BudgetEndedError: If the time of the stage, without that of the tests that follow it, is used up,
                or the user interrupted.
        """
        self.doing = doing or self.doing
        self.check_quietly()
        if self._progress is not None:
            self._progress(self.doing, self.spent, self.seconds)

    def check_quietly(self) -> None:
        """Raise `BudgetEndedError` if the time of the present stage is used up, without a report of progress.

        Raises:
            BudgetEndedError: As `check` does.
        """
        spent = self.spent
        before_tests = self._end(self._tests_part) - self._tests
        if self.interrupted or spent >= min(self._end(self._part), before_tests):
            self._ended = spent
            raise BudgetEndedError

    def goes_on(self) -> bool:
        """Return whether the current stage has time left.

        A stage that must deliver a machine gets False when its time ends; any other stage gets an exception.

        Raises:
            BudgetEndedError: If the time of a stage that need not deliver is used up, or the user interrupted
                it.
        """
        if not self.delivers:
            self.check()
            return True
        return self.has_time(self._part)

    @property
    def session_part(self) -> float:
        """Fraction of a session of normal size that can be fitted in the budget, dimensionless.

        It is the budget / 120 s, from 0.25 to 1; 1 if the budget is 0, because nothing is then searched for.
        """
        if self.seconds == 0.0:
            return 1.0
        return min(max(self.seconds / DEFAULT_SECONDS, _LEAST_SESSION_PART), 1.0)

    def has_time(self, part: float) -> bool:
        """Return whether less than a fraction of the budget is used, so that a stage may begin.

        After an interruption by the user, it is False.

        Args:
            part: Fraction of the budget, dimensionless. If more than a tenth of the budget is reserved for
                what follows the last stage (`reserve`), it is a fraction of (budget - reserved time) / 0.9
                instead: the last stage then ends, at 0.9, when the reserved time begins.
        """
        return not self.interrupted and self.spent < self._end(part)

    def reserve(self, seconds: float) -> None:
        """Reserve time for the work after the last stage; all stages then end earlier by the same factor.

        Args:
            seconds: Expected processor time from the last stage to the end of the identification, s. It
                replaces an earlier estimate; at most half of the budget is reserved.
        """
        self._reserved = min(seconds + self._afterwards, _LARGEST_RESERVE * self.seconds)

    def expect_tests(self, seconds: float) -> None:
        """Let the present stage end earlier, so that the tests of what it found still end in time.

        Args:
            seconds: Expected processor time of these tests, s; at most half of the budget is kept for them.
        """
        self._tests = min(seconds, _LARGEST_RESERVE * self.seconds)

    def _end(self, part: float) -> float:
        """Return the time, s, after which a stage ends that may take some part of the budget."""
        return part * min(self.seconds, (self.seconds - self._reserved) / LAST_STAGE_END)

    def until(self, part: float, longest: float = math.inf) -> Budget:
        """Return a separate budget that ends when a part of this one is used, for one stage.

        An earlier interruption by the user does not end it.

        Args:
            part: Fraction of this budget after which the stage ends, dimensionless.
            longest: Processor time that the stage may take, s.
        """
        seconds = min(self._end(part) - self.spent, longest)
        return Budget(max(seconds, 0.0), clock=self._clock)

    @contextmanager
    def limiting(
        self, part: float = 1.0, *, delivers: bool = False, tests: float = math.inf
    ) -> Iterator[None]:
        """Make this budget the active one, which `spend` and `goes_on` ask, in a `with` block.

        Args:
            part: Part of the budget after which the stage ends, dimensionless.
            delivers: Whether fits of the stage then end with their best parameters instead of an exception.
            tests: Part of the budget after which the tests that follow the stage end (`expect_tests`),
                dimensionless. Default: no tests follow.
        """
        token = _ACTIVE.set(self)
        self.searching, self._part, self.delivers = True, part, delivers
        self._tests_part, self._tests = tests, 0.0
        try:
            yield
        finally:
            self.searching = self.delivers = False
            self._tests_part = math.inf
            _ACTIVE.reset(token)

    @contextmanager
    def during_tests(self) -> Iterator[None]:
        """Let the present stage, in a `with` block, use the time that is kept for the tests that follow it.

        The block contains tests that the stage makes itself. If its end interrupted them, they would begin
        again after it, and rarely end in the time that is left.
        """
        part, expected = self._part, self._tests
        if math.isfinite(self._tests_part):
            self._part, self._tests = self._tests_part, 0.0
        try:
            yield
        finally:
            self._part, self._tests = part, expected


_ACTIVE: ContextVar[Budget | None] = ContextVar("budget", default=None)


def spend(doing: str = "") -> None:
    """Raise `BudgetEndedError` if the time of the present stage is used up; searches call this between fits.

    Otherwise report progress. Without an active budget, and in a stage that must deliver a machine, it does
    nothing; such a stage calls `goes_on` instead.

    Args:
        doing: What the search does next, in words. Default: the same as at the last call.

    Raises:
        BudgetEndedError: If the time of the stage is used up, or the user interrupted.
    """
    budget = _ACTIVE.get()
    if budget is not None and not budget.delivers:
        budget.check(doing)


def goes_on() -> bool:
    """Return whether a fit may continue by the active budget, if there is one; fits call it in iterations.

    Returns:
        False only in a stage that must deliver a machine; the fit then ends with its best parameters.

    Raises:
        BudgetEndedError: If the time of any other stage is used up, or the user interrupted it.
    """
    budget = _ACTIVE.get()
    return True if budget is None else budget.goes_on()


def during_tests() -> AbstractContextManager[None]:
    """Return a context in which the present stage may use the time of its tests (`Budget.during_tests`).

    Without an active budget, it does nothing.
    """
    budget = _ACTIVE.get()
    return nullcontext() if budget is None else budget.during_tests()


def note_error(chi2: float) -> None:
    """Store the error of the best machine so far in the active budget, if there is one, to report progress.

    Args:
        chi2: Chi-squared per sample, dimensionless.
    """
    if (budget := _ACTIVE.get()) is not None:
        budget.error = chi2


def error_so_far() -> float | None:
    """Return the error of the best machine so far in the current search.

    Returns:
        Chi-squared per sample, dimensionless; None without a search, or before its first fit.
    """
    budget = _ACTIVE.get()
    return None if budget is None else budget.error


def may_begin_again() -> bool:
    """Return whether less than 60 % of the active budget is used (`SECOND_SEARCH_PART`), for a second search.

    Without an active budget, it is True; after an interruption by the user, False.
    """
    budget = _ACTIVE.get()
    return budget is None or budget.has_time(SECOND_SEARCH_PART)


def seconds_spent() -> float:
    """Return the processor time since the active budget began, s; 0 without an active budget."""
    budget = _ACTIVE.get()
    return 0.0 if budget is None else budget.spent


def expect_tests(seconds: float) -> None:
    """Keep time of the active budget for tests, by `Budget.expect_tests`; without one, do nothing.

    Args:
        seconds: Expected processor time of the tests, s.
    """
    if (budget := _ACTIVE.get()) is not None:
        budget.expect_tests(seconds)


def spender() -> Callable[[], None]:
    """Return a function for other threads that checks the budget that is active in this thread.

    Returns:
        Function without arguments; it raises `BudgetEndedError` as `spend` does, but reports no progress.
    """
    budget = _ACTIVE.get()
    return (lambda: None) if budget is None or budget.delivers else budget.check_quietly
