"""All of it: what a careful colleague would say about a folder of recordings before anything is fitted."""

from __future__ import annotations

from collections.abc import Sequence

from ..identification import prepare
from ..machine import Machine
from ..recordings import Recording
from . import channels, excitation, wiring
from . import sampling as clock
from .findings import Finding
from .identifiability import parameters


def check_recordings(recordings: Sequence[Recording], machine: Machine) -> list[Finding]:
    """Findings about the runs of a machine, faults first."""
    data = prepare(recordings, machine)
    found = [clock.rate(recordings), *clock.shared_clock(recordings)]
    for recording in recordings:
        found += clock.sampling(recording) + clock.rest(recording, machine)
    found += channels.all_of(recordings, data, machine)
    found += excitation.all_of(recordings, data, machine)
    moved = [r.name for r in recordings if not channels.motionless(r, data, machine) and len(r.time_s) > 2]
    if moved:
        moving = data.only(moved)
        found += wiring.wiring(moving, machine) + wiring.sizes(moving, machine) + wiring.ratios(moving, machine)
        found += parameters(moving, machine)
    order = ("fault", "advice", "note")
    return sorted(found, key=lambda f: order.index(f.severity))


def warnings_of(recording: Recording, machine: Machine) -> list[Finding]:
    """What is odd about one run without being wrong: clock, inputs that never move, outputs stuck or clipped."""
    found = [*clock.sampling(recording), *excitation.inputs([recording], machine), *channels.stuck(recording, machine)]
    return [f for f in found if f.severity != "note"]
