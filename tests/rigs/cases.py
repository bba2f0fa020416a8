"""List the rigs of the identification benchmark, and record them.

    python -m tests.rigs.cases                              # list the rigs
    python -m tests.rigs.cases NAME... --out DIR [--jobs N] # record DIR/NAME/runs/*.csv.gz, machine.json, ...

NAME is the name of a rig or of a set. Every parameter of a rig differs from the declared one by 5 to 20 %,
independently of the others; the seed is a checksum of the rig's name.
"""

from __future__ import annotations

import argparse
import zlib
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from tests.reference_simulator import COORDINATES, Frame, Payload, Rig
from tests.reference_simulator.sensors import Sensors
from tests.rigs.hidden_effects import (
    MOTORS,
    Build,
    HiddenEffect,
    change_fields,
    change_site,
    effect,
    random_rig,
    stall_tension,
)

SIZES = {"full": 1.0, "20%": 0.2, "5%": 0.05}


@dataclass(frozen=True)
class Case:
    """Rig to identify.

    Attributes:
        name: Name of the rig, which is also its seed.
        group: Set to which the rig belongs.
        kind: Where its hidden effects come from: the library, nowhere, or outside the library.
        size: Key of `SIZES`, or empty.
        hidden_effects: Effects that the machine file does not declare.
        runs: Number of runs of 2 s.
        start_fraction: Fraction of the travel in which runs start.
    """

    name: str
    group: str
    kind: Literal["library", "none", "outside"]
    size: str
    hidden_effects: tuple[HiddenEffect, ...]
    runs: int = 12
    start_fraction: float = 0.6

    @property
    def seed(self) -> int:
        """Return the seed of everything random about the rig."""
        return zlib.crc32(self.name.encode())

    def rig(self) -> tuple[Rig, Sensors]:
        """Return the stage and its sensors, with the hidden effects."""
        rig, sensors = random_rig(np.random.default_rng([self.seed, 1])), Sensors()
        for hidden in self.hidden_effects:
            rig, sensors = hidden.build(rig, sensors)
        return rig, sensors

    def true_parameters(self, hidden: HiddenEffect) -> dict[str, float]:
        """Return a hidden effect's parameters as identification should estimate them.

        Args:
            hidden: One of the rig's hidden effects.

        Returns:
            Parameters by name, SI. Forces are scaled to the declared gain of motor 1, which is not fitted.
        """
        rig, declared = self.rig()[0], Rig()
        gain = stall_tension(declared) / stall_tension(rig)
        return {
            name: value * (gain if name in hidden.scale_with_gain else 1.0)
            for name, value in hidden.parameters.items()
        }


# Sites of each effect of the library: first the most likely one, then others, which occur at full size only.
SITES: dict[str, tuple[str, ...]] = {
    "stribeck_friction": ("x", "y", "phi1"),
    "tustin_friction": ("x", "phi1"),
    "dwell_friction": ("x",),
    "constant_force": ("y", "phi2"),
    "voltage_offset": ("motor1",),
    "gain_mismatch": ("motor2",),
    "dead_band": ("motor1",),
    "current_limit": ("motor1",),
    "torque_saturation": ("motor1",),
    "commutation_ripple": ("motor1",),
    "winding_heat": ("motor1",),
    "supply_sag": ("drives",),
    "electrical_lag": ("motor2",),
    "input_delay": ("drives", "motor2"),
    "asymmetric_viscous": ("x", "phi1"),
    "quadratic_drag": ("x", "y"),
    "eddy_brake": ("x",),
    "cable_spring": ("x", "y"),
    "position_friction": ("x", "phi2"),
    "friction_slope": ("x",),
    "cogging": ("motor1", "motor2"),
    "belt_mesh": ("motor2",),
    "unbalance": ("phi2",),
    "load_friction": ("motor1",),
    "eccentric_pulley": ("motor2",),
    "belt_play": ("belts",),
    "belt_damping": ("belts",),
    "belt_slack": ("belts",),
    "belt_hardening": ("belts",),
    "bridge_yaw": ("machine",),
    "payload_swing": ("y",),
    "sensor_skew": ("y_m",),
    "sensor_scale": ("x_m",),
    "eccentric_encoder": ("phi1_rad",),
    "interpolation_error": ("y_m",),
    "sensor_range": ("x_m",),
    "sensor_delay": ("x_m",),
    "presliding": ("x", "phi1"),
    "dahl_hysteresis": ("x", "y"),
    "bouc_wen_hysteresis": ("x",),
    "friction_warm_up": ("machine",),
    "frame_resonance": ("x",),
    "lugre": ("x",),
    "voltage_limit": ("motor1",),
    "coasting_bridge": ("motor2",),
    "inverter_dead_time": ("motor1",),
    "gear_backlash": ("motor1",),
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
    ("cogging@motor1", "second_cogging@motor1"),
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
    *(
        (e, "full")
        for e in ("stribeck_friction@x", "constant_force@y", "input_delay@drives", "cogging@motor1")
    ),
    *(
        (e, "full")
        for e in ("bridge_yaw@machine", "eccentric_pulley@motor2", "belt_damping@belts", "cable_spring@x")
    ),
    *(
        (e, "20%")
        for e in ("stribeck_friction@x", "asymmetric_viscous@x", "sensor_skew@y_m", "position_friction@x")
    ),
)


def _outside() -> dict[str, tuple[tuple[str, ...], Build]]:
    """Return effects that the library lacked when the set was made, by name: accepted labels, and the build.

    `unexplained` is accepted as well. A table (`smooth_force`, `smooth_friction`) names the variable on which
    a force or a friction level depends. Effects with memory or an additional resonance have no such table.
    """
    x, y = (partial(change_site, sites=COORDINATES, site=site) for site in "xy")
    motor = partial(change_site, sites=MOTORS)
    every_coordinate = [f"smooth_friction[{v}]@{c}" for c in COORDINATES for v in ("time", f"path of {c}")]
    return {
        "magnetic catch": (
            ("smooth_force[position of x]@x",),
            partial(x, catch_force=8.0, catch_position=0.06, catch_width=0.012),
        ),
        "rail magnets": (
            ("smooth_force[position of x]@x",),
            partial(x, wave_force=2.5, wave_number=2 * np.pi / 0.032, wave_phase=0.4),
        ),
        "warm-up": (("smooth_friction[time]@x",), partial(x, friction_cold=1.5)),
        "wear by run": (tuple(every_coordinate), partial(change_fields, friction_per_run=0.06)),
        "bent rail": (("smooth_friction[position of y]@x",), partial(x, friction_cross_position=6.0)),
        "y rubs when x moves": (("smooth_friction[velocity of x]@y",), partial(y, friction_cross_speed=4.0)),
        "loose payload": (("payload_swing@y",), partial(change_fields, payload=Payload())),
        "soft frame": (("frame_resonance@x",), partial(change_fields, frame=Frame())),
        "gear backlash": (("gear_backlash@motor1",), partial(change_fields, backlash_rad=(0.012, 0.0))),
        "cable chain": (
            ("presliding@x", "dahl_hysteresis@x", "bouc_wen_hysteresis@x"),
            partial(x, hysteresis_force=4.0, hysteresis_travel=0.008),
        ),
        "hot motor": (("winding_heat@motor1",), partial(motor, site="motor1", heating_loss=0.02)),
        "commutation ripple": (
            ("commutation_ripple@motor2",),
            partial(motor, site="motor2", current_ripple=0.12, current_ripple_order=35.4),
        ),
    }


def _effect_at(label: str, size: float) -> HiddenEffect:
    """Return the library effect of a label, name@site."""
    name, site = label.split("@")
    return effect(name, site, size)


def cases() -> dict[str, Case]:
    """Return all rigs by name."""
    rigs: list[Case] = []
    for name, sites in SITES.items():
        fraction = 0.15 if name == "sensor_range" else 0.6  # runs must start within the laser's range
        for site in sites:
            case = partial(Case, kind="library", start_fraction=fraction)
            label = f"{name}@{site}"
            rigs.append(
                case(f"{label} full", "library-full", size="full", hidden_effects=(effect(name, site, 1.0),))
            )
            for size in ("20%", "5%") if site == sites[0] else ():
                hidden = (effect(name, site, SIZES[size]),)
                rigs.append(case(f"{label} {size}", "library-small", size=size, hidden_effects=hidden))
    for group, combinations in (("pairs", PAIRS), ("triples", TRIPLES)):
        for labels in combinations:
            hidden = tuple(_effect_at(label, 1.0) for label in labels)
            rigs.append(Case(" + ".join(labels), group, "library", "full", hidden))
    for label, size in FOUR_RUNS:
        rigs.append(
            Case(
                f"{label} {size}, 4 runs", "four-runs", "library", size, (_effect_at(label, SIZES[size]),), 4
            )
        )
    for i in range(3):
        rigs.append(
            Case(f"idlers {i + 1}", "order20", "library", "full", (effect("idler_inertia", "machine", 1.0),))
        )
    rigs += [Case(f"none {i + 1}", "none", "none", "", (), 12 if i < 14 else 4) for i in range(24)]
    for name, (accepted, build) in _outside().items():
        rigs.append(Case(name, "outside", "outside", "full", (HiddenEffect(name, build, accepted, {}),)))
    return {case.name: case for case in rigs}


def select_cases(names: list[str]) -> list[Case]:
    """Return the rigs of some names.

    Args:
        names: Names of rigs or of sets; "all" is every rig.

    Returns:
        The rigs, each once, in the order of the names.

    Raises:
        ValueError: If a name is neither that of a rig nor that of a set.
    """
    every_case = cases()
    groups = {case.group for case in every_case.values()}
    selection: dict[str, Case] = {}
    for name in names:
        matches = [case for case in every_case.values() if name in ("all", case.name, case.group)]
        if not matches:
            raise ValueError(
                f"{name!r} is neither a rig nor a set; sets are all, {', '.join(sorted(groups))}"
            )
        selection |= {case.name: case for case in matches}
    return list(selection.values())


def main() -> None:
    """List or record the rigs that the command line names."""
    from tests.rigs.recording_sessions import DEFAULT_FOLDER, record_sessions  # it imports this module

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--out", default=DEFAULT_FOLDER)
    parser.add_argument("--jobs", type=int, default=1)
    arguments = parser.parse_args()
    if not arguments.names:
        for case in cases().values():
            print(f"{case.group:14} {case.name}")
        return
    for session in record_sessions(select_cases(arguments.names), arguments.out, arguments.jobs):
        print(session.folder, flush=True)


if __name__ == "__main__":
    main()
