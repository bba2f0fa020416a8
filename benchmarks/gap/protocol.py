"""The protocol `gap-v1`: its settings, its digest, and how an entry is scored on a plant.

Parts: `reach`, point-to-point moves; `circle` and `square`, paths 50 mm wide at 0.3 m/s. Every plant has its
own starts and goals, the same for all entries. A move is scored by the time from which on the tool stays
within 0.2 mm, over the shortest possible time on the plant (`bounds`); a path by the distance of the tool to
it. Costs of safety are measured besides: the largest belt force, the fraction of commands at the voltage
limit, and the fraction of episodes that leave the workspace. The published plants are those of one seed; a
held set of another seed shows whether an entry was tuned to them.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.gap.control_loop import DURATION_S, PERIOD_S, GapEpisodes, Starts, control, starts_of
from benchmarks.gap.entries import GapEntry
from benchmarks.gap.plants import COUNT, PUBLIC_SEED, GapPlant, declared_machine, draw_plant
from benchmarks.gap.recorder import CHOSEN_S, LOGS_S, RATE_HZ, Recorder
from hframe_gym.envs import Reach, Task, Track
from hframe_gym.errors import InputError
from hframe_gym.evaluation import BANDS, TimedController, settling_times
from hframe_gym.recordings import machine_to_dict
from tests.reference_simulator import Array

NAME = "gap-v1"
DIGEST = "400488b9ae25f2a2"  # of the settings, and of the published plants with their starts and goals
PARTS: dict[str, Task] = {
    "reach": Reach(),
    "circle": Track(path="circle", size=0.05, speed=0.3),
    "square": Track(path="square", size=0.05, speed=0.3),
}
EPISODES = {"reach": 12, "circle": 4, "square": 4}
PRACTICE_EPISODES = 8  # moves, of the online track
SATURATED = 1.0 - 1e-6  # fraction of the rated voltage from which a command counts as at its limit
# Distance to the moving goal, m, up to which the distance to the path alone counts: 67 ms at 0.3 m/s. A tool
# that rests on the path would have no error otherwise.
LARGEST_LAG_M = 0.02
_DECIMALS = 6
# Fields of the parts of a plant when the protocol was published. Later ones count where they change a plant.
_FIELD_NAMES = """
    mass viscous coulomb pulley_radius_m belt_EA_N belt_length_m length_follows gear_ratio torque_constant
    emf_constant resistance_ohm stribeck_force stribeck_velocity stribeck_exponent friction_wave
    friction_wavelength friction_phase friction_slope friction_cross_position friction_cross_speed
    friction_cold friction_stale friction_stale_path warm_up_s friction_age friction_age_s
    friction_age_path friction_per_run bristle_stiffness bristle_damping hysteresis_force
    hysteresis_travel dahl_force dahl_travel constant_force viscous_asymmetry quadratic_drag brake_drag
    brake_speed spring_stiffness spring_rest spring_square wave_force wave_number wave_phase wave_second
    catch_force catch_position catch_width drive_gain voltage_offset_V dead_band_V current_limit_A
    voltage_limit_V electrical_lag_s input_delay_s heating_loss heating_s heating_ohm torque_saturation_A
    dead_time_V dead_time_A supply_V supply_ohm supply_s load_friction current_ripple current_ripple_order
    backlash_rad backlash_stiffness backlash_motor_fraction eccentricity_m eccentricity_phase belt_play_m
    belt_damping_s belt_damping_factor belt_energy_force belt_pretension_N belt_hardening belt_relaxation
    belt_relaxation_s belt_creep mesh_force_N mesh_pitch_m mesh_tension_N idlers yaw payload frame inertia
    stiffness half_width_m mass_kg skew scale range_x_m range_y_m delay_s bend wave wave_period kind note
    euler_step_s energy_force hysteresis colored jitter_s bad_gain glitch_m
"""
_FIELDS = frozenset(_FIELD_NAMES.split())
_NOISE, _PRACTICE_NOISE = 1000, 2000  # offsets of the seeds of the sensors' noise

Values = dict[str, list[float | None]]


def starts(plant: GapPlant, part: str) -> Starts:
    """Return the starts and goals of a part ("reach", "circle" or "square") on a plant."""
    number = list(PARTS).index(part)
    return starts_of(PARTS[part], _seed(plant, number), EPISODES[part])


def _seed(plant: GapPlant, number: int) -> int:
    """Return a seed that belongs to a plant."""
    return int(np.random.SeedSequence([plant.seed, plant.index, 3, number]).generate_state(1)[0])


def compute_digest() -> str:
    """Compute a hash of the settings and of the published plants with their starts and goals.

    Returns:
        16 hexadecimal digits.
    """
    settings = [NAME, EPISODES, PRACTICE_EPISODES, PERIOD_S, DURATION_S, CHOSEN_S, LOGS_S, RATE_HZ, COUNT]
    content: list[Any] = [
        settings,
        machine_to_dict(declared_machine()),
        {k: repr(t) for k, t in PARTS.items()},
    ]
    for index in range(COUNT):
        plant = draw_plant(PUBLIC_SEED, index)
        content.append([_described(part) for part in (*plant.stage, plant.residue)])
        for part in PARTS:
            drawn = starts(plant, part)
            content.append([np.round(values, 9).tolist() for values in drawn])
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]


def _described(part: object) -> str:
    """Return a part of a plant as text, with numbers of 9 digits, which do not depend on the processor."""
    return re.sub(r"-?\d+\.\d+(e[+-]?\d+)?", lambda match: f"{float(match[0]):.9g}", as_text(part))


def as_text(part: Any) -> str:
    """Return a part of a plant like `repr`, without fields that are newer and change no plant."""
    if isinstance(part, tuple):
        return f"({', '.join(map(as_text, part))}{',' if len(part) == 1 else ''})"
    if not dataclasses.is_dataclass(part):
        return repr(part)
    values = {f.name: (getattr(part, f.name), f.default) for f in dataclasses.fields(part)}
    shown = (
        f"{name}={as_text(value)}"
        for name, (value, default) in values.items()
        if name in _FIELDS or value != default
    )
    return f"{type(part).__name__}({', '.join(shown)})"


def check() -> None:
    """Check that this checkout gives the plants and episodes of the protocol.

    Raises:
        InputError: If it does not.
    """
    digest = compute_digest()
    if digest != DIGEST:
        raise InputError(
            f"protocol {NAME}: this checkout gives other plants or episodes (digest {digest}, "
            f"not {DIGEST}), so scores would not be comparable; use a checkout with this protocol"
        )


def score(
    entry: GapEntry,
    plant: GapPlant,
    folder: Path,
    known: Mapping[tuple[int, str], dict[str, Any]] | None = None,
) -> dict[str, Any]:
    """Score an entry on a plant.

    Args:
        entry: New object of the entry.
        folder: Folder of the plant, in which entries keep identified machines and trained agents.
        known: Results of other entries by plant and key (`GapEntry.key`), which are not computed again.

    Returns:
        By key, as plain data: "values" of all episodes by part and metric, "prepare_cpu_s", "control_us" per
        episode and period, "about" of the entry, and "key" if it has one.

    Raises:
        InputError: If the entry cannot run.
    """
    began = time.process_time()
    entry.prepare(declared_machine(), Recorder(plant, allowed=entry.track == "identified"), folder)
    if entry.track == "online":
        _practice(entry, plant)
    prepared = time.process_time()
    row = {"plant": plant.index, "prepare_cpu_s": round(prepared - began, 2), "about": entry.about()}
    if key := entry.key():
        row["key"] = key
        same = (known or {}).get((plant.index, key))
        if same:
            return row | {name: same[name] for name in ("values", "control_us")}
    values, timed = {}, []
    for part, task in PARTS.items():
        timed.append(TimedController(entry.controller(task)))
        values[part] = episode_values(control(timed[-1], plant, task, starts(plant, part), _NOISE))
    actions = sum(t.actions for t in timed)
    return row | {"values": values, "control_us": round(1e6 * sum(t.cpu_s for t in timed) / actions, 1)}


def _practice(entry: GapEntry, plant: GapPlant) -> None:
    """Let an entry of the online track practice moves, one after the other."""
    task = PARTS["reach"]
    drawn = starts_of(task, _seed(plant, len(PARTS)), PRACTICE_EPISODES)
    for k in range(PRACTICE_EPISODES):
        controller = entry.controller(task)
        one = Starts(drawn.start[k : k + 1], drawn.plan[k : k + 1])
        entry.practice(as_measured(control(controller, plant, task, one, _PRACTICE_NOISE + k)), controller)


def as_measured(episodes: GapEpisodes) -> GapEpisodes:
    """Return episodes as an entrant may see them: measured positions at the control periods, no belt forces.

    Args:
        episodes: Episodes with true positions.
    """
    every = round(PERIOD_S / (episodes.time_s[1] - episodes.time_s[0]))
    periods = episodes.actions.shape[1]
    return GapEpisodes(
        episodes.time_s[: every * periods : every],
        episodes.observed[:, :, :2],
        episodes.goal[:, : every * periods : every],
        None,
        episodes.actions,
        episodes.observed,
        np.full(len(episodes.actions), np.nan),
    )


def episode_values(episodes: GapEpisodes) -> Values:
    """Compute the metrics of every episode of a part.

    Args:
        episodes: The B episodes.

    Returns:
        By metric a list of B values. Of moves: `settling_s.1mm`, `settling_s.0.2mm` and `settling_s.0.05mm`,
        s, None if the tool does not settle, and `final_error_mm`. Of paths: `path_rms_mm` and `path_max_mm`,
        the distance to the path, or to the moving goal where that ever exceeds `LARGEST_LAG_M`; `lag_max_mm`,
        the latter. Of both: `belt_force_N`, `saturated` (fraction of commands at the voltage limit) and
        `left_workspace` (0 or 1).
    """
    values: Values
    if episodes.contour is None:
        error = np.linalg.norm(episodes.position - episodes.goal, axis=2)
        values = {"final_error_mm": _rounded(1e3 * error[:, -1])}
        for band, radius in BANDS.items():
            times, settled = settling_times(error, episodes.time_s, radius)
            pairs = zip(times.tolist(), settled.tolist(), strict=True)
            values[f"settling_s.{band}"] = [round(t, _DECIMALS) if ok else None for t, ok in pairs]
    else:
        lag = np.linalg.norm(episodes.position - episodes.goal, axis=2)
        follows = lag.max(axis=1, keepdims=True) <= LARGEST_LAG_M
        error = np.where(follows, episodes.contour, lag)
        values = {
            "path_rms_mm": _rounded(1e3 * np.sqrt(np.mean(error**2, axis=1))),
            "path_max_mm": _rounded(1e3 * error.max(axis=1)),
            "lag_max_mm": _rounded(1e3 * lag.max(axis=1)),
        }
    machine = declared_machine()
    low, high = np.array([machine.coordinate(axis).range for axis in machine.tool_axes]).T
    outside = ((episodes.position < low) | (episodes.position > high)).any(axis=(1, 2))
    return values | {
        "belt_force_N": _rounded(episodes.belt_force_N),
        "saturated": _rounded((np.abs(episodes.actions) >= SATURATED).mean(axis=(1, 2))),
        "left_workspace": _rounded(outside.astype(np.float64)),
    }


def _rounded(values: Array) -> list[float | None]:
    """Return values (B,) rounded to `_DECIMALS`."""
    return [round(value, _DECIMALS) for value in values.tolist()]


def score_plants(
    make: Callable[[], GapEntry],
    seed: int,
    indices: list[int],
    folder: Path,
    done: Mapping[int, dict[str, Any]],
    known: Mapping[tuple[int, str], dict[str, Any]],
    each: Callable[[dict[str, Any]], None],
) -> None:
    """Score an entry on plants, given by their numbers, that are not scored yet.

    Args:
        make: Returns a new object of the entry, one per plant.
        done: Results by the number of the plant, of an earlier run.
        known: Results of other entries by plant and key.
        each: Called with the result of each plant; where the entry refuses the plant by an `InputError`, with
            the number of the plant, "plant", and the reason, "refused".
    """
    for index in indices:
        if index in done:
            continue
        plant = draw_plant(seed, index)
        try:
            row = score(make(), plant, folder / plant.name, known)
        except InputError as error:
            row = {"plant": index, "refused": str(error)}
        each(row)
