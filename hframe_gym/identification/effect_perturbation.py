"""What an effect would add along a known motion: forces on coordinates and changes of readings, by its own formulas.

Parameters may be arrays (G,): G variants of an effect at once.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from ..machine import Effect, Machine
from ..machine.effect import AppliedEffect, asked

Array = NDArray[np.float64]
_COARSE = 5


class EffectPerturbation(NamedTuple):
    """force (G, n, coordinates), own units; reading (G, n, sensors) or None where no sensor is touched."""

    force: Array
    reading: Array | None


class MotionRecord(NamedTuple):
    """A motion of a machine: time (n,) s, volts (n, drives), positions and velocities (n, coordinates), readings
    (n, sensors), own units."""

    time_s: Array
    inputs: Array
    positions: Array
    velocities: Array
    readings: Array


def addition(
    machine: Machine, effect: Effect, site: str, parameters: Mapping[str, Array], motion: MotionRecord
) -> EffectPerturbation:
    """What `effect` at `site` adds, for each of G sets of parameters, by name (G,)."""
    own = {name: np.asarray(value)[:, None] for name, value in parameters.items()}
    variants = len(next(iter(own.values())))
    applied = AppliedEffect(effect, site, own)
    force = np.zeros((variants, *motion.positions.shape))
    reading = np.zeros((variants, *motion.readings.shape)) if effect.reading or effect.lag else None
    coordinate = machine.site_coordinate(site)
    if coordinate is not None and site not in machine.output_channels:
        i = machine.coordinate_names.index(coordinate)
        force[:, :, i] += _on_coordinate(machine, applied, coordinate, motion)
    if effect.voltage or effect.current:
        _on_drive(machine, applied, motion, force)
    if effect.delay:
        _late(machine, applied, motion, force)
    if effect.tension:
        _in_belts(machine, applied, motion, force)
    if effect.travel and coordinate is not None:
        _by_pulley(machine, applied, coordinate, motion, force)
    if reading is not None:
        _in_sensor(machine, applied, motion, reading)
    return EffectPerturbation(force, reading)


def effects_force(machine: Machine, motion: MotionRecord) -> Array:
    """What all effects of a machine add along a motion: force (n, coordinates), own units."""
    force = np.zeros_like(motion.positions)
    for e in machine.effects:
        parameters = {name: np.array([value]) for name, value in e.parameters.items()}
        force += addition(machine, e.definition, e.site, parameters, motion).force[0]
    return force


def _on_coordinate(machine: Machine, e: AppliedEffect, name: str, motion: MotionRecord) -> Any:
    d = e.definition
    i = machine.coordinate_names.index(name)
    q, v = motion.positions[:, i], motion.velocities[:, i]
    level = machine.coordinate(name).coulomb
    scope: dict[str, Any] = {"q": q, "v": v, "t": motion.time_s, "u": variable(machine, d, motion), "z": 0.0}
    if d.friction:
        scope["z"] = _bristles(e, q, level)
    total: Any = 0.0
    if d.force:
        total = total + e("force", **scope)
    if d.coulomb:
        total = total - np.sign(v) * e("coulomb", **scope)
    if d.friction:
        total = total + np.sign(v) * level - e("friction", **scope, level=level)
    if d.viscous:
        b = machine.coordinate(name).viscous
        total = total - (e("viscous", b=b, direction=np.sign(v)) - b) * v
    return total


def variable(machine: Machine, definition: Effect, motion: MotionRecord) -> Array:
    """The variable `u` of a table along a motion."""
    what, _, coordinate = definition.against.partition(" of ")
    if what in ("", "time"):
        return motion.time_s
    i = machine.coordinate_names.index(coordinate)
    if what == "velocity":
        return motion.velocities[:, i]
    if what == "path":
        return np.concatenate([[0.0], np.cumsum(np.abs(np.diff(motion.positions[:, i])))])
    return motion.positions[:, i]


def _bristles(e: AppliedEffect, q: Array, level: float) -> Array:
    """The own state (G, n) of a friction along a motion.

    Its flow over a way that does not turn is closed, so few steps do: every fifth row.
    """
    evolve, own = e.definition.evolve, e.parameters
    assert evolve is not None
    scope = {"level": level, "dt": 0.0, "v": 0.0, **own}
    names = asked(evolve)
    coarse = np.append(np.arange(0, len(q) - 1, _COARSE), len(q) - 1)
    z = np.zeros((len(next(iter(own.values()))), 1))
    states = np.zeros((len(z), len(coarse)))
    for k, step in enumerate(np.diff(q[coarse]), start=1):
        known = {**scope, "z": z, "dq": step}
        z = evolve(*(known[name] for name in names))
        states[:, k] = z[:, 0]
    rows = np.arange(len(q))
    return np.array([np.interp(rows, coarse, line) for line in states])


def _on_drive(machine: Machine, e: AppliedEffect, motion: MotionRecord, force: Array) -> None:
    for j, d in enumerate(machine.drives):
        if e.site not in (d.name, "drives"):
            continue
        i = machine.coordinate_names.index(d.coordinate)
        volts = motion.inputs[:, j]
        if e.definition.voltage:
            force[:, :, i] += d.gain * (e("voltage", V=volts) - volts)
        if e.definition.current:
            ohm = (volts - d.Ke * d.gear_ratio * motion.velocities[:, i]) / d.resistance
            z: Any = 0.0
            if e.definition.evolve:
                # The winding's lag hardly moves while a row's voltage is held: its mean over the row.
                z = _filtered(ohm, motion.time_s, e.parameters["tau"])
            force[:, :, i] += d.gear_ratio * d.Kt * (e("current", i=ohm, z=z) - ohm)


def _filtered(values: Array, time_s: Array, tau: Array) -> Array:
    """Mean over each row of a first-order lag's answer (G, n), values held from row to row."""
    period = float(np.median(np.diff(time_s)))
    found = []
    for lag in np.maximum(tau[:, 0], 1e-9):
        decay = float(np.exp(-period / lag))
        mean = lag / period * (1.0 - decay)
        z, _ = signal.lfilter([0.0, 1.0 - decay], [1.0, -decay], values, zi=[values[0]])
        found.append(values + (z - values) * mean)
    return np.array(found)


def _late(machine: Machine, e: AppliedEffect, motion: MotionRecord, force: Array) -> None:
    late = e("delay") / np.median(np.diff(motion.time_s))
    for j, d in enumerate(machine.drives):
        if e.site in (d.name, "drives"):
            i = machine.coordinate_names.index(d.coordinate)
            volts = motion.inputs[:, j]
            before = np.concatenate([volts[:1], volts[:-1]])
            force[:, :, i] += d.gain * (before - volts) * late


class _Stretch(NamedTuple):
    row: Array
    s: Array
    rate: Array
    k: Array


def _stretches(machine: Machine, motion: MotionRecord) -> list[_Stretch]:
    travel, speed = motion.positions * machine.radii, motion.velocities * machine.radii
    found = []
    for b in machine.belts:
        row = machine.row(b.extension)
        k = b.EA / (b.rest_length + travel @ machine.row(b.length))
        found.append(_Stretch(row * machine.radii, travel @ row, speed @ row, k))
    return found


def _in_belts(machine: Machine, e: AppliedEffect, motion: MotionRecord, force: Array) -> None:
    for b in _stretches(machine, motion):
        more = e("tension", s=b.s, rate=b.rate, k=b.k) - b.k * b.s
        force -= np.asarray(more)[:, :, None] * b.row


def _by_pulley(machine: Machine, e: AppliedEffect, name: str, motion: MotionRecord, force: Array) -> None:
    i = machine.coordinate_names.index(name)
    q = motion.positions[:, i]
    gone = q - q[0]
    radius = machine.radii[i]
    turned = {"q": q, "z": gone, "per_radius": 1.0 / radius}
    travel, arm = e("travel", **turned), e("arm", **turned)
    for b in _stretches(machine, motion):
        share = b.row[i] / radius
        force -= (b.k * share * travel)[:, :, None] * b.row
        force[:, :, i] -= share * b.k * b.s * arm


def _in_sensor(machine: Machine, e: AppliedEffect, motion: MotionRecord, reading: Array) -> None:
    j = machine.output_channels.index(e.site)
    shown = motion.readings[:, j]
    if e.definition.lag:
        reading[:, :, j] -= e("lag") * np.gradient(shown, motion.time_s)
        return
    other = machine.across(machine.sensors[j].coordinate)
    across = motion.positions[:, machine.coordinate_names.index(other)] if other else 0.0
    reading[:, :, j] += e("reading", r=shown, across=across) - shown
