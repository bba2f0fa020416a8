"""Is a user with real logs ever worse off than with a plain fit? Public recordings of motors and axes.

    python -m benchmarks.public_axes                          # all whose recordings are there
    python -m benchmarks.public_axes --only odrive --log      # some of them; nothing is written

The recordings are those of $HFRAME_DATA/public_axes, a folder with ``runs`` for each set; for a set without
them, the benchmark says how to get and convert its logs. The machine file is that of a newcomer, in the
folder or in ``benchmarks/machines``. The error to beat is that of an inverse-dynamics fit, refined as an
output-error fit of inertia, viscous and dry friction and an offset, computed without this package on the same
held-out runs. No licenses permit shipping the recordings.
"""

from __future__ import annotations

import json
import sys
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.real_machines.study import MACHINES
from benchmarks.results_file import data_root, write_results
from benchmarks.timed_identification import timed_identification
from hframe_gym.identification.validate.machine_errors import ModelEvaluation
from hframe_gym.parallel import map_tasks
from hframe_gym.recordings import load_machine, load_recordings
from tools.command_line import add_rig_options, command_line


class PublicSet(NamedTuple):
    """A set of recordings.

    Attributes:
        machine: What was recorded.
        source: Where it was published.
        held_out: Runs to evaluate on; empty for the default.
        plain_error: Error of the fit to beat on these runs, in the unit of the sensor.
        file: Name of the machine file in ``benchmarks/machines``; empty if it is in the folder of the
            recordings.
        logs: Logs in the repository.
        options: Options of `hframe import` for them.
    """

    machine: str
    source: str
    held_out: tuple[str, ...]
    plain_error: float
    file: str = ""
    logs: str = ""
    options: str = ""

    def recipe(self, runs: Path) -> str:
        """Return how to get and convert the logs of the set; "" for a set that has no recipe."""
        if not self.file:
            return ""
        machine = f"benchmarks/machines/{self.file}.json"
        return (
            f"copy {self.logs} of github.com/{self.source} into a folder LOGS, and call: "
            f"hframe import LOGS --machine {machine} --out {runs} {self.options}"
        )


_LEFT_SIDE = "--map 'u_V=l voltage [V]' --map 'x_m=l position [m]'"
SETS = {
    "swerve": PublicSet("drive of a swerve robot", "Eaglestrike/2023-RobotCode", (), 0.0142),
    "odrive": PublicSet(
        "motor at an ODrive", "labmrd/odrive-with-motor-characterization", ("chirp4", "step4"), 0.73
    ),
    "measured_current": PublicSet("motor with measured current", "lvjonok/mujoco-sysid", ("traj_4",), 17.6),
    "l298": PublicSet(
        "geared motor at an L298N",
        "Piyushiitk24/dc-motor-signed-bias-deadzone-id-control",
        ("run_minimal_05", "run_minimal_07"),
        7.46,
    ),
    "frc_flywheel": PublicSet(
        "flywheel of an FRC robot",
        "calcmogul/SysIdOpt",
        (),
        29.3,
        "frc_flywheel",
        "sysid_data.json",
        "--map 'u_V=voltage [V]' --map 'angle_rad=position [rad]'",
    ),
    "frc_shooter": PublicSet(
        "shooter of an FRC robot",
        "STMARobotics/frc-7028-2022",
        (),
        10.0,
        "frc_shooter",
        "sysid/ShooterData/sysid_data20220309-190419.json",
        "--map 'u_V=voltage [V]' --map 'angle_rad=position [rev]'",
    ),
    "frc_drivetrain": PublicSet(
        "drivetrain of an FRC robot",
        "MiamiBeachBots/base-bot",
        (),
        0.103,
        "frc_drivetrain",
        "sysid_data.json",
        _LEFT_SIDE,
    ),
    "frc_drivetrain_2022": PublicSet(
        "drivetrain of an FRC robot",
        "STMARobotics/frc-7028-2022",
        (),
        0.186,
        "frc_drivetrain",
        "sysid/DrivetrainData/sysid_data20220317-195249.json",
        _LEFT_SIDE,
    ),
    "frc_drivetrain_2023": PublicSet(
        "drivetrain of an FRC robot",
        "STMARobotics/frc-7028-2023",
        (),
        0.611,
        "frc_drivetrain",
        "sysid/drivetrain/sysid_data20230221-172941.json",
        _LEFT_SIDE,
    ),
    "coarse_encoder": PublicSet(
        "geared motor in a position loop, encoder of 3.5 degrees",
        "gkeiel/dc_motor_position_control",
        (),
        0.590,
        "coarse_encoder",
        "the nine data*.csv, each named after its folder,",
        "--map 'u_V=Channel 4' --unit u_V=% --map 'angle_rad=Channel 2' "
        "--unit angle_rad=deg --map time_s=500Hz",
    ),
    "crane_trolley": PublicSet(
        "trolley of a crane, speed alone",
        "prj-phcp/SYSID_Atividades",
        (),
        0.0284,
        "crane_trolley",
        "Atividade05/matlab/Contsid/Contsid7_3/crane.mat",
        "--map u_V=u2 --map x_m_s=y2.1 --map time_s=100Hz --split-every 6",
    ),
}


def run_set(name: str, data: Path, *, log: bool = False) -> dict[str, Any]:
    """Identify one set.

    Args:
        log: Whether to print the progress of the identification, with the processor time.
    """
    public, folder = SETS[name], data / name
    file = MACHINES / f"{public.file}.json" if public.file else folder / "machine.json"
    declared = load_machine(str(file))
    recordings = load_recordings(folder / "runs", declared)
    result, seconds = timed_identification(recordings, declared, log=log, held_out=public.held_out)
    report = result.as_json()
    after = _error(result.after)
    return {
        "set": name,
        "machine": public.machine,
        "source": public.source,
        "unit": declared.sensor_unit(declared.sensors[0]),
        "held_out": [run.name for run in result.held_out.runs],
        "verdict": result.verdict,
        "named": [f"{e['name']}@{e['site']}" for e in report["effects"]],
        "hint": report["hint"],
        "unfinished": report["unfinished"],
        "errors": {
            "declared": _error(result.declared),
            "plain": None if result.plain is None else _error(result.plain.evaluation),
            "before": _error(result.before),
            "after": after,
            "reference": public.plain_error,
        },
        "plain_delivered": bool(result.plain and result.plain.delivered),
        "ratio": None if after is None else after / public.plain_error,
        "cpu_seconds": round(seconds["cpu"], 1),
    }


def _error(evaluation: ModelEvaluation) -> float | None:
    """Return the simulation error on the held-out runs, m or rad; None if the machine diverges."""
    (error,) = evaluation.held_out.channels.values()  # each of these machines has one sensor
    return error.rmse


def show(console: Console, rows: list[dict[str, Any]]) -> None:
    """Print the table of all sets."""
    stages = ("declared", "plain", "before", "after", "reference")
    table = Table("set", "verdict", "named", *stages, "ratio", "cpu s")
    for r in rows:
        errors = (
            "-" if r["errors"][stage] is None else f"{r['errors'][stage]:.3g} {r['unit']}" for stage in stages
        )
        ratio = "-" if r["ratio"] is None else f"{r['ratio']:.2f}"
        table.add_row(
            r["set"], r["verdict"], ", ".join(r["named"]), *errors, ratio, f"{r['cpu_seconds']:.0f}"
        )
    console.print(table)
    ratios = [np.inf if r["ratio"] is None else r["ratio"] for r in rows]
    console.print(
        f"error over that of the fit to beat: median {np.median(ratios):.2f}, largest {max(ratios):.2f}"
    )


def main() -> None:
    """Identify the sets that the command line names, print the table and write the results."""
    parser = command_line(__doc__)
    parser.add_argument("--only", nargs="+", metavar="SET", choices=tuple(SETS))
    add_rig_options(parser)
    arguments = parser.parse_args()
    data = data_root() / "public_axes"
    console, rows, names = Console(width=170), [], []
    for name in arguments.only or SETS:
        if (data / name / "runs").is_dir():
            names.append(name)
        else:
            print(f"skipped: no folder {data / name / 'runs'}. {SETS[name].recipe(data / name / 'runs')}")
    for row in map_tasks(partial(run_set, data=data, log=arguments.log), names, jobs=arguments.jobs):
        print(json.dumps(row), flush=True)
        rows.append(row)
    if not rows:
        sys.exit("no recordings in $HFRAME_DATA/public_axes")
    show(console, rows)
    if not arguments.only:
        write_results("public_axes", {"sets": rows}, seed=None)


if __name__ == "__main__":
    main()
