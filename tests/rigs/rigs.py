"""The rigs of the identification benchmark: what each hides, and what an identification may call it.

    python -m tests.rigs.rigs                              # list them
    python -m tests.rigs.rigs NAME... --out DIR [--jobs N] # record them: DIR/NAME/runs/*.csv.gz, machine.json, ...

NAME is a rig's name or that of a set. Every rig's parameters are 5 to 20 % away from those declared, each by a draw of
its own; the seed is the name.
"""

from __future__ import annotations

import argparse
import zlib
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from tests.reference_simulator import COORDINATES, Frame, Payload, Rig
from tests.reference_simulator import Array as Array  # for tools.make_examples, until it asks the reference itself
from tests.reference_simulator.sensors import Sensors
from tests.rigs.planted import MOTORS, Build, Planted, at_place, drawn, effect, stall_tension, whole

SIZES = {"full": 1.0, "20%": 0.2, "5%": 0.05}


@dataclass(frozen=True)
class Case:
    """A rig to identify: 12 or 4 runs of 2 s. ``start_share``: of the travel, in which runs start."""

    name: str
    group: str
    kind: Literal["library", "none", "outside"]
    size: str
    planted: tuple[Planted, ...]
    runs: int = 12
    start_share: float = 0.6

    @property
    def seed(self) -> int:
        return zlib.crc32(self.name.encode())

    def rig(self) -> tuple[Rig, Sensors]:
        """The stage and its sensors."""
        rig, sensors = drawn(np.random.default_rng([self.seed, 1])), Sensors()
        for planted in self.planted:
            rig, sensors = planted.build(rig, sensors)
        return rig, sensors

    def truth(self, planted: Planted) -> dict[str, float]:
        """The planted effect's parameters as a fit in which motor 1 is as declared must find them."""
        rig, declared = self.rig()[0], Rig()
        gain = stall_tension(declared) / stall_tension(rig)
        return {name: value * (gain if name in planted.forces else 1.0) for name, value in planted.truth.items()}


# Each effect of the library at the site where a rig has it most likely, and at others that the full size tries as well.
SITES: dict[str, tuple[str, ...]] = {
    "stribeck_friction": ("x", "y", "phi1"),
    "constant_force": ("y", "phi2"),
    "voltage_offset": ("motor1",),
    "gain_mismatch": ("motor2",),
    "dead_band": ("motor1",),
    "current_limit": ("motor1",),
    "electrical_lag": ("motor2",),
    "input_delay": ("drives",),
    "asymmetric_viscous": ("x", "phi1"),
    "quadratic_drag": ("x", "y"),
    "cable_spring": ("x", "y"),
    "position_friction": ("x", "phi2"),
    "friction_slope": ("x",),
    "cogging": ("motor1", "motor2"),
    "eccentric_pulley": ("motor2",),
    "belt_play": ("belts",),
    "belt_damping": ("belts",),
    "belt_slack": ("belts",),
    "belt_hardening": ("belts",),
    "bridge_yaw": ("machine",),
    "sensor_skew": ("y_m",),
    "sensor_scale": ("x_m",),
    "sensor_range": ("x_m",),
    "sensor_delay": ("x_m",),
    "presliding": ("x", "phi1"),
    "lugre": ("x",),
}
PAIRS = (
    ("stribeck_friction@x", "input_delay@drives"),
    ("stribeck_friction@x", "constant_force@y"),
    ("cogging@motor1", "stribeck_friction@y"),
    ("bridge_yaw@machine", "cogging@motor2"),
    ("cable_spring@x", "sensor_skew@y_m"),
    ("belt_damping@belts", "asymmetric_viscous@x"),
    ("eccentric_pulley@motor2", "quadratic_drag@y"),
    ("presliding@phi1", "input_delay@drives"),
    ("belt_play@belts", "position_friction@x"),
    ("dead_band@motor1", "voltage_offset@motor2"),
)
TRIPLES = (
    ("stribeck_friction@x", "input_delay@drives", "cable_spring@y"),
    ("bridge_yaw@machine", "stribeck_friction@y", "sensor_skew@y_m"),
    ("cogging@motor1", "cogging@motor2", "stribeck_friction@x"),
    ("belt_damping@belts", "eccentric_pulley@motor2", "constant_force@y"),
    ("input_delay@drives", "electrical_lag@motor2", "asymmetric_viscous@x"),
    ("position_friction@x", "sensor_delay@x_m", "dead_band@motor1"),
)
FOUR_RUNS = (
    *((e, "full") for e in ("stribeck_friction@x", "constant_force@y", "input_delay@drives", "cogging@motor1")),
    *((e, "full") for e in ("bridge_yaw@machine", "eccentric_pulley@motor2", "belt_damping@belts", "cable_spring@x")),
    *((e, "20%") for e in ("stribeck_friction@x", "asymmetric_viscous@x", "sensor_skew@y_m", "position_friction@x")),
)


def _outside() -> dict[str, tuple[tuple[str, ...], Build]]:
    """Rigs that lack what no library entry says: by name, what may be said beside `unexplained`, and the build.

    A table says which variable a force or a friction level follows; what has memory or a resonance of its own is none.
    """
    x, y = (partial(at_place, places=COORDINATES, site=site) for site in "xy")
    motor = partial(at_place, places=MOTORS)
    everywhere = [f"smooth_friction[{v}]@{c}" for c in COORDINATES for v in ("time", f"path of {c}")]
    return {
        "magnetic catch": (
            ("smooth_force[position of x]@x",),
            partial(x, catch_force=8.0, catch_place=0.06, catch_width=0.012),
        ),
        "rail magnets": (
            ("smooth_force[position of x]@x",),
            partial(x, wave_force=2.5, wave_number=2 * np.pi / 0.032, wave_phase=0.4),
        ),
        "warm-up": (("smooth_friction[time]@x",), partial(x, friction_cold=1.5)),
        "wear by run": (tuple(everywhere), partial(whole, friction_per_run=0.06)),
        "bent rail": (("smooth_friction[position of y]@x",), partial(x, friction_cross_place=6.0)),
        "y rubs when x moves": (("smooth_friction[velocity of x]@y",), partial(y, friction_cross_speed=4.0)),
        "loose payload": ((), partial(whole, payload=Payload())),
        "soft frame": ((), partial(whole, frame=Frame())),
        "gear backlash": ((), partial(whole, backlash_rad=(0.012, 0.0))),
        "cable chain": (("presliding@x",), partial(x, hysteresis_force=4.0, hysteresis_travel=0.008)),
        "hot motor": ((), partial(motor, site="motor1", heating_loss=0.02)),
        "commutation ripple": ((), partial(motor, site="motor2", current_ripple=0.12, current_ripple_order=35.4)),
    }


def _split(label: str, size: float) -> Planted:
    name, site = label.split("@")
    return effect(name, site, size)


def cases() -> dict[str, Case]:
    """All rigs by name."""
    made: list[Case] = []
    for name, sites in SITES.items():
        share = 0.15 if name == "sensor_range" else 0.6  # it starts where the laser sees it
        for site in sites:
            case = partial(Case, kind="library", start_share=share)
            label = f"{name}@{site}"
            made.append(case(f"{label} full", "library-full", size="full", planted=(effect(name, site, 1.0),)))
            for size in ("20%", "5%") if site == sites[0] else ():
                planted = (effect(name, site, SIZES[size]),)
                made.append(case(f"{label} {size}", "library-small", size=size, planted=planted))
    for group, combinations in (("pairs", PAIRS), ("triples", TRIPLES)):
        for labels in combinations:
            planted = tuple(_split(label, 1.0) for label in labels)
            made.append(Case(" + ".join(labels), group, "library", "full", planted))
    for label, size in FOUR_RUNS:
        made.append(Case(f"{label} {size}, 4 runs", "four-runs", "library", size, (_split(label, SIZES[size]),), 4))
    for i in range(3):
        made.append(Case(f"idlers {i + 1}", "order20", "library", "full", (effect("idler_inertia", "machine", 1.0),)))
    made += [Case(f"none {i + 1}", "none", "none", "", (), 12 if i < 14 else 4) for i in range(24)]
    for name, (accepted, build) in _outside().items():
        made.append(Case(name, "outside", "outside", "full", (Planted(name, build, accepted, {}),)))
    return {case.name: case for case in made}


def chosen(names: list[str]) -> list[Case]:
    """The rigs of these names or sets. Raises ValueError for one that is neither."""
    known = cases()
    groups = {case.group for case in known.values()}
    found: dict[str, Case] = {}
    for name in names:
        some = (
            [c for c in known.values() if name in (c.name, c.group, "all")] if name != "all" else list(known.values())
        )
        if not some:
            raise ValueError(f"{name!r} is neither a rig nor a set; sets are all, {', '.join(sorted(groups))}")
        found |= {c.name: c for c in some}
    return list(found.values())


def main() -> None:
    from tests.rigs.sessions import DEFAULT_FOLDER, recorded  # it needs this table

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--out", default=DEFAULT_FOLDER)
    parser.add_argument("--jobs", type=int, default=1)
    arguments = parser.parse_args()
    if not arguments.names:
        for case in cases().values():
            print(f"{case.group:14} {case.name}")
        return
    for session in recorded(chosen(arguments.names), arguments.out, arguments.jobs):
        print(session.folder, flush=True)


if __name__ == "__main__":
    main()
