"""Forward selection: which effects does the machine lack?

The best few of the screening are fitted in full beside the machine's own parameters, by innovations; the best of them
stays if it saves enough, and the search goes on from there.  At the end each effect must still be worth its place.
"Enough" is a share of the number of samples: quantised encoders leave a residual that is not white, in which any
statistic for white noise sees effects that are not there.  Where the model misses by far more than the noise, it is a
share of what is missed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..machine import AppliedEffect, Machine
from .candidates import Candidate, candidates, effect_parameters, references
from .data import Data
from .fit import Fit, fit, over_runs
from .prediction import predict
from .screening import Screened, screen

# Smaller savings are nothing, by share of samples.  Rigs without effects stay below 0.0005 (tests/identify).
LEAST_GAIN = 0.01
# ... and where the model misses by far more than the noise, by share of what is missed.
LEAST_SHARE = 0.02
# Candidates within this share of samples of the best are not told apart from it.
RIVAL_GAIN = 0.002
NOTHING_LEFT = 1.02
MOST_EFFECTS = 4
_FITTED_IN_FULL = 5

Say = Callable[[str], None]


@dataclass(frozen=True)
class Found:
    """An effect of the corrected machine, with those not told apart from it and what it saved (in-sample chi2)."""

    effect: AppliedEffect
    rivals: tuple[str, ...]
    saved: float

    def with_values(self, machine: Machine) -> Found:
        """The same finding with the numbers of a machine fitted later."""
        effect = next(e for e in machine.effects if e.label == self.effect.label)
        return Found(effect, self.rivals, self.saved)


def trace(base: Fit, data: Data, say: Say) -> tuple[Fit, tuple[Found, ...]]:
    """The machine with the effects that the data demand, fitted by innovations, and the effects."""
    current = base
    found: list[Found] = []
    while len(found) < MOST_EFFECTS and current.chi2 > NOTHING_LEFT:
        ranked = screen(current, _candidates(current, data), data)
        trials = [_add(current, s, data) for s in _best(ranked, current)]
        if not trials:
            break
        trials.sort(key=lambda t: t.cost)
        best, effect = trials[0], trials[0].machine.effects[-1]
        saved = (current.cost - best.cost) / data.count
        say(f"  {effect.label} saves {saved:.3g} of {current.chi2:.4g} (chi2 a sample)")
        if saved < _least(current):
            break
        rivals = tuple(t.machine.effects[-1].label for t in trials[1:] if t.cost - best.cost < RIVAL_GAIN * data.count)
        found.append(Found(effect, rivals + effect.definition.equivalent, saved))
        current = best
    return current, tuple(f.with_values(current.machine) for f in found)


def _least(current: Fit) -> float:
    return max(LEAST_GAIN, LEAST_SHARE * (current.chi2 - 1.0))


def without_idle(
    current: Fit, found: tuple[Found, ...], data: Data, say: Say, *, longest_step: float
) -> tuple[Fit, tuple[Found, ...]]:
    """Drop the effects whose absence costs less than the least gain, in the mode of `current`.

    Later effects make earlier ones idle, and what only improves the innovations does not predict anything.
    """
    for f in found:
        others = tuple(e for e in current.machine.effects if e.label != f.effect.label)
        kept = [i for i, free in enumerate(current.free) if not free.name.startswith(f"{f.effect.label}.")]
        shorter = fit(
            current.machine.replace(effects=others),
            [current.free[i] for i in kept],
            data,
            current.mode,
            theta=current.theta[kept],
            longest_step=longest_step,
        )
        if (shorter.cost - current.cost) / data.count < _least(current):
            say(f"  {f.effect.label} is idle")
            current, found = shorter, tuple(other for other in found if other is not f)
    return current, tuple(f.with_values(current.machine) for f in found)


def _candidates(current: Fit, data: Data) -> list[Candidate]:
    count = len(current.machine.coordinates)
    period = data.period
    motions = over_runs(
        lambda run: predict(current.machine, run, current.mode, period=period, velocities=True)[0, :, count:], data
    )
    return candidates(current.machine, references(current.machine, np.concatenate(list(motions))))


def _best(ranked: list[Screened], current: Fit) -> list[Screened]:
    """The few best, one shape of each effect and site, that could save enough."""
    chosen: dict[str, Screened] = {}
    for s in ranked:
        if s.gain > 0.3 * _least(current) * current.count:
            chosen.setdefault(s.candidate.label, s)
    return list(chosen.values())[:_FITTED_IN_FULL]


def _add(current: Fit, screened: Screened, data: Data) -> Fit:
    """The machine with one more effect, everything fitted together by innovations."""
    candidate = screened.candidate
    machine = current.machine.with_effects(candidate.applied(screened.amplitude))
    own = effect_parameters(machine.effects[-1], candidate.references, candidate.amplitude)
    theta = np.concatenate([current.theta, np.zeros(len(own))])
    return fit(machine, current.free + own, data, current.mode, theta=theta)
