"""Tests of the choice of held-out runs, and of the spectra and accelerations that it compares."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
import pytest

from hframe_gym.errors import InputError
from hframe_gym.identification import hold_out
from hframe_gym.preparation.runs.accelerations import acceleration_fractions
from hframe_gym.preparation.runs.spectra import spectral_differences
from hframe_gym.recordings import Recording
from tests.identification.scripted_fits import AXIS


def voltages(kind: str, seed: int, rate: float = 1000.0, duration: float = 2.0) -> np.ndarray:
    """Return voltages of up to 5 V of a kind of motion, which random numbers vary, shape (n,)."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(round(duration * rate)) / rate
    phases = 2 * np.pi * rng.random(12)
    if kind == "sine":
        return 5.0 * np.sin(2 * np.pi * 0.8 * time_s) * rng.choice([-1.0, 1.0])
    if kind == "multisine":
        return sum(
            1.5 * np.sin(2 * np.pi * f * time_s + p)
            for f, p in zip(np.geomspace(1, 40, 12), phases, strict=True)
        )
    if kind == "chirp":
        return 5.0 * np.sin(2 * np.pi * (time_s + 40.0 / 2 / duration * time_s**2) + phases[0])
    # Steps.
    return 5.0 * np.repeat([-1.0, 1.0] * 12, round(0.2 * rate))[: len(time_s)] * rng.choice([-1.0, 1.0])


def recorded(kinds: Sequence[str], rate: float = 1000.0) -> list[Recording]:
    """Return a run of an axis for each kind of motion, named r00_KIND and so on."""
    runs = []
    for i, kind in enumerate(kinds):
        inputs = voltages(kind, i, rate)[:, None]
        runs.append(
            Recording(f"r{i:02d}_{kind}", np.arange(len(inputs)) / rate, inputs, np.zeros_like(inputs))
        )
    return runs


def kinds_of(names: Sequence[str]) -> list[str]:
    """Return the kinds of motion of runs, given their names."""
    return [name.partition("_")[2] for name in names]


@pytest.mark.parametrize("kind", ["sine", "chirp", "multisine", "steps"])
@pytest.mark.parametrize(
    ("count", "expected"),
    [(2, [1]), (3, [2]), (4, [3]), (7, [3]), (8, [3, 7]), (11, [3, 7]), (12, [3, 7, 11])],
)
def test_every_fourth_run_is_held_out_if_all_are_alike(kind: str, count: int, expected: list[int]) -> None:
    recordings = recorded([kind] * count)
    assert hold_out(recordings) == tuple(recordings[i].name for i in expected)


def with_motion(recording: Recording, size: float) -> Recording:
    """Return a run with a measured motion and noise of 20 um."""
    noise = np.random.default_rng(len(recording.name)).normal(0.0, 2e-5, recording.inputs.shape)
    return dataclasses.replace(recording, outputs=size * np.sin(9.0 * recording.time_s)[:, None] + noise)


@pytest.mark.parametrize("still", [(0,), (3,), (0, 1, 3), (1, 2, 3)])
def test_a_run_in_which_nothing_moves_is_not_held_out(still: tuple[int, ...]) -> None:
    """A motor turns only above a dead band; the third and fourth of five runs stay below."""
    recordings = [with_motion(r, 5e-5 if i in still else 0.1) for i, r in enumerate(recorded(["sine"] * 5))]
    [chosen] = hold_out(recordings)
    assert chosen not in {recordings[i].name for i in still}
    with pytest.raises(InputError, match="nothing moves in it, so its error says nothing about the machine"):
        hold_out(recordings, [recordings[still[0]].name])
    moving = [r for i, r in enumerate(recordings) if i not in still]
    with pytest.raises(InputError, match=f"nothing moves except in run {moving[0].name}"):
        hold_out([moving[0], recordings[still[0]]])


KINDS = ("steps", "sine", "multisine", "chirp")


@pytest.mark.parametrize("order", list(itertools.permutations(KINDS)))
@pytest.mark.parametrize("repetitions", [2, 3, 4, 5])
def test_a_protocol_that_repeats_four_kinds_holds_out_several(
    order: tuple[str, ...], repetitions: int
) -> None:
    """Every fourth run would be of one kind."""
    names = [r.name for r in recorded(order * repetitions)]
    chosen = hold_out(recorded(order * repetitions))
    assert len(chosen) == repetitions
    assert len(set(kinds_of(chosen))) == min(repetitions, 4)
    assert set(kinds_of(chosen)) <= set(kinds_of([name for name in names if name not in chosen]))


@pytest.mark.parametrize("single", range(8))
@pytest.mark.parametrize("other", ["steps", "multisine"])
def test_a_kind_that_occurs_once_is_fitted(single: int, other: str) -> None:
    kinds = [other] * 8
    kinds[single] = "chirp"
    chosen = hold_out(recorded(kinds))
    assert kinds_of(chosen) == [other] * 2
    kinds = [other] * 3
    kinds[single % 3] = "sine"
    assert kinds_of(hold_out(recorded(kinds))) == [other]


def test_runs_of_different_axes_are_told_apart_by_the_signs_of_their_voltages() -> None:
    """On an H-frame, equal voltages move y and opposite ones x."""
    runs = [dataclasses.replace(r, inputs=r.inputs * [1.0, 1.0]) for r in recorded(["multisine"] * 8)]
    for i in (1, 3, 5, 7):
        runs[i] = dataclasses.replace(runs[i], inputs=runs[i].inputs * [1.0, -1.0])
    differences = spectral_differences(runs)
    assert (differences[0, 2], differences[1, 3]) == (0.0, 0.0)
    assert differences[0, 1] == pytest.approx(0.5, abs=0.01)  # the spectra of the single drives are equal
    assert sorted(int(name[1:3]) % 2 for name in hold_out(runs)) == [0, 1]


def test_spectra_depend_neither_on_sampling_rate_nor_on_duration_but_on_amplitude() -> None:
    fast, slow = recorded(["multisine"])[0], recorded(["multisine"], rate=400.0)[0]
    long = dataclasses.replace(fast, inputs=np.tile(fast.inputs, (2, 1)), time_s=np.arange(4000) * 1e-3)
    weak = dataclasses.replace(fast, inputs=fast.inputs / 2.0)
    none = dataclasses.replace(fast, inputs=0.0 * fast.inputs)
    differences = spectral_differences([fast, slow, long, weak, none, none])
    assert differences[0] == pytest.approx([0.0, 0.0, 0.0, 1.0 / 3.0, 1.0, 1.0])
    assert differences[4, 5] == 0.0


@pytest.mark.parametrize("seed", range(5))
def test_noise_of_the_voltages_does_not_change_the_choice(seed: int) -> None:
    """The voltages of a controller contain the noise of the sensors."""
    recordings = recorded(KINDS * 2)
    rng = np.random.default_rng(seed)
    noisy = [
        dataclasses.replace(r, inputs=r.inputs + rng.normal(0.0, 0.1, r.inputs.shape)) for r in recordings
    ]
    assert hold_out(noisy) == hold_out(recordings)


def test_the_only_start_of_slow_runs_is_not_held_out() -> None:
    """A constant voltage from rest resembles the end of a ramp, which shows no inertia, like noise."""
    rng = np.random.default_rng(4)
    time_s = np.arange(2000) * 1e-3
    volts = {f"ramp_{k}": 4.6 + 0.1 * k + 0.02 * time_s for k in range(3)}
    volts |= {"start": np.full(2000, 5.0), "ramp_3": 4.9 + 0.02 * time_s}
    runs = []
    for name, inputs in volts.items():
        speed = inputs * (1.0 - np.exp(-20.0 * time_s) if name == "start" else 1.0)
        outputs = np.cumsum(speed) * 1e-3 + rng.normal(0.0, 1e-3, 2000)
        runs.append(Recording(name, time_s, inputs[:, None], outputs[:, None]))
    assert hold_out(runs) == ("start",)
    assert hold_out(runs, (), AXIS) != ("start",)
    assert acceleration_fractions(runs, AXIS)[3] > 0.9
    assert not acceleration_fractions(runs[:3], AXIS).any()


def test_impossible_choices_of_held_out_runs_are_refused() -> None:
    recordings = recorded(KINDS)
    assert hold_out(recordings, ["r00_steps"]) == ("r00_steps",)
    with pytest.raises(InputError, match="--hold-out nothing: no such run"):
        hold_out(recordings, ["r00_steps", "nothing"])
    with pytest.raises(InputError, match="at least one must be left to fit"):
        hold_out(recordings, [recording.name for recording in recordings])


def test_a_single_run_cannot_be_held_out() -> None:
    recordings = recorded(["sine"])
    with pytest.raises(InputError, match="runs: 1, held out: 1"):
        hold_out(recordings)
