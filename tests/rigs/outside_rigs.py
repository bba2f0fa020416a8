"""Draw rigs that hide one effect outside the library, half of them recorded in closed loop.

    python -m tests.rigs.outside_rigs --seed 1                     # what these rigs hide
    python -m tests.rigs.outside_rigs --seed 1 --only 0 --out DIR  # record: DIR/1_00/runs, unseen, truth.json

A rig follows from a seed and an index. Every family that the library lacks occurs once before one occurs
again, in random order; rigs with an even and an odd index are recorded in open and in closed loop. Every
parameter differs from the declared machine by 5 to 15 %. The stage is that of the reference simulator.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from hframe_gym.recordings import Recording
from tests.reference_simulator import Array, Rig, Stage
from tests.reference_simulator.sensors import Sensors, noisy
from tests.rigs.hidden_effects import random_rig
from tests.rigs.machine_programs import PROGRAMS, follow
from tests.rigs.outside_effects import FAMILIES, IN_LIBRARY, OutsideEffect
from tests.rigs.random_excitation import STARTS, Plant, draw_start, play
from tests.rigs.session_files import write_session

COUNT = 20
OUTSIDE = tuple(family for family in FAMILIES if family not in IN_LIBRARY)
RUNS, UNSEEN_RUNS = 8, 3
DURATION_S, RATE_HZ = 2.0, 1000.0
OPEN_LOOP = ("steps", "single", "triangle", "multisine", "telegraph")
_RTOL, _ATOL = 1e-8, 1e-11  # cost less than a nanometer per run


@dataclass(frozen=True)
class OutsideRig:
    """Rig with an effect outside the library.

    Attributes:
        seed: Seed of the set of rigs.
        index: Number of the rig in the set.
        closed_loop: Whether a position controller follows machine programs.
        effect: The effect.
    """

    seed: int
    index: int
    closed_loop: bool
    effect: OutsideEffect

    @property
    def name(self) -> str:
        """Name of the rig."""
        return f"{self.seed}_{self.index:02d}"

    def describe(self) -> str:
        """Return what the rig hides, in a line of text."""
        return f"{self.effect.label}: {self.effect.note} ({'closed' if self.closed_loop else 'open'} loop)"

    @cached_property
    def stage(self) -> tuple[Rig, Sensors]:
        """The stage and its sensors with the effect."""
        rng = np.random.default_rng([self.seed, self.index, 1])
        rig, sensors = self.effect.build(_five_to_fifteen_percent(random_rig(rng)), Sensors())
        return rig, sensors

    def record(self) -> OutsideSession:
        """Record all runs of the rig.

        Returns:
            The session.
        """
        rng = np.random.default_rng([self.seed, self.index, 2])
        rig, sensors = self.stage
        kinds = PROGRAMS if self.closed_loop else OPEN_LOOP
        order = [kinds[i % len(kinds)] for i in range(RUNS + UNSEEN_RUNS)]
        recordings, truth, clock = [], {}, float(np.round(rng.uniform(0.0, 30.0), 3))
        for i, kind in enumerate(order):
            start = str(rng.choice(STARTS))
            place = draw_start("elsewhere" if self.closed_loop else start, rng, 0.5)
            time_s = np.round(clock + np.arange(round(DURATION_S * RATE_HZ)) / RATE_HZ, 6)

            def plant_at(start_s: float, place: tuple[float, float] = place) -> Plant:
                return Stage(rig, place, start_s, rtol=_RTOL, atol=_ATOL)

            clock_of_run = drifting_clock(self.effect.drift) if self.effect.drift else None
            if self.closed_loop:
                run = follow(plant_at, sensors, kind, time_s, rng, clock_of_run)
            else:
                run = play(plant_at, kind, start, time_s, rng, clock=clock_of_run)
            ideal = sensors.ideal(run.actual_s, run.positions, run.velocities)
            name = f"{'run' if i < RUNS else 'unseen'}_{i:02d}_{kind.replace(' ', '_')}"
            truth[name] = ideal
            recordings.append(Recording(name, run.time_s, run.inputs, np.round(noisy(ideal, rng), 9)))
            clock = float(np.round(time_s[-1] + rng.uniform(3.0, 20.0), 3))
        return OutsideSession(self, tuple(recordings[:RUNS]), tuple(recordings[RUNS:]), truth)


@dataclass(frozen=True)
class OutsideSession:
    """Recorded rig.

    Attributes:
        rig: The rig.
        recordings: Runs to identify.
        unseen: Runs for the error of the answer, never to be fitted.
        truth: Noise-free measurements phi1, phi2, rad, x, y, m, shape (n, 4), by the name of the run.
    """

    rig: OutsideRig
    recordings: tuple[Recording, ...]
    unseen: tuple[Recording, ...]
    truth: dict[str, Array]

    def write(self, folder: Path) -> None:
        """Write `runs`, `unseen` and `truth.json` to a folder."""
        write_session(folder, self.recordings, self.unseen, {"hidden": self.rig.describe()})


def drifting_clock(drift: float) -> Callable[[Array], Array]:
    """Return the function from nominal to actual sample times of a clock whose rate changes linearly.

    Args:
        drift: Relative change of the actual period from the first row to the last; the mean is nominal.
    """

    def actual_s(time_s: Array) -> Array:
        elapsed = (time_s - time_s[0]) / (time_s[-1] - time_s[0])
        return np.asarray(time_s + 0.5 * drift * (time_s[-1] - time_s[0]) * (elapsed**2 - elapsed))

    return actual_s


def _five_to_fifteen_percent(rig: Rig) -> Rig:
    """Return a rig whose differences from the declared one of 5 to 20 % are 5 to 15 % instead."""
    declared, changed = Rig(), {}
    for name in (
        "mass",
        "viscous",
        "coulomb",
        "belt_EA_N",
        "torque_constant",
        "emf_constant",
        "resistance_ohm",
    ):
        values = []
        for value, nominal in zip(getattr(rig, name), getattr(declared, name), strict=True):
            off = value / nominal - 1.0
            values.append(nominal * (1.0 + np.sign(off) * (0.05 + (abs(off) - 0.05) * 0.1 / 0.15)))
        changed[name] = tuple(map(float, values))
    return dataclasses.replace(rig, **changed)


def draw_rig(seed: int, index: int) -> OutsideRig:
    """Draw a rig.

    Args:
        seed: Seed of the set of rigs.
        index: Number of the rig in the set.

    Returns:
        The rig; the same arguments give the same rig.
    """
    order_rng = np.random.default_rng([seed, 0])
    order: list[str] = []
    while len(order) <= index:
        order += [str(family) for family in order_rng.permutation(OUTSIDE)]
    rng = np.random.default_rng([seed, index, 3])
    return OutsideRig(seed, index, index % 2 == 1, FAMILIES[order[index]](rng))


def main() -> None:
    """Describe or record the rigs that the command line names."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--only", type=int, nargs="+", metavar="INDEX")
    parser.add_argument("--out", type=Path, metavar="DIR", help="record into this folder")
    arguments = parser.parse_args()
    for index in arguments.only or range(arguments.count):
        rig = draw_rig(arguments.seed, index)
        print(f"{rig.name} {rig.describe()}", flush=True)
        if arguments.out:
            rig.record().write(arguments.out / rig.name)


if __name__ == "__main__":
    main()
