"""What an identification's answer is worth, given what the rig hides."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from hframe_gym.identification import IdentificationResult
from hframe_gym.identification.residual import channel_errors
from hframe_gym.machine import Machine
from tests.reference_simulator import Array
from tests.rigs.planted import Planted
from tests.rigs.rigs import Case
from tests.rigs.sessions import Session

RIGHT = ("right",)
SCORES = ("right", "missed", "part", "extra", "wrong", "false alarm")


def judged(case: Case, verdict: str, named: list[str]) -> str:
    """One of SCORES for the labels (name@site) that were named.

    right: all that is planted, by an accepted label, and nothing else. missed: nothing named. part: some of it, nothing
    else. extra: all of it and more. wrong: something that is not there, and not all that is. false alarm: an effect in
    a rig without any. Outside the library it is right to say `unexplained`, or to name a table of the right variable.
    """
    if case.kind == "none":
        return "false alarm" if named else "right"
    harmless = {label for planted in case.planted for label in (*planted.accepted, *planted.also)}
    strange = [label for label in named if label not in harmless]
    if case.kind == "outside":
        if strange:
            return "wrong"
        return "right" if named or verdict == "unexplained" else "missed"
    there = [p for p in case.planted if set(p.accepted) & set(named)]
    whole = all(p in there or p.silent for p in case.planted)
    if strange:
        return "extra" if whole else "wrong"
    if whole:
        return "right"
    return "part" if named else "missed"


def scored(session: Session, answer: IdentificationResult) -> dict[str, Any]:
    """A row of the results: what was planted and found, errors before and after on the held-out runs, time."""
    case = session.case
    named = [f.effect.label for f in answer.found]
    score = judged(case, answer.verdict, named)
    stages = {"declared": answer.declared, "before": answer.before, "after": answer.after}
    mean = {
        name: float(np.mean([e.noise_ratio for e in stage.held_out.channels.values() if e.noise_ratio is not None]))
        for name, stage in stages.items()
    }
    return {
        "rig": case.name,
        "group": case.group,
        "kind": case.kind,
        "size": case.size,
        "runs": case.runs,
        "hides": " + ".join(p.label for p in case.planted),
        "verdict": answer.verdict,
        "found": " + ".join(named),
        "rivals": {f.effect.label: list(f.rivals) for f in answer.found},
        "score": score,
        "hit": score in RIGHT,
        **mean,
        "noise_ratio": {n: {c: e.noise_ratio for c, e in s.held_out.channels.items()} for n, s in stages.items()},
        "truth_um": {n: _tool_error(session, answer, s.machine) for n, s in stages.items()},
        "parameter_error": _parameter_error(case, answer),
        "white": answer.white,
        "seconds": round(answer.seconds, 2),
    }


def _tool_error(session: Session, answer: IdentificationResult, machine: Machine) -> float:
    """Free-run error of the tool (x and y together) against the noise-free held-out runs, um rms."""
    truth = session.truth()
    measured = {r.name: r.outputs for r in session.recordings()}

    def clean(name: str, outputs: Array) -> Array:
        # The same offsets taken off as from the measurement.
        offset = np.nanmean(measured[name] - outputs, axis=0)
        return truth[name] - offset

    runs = tuple(dataclasses.replace(r, outputs=clean(r.name, r.outputs)) for r in answer.held_out.runs)
    errors = channel_errors(machine, dataclasses.replace(answer.held_out, runs=runs))
    return 1e6 * float(np.sqrt(sum((errors[channel].rmse or 0.0) ** 2 for channel in ("x_m", "y_m"))))


def _parameter_error(case: Case, answer: IdentificationResult) -> dict[str, float]:
    """Relative error of the planted effects' parameters, by name@site.parameter, where they were named as planted."""
    errors = {}
    for planted in case.planted:
        found = _same(planted, answer)
        if found is None:
            continue
        for name, value in case.truth(planted).items():
            if name in found:
                # The sign of a sine's amplitude is half a period of its phase.
                errors[f"{planted.label}.{name}"] = abs(abs(found[name]) / abs(value) - 1.0)
    return errors


def _same(planted: Planted, answer: IdentificationResult) -> dict[str, float] | None:
    for f in answer.found:
        if f.effect.label == planted.label:
            return dict(f.effect.parameters)
    return None
