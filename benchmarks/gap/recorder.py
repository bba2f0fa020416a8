"""Record a plant within the budget of the protocol, as an entrant does before it controls the plant.

An entrant takes one of two kinds of recordings: runs with an excitation of its own choice, `CHOSEN_S` of them
in total, or the given logs of a position controller that follows machine programs, `LOGS_S` in total. All are
at 1 kHz, with the measurements of encoders and lasers. The runs of a session share a clock, on which the
plant warms up.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.gap.plants import GapPlant
from hframe_gym.errors import InputError
from hframe_gym.recordings import Recording
from tests.reference_simulator import Array
from tests.reference_simulator.sensors import noisy
from tests.rigs.machine_programs import PROGRAMS, follow
from tests.rigs.random_excitation import KINDS, MAX_VOLTAGE_V, STARTS, Played, draw_start, play
from tests.rigs.random_rigs import colored_noise

CHOSEN_S, LOGS_S = 16.0, 60.0
RUN_S, RATE_HZ = 2.0, 1000.0
_LONGEST_RUN_S = 10.0
_CHANNELS = ("phi1_rad", "phi2_rad", "x_m", "y_m")
_SETTLING_S = 0.4
# Maps the time since the beginning of the run, s, and the measurements phi1, phi2, rad, x, y, m, shape (4,),
# to the voltages of the motors, V, shape (2,).
Excitation = Callable[[float, Array], Array]


class Recorder:
    """Recorder of one plant. The same calls give the same recordings.

    Attributes:
        left_s: Length of runs of chosen excitation that the budget still allows, s.

    Args:
        plant: The plant.
        allowed: Whether the track of the entry allows recordings.
    """

    def __init__(self, plant: GapPlant, *, allowed: bool = True) -> None:
        self._plant, self._allowed = plant, allowed
        self._rng = np.random.default_rng([plant.seed, plant.index, 2])
        self._clock = float(np.round(self._rng.uniform(0.0, 30.0), 3))
        self._logs: tuple[Recording, ...] | None = None
        self._count = 0
        self.left_s = CHOSEN_S

    def excite(self, kind: str, start: str = "elsewhere") -> Recording:
        """Record a run of 2 s of a ready-made excitation, which turns back at the end of the travel.

        Args:
            kind: One of "steps", "single" (one motor), "triangle", "multisine", "telegraph", "moves".
            start: "center", "elsewhere", or "jog": after a short motion that leaves the belts stretched.

        Raises:
            InputError: If a name is unknown or the budget does not allow the run.
        """
        if kind not in KINDS or start not in STARTS:
            raise InputError(
                f"excitation {kind!r} from {start!r}: choose one of {', '.join(KINDS)}, "
                f"from one of {', '.join(STARTS)}"
            )
        time_s = self._begin(RUN_S)
        jitter_s = self._plant.residue.jitter_s
        place = draw_start(start, self._rng, 0.6)
        played = play(
            lambda start_s: self._plant.at_rest(place, start_s), kind, start, time_s, self._rng, jitter_s
        )
        return self._measured(played)

    def record(self, excitation: Excitation, start_xy: tuple[float, float], duration_s: float) -> Recording:
        """Record a run of an excitation of your own.

        Args:
            excitation: Function from time, s, and measurements phi1, phi2, rad, x, y, m, shape (4,), to the
                voltages of the motors, V, shape (2,); limited to 8 V. In the first 0.1 s they are 0.
            start_xy: Position at which the stage is set up, m.
            duration_s: Length of the run, s, at most 10.

        Raises:
            InputError: If the budget does not allow the run or a voltage is not finite.
        """
        time_s = self._begin(duration_s)
        stage = self._plant.at_rest(start_xy, time_s[0] - _SETTLING_S)
        stage.step(np.zeros(2), time_s[0])
        sensors = self._plant.stage[1]
        inputs, states = np.zeros((len(time_s), 2)), np.empty((len(time_s), 8))
        for row, now in enumerate(time_s):
            states[row, :4], states[row, 4:] = stage.position, stage.velocity
            if now - time_s[0] >= 0.1 - 1e-9:
                seen = sensors.graduated(states[row, [2, 3, 0, 1]])
                volts = np.asarray(
                    excitation(float(now - time_s[0]), noisy(seen[None], self._rng)[0]), np.float64
                )
                if volts.shape != (2,) or not np.isfinite(volts).all():
                    raise InputError(
                        f"excitation at {now - time_s[0]:.3f} s: {volts} is not two finite voltages"
                    )
                inputs[row] = np.clip(volts, -MAX_VOLTAGE_V, MAX_VOLTAGE_V)
            if row + 1 < len(time_s):
                stage.step(inputs[row], time_s[row + 1])
        return self._measured(
            Played("own", "own", time_s, time_s, inputs, states[:, :4].copy(), states[:, 4:].copy())
        )

    def logs(self) -> tuple[Recording, ...]:
        """Return the given closed-loop logs: 30 runs of 2 s of machine programs, not of chosen excitation.

        Raises:
            InputError: If chosen excitation was recorded, or the track of the entry allows no recordings.
        """
        if self._logs is None:
            if self.left_s < CHOSEN_S:
                raise InputError("the budget is for chosen excitation or for the given logs, not for both")
            runs = []
            for i in range(round(LOGS_S / RUN_S)):
                time_s = self._times(RUN_S)
                place = draw_start("elsewhere", self._rng, 0.5)
                kind = PROGRAMS[i % len(PROGRAMS)]
                sensors = self._plant.stage[1]
                runs.append(
                    self._measured(
                        follow(
                            lambda start_s, place=place: self._plant.at_rest(place, start_s),  # type: ignore[misc]
                            sensors,
                            kind,
                            time_s,
                            self._rng,
                        )
                    )
                )
            self._logs, self.left_s = tuple(runs), 0.0
        return self._logs

    def _begin(self, duration_s: float) -> Array:
        """Take a run from the budget and return its sample times, s, shape (n,)."""
        if not 0.2 <= duration_s <= _LONGEST_RUN_S:
            raise InputError(f"a run of {duration_s} s: runs take 0.2 to {_LONGEST_RUN_S:g} s")
        if duration_s > self.left_s + 1e-9:
            raise InputError(
                f"a run of {duration_s:g} s exceeds the budget, of which {self.left_s:g} s are left"
            )
        time_s = self._times(duration_s)
        self.left_s -= duration_s
        return time_s

    def _times(self, duration_s: float) -> Array:
        """Return the next sample times on the session's clock, s, shape (n,)."""
        if not self._allowed:
            raise InputError("an entry of the zero-shot or online track gets no recordings")
        time_s = np.round(self._clock + np.arange(round(duration_s * RATE_HZ)) / RATE_HZ, 6)
        self._clock = float(np.round(time_s[-1] + self._rng.uniform(3.0, 20.0), 3))
        return time_s

    def _measured(self, played: Played) -> Recording:
        """Return the run as a file holds it, with noise, quantization and the residue of the sensors."""
        ideal = self._plant.stage[1].ideal(played.actual_s, played.positions, played.velocities)
        outputs = noisy(ideal, self._rng)
        if self._plant.residue.colored:
            channel, size, tau = self._plant.residue.colored
            outputs[:, _CHANNELS.index(channel)] += colored_noise(len(ideal), size, tau * RATE_HZ, self._rng)
        self._count += 1
        kind = played.kind.replace(" ", "_")
        return Recording(f"run_{self._count:02d}_{kind}", played.time_s, played.inputs, np.round(outputs, 9))


def standard_session(recorder: Recorder) -> tuple[Recording, ...]:
    """Record the session of the repository's entries: eight runs of 2 s, each excitation once or twice.

    Args:
        recorder: Recorder with its whole budget.
    """
    kinds = (*KINDS, "multisine", "steps")
    return tuple(recorder.excite(kind, STARTS[i % len(STARTS)]) for i, kind in enumerate(kinds))
