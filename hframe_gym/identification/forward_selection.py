"""Forward selection: which effects does the machine lack?

The best few of the screening are fitted in full beside the machine's own parameters, by innovations; the best of them
stays if it saves enough, and the search goes on from there.  At the end each effect must still be worth its place.
"Enough" is a share of the number of samples: quantised encoders leave a residual that is not white, in which any
statistic for white noise sees effects that are not there.  Where the model misses by far more than the noise, it is a
share of what is missed.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..machine import AppliedEffect, Machine
from .candidates import candidates, effect_parameters
from .covariance import with_uncertainty
from .dataset import Dataset
from .estimation import Fit, cost_of, default_free_parameters, fit, over_runs
from .nonparametric import tables
from .prediction import POLISH_STEP, SEARCH_STEP, predict
from .residual import missing_force
from .screening import ScoredCandidate, screen
from .structural_candidates import structural
from .typical_scales import TypicalScales, references

# Smaller savings are nothing, by share of samples: in free run, calibrated on rigs without effects
# (benchmarks/identification.py); by innovations, whose memory can pretend more.
LEAST_GAIN = 0.003
LEAST_INNOVATION = 0.01
# ... in few samples chance has a larger share: so much (chi2 of all) is nothing, however short the recordings.
LEAST_COST = 200.0
# ... and where the model misses by far more than the noise, by share of what is missed.
LEAST_SHARE = 0.02
# Candidates that save at least this share of what the best one saves are not told apart from it.
RIVAL_SHARE = 0.97
# ... nor are those within this share of samples.
RIVAL_GAIN = 0.002
NOTHING_LEFT = 1.01
# An effect smaller than this many of its own (robust) standard deviations is not there.
DOUBT = 4.0
# What a table of two dozen values must save: as a share of samples, and of what is missed.
TABLE_GAIN, TABLE_SHARE = 0.02, 0.2
MOST_EFFECTS = 5
_FITTED_IN_FULL = 5
_TABLES = 6
# Of the cost of data that a table was not fitted to, it must take off most.
_UNSEEN = 0.4
# A single run is judged by this many parts, in turn.
_PARTS = 8
# Candidates that promise less than this share of the best promise are not worth a fit.
_PROMISING = 0.4
# ... and a fit finds more than the linear promise, but hardly twice as much.
_LINEAR = 0.6
# Innovations of a right model, quantised encoders and all, are about this large (chi2 a sample).
_FLOOR = 1.1
_REST = 0.2
# Where this much is missed, what saves less than that share of it is a crutch, not the effect.
_MUCH, _LEAST_OF_MUCH = 3.0, 0.1

# In free run what is left is compared with what a polished fit leaves.
_STEPS = {"innovations": SEARCH_STEP, "free": POLISH_STEP}

Say = Callable[[str], None]


@dataclass(frozen=True)
class SelectedEffect:
    """An effect of the corrected machine, with those not told apart from it and what it saved (in-sample chi2).

    lacking: the machine as it was fitted before the effect was added.  rival_effects: the rivals that were fitted.
    """

    effect: AppliedEffect
    rivals: tuple[str, ...]
    saved: float
    lacking: Machine
    rival_effects: tuple[AppliedEffect, ...] = ()

    def with_values(self, machine: Machine) -> SelectedEffect:
        """The same finding with the numbers of a machine fitted later."""
        effect = next(e for e in machine.effects if e.label == self.effect.label)
        return dataclasses.replace(self, effect=effect)


def trace(
    current: Fit,
    found: tuple[SelectedEffect, ...],
    data: Dataset,
    say: Say,
    smallest: float,
    done: Callable[[Fit], bool] = lambda fit: False,
) -> tuple[Fit, tuple[SelectedEffect, ...]]:
    """The machine with the effects that the data demand beyond those found, in the mode of `current`.

    smallest: the gain (chi2 a sample) below which an effect is nothing.  done: whether a fit with one more effect ends
    the search.
    """
    while len(found) < MOST_EFFECTS and current.chi2 > NOTHING_LEFT:
        enough = least(current, smallest)
        scale = typical(current, data)
        missing = missing_force(current.machine, data)
        everything = candidates(current.machine, data, scale, missing, long=current.mode == "free")
        promising = _best(screen(current, everything, data), enough * data.count)
        trials = [_add(current, s, scale, data) for s in promising]
        if not any(_explains(trial, current) for trial in trials):
            worth = max((current.cost - t.cost for t in trials), default=0.0) >= enough * data.count
            machines = structural(current, data, scale, enough if worth else 0.0)
            trials += [_restructured(current, machine, scale, data) for machine in machines]
        if not trials:
            break
        trials.sort(key=lambda t: t.cost)
        best = _finished(trials[0], data)
        effect = best.machine.effects[-1]
        saved = (current.cost - best.cost) / data.count
        say(f"  {effect.label} saves {saved:.3g} of {current.chi2:.4g} (chi2 a sample, {current.mode})")
        if saved < enough:
            break
        close = _rivals(trials, current, data)
        names = (*(e.label for e in close), *effect.definition.equivalent)
        found = (*found, SelectedEffect(effect, names, saved, current.machine, close))
        current = best
        if done(current):
            break
    return current, tuple(f.with_values(current.machine) for f in found)


def _finished(trial: Fit, data: Dataset) -> Fit:
    """A trial fitted to the last digit, from where it stands and from the machine as declared.

    Without the effect the machine's own numbers had bent to do its work, sometimes into a valley of their own.
    """
    effects = np.array(["@" in f.name for f in trial.free])
    step = _STEPS[trial.mode]
    fits = [
        fit(trial.machine, trial.free, data, trial.mode, theta=theta, longest_step=step)
        for theta in (trial.theta, np.where(effects, trial.theta, 0.0))
    ]
    return min(fits, key=lambda f: f.cost)


def _explains(trial: Fit, current: Fit) -> bool:
    """Whether a trial leaves so little that no change of structure needs to be tried."""
    return trial.chi2 - _FLOOR < _REST * (current.chi2 - _FLOOR)


def _rivals(trials: list[Fit], current: Fit, data: Dataset) -> tuple[AppliedEffect, ...]:
    """The effects that the data do not tell apart from the best trial's."""
    best = trials[0]
    margin = max(RIVAL_GAIN * data.count, (1.0 - RIVAL_SHARE) * (current.cost - best.cost))
    close = (t.machine.effects[-1] for t in trials[1:] if t.cost - best.cost < margin)
    return tuple(e for e in close if e.label != best.machine.effects[-1].label)


def least(current: Fit, smallest: float) -> float:
    """The gain (chi2 a sample) below which an effect is nothing."""
    missed = current.chi2 - 1.0
    share = LEAST_SHARE if missed < _MUCH else _LEAST_OF_MUCH
    return max(smallest, LEAST_COST / current.count, share * missed)


def prune_effects(
    current: Fit, found: tuple[SelectedEffect, ...], data: Dataset, say: Say, *, longest_step: float
) -> tuple[Fit, tuple[SelectedEffect, ...]]:
    """Drop the effects that are not worth their place in the mode of `current`, weakest first.

    Later effects make earlier ones idle, and what only improves the innovations does not predict anything.  An effect
    also goes when its size is within DOUBT of its own standard deviations of nought.  A structural effect stays: the
    others stand on its tables.
    """
    for f in sorted(found, key=lambda f: f.saved):
        if f.effect.definition.structure:
            continue
        shorter = without(current, f.effect.label, data, longest_step=longest_step)
        idle = (shorter.cost - current.cost) / data.count < least(current, LEAST_GAIN)
        if idle or _doubtful(current, f.effect, data):
            say(f"  {f.effect.label} is {'idle' if idle else 'in doubt'}")
            # What was worth its place beside it need not be so alone.
            others = tuple(other for other in found if other is not f)
            return prune_effects(shorter, others, data, say, longest_step=longest_step)
    return current, tuple(f.with_values(current.machine) for f in found)


def _doubtful(current: Fit, effect: AppliedEffect, data: Dataset) -> bool:
    names = effect.definition.amplitudes
    if len(names) != 1:
        return False
    machine = with_uncertainty(current, data)
    name = f"{effect.label}.{names[0]}"
    std = machine.uncertainty.std(name) if machine.uncertainty else None
    return std is not None and abs(machine.parameters[name]) < DOUBT * std


def add_tables(
    current: Fit, found: tuple[SelectedEffect, ...], data: Dataset, say: Say, most: int
) -> tuple[Fit, tuple[SelectedEffect, ...]]:
    """The machine with up to `most` tables for what its effects leave, fitted by innovations."""
    for _ in range(most):
        scale = typical(current, data)
        ranked = screen(current, tables(current.machine, data, scale), data)
        enough = max(TABLE_GAIN, TABLE_SHARE * (current.chi2 - _FLOOR)) * data.count
        if not ranked or ranked[0].gain < enough:
            break
        tested = (s for s in ranked[:_TABLES] if s.gain > enough)
        chosen = next((s for s in tested if _unseen(current, s, scale, data) < _UNSEEN), None)
        if chosen is None:
            break
        trial = _add(current, chosen, scale, data)
        best = fit(trial.machine, trial.free, data, current.mode, theta=trial.theta)
        effect = best.machine.effects[-1]
        saved = (current.cost - best.cost) / data.count
        say(f"  {effect.label} saves {saved:.3g} of {current.chi2:.4g} (chi2 a sample)")
        if saved < enough / data.count:
            break
        found = (*found, SelectedEffect(effect, (), saved, current.machine))
        current = best
    return current, tuple(f.with_values(current.machine) for f in found)


def _unseen(current: Fit, screened: ScoredCandidate, scale: TypicalScales, data: Dataset) -> float:
    """Share of the cost of data that a table was not fitted to which is left with it, each half of the data in turn.

    Two dozen values fit much that is not there; a table against the wrong variable tells nothing about another run.
    """
    halves = _halves(data, by_run=screened.candidate.effect.against != "time")
    left = missed = 0.0
    for fitted, unseen in (halves, halves[::-1]):
        trial = _add(current, screened, scale, fitted)
        left += cost_of(trial.machine, unseen, current.mode)
        missed += cost_of(current.machine, unseen, current.mode)
    return left / missed


def _halves(data: Dataset, *, by_run: bool) -> tuple[Dataset, Dataset]:
    """Every other run and the rest; or, where there is one or where runs have nothing in common, every other part."""
    if by_run and len(data.runs) > 1:
        names = [run.name for run in data.runs]
        return data.only(names[0::2]), data.only(names[1::2])
    parts = 2 if len(data.runs) > 1 else _PARTS
    first = [(np.arange(len(run.time_s)) * parts // len(run.time_s) + k) % 2 == 0 for k, run in enumerate(data.runs)]
    return data.judged(first), data.judged([~rows for rows in first])


def without(current: Fit, label: str, data: Dataset, *, longest_step: float) -> Fit:
    """The fit without one effect, everything else fitted anew."""
    others = tuple(e for e in current.machine.effects if e.label != label)
    kept = [i for i, free in enumerate(current.free) if not free.name.startswith(f"{label}.")]
    return fit(
        current.machine.replace(effects=others),
        [current.free[i] for i in kept],
        data,
        current.mode,
        theta=current.theta[kept],
        longest_step=longest_step,
    )


def typical(current: Fit, data: Dataset) -> TypicalScales:
    """What is typical of the fitted machine in these runs."""
    motions = list(
        over_runs(lambda run: predict(current.machine, run, current.mode, period=data.period, states=True), data)
    )
    positions, velocities = (
        np.concatenate([getattr(m, key)[0] for m in motions]) for key in ("positions", "velocities")
    )
    return references(current.machine, positions, velocities, [run.inputs for run in data.runs])


def _best(ranked: list[ScoredCandidate], enough: float) -> list[ScoredCandidate]:
    """The few best, one shape of each effect and site, that could save enough (cost)."""
    chosen: dict[str, ScoredCandidate] = {}
    least_promise = max(_LINEAR * enough, _PROMISING * ranked[0].gain if ranked else 0.0)
    for s in ranked:
        if s.gain > least_promise:
            chosen.setdefault(s.candidate.label, s)
    return list(chosen.values())[:_FITTED_IN_FULL]


def _add(current: Fit, screened: ScoredCandidate, scale: TypicalScales, data: Dataset) -> Fit:
    """The machine with one more effect, everything fitted together by innovations."""
    candidate = screened.candidate
    machine = current.machine.with_effects(candidate.applied(screened.amounts))
    own = effect_parameters(machine.effects[-1], machine, scale)
    values = machine.parameters
    theta = np.concatenate([current.theta, [f.theta(values[f.name]) for f in own]])
    step = _STEPS[current.mode]
    return fit(
        machine, current.free + own, data, current.mode, theta=theta, iterations=8, tolerance=1e-3, longest_step=step
    )


def _restructured(current: Fit, machine: Machine, scale: TypicalScales, data: Dataset) -> Fit:
    """A machine with another effect in the place of what it had, its own parameters free around those fitted so far.

    Around the declared ones where the tables are new: fitted without them, the others had bent to do their work.
    """
    effect = machine.effects[-1]
    if effect.definition.structure:
        own = {f.name: f.center for f in current.free if "@" not in f.name}
        machine = current.machine.replace(own).with_effects(effect)
    free = list(default_free_parameters(machine, effects=False))
    for e in machine.effects:
        free += effect_parameters(e, machine, scale)
    theta = np.array([f.theta(machine.parameters[f.name]) for f in free])
    step = _STEPS[current.mode]
    return fit(machine, free, data, current.mode, theta=theta, iterations=8, tolerance=1e-3, longest_step=step)
