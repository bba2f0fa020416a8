"""Typical forces, speeds and travels of a machine, by which effects' start values are multiplied."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import Array
from ...machine import Machine
from ...preparation.dataset import Dataset
from ..fit.estimation import Fit
from ..predict.free_parameters import typical_force
from ..predict.prediction import map_runs, predict

_NO_MOTION = 1e-9  # m or rad, m/s or rad/s, V, A; size where nothing moves or acts, which permits a division
SESSION = "session"  # key of the time from the first to the last fitted row, s, in `TypicalScales.general`
LONGEST_RUN = "run"  # key of the duration of the longest fitted run, s, likewise


@dataclass(frozen=True)
class TypicalScales:
    """Typical sizes of physical quantities on a machine during its recordings.

    The keys are the units that effect parameters declare; `scales_of_motion` documents how the sizes are
    computed.

    Attributes:
        by_coordinate: Sizes by coordinate and by key, in N, m/s and m or in Nm, rad/s and rad: "mass",
            "force", "speed", "position", "viscous", "drag", "stiffness"; with a drive, also "voltage" (V),
            "A" (its current, A), "1/A^2", "1/W".
        general: Sizes of the belts, by key: "m" (extension, m), "N" (force, N), "1/m^2" (1 / extension^2).
            "session": time from the beginning of the first fitted run to the end of the last one, s.
            "run": duration of the longest fitted run, s.
    """

    by_coordinate: Mapping[str, Mapping[str, float]]
    general: Mapping[str, float]

    def of(self, coordinate: str) -> Mapping[str, float]:
        """Return the typical sizes at a coordinate together with the sizes that belong to no coordinate.

        Args:
            coordinate: Name of the coordinate; any other text, such as "", gives the general sizes only.

        Returns:
            Typical size, SI, by key. Of the coordinate: "mass", "force", "speed", "position", "viscous"
            (force / speed), "drag" (force / speed^2), "stiffness" (force / position); with a drive,
            "voltage", "A" (current), "1/A^2", "1/W". General: "session" (time of all fitted runs, s),
            "run" (duration of the longest one, s); with belts, "m" (extension), "N" (force), "1/m^2".
        """
        return {**self.general, **self.by_coordinate.get(coordinate, {})}


def scales_of_motion(
    machine: Machine, positions: Array, velocities: Array, inputs: Sequence[Array]
) -> TypicalScales:
    """Compute typical forces, speeds, positions, voltages, currents and belt extensions from a motion.

    Starting values of effect parameters are multiples of these sizes. The sizes of motions, voltages and
    currents are at least 1e-9, even for an axis that never moves. Effects on such an axis get meaningless
    starting values, but as they change no prediction, the screening drops them.

    Args:
        positions: Positions over all rows of all runs, m or rad, shape (n, coordinates).
        velocities: Velocities over the same rows, m/s or rad/s, shape (n, coordinates).
        inputs: Drive voltages by run, V, shape (rows of the run, drives) each; n rows in total.

    Returns:
        by_coordinate: By coordinate, sizes by key, in N, m/s and m (linear) or in Nm, rad/s and rad (rotary):

            - "mass": the machine's mass or moment of inertia.
            - "force": a tenth of the force of all drives together at standstill and rated voltage.
            - "speed": 99th percentile of its magnitude. "position": largest minus smallest position.
            - "viscous": force / speed. "drag": force / speed^2. "stiffness": force / position.
            - With a drive, "voltage": largest magnitude of its voltage, V.
            - With a drive, "A": largest magnitude of its current, A, which is (voltage - back-EMF) /
              resistance. "1/A^2": 1 / this size squared; "1/W": 1 / (current * voltage).
        general: Empty without belts; with belts, sizes by key:

            - "m": 99th percentile of the magnitude of the belts' extensions, m. "1/m^2": 1 / this size
              squared.
            - "N": largest magnitude of a belt's force, N, which is extension * EA / rest length.
    """
    force = typical_force(machine)
    top_speed = np.maximum(np.percentile(np.abs(velocities), 99, axis=0), _NO_MOTION)
    span = np.maximum(np.ptp(positions, axis=0), _NO_MOTION)
    by_coordinate: dict[str, dict[str, float]] = {}
    for i, c in enumerate(machine.coordinates):
        drive = force * c.travel_per_unit  # N, or Nm: force at the belt times the pulley radius
        speed, distance = float(top_speed[i]), float(span[i])
        by_coordinate[c.name] = {"mass": c.mass, "force": drive, "speed": speed, "position": distance}
        by_coordinate[c.name] |= {
            "viscous": drive / speed,
            "drag": drive / speed**2,
            "stiffness": drive / distance,
        }
    for d, voltage in zip(machine.drives, np.concatenate(list(inputs)).T, strict=True):
        i = machine.coordinate_names.index(d.coordinate)
        # Ohm's law with the back-EMF of the motor, which turns gear_ratio times as fast as the coordinate.
        current = (voltage - d.Ke * d.gear_ratio * velocities[:, i]) / d.resistance
        sizes = by_coordinate[d.coordinate]
        for key, values in (("A", current), ("voltage", voltage)):
            sizes[key] = max(float(np.abs(values).max()), sizes.get(key, _NO_MOTION))
        sizes["1/A^2"] = 1.0 / sizes["A"] ** 2
        sizes["1/W"] = 1.0 / (sizes["A"] * sizes["voltage"])
    general: dict[str, float] = {}
    if machine.belts:
        extension = positions @ machine.belt_matrix.T  # (n, belts)
        stiffness = np.array([b.EA / b.rest_length for b in machine.belts])
        largest = max(float(np.percentile(np.abs(extension), 99)), _NO_MOTION)
        general = {"m": largest, "N": float(np.abs(extension * stiffness).max()), "1/m^2": 1.0 / largest**2}
    return TypicalScales(by_coordinate, general)


def typical_scales(current: Fit, data: Dataset) -> TypicalScales:
    """Compute typical sizes of forces, speeds, travels and so on, which multiply starting values of effects.

    Args:
        current: Fit of the machine, which predicts the motion with the widest observer.
        data: Runs that were fitted.

    Returns:
        The sizes of `scales_of_motion`, and in `general` also "session", the time from the beginning of the
        first run to the end of the last one, s, and "run", the duration of the longest run, s.
    """
    motions = list(
        map_runs(
            lambda run: predict(current.machine, run, current.bandwidth, period=data.period, states=True),
            data,
        )
    )
    positions = np.concatenate([motion.positions[0] for motion in motions])
    velocities = np.concatenate([motion.velocities[0] for motion in motions])
    scales = scales_of_motion(current.machine, positions, velocities, [run.inputs for run in data.runs])
    # Runs share the clock of the rig. Those to which nothing is fitted, such as held-out ones, do not extend
    # it: they say nothing of a parameter.
    session = max(float(run.time_s[-1]) for run in data.runs) - min(float(run.time_s[0]) for run in data.runs)
    longest = max(float(run.time_s[-1] - run.time_s[0]) for run in data.runs)
    durations = {SESSION: session, LONGEST_RUN: max(longest, data.period)}
    return dataclasses.replace(scales, general={**scales.general, **durations})
