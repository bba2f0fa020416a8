"""Protocols: benchmarks with everything fixed, so that scores of different people and years are comparable.

A protocol fixes the machine, randomization, sensors, drives, control period and metrics. Its *parts* are
tasks that are scored separately. Its *draws* are the episodes: a start, a goal and sampled machine parameters
each, the same for every *entry* (the controller or agent that is scored). A digest of all settings and draws
is part of the definition (`Protocol.digest`). Before a run the digest is computed again: if the package has
changed what it covers, no result is written, and the benchmark needs a new version (`reach-v2`), never a new
digest.

    reach-v1    point-to-point moves, full state, ideal drives, randomization "default"
    track-v1    circle, square and Lissajous figure, otherwise as reach-v1
    hard-v1     moves, circle and square with the sensors and drives of a rig, randomization "wide",
                and effects that no controller's model declares (see `undeclared_effects`)

`entries` runs controllers and agents through a protocol; `result_file` writes and reads the files with the
scores.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ...arrays import Array
from ...envs import RANDOMIZATION_PRESETS, Reach, Task, Track, as_machine
from ...envs.actuation.actuators import ACTUATOR_PRESETS
from ...errors import InputError, suggestion
from ...machine import Machine
from ...recordings import machine_to_dict
from ..episodes import Episodes
from ..metrics import BANDS, settling_times
from ..scenario import Scenario, episode_conditions
from ..stored_bounds import condition_digests
from ..undeclared_effects import effect_rules, with_absent_effects

Draws = dict[str, list[float | None]]
DECIMALS = 6  # of the values in results, s and mm: hides differences between processors, far below any effect
# Draws of these seeds decide nothing: no tuning, no selection of agents.
SEED_OF_RESULTS, SEED_OF_HARD = 1000, 71_000
GAP = "gap-v1"  # runs in a clone of the repository only
FIXED_OPTIONS = ("machine", "task", "path", "randomize", "sensors", "period", "episodes", "seed")


@dataclass(frozen=True)
class Protocol:
    """A benchmark with all its settings.

    Attributes:
        name: Name with the version, for example "reach-v1".
        parts: Tasks by the name of the part, each scored separately.
        digest: First 16 hexadecimal digits of a SHA-256 of the settings and of all draws.
        summary: What the benchmark asks for, one sentence.
        machine: Name of the preset of the declared machine.
        randomize: Name of the randomization preset of the simulated machine.
        undeclared_effects: Whether each draw also has effects that the declared machine lacks.
        sensors: What controllers observe, "state" or "rig".
        drives: What applies the voltages, "ideal" or "rig".
        period: Control period, s.
        draws: Number of episodes of each part.
        seed: Seed of the first episode.
        duration_s: Length of an episode, s.
    """

    name: str
    parts: Mapping[str, Task]
    digest: str
    summary: str
    machine: str = "hframe"
    randomize: str = "default"
    undeclared_effects: bool = False
    sensors: str = "state"
    drives: str = "ideal"
    period: float = 0.01
    draws: int = 512
    seed: int = SEED_OF_RESULTS
    duration_s: float = 1.5

    @cached_property
    def declared_machine(self) -> Machine:
        """Machine that controllers know: nominal parameters, converters and current limits of drives."""
        machine = as_machine(self.machine)
        actuators = ACTUATOR_PRESETS[self.drives] if self.drives != "ideal" else None
        return actuators.apply(machine) if actuators else machine

    def scenario(self, part: str) -> Scenario:
        """Return the settings with which the episodes of a part, for example "reach", are simulated.

        The machine includes effects that controllers do not know, if the protocol has any.
        """
        machine, rules = as_machine(self.machine), RANDOMIZATION_PRESETS[self.randomize]
        if self.undeclared_effects:
            machine, rules = with_absent_effects(machine), (*rules, *effect_rules())
        return Scenario(
            machine,
            self.parts[part],
            rules if self.undeclared_effects else self.randomize,  # type: ignore[arg-type]
            self.sensors,  # type: ignore[arg-type]
            self.draws,
            self.seed,
            self.period,
            self.duration_s,
            self.drives,  # type: ignore[arg-type]
        )

    def declared_scenario(self, part: str) -> Scenario:
        """Return the settings from which a controller is designed for a part (task) of the benchmark.

        They differ from the simulated ones: the machine lacks undeclared effects, and the full state is
        observed.
        """
        return dataclasses.replace(
            self.scenario(part),
            machine=self.declared_machine,
            randomize=self.randomize,  # type: ignore[arg-type]
            sensors="state",
        )

    def compute_digest(self) -> str:
        """Compute the digest of the settings and episodes that this installation gives, in about a second."""
        settings = {
            field.name: getattr(self, field.name)
            for field in dataclasses.fields(self)
            if field.name not in ("parts", "digest", "summary")
        }
        content: dict[str, Any] = {"settings": settings, "machine": machine_to_dict(self.declared_machine)}
        for part, task in self.parts.items():
            conditions = episode_conditions(self.scenario(part))
            content[part] = [repr(task), machine_to_dict(conditions.machine), condition_digests(conditions)]
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]

    def check(self) -> None:
        """Raise an InputError if the settings or episodes of this installation do not match `digest`."""
        digest = self.compute_digest()
        if digest != self.digest:
            raise InputError(
                f"protocol {self.name}: the installed packages give other "
                f"settings or draws (digest {digest}, not {self.digest}), "
                "so scores would not be comparable; install a release of hframe_gym with this protocol"
            )


def _track(path: str) -> Track:
    """Return the task of a path, 50 mm wide, at 0.3 m/s."""
    return Track(path=path, size=0.05, speed=0.3)


PROTOCOLS: dict[str, Protocol] = {
    protocol.name: protocol
    for protocol in (
        Protocol(
            "reach-v1",
            {"reach": Reach()},
            "2cd343ef8e91485b",
            "Move the tool to a point and keep it there; "
            "the masses, friction and belts of each draw are unknown.",
        ),
        Protocol(
            "track-v1",
            {path: _track(path) for path in ("circle", "square", "lissajous")},
            "0183eb18afcc531c",
            "Follow a path at 0.3 m/s; the masses, friction and belts of each draw are unknown.",
        ),
        Protocol(
            "hard-v1",
            {"reach": Reach(), "circle": _track("circle"), "square": _track("square")},
            "ca92cbc61f7531fb",
            "Moves and paths with a rig's sensors and drives, parameters far from the model's, "
            "and effects that the model does not declare.",
            randomize="wide",
            undeclared_effects=True,
            sensors="rig",
            drives="rig",
            seed=SEED_OF_HARD,
        ),
    )
}


def get_protocol(name: str) -> Protocol:
    """Return a benchmark protocol by its name with version, such as "reach-v1"; InputError if unknown."""
    if name == GAP:
        raise InputError(
            f"protocol {GAP} has plants of the independent simulator, which is not installed with "
            "the package: run python -m benchmarks.gap run ENTRY in a clone of the repository (docs/gap.md)"
        )
    if name not in PROTOCOLS:
        raise InputError(
            f"protocol {name!r} is unknown; choose one of {', '.join(PROTOCOLS)}{suggestion(name, PROTOCOLS)}"
        )
    return PROTOCOLS[name]


def draw_values(episodes: Episodes) -> Draws:
    """Compute the metrics of every episode of one task of a protocol; its scores follow from them.

    Returns:
        By name of the metric, a list of B values, rounded to 6 decimals. For moves to a point:
        `settling_s.1mm`, `settling_s.0.2mm` and `settling_s.0.05mm`, time until the tool stays this close to
        the goal, s, None if it does not; and `final_error_mm`, mm. For paths: `contour_rms_mm`,
        `contour_max_mm` and `tracking_rms_mm`, mm.
    """
    if episodes.contour is None:
        values: Draws = {}
        for band, radius in BANDS.items():
            times, success = settling_times(episodes.goal_error, episodes.time_s, radius)
            pairs = zip(times.tolist(), success.tolist(), strict=True)
            values[f"settling_s.{band}"] = [
                round(time, DECIMALS) if settled else None for time, settled in pairs
            ]
        return values | {"final_error_mm": _rounded(1e3 * episodes.goal_error[:, -1])}
    return {
        "contour_rms_mm": _rounded(1e3 * np.sqrt(np.mean(episodes.contour**2, axis=1))),
        "contour_max_mm": _rounded(1e3 * episodes.contour.max(axis=1)),
        "tracking_rms_mm": _rounded(1e3 * np.sqrt(np.mean(episodes.goal_error**2, axis=1))),
    }


def _rounded(values: Array) -> list[float | None]:
    """Return values (B,) rounded to `DECIMALS`."""
    return [round(value, DECIMALS) for value in values.tolist()]
