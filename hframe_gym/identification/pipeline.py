"""The loop: recordings -> fit -> residual -> trace -> verdict, each arrow a function on plain data."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from ..errors import InputError
from ..machine import Machine
from ..recordings import Recording
from .covariance import with_uncertainty
from .dataset import Dataset, prepare, shown
from .encoder_offsets import with_zeros, zero_errors
from .estimation import Fit, default_free_parameters, fit
from .experiment_design import design_discriminating_experiment
from .forward_selection import LEAST_GAIN, LEAST_INNOVATION, SelectedEffect, add_tables, least, prune_effects, trace
from .prediction import POLISH_STEP, Mode
from .residual import channel_errors, depends_on, force_error, is_white
from .result import IdentificationResult, ModelEvaluation, PredictionErrors, Verdict
from .sensor_saturation import blank_saturated, range_effects, saturation_ranges

# A free run this far off, over the signal's own size, has drifted: then innovations judge, and the force error.
_DRIFT = 0.3
# Cost a sample up to which what is left is the sensors' noise.
_EXPLAINED = 1.5
# Where no free run can judge it, an effect must account for this share of all that was missed.
_LEAST_UNJUDGED = 0.01
# Up to here a free run is near enough to the data for its own search.
_NEAR = 50.0
# ... or this share of the cost before, where that was large.
_NEXT_TO_NOTHING = 1e-4
# A table is named as what it is: it may stand where it leaves no more than this share of the best named cost.
_TABLED = 0.02
# Named effects that take less than this off what is missed are no explanation.
_MOSTLY = 0.25

Say = Callable[[str], None]


def hold_out(recordings: Sequence[Recording], chosen: Sequence[str] = ()) -> tuple[str, ...]:
    """Names of the runs kept for judging: those asked for, else every fourth, at least one.

    Raises InputError for an unknown run or when no run would be left to fit.
    """
    names = [r.name for r in recordings]
    unknown = [c for c in chosen if c not in names]
    if unknown:
        raise InputError(f"--hold-out {unknown[0]}: no such run; there are {', '.join(names)}")
    kept = tuple(chosen) or tuple(names[3::4]) or tuple(names[-1:])
    if len(set(kept)) >= len(names):
        raise InputError(f"{len(names)} run(s), {len(set(kept))} held out: at least one must be left to fit")
    return kept


def identify(
    recordings: Sequence[Recording],
    machine: Machine,
    *,
    held_out: Sequence[str] = (),
    say: Callable[[str], None] = lambda line: None,
) -> IdentificationResult:
    """Fit the machine to its recordings, find what it lacks, and judge on runs that nothing was fitted to.

    held_out: names of the runs to judge on (default: every fourth).  say: called with a line at each stage.

    Raises InputError when the runs cannot be split.
    """
    began = time.perf_counter()
    everything = prepare(recordings, machine)
    ranges = saturation_ranges(recordings, machine, everything.noise)
    if ranges:
        say(f"stuck at the ends of a range: {', '.join(ranges)}")
        noise = everything.noise
        everything = prepare([blank_saturated(r, ranges, machine, noise) for r in recordings], machine)
    kept = hold_out(recordings, held_out)
    judge = shown(everything.only(kept), recordings)
    data = everything.only([r.name for r in recordings if r.name not in kept])
    say(f"fitting {machine.name} to {len(data.runs)} runs, {len(judge.runs)} held out")
    base = fit(machine, default_free_parameters(machine), data, "innovations")
    before = _polish(base, data)
    mode = before.mode
    say(f"refitted: chi2 a sample {base.chi2:.4g} by innovations, {before.chi2:.4g} in {mode} run")
    say("searching for effects")
    verdict, after, found = _explain(base, before, data, say)
    say(f"verdict: {verdict}")
    own = _from_zeros(after.machine, data, data)
    fitted = with_uncertainty(after, own).replace(name=f"{machine.name}-identified")
    # One range a sensor: what the fit has found of its ends goes with what the readings show.
    ends = range_effects(ranges, [f.effect for f in found])
    labels = {e.label for e in ends}
    fitted = fitted.replace(effects=tuple(e for e in fitted.effects if e.label not in labels))
    found = tuple(f for f in found if f.effect.label not in labels)
    corrected = fitted.with_effects(*ends)
    found += tuple(SelectedEffect(e, (), 0.0, fitted) for e in ends)
    if found and verdict == "no_effect":
        verdict = "effect_found"
    refitted = before.machine.replace(name=f"{machine.name}-refitted")
    experiments = (
        design_discriminating_experiment(after, corrected, f.effect.label, f.rival_effects, own) for f in found
    )
    stages = [ModelEvaluation(m, _errors(m, _from_zeros(m, judge, data))) for m in (machine, refitted, corrected)]
    judge = _from_zeros(corrected, judge, data)
    return IdentificationResult(
        verdict=verdict,
        declared=stages[0],
        before=stages[1],
        after=stages[2],
        found=found,
        gains={f.effect.label: _gain(f, corrected, judge, mode) for f in found},
        dependence=tuple(depends_on(before.machine, data)[:6]),
        white=is_white(corrected, judge),
        fitted=data,
        held_out=judge,
        seconds=time.perf_counter() - began,
        experiment=next(filter(None, experiments), None),
    )


def _from_zeros(machine: Machine, runs: Dataset, data: Dataset) -> Dataset:
    """Runs that start where a machine fitted to `data` takes the encoders' zeros to be."""
    return with_zeros(runs, machine, zero_errors(machine, data))


def _polish(fitted: Fit, data: Dataset, mode: Mode | None = None) -> Fit:
    """The fit refined in free run, at the finer step; by innovations where the free run drifts away."""
    if mode is None:
        errors = channel_errors(fitted.machine, data)
        outputs = np.concatenate([run.outputs for run in data.runs])
        worst = 0.0
        for channel, values in zip(fitted.machine.output_channels, outputs.T, strict=True):
            rmse = errors[channel].rmse
            if rmse is not None:
                worst = max(worst, rmse / max(float(np.nanstd(values)), 1e-12))
        mode = "free" if worst < _DRIFT else "innovations"
    return fit(fitted.machine, fitted.free, data, mode, theta=fitted.theta, longest_step=POLISH_STEP)


def _explain(base: Fit, before: Fit, data: Dataset, say: Say) -> tuple[Verdict, Fit, tuple[SelectedEffect, ...]]:
    """Named effects if they explain the residual; else a table, alone or beside them; else nothing."""
    free = before.mode == "free"
    near = free and before.chi2 < _NEAR
    polished: dict[tuple[str, ...], Fit] = {(): before}

    def settled(traced: Fit, found: tuple[SelectedEffect, ...]) -> tuple[Fit, tuple[SelectedEffect, ...]]:
        """Polished, completed where a free run shows what innovations cannot, and rid of what is idle."""
        now = polished.get(_labels(traced)) or _polish(traced, data, before.mode)
        runs = _from_zeros(now.machine, data, data) if free else data
        if runs is not data:
            now = _polish(now, runs, "free")
        if free and now.chi2 < _NEAR:
            now, found = trace(now, found, runs, say, LEAST_GAIN)
        return prune_effects(now, found, runs, say, longest_step=POLISH_STEP)

    def done(traced: Fit) -> bool:
        """Whether a free run is explained, or shows that the last effect is none: innovations keep other traces."""
        if not free or traced.chi2 > _NEAR:
            return False
        last = polished.get(_labels(traced)[:-1])
        now = polished[_labels(traced)] = _polish(traced, data, before.mode)
        idle = near and last is not None and (last.cost - now.cost) / data.count < least(now, LEAST_GAIN)
        return now.chi2 < _EXPLAINED or idle

    smallest = LEAST_INNOVATION if free else max(LEAST_INNOVATION, _LEAST_UNJUDGED * base.chi2)
    traced, named = trace(base, (), data, say, smallest, done)
    after, found = settled(traced, named)
    if near and named and not _explains(after, before):
        again, others = settled(before, ())
        if again.cost < after.cost:
            after, found = again, others
    if _explains(after, before):
        return ("effect_found", after, found) if found else ("no_effect", before, ())
    say("searching for what has no name here")
    for start, beside, most in ((base, (), 1), (traced, named, 2)):
        tabled, more = add_tables(start, beside, data, say, most)
        if len(more) > len(beside):
            # No search beside a table: what its straight pieces leave looks like many a small effect.
            now = _polish(tabled, data, before.mode)
            candidate, kept = prune_effects(now, more, data, say, longest_step=POLISH_STEP)
            if kept and (_explains(candidate, before) or candidate.cost < _TABLED * min(before.cost, after.cost)):
                return "effect_found", candidate, kept
    if found and after.cost < _MOSTLY * before.cost:
        return "effect_found", after, found
    return "unexplained", before, ()


def _labels(fitted: Fit) -> tuple[str, ...]:
    return tuple(e.label for e in fitted.machine.effects)


def _explains(after: Fit, before: Fit) -> bool:
    """Whether what is left is the sensors' noise, or next to nothing of what was missed."""
    return after.chi2 < max(_EXPLAINED, _NEXT_TO_NOTHING * before.chi2)


def _errors(machine: Machine, data: Dataset) -> PredictionErrors:
    return PredictionErrors(channel_errors(machine, data), force_error(machine, data))


def _gain(found: SelectedEffect, machine: Machine, judge: Dataset, mode: Mode) -> float:
    """Share of the held-out squared error that the machine without this one effect has and with it has not.

    Where the free run drifts it is the error of the force, if the machine has one.
    """

    def cost(m: Machine) -> float:
        force = force_error(m, judge) if mode == "innovations" else None
        if force is not None:
            return force**2
        return float(
            np.mean([e.noise_ratio**2 for e in channel_errors(m, judge).values() if e.noise_ratio is not None])
        )

    others = tuple(e for e in machine.effects if e.label != found.effect.label)
    without = found.lacking if found.effect.definition.structure else machine.replace(effects=others)
    return 1.0 - cost(machine) / cost(without)
