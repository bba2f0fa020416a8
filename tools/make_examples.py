"""Write the example recordings: ``python -m tools.make_examples``.

Two rigs of the same make, each logged for one session of identification runs: ``examples/rig_a``
has one effect that no machine file declares, ``examples/rig_b`` is its twin without it. Seeded: the
same files every time.
"""

from __future__ import annotations

import argparse
import dataclasses
import gzip
from pathlib import Path

import numpy as np

from tests.rigs.excitation import ENCODER_STEP_RAD, PreparedRecording, runs
from tests.rigs.rigs import Array, Rig

# What the rigs really are: every declared parameter 5 to 15 % away from the paper's, the motors
# unlike each other.
TRUTH = Rig(
    mass=(4.50, 0.96, 1.25e-4, 1.03e-4),
    viscous=(36.0, 32.0, 0.0040, 0.0033),
    coulomb=(2.25, 0.36, 0.055, 0.046),
    belt_EA_N=(12600.0, 12600.0, 12600.0),
    torque_constant=(0.0243, 0.0212),
    emf_constant=(0.0243, 0.0212),
)
RIGS = {
    "rig_a": dataclasses.replace(
        TRUTH,
        stribeck_force=(3.0, 0.0, 0.0, 0.0),
        stribeck_velocity=(0.04, 0.05, 2.5, 2.5),
    ),
    "rig_b": TRUTH,
}
RUNS, DURATION_S, SEED = 8, 2.5, 1
NOISE_M, STEP_M = 20e-6, 5e-6
COLUMNS = "time_s,v1_V,v2_V,phi1_rad,phi2_rad,x_m,y_m"

README = """# Example recordings

Two H-frame stages of the same make, `rig_a` and `rig_b`, eight runs of 2.5 s each at 1 kHz. Neither
is quite what its machine file says. One of them, or both, or none, may do something that the
machine file has no word for:

    hframe identify examples/rig_a --out out/rig_a
    hframe identify examples/rig_b --out out/rig_b

The recordings are simulated, but not by the simulator in `hframe_gym`: `benchmarks/reference/` is
a separate one, which shares no code and no numerical method with it (friction event by event, and an
adaptive Runge-Kutta pair at tight tolerances in between). `python -m tools.make_examples` writes
them again, byte for byte with the same versions of NumPy and zlib; what each rig hides stands in that
script, and nowhere here.

## Columns

| column | unit | what |
|---|---|---|
| `time_s` | s | the session's clock; the runs of a rig follow each other with pauses |
| `v1_V`, `v2_V` | V | commanded voltage of motor 1 and 2, held from its row until the next |
| `phi1_rad`, `phi2_rad` | rad | belt pulleys by the motors' encoders, steps of 0.52 mrad |
| `x_m`, `y_m` | m | bridge and cart by laser, white noise of 20 um std, steps of 5 um |

An encoder step is 2 pi / (512 x 4 x 5.9) at the belt pulley: 512 lines, four edges, gear 5.9:1.

A run starts at rest with 0.1 s at 0 V, its belts unstretched: r phi1 = -x - y, r phi2 = x - y.
Odd runs are open loop (steps, square waves, slow ramps, chirps, multi-sines), even runs are logged
under a crude position controller with dither; the voltages stay within 8 V and the carriage within
0.25 m (x) and 0.16 m (y) of the middle.
"""


def measure(positions: Array, rng: np.random.Generator) -> Array:
    """What the sensors of a rig read, (n, 4): phi1, phi2 [rad], x, y [m]; from x, y, phi1, phi2."""
    phi = np.round(positions[:, 2:] / ENCODER_STEP_RAD) * ENCODER_STEP_RAD
    noisy = positions[:, :2] + rng.normal(0.0, NOISE_M, (len(positions), 2))
    return np.hstack([phi, np.round(noisy / STEP_M) * STEP_M])


def recording(run: PreparedRecording, rng: np.random.Generator) -> bytes:
    """One run as the bytes of a .csv.gz, the same bytes for the same run."""
    lines = [COLUMNS]
    for t, volts, read in zip(run.time_s, run.inputs, measure(run.positions, rng), strict=True):
        fields = [f"{t:.3f}", *(f"{v:.3f}" for v in volts), *(f"{o + 0.0:.6f}" for o in read)]
        lines.append(",".join(fields))
    return gzip.compress(("\n".join(lines) + "\n").encode(), compresslevel=9, mtime=0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    default = Path(__file__).resolve().parents[1] / "examples"
    parser.add_argument("--out", type=Path, default=default, help="folder (default: examples/)")
    folder: Path = parser.parse_args().out
    total = 0
    for number, (name, rig) in enumerate(RIGS.items()):
        (folder / name).mkdir(parents=True, exist_ok=True)
        rng = np.random.default_rng([SEED, number])
        for index, run in enumerate(runs(SEED, RUNS, DURATION_S, rig=rig), start=1):
            path = folder / name / f"run_{index:02d}.csv.gz"
            data = recording(run, rng)
            path.write_bytes(data)
            total += len(data)
            print(f"{path}: {len(run.time_s)} rows, {len(data) / 1024:.0f} kB", flush=True)
    (folder / "README.md").write_text(README)
    print(f"{folder / 'README.md'}; recordings together {total / 1024:.0f} kB")


if __name__ == "__main__":
    main()
