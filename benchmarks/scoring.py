"""Score an identification against the effects that the rig hides."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from fnmatch import fnmatch
from typing import Any

import numpy as np

from hframe_gym.arrays import Array
from hframe_gym.effects import EFFECTS
from hframe_gym.identification import IdentificationResult
from hframe_gym.identification.fit.channel_errors import channel_errors
from hframe_gym.machine import Machine
from tests.rigs.cases import Case
from tests.rigs.hidden_effects import HiddenEffect
from tests.rigs.random_effects import DrawnEffect
from tests.rigs.recording_sessions import Session

RIGHT = ("right",)
SCORES = ("right", "missed", "part", "extra", "wrong", "false alarm")


def classify(case: Case, verdict: str, named: list[str]) -> str:
    """Classify the effects that an identification named.

    right: all hidden effects by an accepted label, and nothing else. missed: no effect. part: some of the
    hidden effects, and nothing else. extra: all of them and others. wrong: others, but not all hidden ones.
    false alarm: an effect in a rig without any. For effects outside the library, the verdict `unexplained` or
    a table over the right variable counts as right.

    Args:
        case: The rig.
        verdict: The identification's verdict.
        named: Labels (name@site) of the identified effects.

    Returns:
        One of `SCORES`.
    """
    if case.kind == "none":
        return "false alarm" if named else "right"
    harmless = {label for hidden in case.hidden_effects for label in (*hidden.accepted, *hidden.tolerated)}
    unexpected = [label for label in named if label not in harmless]
    if case.kind == "outside":
        if unexpected:
            return "wrong"
        return "right" if named or verdict == "unexplained" else "missed"
    identified = [hidden for hidden in case.hidden_effects if set(hidden.accepted) & set(named)]
    complete = all(hidden in identified or hidden.absorbed for hidden in case.hidden_effects)
    if unexpected:
        return "extra" if complete else "wrong"
    if complete:
        return "right"
    return "part" if named else "missed"


def score_session(session: Session, answer: IdentificationResult) -> dict[str, Any]:
    """Return a row of results: hidden and identified effects, errors on held-out runs, computing time."""
    case = session.case
    named = [f.effect.label for f in answer.effects]
    score = classify(case, answer.verdict, named)
    stages = {"declared": answer.declared, "before": answer.before, "after": answer.after}
    mean = {
        name: float(
            np.mean([e.noise_ratio for e in stage.held_out.channels.values() if e.noise_ratio is not None])
        )
        for name, stage in stages.items()
    }
    return {
        "rig": case.name,
        "group": case.group,
        "kind": case.kind,
        "size": case.size,
        "runs": case.runs,
        "hides": " + ".join(hidden.label for hidden in case.hidden_effects),
        "verdict": answer.verdict,
        "found": " + ".join(named),
        "rivals": {f.effect.label: list(f.rivals) for f in answer.effects},
        "score": score,
        "hit": score in RIGHT,
        **mean,
        "noise_ratio": {
            n: {c: e.noise_ratio for c, e in s.held_out.channels.items()} for n, s in stages.items()
        },
        "truth_um": {n: _tool_error(session, answer, s.machine) for n, s in stages.items()},
        "parameter_error": parameter_error(case, answer),
        "white": answer.white,
        "seconds": round(answer.seconds, 2),
    }


def _tool_error(session: Session, answer: IdentificationResult, machine: Machine) -> float:
    """Return the tool's error in open-loop simulation of the noise-free held-out runs, um rms of x and y."""
    truth = session.truth()
    measured = {r.name: r.outputs for r in session.recordings()}

    def clean(name: str, outputs: Array) -> Array:
        # Subtract the same offsets as from the measurement.
        offset = np.nanmean(measured[name] - outputs, axis=0)
        return truth[name] - offset

    runs = tuple(dataclasses.replace(r, outputs=clean(r.name, r.outputs)) for r in answer.held_out.runs)
    errors = channel_errors(machine, dataclasses.replace(answer.held_out, runs=runs))
    return 1e6 * float(np.sqrt(sum((errors[channel].rmse or 0.0) ** 2 for channel in ("x_m", "y_m"))))


def parameter_error(case: Case, answer: IdentificationResult) -> dict[str, float]:
    """Return the relative errors of parameters by name@site.parameter, for effects named by their label.

    A parameter whose true value is zero has no relative error.
    """
    errors = {}
    for hidden in case.hidden_effects:
        estimates = _estimates(hidden, answer)
        for name, value in case.true_parameters(hidden).items():
            if name in estimates and value != 0.0:
                # A negative amplitude of a sine is a phase that differs by half a period.
                errors[f"{hidden.label}.{name}"] = float(abs(abs(estimates[name]) / abs(value) - 1.0))
    return errors


def _estimates(hidden: HiddenEffect, answer: IdentificationResult) -> dict[str, float]:
    """Return the estimated parameters of a hidden effect; none if it was not named by its label."""
    for f in answer.effects:
        if f.effect.label == hidden.label:
            return dict(f.effect.parameters)
    return {}


@dataclasses.dataclass(frozen=True)
class NameScore:
    """Score of the names that an identification gave.

    Attributes:
        identified: For each hidden effect whether it, or an acknowledged rival of it, was named.
        extra: Labels that were named and are not there.
    """

    identified: tuple[bool, ...]
    extra: tuple[str, ...]


def effect_class(label: str) -> str:
    """Return the class (family@site) of a label; no recording or report tells effects of one class apart.

    An offset of a motor's voltage is a constant torque of its pulley.
    """
    name, _, site = label.partition("@")
    if name == "voltage_offset":
        return f"constant_force@{site.replace('motor', 'phi')}"
    family = EFFECTS[name].family if name in EFFECTS else name
    return f"{family}@{site}"


def accepted_classes(effect: DrawnEffect) -> tuple[tuple[str, ...], ...]:
    """Return the sets of classes of which one must be named completely to count an effect as identified.

    Args:
        effect: Hidden effect of the library.

    Returns:
        For an effect on both drives, that on the site "drives", or one on each motor; for an effect on the
        belts, that on the site "belts", or on any belt.
    """
    if effect.site == "belts":
        return tuple(
            (effect_class(f"{effect.name}@{site}"),) for site in ("belts", "left", "right", "bottom")
        )
    per_motor = tuple(effect_class(f"{effect.name}@{site}") for site in effect.library_sites())
    return ((effect_class(effect.label),), per_motor)


def score_names(hidden: Sequence[DrawnEffect], verdict: str, named: Mapping[str, Sequence[str]]) -> NameScore:
    """Compare the named effects with the hidden ones up to their class.

    An effect outside the library counts as identified if one of its accepted labels is named, or if the
    verdict is `unexplained` and nothing else is named.

    Args:
        named: Rivals that the identification lists, by label of the named effect.
    """
    classes = {label: {effect_class(label), *map(effect_class, rivals)} for label, rivals in named.items()}
    all_named: set[str] = set().union(*classes.values())
    identified, expected = [], set()
    for effect in hidden:
        if effect.in_library:
            groups = accepted_classes(effect)
            accepted = {name for group in groups for name in group}
            labels = [label for label in named if classes[label] & accepted or label in effect.tables]
            described = any(label in effect.tables for label in labels)
            identified.append(
                effect.absorbed or described or any(set(group) <= all_named for group in groups)
            )
        else:
            # Labels may contain brackets, which would be special for `fnmatch`; only * is.
            patterns = [pattern.replace("[", "[[]") for pattern in effect.accepted if pattern]
            labels = [label for label in named if any(fnmatch(label, pattern) for pattern in patterns)]
            identified.append(
                bool(labels) or ("" in effect.accepted and verdict == "unexplained" and not named)
            )
        expected.update(labels)
    return NameScore(tuple(identified), tuple(label for label in named if label not in expected))
