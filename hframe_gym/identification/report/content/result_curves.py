"""Curves of a result that the report draws: held-out runs with errors, missing force, and covered states."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from ....arrays import Array


@dataclass(frozen=True)
class RunCurves:
    """A held-out run, which was not fitted, with the errors of the machines on it.

    Attributes:
        time_s: Sample times, s, shape (n,).
        measured: Measurements minus the sensors' zeros, in the sensors' units, shape (n, sensors).
        errors: Measured minus simulated values, in the sensors' units, shape (n, sensors), of the "declared",
            the refitted ("before") and the corrected ("after") machine, and of the "plain" fit, if there is
            one.
        inputs: Inputs, in the drives' units, shape (n, drives); None in results of older versions.
    """

    time_s: Array
    measured: Array
    errors: dict[str, Array]
    inputs: Array | None = None


@dataclass(frozen=True)
class MissingForce:
    """Force that would have to act in addition for a machine to follow the measurements, in the fitted runs.

    Attributes:
        variable: Values of the variable on which the force depends most, such as a position, SI, shape (m,).
        by_machine: Force that the refitted ("before") and the corrected ("after") machine lack, on the
            coordinate that shows this dependence, N or Nm, shape (m,).
    """

    variable: Array
    by_machine: dict[str, Array]


@dataclass(frozen=True)
class ResultCurves:
    """Curves of a result.

    Those of the fitted runs are thinned: every k-th row of all runs, one after the other, m rows.

    Attributes:
        runs: Held-out runs by name.
        missing_force: Missing force of the fitted runs; None if it depends on no variable.
        coverage: Where the fitted runs have been, SI, shape (m,), by name: an input channel, or "position of
            C" or "velocity of C" for each linear coordinate C; on a machine without linear coordinates, for
            each coordinate.
    """

    runs: dict[str, RunCurves]
    missing_force: MissingForce | None
    coverage: dict[str, Array]

    def as_arrays(self) -> dict[str, Array]:
        """Return the arrays of evidence.npz by name, SI, shape (n,), (n, sensors), (n, drives) or (m,).

        They are RUN/time_s, RUN/measured, RUN/inputs and RUN/MACHINE of each held-out run; force/variable and
        force/MACHINE of the missing force; and coverage/NAME.
        """
        arrays: dict[str, Array] = {}
        for name, run in self.runs.items():
            arrays |= {f"{name}/time_s": run.time_s, f"{name}/measured": run.measured}
            if run.inputs is not None:
                arrays[f"{name}/inputs"] = run.inputs
            arrays |= {f"{name}/{machine}": error for machine, error in run.errors.items()}
        if self.missing_force:
            arrays["force/variable"] = self.missing_force.variable
            arrays |= {f"force/{machine}": f for machine, f in self.missing_force.by_machine.items()}
        return arrays | {f"coverage/{name}": values for name, values in self.coverage.items()}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Array], runs: Iterable[str]) -> ResultCurves:
        """Return the curves that evidence.npz holds, the inverse of `as_arrays`.

        Args:
            arrays: Arrays by the names of `as_arrays`, SI, shape (n,), (n, sensors), (n, drives) or (m,).
            runs: Names of the held-out runs.
        """
        force = None
        if "force/variable" in arrays:
            by_machine = {machine: arrays[f"force/{machine}"] for machine in ("before", "after")}
            force = MissingForce(arrays["force/variable"], by_machine)
        covered = (name for name in arrays if name.startswith("coverage/"))
        return cls(
            {
                run: RunCurves(
                    arrays[f"{run}/time_s"],
                    arrays[f"{run}/measured"],
                    {
                        machine: arrays[f"{run}/{machine}"]
                        for machine in ("declared", "before", "after", "plain")
                        if f"{run}/{machine}" in arrays
                    },
                    arrays.get(f"{run}/inputs"),
                )
                for run in runs
            },
            force,
            {name.removeprefix("coverage/"): arrays[name] for name in covered},
        )
