"""Draw rigs at random, with the truth about them, and record them on one of two independent simulators.

    python -m tests.rigs.random_rigs --seed 1 --only 0 1 2              # what these rigs hide
    python -m tests.rigs.random_rigs --seed 1 --only 0 --out DIR        # DIR/1_0000/runs, unseen, truth.json
    python -m tests.rigs.random_rigs --seed 1 --closed-loop             # the same under a controller

A rig follows from a seed and an index alone. A quarter hides nothing; 8 % hide an effect outside the library
and 8 % one or two effects that are 10 to 20 % off the library's form; the others hide one to three effects of
the library, of log-uniform size (`random_effects`). Every parameter differs from the declared machine by
5 to 20 %. Half of the rigs without effects or with library effects have a residue: a small error that no
effect of the library is.

In closed loop, a position controller follows machine programs (`machine_programs`) with a period of
0.5 to 2 ms, and the log has every n-th of its rows, 100 Hz to 1 kHz. In half of these rigs the period
jitters; the stamps say so. The unseen runs judge the answer, whatever the log: they have every row of the
controller, and most are in open loop.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np

from hframe_gym.recordings import Recording
from tests.euler_simulator import DEFAULT_STEP_S, EulerStage
from tests.reference_simulator import COORDINATES, Array, Rig, Stage
from tests.reference_simulator.sensors import ENCODER_STEP_RAD, LASER_NOISE_M, Sensors
from tests.rigs.euler_rig import euler_parameters
from tests.rigs.hidden_effects import CHANNELS, change_site, random_rig
from tests.rigs.machine_programs import PICKS, PROGRAMS, Controller, follow
from tests.rigs.random_effects import DrawnEffect, draw_effects, draw_off_form, draw_outside, log_uniform
from tests.rigs.random_excitation import KINDS, STARTS, Plant, Played, draw_start, play
from tests.rigs.session_files import write_session

DURATION_S = 2.0
UNSEEN_RUNS = 3
CLOSED_LOOP_RUNS = (*PROGRAMS, PICKS)
OPEN_LOOP = tuple(kind for kind in KINDS if kind != "moves")  # of the unseen runs of a rig in closed loop
LOG_RATES_HZ = (100.0, 1000.0)  # slowest and fastest log in closed loop
_PERIODS_S = (0.5e-3, 1e-3, 2e-3)  # of controllers
_ROWS = 1500  # of a run's log in closed loop, if it takes 2 to 6 s
RESIDUES = ("integrator", "missing force", "hysteresis", "colored noise", "clock jitter", "bad run")
# Tolerances of the reference simulator that cost less than a nanometer per run.
_RTOL, _ATOL = 1e-8, 1e-11
Kind = Literal["library", "none", "outside", "off-form"]
Simulator = Literal["reference", "euler"]


@dataclass(frozen=True)
class Residue:
    """Small error of a rig that is no effect of the library.

    Attributes:
        kind: One of `RESIDUES`, or empty.
        note: The error in words, with its size.
        euler_step_s: Step of the Euler simulator, s; None: its default.
        energy_force: Whether the belts push with 1/2 s^2 dk/dq.
        hysteresis: Site (coordinate), force, N or Nm, and travel, m or rad, of a hysteresis; None: there is
            none.
        colored: Channel, standard deviation, m, and time constant, s, of an additional noise; None: there is
            none.
        jitter_s: Standard deviation of the clock, s.
        bad_gain: Factor of both drives in the bad run; None: it is correct.
        glitch_m: Error of one row of one laser in the bad run, m; None: there is none.
    """

    kind: str = ""
    note: str = ""
    euler_step_s: float | None = None
    energy_force: bool = True
    hysteresis: tuple[str, float, float] | None = None
    colored: tuple[str, float, float] | None = None
    jitter_s: float = 0.0
    bad_gain: float | None = None
    glitch_m: float | None = None


@dataclass(frozen=True)
class ClosedLoop:
    """Controller of a rig, and the log of its runs.

    Attributes:
        controller: The controller.
        period_s: Its period, s.
        updates: Number of its periods from one row of the log to the next.
        jitter_s: Standard deviation of its steps in time, s; the stamps of the log state the actual times.
    """

    controller: Controller
    period_s: float
    updates: int
    jitter_s: float

    @property
    def duration_s(self) -> float:
        """Duration of a run, s: longer if the log is slow."""
        return float(np.clip(_ROWS * self.period_s * self.updates, 2.0, 6.0))


@dataclass(frozen=True)
class RandomRig:
    """Rig that was drawn at random.

    Attributes:
        seed: Seed of the set of rigs.
        index: Number of the rig in the set.
        kind: What it hides: effects of the library, nothing, an effect outside the library, or effects off
            its form.
        simulator: Simulator that plays it.
        hidden_effects: The effects.
        residue: The residue.
        runs: Number of runs to identify.
        rate_hz: Sampling rate of the log, Hz.
        bad_run: Index of the run that a bad run's residue concerns.
        closed_loop: Controller and log; None: the runs are in open loop.
    """

    seed: int
    index: int
    kind: Kind
    simulator: Simulator
    hidden_effects: tuple[DrawnEffect, ...]
    residue: Residue
    runs: int
    rate_hz: float
    bad_run: int
    closed_loop: ClosedLoop | None = None

    @property
    def name(self) -> str:
        """Name of the rig."""
        return f"{self.seed}_{self.index:04d}{'_closed' if self.closed_loop else ''}"

    def describe(self) -> str:
        """Return what the rig hides, in a line of text."""
        residue = f", residue: {self.residue.note}" if self.residue.kind else ""
        runs = f"{self.runs} runs at {self.rate_hz:.0f} Hz, {self.simulator}"
        if loop := self.closed_loop:
            runs += f", controller {1e3 * loop.period_s:g} ms, jitter {1e6 * loop.jitter_s:.0f} us"
        return f"{describe_effects(self.hidden_effects)}{residue} ({runs})"

    @cached_property
    def stage(self) -> tuple[Rig, Sensors]:
        """The stage and its sensors with the hidden effects and the residue."""
        rng = np.random.default_rng([self.seed, self.index, 1])
        rig, sensors = random_rig(rng), Sensors()
        # there, one belt runs around all
        if not any(effect.name == "idler_inertia" for effect in self.hidden_effects):
            strengths = rng.choice([-1.0, 1.0], 3) * rng.uniform(0.05, 0.2, 3) + 1.0
            rig = dataclasses.replace(rig, belt_EA_N=tuple(float(s) * Rig().belt_EA_N[0] for s in strengths))
        for effect in self.hidden_effects:
            rig, sensors = effect.build(rig, sensors)
        rig = dataclasses.replace(rig, belt_energy_force=self.residue.energy_force)
        if self.residue.hysteresis:
            site, force, travel = self.residue.hysteresis
            rig, sensors = change_site(
                rig, sensors, sites=COORDINATES, site=site, hysteresis_force=force, hysteresis_travel=travel
            )
        return rig, sensors

    @cached_property
    def _euler_parameters(self) -> Array:
        return euler_parameters(self.stage[0])

    def plant(self, start_xy: tuple[float, float], start_s: float) -> Plant:
        """Set up the stage at rest.

        Args:
            start_xy: Position of the carriage, m.
            start_s: Time on the session's clock, s.

        Returns:
            The stage on the rig's simulator.
        """
        rig = self.stage[0]
        if self.simulator == "reference":
            return Stage(rig, start_xy, start_s, rtol=_RTOL, atol=_ATOL)
        step_s = self.residue.euler_step_s or DEFAULT_STEP_S
        return EulerStage(self._euler_parameters, rig.input_delay_s, start_xy, start_s, step_s)

    def record(self) -> RandomSession:
        """Record all runs of the rig.

        Returns:
            The session.
        """
        rng = np.random.default_rng([self.seed, self.index, 2])
        count, clock = self.runs + UNSEEN_RUNS, float(np.round(rng.uniform(0.0, 30.0), 3))
        kinds = _cycle(CLOSED_LOOP_RUNS if self.closed_loop else KINDS, self.runs, rng)
        if self.closed_loop:
            kinds += [*_cycle(OPEN_LOOP, UNSEEN_RUNS - 1, rng), str(rng.choice(CLOSED_LOOP_RUNS))]
        else:
            kinds += _cycle(KINDS, UNSEEN_RUNS, rng)
        confined = any(effect.name == "sensor_range" for effect in self.hidden_effects)
        played, recordings, truth = [], [], {}
        for i in range(count):
            bad = i == self.bad_run and self.residue.kind == "bad run"
            # Most runs start within the range of a laser that saturates, a few outside.
            fraction = 0.15 if confined and rng.random() < 0.8 else 0.6
            gain = self.residue.bad_gain if bad and self.residue.bad_gain else 1.0
            run = self._play(kinds[i], clock, fraction, gain, rng, logged=i < self.runs)
            ideal = self.stage[1].ideal(run.actual_s, run.positions, run.velocities)
            if self.closed_loop and i < self.runs:
                run, ideal = _every(run, self.closed_loop.updates), ideal[:: self.closed_loop.updates]
            name = f"{'run' if i < self.runs else 'unseen'}_{i:02d}_{kinds[i].replace(' ', '_')}"
            outputs = self._measured(ideal, run.time_s, rng, glitch=bad)
            played.append(run)
            truth[name] = ideal
            recordings.append(Recording(name, run.time_s, run.inputs, outputs))
            clock = float(np.round(run.time_s[-1] + rng.uniform(3.0, 20.0), 3))
        return RandomSession(
            self, tuple(recordings[: self.runs]), tuple(recordings[self.runs :]), tuple(played), truth
        )

    def _play(
        self, kind: str, clock: float, fraction: float, gain: float, rng: np.random.Generator, *, logged: bool
    ) -> Played:
        """Play a run from a time of the session's clock, s, on; in closed loop with all controller rows."""
        loop, start = self.closed_loop, str(rng.choice(STARTS))
        place = draw_start(start, rng, fraction)
        rate_hz = round(1.0 / loop.period_s) if loop else self.rate_hz
        rows = round((loop.duration_s if loop and logged else DURATION_S) * rate_hz)
        time_s = np.round(clock + np.arange(rows) / rate_hz, 6)

        def plant_at(start_s: float) -> Plant:
            return self.plant(place, start_s)

        if loop is None or kind not in CLOSED_LOOP_RUNS:
            return play(plant_at, kind, start, time_s, rng, self.residue.jitter_s, (gain, gain))
        stamps = np.round(_jittered(time_s, loop.jitter_s if logged else 0.0, rng), 6)
        actual_s = _jittered(stamps, self.residue.jitter_s, rng)
        run = follow(
            plant_at, self.stage[1], kind, time_s, rng, lambda _: actual_s, loop.controller, (gain, gain)
        )
        return dataclasses.replace(run, time_s=stamps)

    def _measured(self, ideal: Array, time_s: Array, rng: np.random.Generator, *, glitch: bool) -> Array:
        """Return measurements with noise, quantization and the sensors' residue, as a file holds them."""
        outputs, period_s = ideal.copy(), (time_s[-1] - time_s[0]) / (len(time_s) - 1)
        outputs[:, :2] = np.round(outputs[:, :2] / ENCODER_STEP_RAD) * ENCODER_STEP_RAD
        outputs[:, 2:] += rng.normal(0.0, LASER_NOISE_M, (len(ideal), 2))
        if self.residue.colored:
            channel, size, tau = self.residue.colored
            outputs[:, CHANNELS.index(channel)] += colored_noise(len(ideal), size, tau / period_s, rng)
        if glitch and self.residue.glitch_m:
            row = int(rng.integers(round(0.2 * len(ideal)), len(ideal)))
            outputs[row, int(rng.integers(2, 4))] += self.residue.glitch_m
        for j, limits in ((2, self.stage[1].range_x_m), (3, self.stage[1].range_y_m)):
            outputs[:, j] = np.clip(outputs[:, j], *limits)
        return np.round(outputs, 9)


@dataclass(frozen=True)
class RandomSession:
    """Recorded rig.

    Attributes:
        rig: The rig.
        recordings: Runs to identify.
        unseen: Runs for the error of the answer, never to be fitted.
        played: The same runs in the same order as simulated, first those to identify.
        truth: Noise-free measurements phi1, phi2, rad, x, y, m, shape (n, 4), by the name of the run.
    """

    rig: RandomRig
    recordings: tuple[Recording, ...]
    unseen: tuple[Recording, ...]
    played: tuple[Played, ...]
    truth: dict[str, Array]

    def write(self, folder: Path) -> None:
        """Write `runs`, `unseen` and `truth.json` to a folder."""
        truth = {
            "hidden": self.rig.describe(),
            "effects": {e.label: e.parameters for e in self.rig.hidden_effects},
            "residue": self.rig.residue.note,
        }
        write_session(folder, self.recordings, self.unseen, truth)


def _every(run: Played, count: int) -> Played:
    """Return every `count`-th row of a run, as a log that is slower than the controller."""
    rows = {
        name: getattr(run, name)[::count]
        for name in ("time_s", "actual_s", "inputs", "positions", "velocities")
    }
    return dataclasses.replace(run, **rows)


def _jittered(time_s: Array, size_s: float, rng: np.random.Generator) -> Array:
    """Return times, s, that are off by a standard deviation, s; the first is right, the order is kept."""
    largest = 0.4 * (time_s[1] - time_s[0])
    off = np.clip(size_s * rng.standard_normal(len(time_s)), -largest, largest)
    off[0] = 0.0
    return np.asarray(time_s + off)


def describe_effects(effects: Sequence[DrawnEffect]) -> str:
    """Return hidden effects with their sizes in words."""
    texts = [f"{e.label} {e.size:.0%}{' off form' if e.off_form else ''}" for e in effects]
    return " + ".join(texts) or "nothing"


def _cycle(kinds: tuple[str, ...], count: int, rng: np.random.Generator) -> list[str]:
    """Return kinds in random order, each as often as the others."""
    order: list[str] = []
    while len(order) < count:
        order += [str(kind) for kind in rng.permutation(kinds)]
    return order[:count]


def colored_noise(rows: int, size: float, rows_per_tau: float, rng: np.random.Generator) -> Array:
    """Draw first-order noise.

    Args:
        rows: Number of values.
        size: Standard deviation, in the unit of the values.
        rows_per_tau: Time constant in rows.
        rng: Source of the noise.

    Returns:
        The noise, shape (rows,).
    """
    pole, values = float(np.exp(-1.0 / rows_per_tau)), np.empty(rows)
    value = size * rng.standard_normal()
    for row, kick in enumerate(size * np.sqrt(1.0 - pole**2) * rng.standard_normal(rows)):
        values[row] = value = pole * value + kick
    return values


def draw_rig(seed: int, index: int, *, closed_loop: bool = False) -> RandomRig:
    """Draw a rig.

    Args:
        seed: Seed of the set of rigs.
        index: Number of the rig in the set.
        closed_loop: Whether a position controller drives it while it is recorded.

    Returns:
        The rig; the same arguments give the same rig. In closed loop it is the same rig with another log.
    """
    rng = np.random.default_rng([seed, index, 0])
    simulator: Simulator = "reference" if rng.random() < 0.5 else "euler"
    runs, rate = int(rng.integers(3, 13)), 500.0 if rng.random() < 0.15 else 1000.0
    kind: Kind
    draw = rng.random()
    effects: list[DrawnEffect] = []
    if draw < 0.25:
        kind = "none"
    elif draw < 0.33:
        kind, effects = "outside", [draw_outside(rng)]
    elif draw < 0.41:
        kind, effects = "off-form", _off_form(rng)
    else:
        kind, effects = "library", draw_effects(rng, int(rng.choice([1, 2, 3], p=[0.5, 0.33, 0.17])))
    residue = Residue()
    if kind in ("none", "library") and rng.random() < 0.5:
        residue = draw_residue(str(rng.choice(RESIDUES)), rng)
    if any(effect.name == "idler_inertia" for effect in effects):
        simulator = "reference"  # the Euler simulator has the 8th-order stage only
        if residue.kind == "integrator":
            residue = Residue()
    elif residue.kind == "integrator":
        simulator = "euler"
    rig = RandomRig(
        seed, index, kind, simulator, tuple(effects), residue, runs, rate, int(rng.integers(runs))
    )
    if closed_loop:
        loop = _draw_closed_loop(np.random.default_rng([seed, index, 4]))
        rate = round(1.0 / (loop.period_s * loop.updates), 6)
        rig = dataclasses.replace(rig, rate_hz=rate, closed_loop=loop)
    return rig


def _draw_closed_loop(rng: np.random.Generator) -> ClosedLoop:
    """Draw a controller and the log of its rows."""
    period_s = float(rng.choice(_PERIODS_S))
    slowest, fastest = LOG_RATES_HZ
    updates = [n for n in (1, 2, 4, 5, 8, 10, 20) if slowest - 1e-6 <= 1.0 / (n * period_s) <= fastest + 1e-6]
    controller = Controller(
        proportional=rng.uniform(150.0, 400.0),
        derivative=rng.uniform(3.0, 8.0),
        integral=float(rng.choice([0.0, rng.uniform(500.0, 3000.0)])),
        feedforward=float(rng.choice([0.0, rng.uniform(6.0, 10.0)])),
        filter_fraction=1.0 - np.exp(-period_s / log_uniform(rng, 1e-3, 5e-3)),
    )
    jitter_s = log_uniform(rng, 10e-6, 150e-6) if rng.random() < 0.5 else 0.0
    return ClosedLoop(controller, period_s, int(rng.choice(updates)), jitter_s)


def _off_form(rng: np.random.Generator) -> list[DrawnEffect]:
    """Return one or two effects off the library's form, of different names and sites."""
    first, second = draw_off_form(rng), draw_off_form(rng)
    together = first.name != second.name and first.site.replace("motor", "phi") != second.site.replace(
        "motor", "phi"
    )
    return [first, second] if together and rng.random() < 0.4 else [first]


def draw_residue(kind: str, rng: np.random.Generator) -> Residue:
    """Draw a residue of random size.

    Args:
        kind: One of `RESIDUES`.
        rng: Source of the size.

    Returns:
        The residue.
    """
    draws: dict[str, Callable[[], Residue]] = {
        "integrator": lambda: _integrator(log_uniform(rng, 20e-6, 100e-6)),
        "missing force": lambda: Residue(kind, "the belts' 1/2 s^2 dk/dq is missing", energy_force=False),
        "hysteresis": lambda: _hysteresis(rng),
        "colored noise": lambda: _colored_noise(rng),
        "clock jitter": lambda: _jitter(log_uniform(rng, 8e-6, 25e-6)),
        "bad run": lambda: _bad_run(rng),
    }
    return draws[kind]()


def _integrator(step_s: float) -> Residue:
    return Residue("integrator", f"Euler steps of {1e6 * step_s:.0f} us", euler_step_s=step_s)


def _hysteresis(rng: np.random.Generator) -> Residue:
    site = str(rng.choice(COORDINATES))
    rotary = site.startswith("phi")
    # A fraction of the friction; it costs 5 to 40 um after two seconds, as the other residues do.
    force = log_uniform(rng, 0.01, 0.04) * {"x": 2.0, "y": 0.4}.get(site, 0.02)
    travel = log_uniform(rng, 0.1, 0.5) if rotary else log_uniform(rng, 0.002, 0.01)
    note = (
        f"hysteresis of {site}, {force:.2g} {'Nm' if rotary else 'N'} within "
        f"{travel:.2g} {'rad' if rotary else 'm'}"
    )
    return Residue("hysteresis", note, hysteresis=(site, force, travel))


def _colored_noise(rng: np.random.Generator) -> Residue:
    channel = str(rng.choice(CHANNELS[2:]))
    size, tau = log_uniform(rng, 8e-6, 30e-6), log_uniform(rng, 5e-3, 50e-3)
    note = f"noise of {1e6 * size:.0f} um and {1e3 * tau:.0f} ms at {channel}"
    return Residue("colored noise", note, colored=(channel, size, tau))


def _jitter(size_s: float) -> Residue:
    return Residue("clock jitter", f"clock jitter of {1e6 * size_s:.0f} us", jitter_s=size_s)


def _bad_run(rng: np.random.Generator) -> Residue:
    if rng.random() < 0.5:
        gain = float(np.round(rng.uniform(0.6, 0.9), 2))
        return Residue("bad run", f"one run with {gain} times the gain of both drives", bad_gain=gain)
    return Residue("bad run", "one row of one run off by 50 mm", glitch_m=0.05)


def main() -> None:
    """Describe or record the rigs that the command line names."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--only", type=int, nargs="+", metavar="INDEX")
    parser.add_argument("--closed-loop", action="store_true", help="under a position controller")
    parser.add_argument("--out", type=Path, metavar="DIR", help="record into this folder")
    arguments = parser.parse_args()
    for index in arguments.only or range(arguments.count):
        rig = draw_rig(arguments.seed, index, closed_loop=arguments.closed_loop)
        print(f"{rig.name} {rig.kind:8} {rig.describe()}", flush=True)
        if arguments.out:
            rig.record().write(arguments.out / rig.name)


if __name__ == "__main__":
    main()
