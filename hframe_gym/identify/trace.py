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
from .candidates import candidates, effect_parameters
from .data import Data
from .fit import Fit, fit, over_runs, own_parameters
from .prediction import predict
from .references import References, references
from .residual import missing_force
from .screening import Screened, screen
from .structures import structural

# Smaller savings are nothing, by share of samples (calibrated on rigs without effects, benchmarks/identification.py).
LEAST_GAIN = 0.003
# ... and where the model misses by far more than the noise, by share of what is missed.
LEAST_SHARE = 0.02
# Candidates that save at least this share of what the best one saves are not told apart from it.
RIVAL_SHARE = 0.97
# ... nor are those within this share of samples.
RIVAL_GAIN = 0.002
NOTHING_LEFT = 1.01
MOST_EFFECTS = 5
_FITTED_IN_FULL = 5
# Candidates that promise less than this share of the best promise are not worth a fit.
_PROMISING = 0.4

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
        scale = typical(current, data)
        everything = candidates(current.machine, data, scale, missing_force(current.machine, data))
        promising = _best(screen(current, everything, data), current)
        trials = [_add(current, s, data) for s in promising]
        trials += [_restructured(current, machine, scale, data) for machine in structural(current, data)]
        if not trials:
            break
        trials.sort(key=lambda t: t.cost)
        best, effect = trials[0], trials[0].machine.effects[-1]
        saved = (current.cost - best.cost) / data.count
        say(f"  {effect.label} saves {saved:.3g} of {current.chi2:.4g} (chi2 a sample)")
        if saved < least(current):
            break
        found.append(Found(effect, _rivals(trials, current, data), saved))
        current = best
    return current, tuple(f.with_values(current.machine) for f in found)


def _rivals(trials: list[Fit], current: Fit, data: Data) -> tuple[str, ...]:
    """The effects that the data do not tell apart from the best trial's."""
    best = trials[0]
    margin = max(RIVAL_GAIN * data.count, (1.0 - RIVAL_SHARE) * (current.cost - best.cost))
    close = tuple(t.machine.effects[-1].label for t in trials[1:] if t.cost - best.cost < margin)
    return close + best.machine.effects[-1].definition.equivalent


def least(current: Fit) -> float:
    """The gain (chi2 a sample) below which an effect is nothing."""
    return max(LEAST_GAIN, LEAST_SHARE * (current.chi2 - 1.0))


def without_idle(
    current: Fit, found: tuple[Found, ...], data: Data, say: Say, *, longest_step: float
) -> tuple[Fit, tuple[Found, ...]]:
    """Drop the effects whose absence costs less than the least gain, in the mode of `current`.

    Later effects make earlier ones idle, and what only improves the innovations does not predict anything.  A
    structural effect stays: the others stand on its tables.
    """
    for f in found:
        if f.effect.definition.structure:
            continue
        shorter = without(current, f.effect.label, data, longest_step=longest_step)
        if (shorter.cost - current.cost) / data.count < least(current):
            say(f"  {f.effect.label} is idle")
            current, found = shorter, tuple(other for other in found if other is not f)
    return current, tuple(f.with_values(current.machine) for f in found)


def without(current: Fit, label: str, data: Data, *, longest_step: float) -> Fit:
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


def typical(current: Fit, data: Data) -> References:
    """What is typical of the fitted machine in these runs."""
    motions = list(
        over_runs(lambda run: predict(current.machine, run, current.mode, period=data.period, states=True), data)
    )
    positions, velocities = (np.concatenate([getattr(m, key)[0] for m in motions]) for key in ("positions", "velocities"))
    return references(current.machine, positions, velocities, [run.inputs for run in data.runs])


def _best(ranked: list[Screened], current: Fit) -> list[Screened]:
    """The few best, one shape of each effect and site, that could save enough."""
    chosen: dict[str, Screened] = {}
    enough = max(0.3 * least(current) * current.count, _PROMISING * ranked[0].gain if ranked else 0.0)
    for s in ranked:
        if s.gain > enough:
            chosen.setdefault(s.candidate.label, s)
    return list(chosen.values())[:_FITTED_IN_FULL]


def _add(current: Fit, screened: Screened, data: Data) -> Fit:
    """The machine with one more effect, everything fitted together by innovations."""
    candidate = screened.candidate
    machine = current.machine.with_effects(candidate.applied(screened.amounts))
    own = effect_parameters(machine.effects[-1], candidate.references)
    theta = np.concatenate([current.theta, np.zeros(len(own))])
    return fit(machine, current.free + own, data, current.mode, theta=theta)


def _restructured(current: Fit, machine: Machine, scale: References, data: Data) -> Fit:
    """A machine with other tables, its own parameters free around what the fit so far has found."""
    free = list(own_parameters(machine))
    for e in machine.effects:
        free += effect_parameters(e, scale.of(machine.site_coordinate(e.site) or ""))
    return fit(machine, free, data, current.mode)

