"""Write the example recordings.

    python -m tools.make_examples

Two rigs of the same type are recorded for one session of identification runs each. `examples/rig_a` has one
effect that no machine file declares; `examples/rig_b` is the same rig without it. The seed is fixed, so the
files are always equal.
"""

from __future__ import annotations

import dataclasses
import gzip
from pathlib import Path

import numpy as np

from tests.reference_simulator import Array, Rig
from tests.reference_simulator.sensors import ENCODER_STEP_RAD
from tests.rigs.excitation import ExcitationRun, record_runs
from tools.command_line import command_line
from tools.repository import ROOT

# True parameters: each differs by 5 to 15 % from the declared (the paper's) one, and the motors differ from
# each other.
TRUE_RIG = Rig(
    mass=(4.50, 0.96, 1.25e-4, 1.03e-4),
    viscous=(36.0, 32.0, 0.0040, 0.0033),
    coulomb=(2.25, 0.36, 0.055, 0.046),
    belt_EA_N=(12600.0, 12600.0, 12600.0),
    torque_constant=(0.0243, 0.0212),
    emf_constant=(0.0243, 0.0212),
)
RIGS = {
    "rig_a": dataclasses.replace(
        TRUE_RIG, stribeck_force=(3.0, 0.0, 0.0, 0.0), stribeck_velocity=(0.04, 0.05, 2.5, 2.5)
    ),
    "rig_b": TRUE_RIG,
}
RUNS, DURATION_S, SEED = 8, 2.5, 1
NOISE_M, STEP_M = 20e-6, 5e-6
COLUMNS = "time_s,v1_V,v2_V,phi1_rad,phi2_rad,x_m,y_m"

README = """# Example recordings

Eight runs of 2.5 s at 1 kHz of each of two H-frame stages of the same type, `rig_a` and `rig_b`. The
parameters of both differ from those of the machine file. One, both or none of them may also have an effect
that the machine file does not declare:

    hframe identify examples/rig_a --out out/rig_a
    hframe identify examples/rig_b --out out/rig_b

The recordings are simulated, but not by the simulator of `hframe_gym`. The simulator in
`tests/reference_simulator/` shares no code and no numerical method with it: friction is event-driven, with an
adaptive Runge-Kutta pair at tight tolerances between the events. `python -m tools.make_examples` writes the
recordings again, byte for byte with the same versions of NumPy and zlib. That script also defines what each
rig hides.

## Columns

| column | unit | quantity |
|---|---|---|
| `time_s` | s | clock of the session; the runs of a rig follow each other with pauses |
| `v1_V`, `v2_V` | V | commanded voltage of motor 1 and 2, held from its row until the next |
| `phi1_rad`, `phi2_rad` | rad | belt pulleys, measured by the motors' encoders in steps of 0.52 mrad |
| `x_m`, `y_m` | m | bridge and cart, measured by laser with white noise of 20 um std and steps of 5 um |

An encoder step at the belt pulley is 2 pi / (512 x 4 x 5.9): 512 lines, four edges, gear ratio 5.9.

A run starts at rest with 0.1 s at 0 V and unstretched belts: r phi1 = -x - y, r phi2 = x - y. Odd runs are
open loop (steps, square waves, slow ramps, chirps, multi-sines). Even runs are recorded under a simple
position controller with dither. The voltages stay within 8 V and the carriage within 0.25 m (x) and 0.16 m
(y) of the middle.
"""


def measure(positions: Array, rng: np.random.Generator) -> Array:
    """Add the noise and quantization of the examples' sensors.

    Args:
        positions: Coordinates x, y, phi1, phi2, m and rad, shape (n, 4).

    Returns:
        Measurements phi1, phi2, x, y, rad and m, shape (n, 4).
    """
    phi = np.round(positions[:, 2:] / ENCODER_STEP_RAD) * ENCODER_STEP_RAD
    noisy = positions[:, :2] + rng.normal(0.0, NOISE_M, (len(positions), 2))
    return np.hstack([phi, np.round(noisy / STEP_M) * STEP_M])


def encode(run: ExcitationRun, rng: np.random.Generator) -> bytes:
    """Return one run as the content of a .csv.gz file; the same run gives the same bytes."""
    lines = [COLUMNS]
    for t, volts, measured in zip(run.time_s, run.inputs, measure(run.positions, rng), strict=True):
        fields = [f"{t:.3f}", *(f"{v:.3f}" for v in volts), *(f"{o + 0.0:.6f}" for o in measured)]
        lines.append(",".join(fields))
    return gzip.compress(("\n".join(lines) + "\n").encode(), compresslevel=9, mtime=0)


def main() -> None:
    """Write the recordings and their README."""
    parser = command_line(__doc__)
    default = ROOT / "examples"
    parser.add_argument("--out", type=Path, default=default, help="folder (default: examples/)")
    folder: Path = parser.parse_args().out
    total = 0
    for number, (name, rig) in enumerate(RIGS.items()):
        (folder / name).mkdir(parents=True, exist_ok=True)
        rng = np.random.default_rng([SEED, number])
        for index, run in enumerate(record_runs(SEED, RUNS, DURATION_S, rig=rig), start=1):
            path = folder / name / f"run_{index:02d}.csv.gz"
            data = encode(run, rng)
            path.write_bytes(data)
            total += len(data)
            print(f"{path}: {len(run.time_s)} rows, {len(data) / 1024:.0f} kB", flush=True)
    (folder / "README.md").write_text(README, "utf-8")
    print(f"{folder / 'README.md'}; recordings together {total / 1024:.0f} kB")


if __name__ == "__main__":
    main()
