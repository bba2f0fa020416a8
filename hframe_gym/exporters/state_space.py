"""Linear state-space model and modes of a machine at an operating point, for MATLAB and python-control."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import Any

import numpy as np
from typing_extensions import override

from ..machine import Machine, rest_positions_per_axis
from .base import EXPORTERS, Files, MachineExporter, commented, json_text, operating_point, option, plain
from .models.linear_model import LinearModel, Mode, linear_model, modes


@EXPORTERS.register("state-space")
@dataclass(frozen=True, kw_only=True)
class StateSpaceExporter(MachineExporter):
    """Write the linear model x' = A x + B u, y = C x + D u at an operating point, and its modes with damping.

    The files are state_space.mat (MATLAB, SciPy), state_space.json (its entries A, B, C, D, states, inputs,
    outputs are arguments of control.ss in python-control), state_space.csv (one labeled table) and modes.csv.
    States are positions and velocities of all coordinates, SI; inputs are the commands of the drives. Dry
    friction is left out; delays are stated. A drive that follows a set point is linear about it, and the
    integral of its loop keeps its value.

    Example:  hframe export state-space --machine hframe --at x=0.1 --out out/state_space
    """

    at: list[str] | None = option(
        None, "Operating point as AXIS=POSITION, for example x=0.1; repeat for more axes."
    )

    @override
    def files(self, machine: Machine) -> Files:
        """Write the matrices as state_space.json, .mat and .csv, and the modes as modes.csv."""
        position = operating_point(machine, self.at)
        model = linear_model(machine, position)
        found = modes(model.A, machine.travel_per_unit, rest_positions_per_axis(machine))
        point = ", ".join(
            f"{n} = {q!r}" for n, q in zip(machine.coordinate_names, position.tolist(), strict=True)
        )
        units = (
            "Units: SI; positions m or rad, velocities m/s or rad/s, inputs V; deviations from rest at the "
            f"operating point {point}",
            "Coulomb friction is not part of the model. Back-EMF is.",
            "Effects left out because they have no linear model at rest: "
            f"{', '.join(model.left_out) or 'none'}",
            f"Delays that come on top, s: inputs {model.input_delays.tolist()}, "
            f"outputs {model.output_delays.tolist()}",
        )
        header = self.header(machine, *units)
        return {
            "state_space.json": json_text(self._json(machine, model, position, found)),
            "state_space.mat": _mat(model, position, found, machine, "\n".join(header)),
            "state_space.csv": commented(header, "#") + _table(model),
            "modes.csv": commented(header, "#") + _mode_table(machine, found),
        }

    def _json(self, machine: Machine, model: LinearModel, position: Any, found: list[Mode]) -> dict[str, Any]:
        """Return the content of the JSON file."""
        return {
            "provenance": self.provenance(machine),
            "name": machine.name,
            "operating_point": dict(zip(machine.coordinate_names, position.tolist(), strict=True)),
            **model._asdict(),
            "input_units": [machine.command_unit(drive) for drive in machine.drives],
            "modes": [
                {
                    "eigenvalue_1_s": [m.eigenvalue.real, m.eigenvalue.imag],
                    "frequency_Hz": m.frequency,
                    "damping_ratio": m.damping,
                    "shape_m": {
                        name: [s.real, s.imag]
                        for name, s in zip(machine.coordinate_names, m.shape, strict=True)
                    },
                }
                for m in found
            ],
        }


def _table(model: LinearModel) -> str:
    """Return [A B; C D] as CSV; a row is the derivative of a state or an output."""
    columns = [f"{n} [{u}]" for n, u in zip(model.states, model.state_units, strict=True)]
    lines = [["", *columns, *(f"{name} [V]" for name in model.inputs)]]
    names = [f"d/dt {name} [{unit}/s]" for name, unit in zip(model.states, model.state_units, strict=True)]
    names += [f"{name} [{unit}]" for name, unit in zip(model.outputs, model.output_units, strict=True)]
    values = np.block([[model.A, model.B], [model.C, model.D]])
    lines += [[name, *map(repr, row)] for name, row in zip(names, values.tolist(), strict=True)]
    return "".join(",".join(_cell(cell) for cell in line) + "\n" for line in lines)


def _mode_table(machine: Machine, found: list[Mode]) -> str:
    """Return the modes as CSV; shapes in belt travel, relative to the largest, as magnitude and phase."""
    names = machine.coordinate_names
    head = ["mode", "frequency_Hz", "damping_ratio", "eigenvalue_real_1_s", "eigenvalue_imag_rad_s"]
    head += [f"{name}_{part}" for name in names for part in ("magnitude", "phase_deg")]
    lines = [head]
    for number, mode in enumerate(found, 1):
        values = [mode.frequency, mode.damping, mode.eigenvalue.real, mode.eigenvalue.imag]
        for displacement in mode.shape:
            values += [float(np.abs(displacement)), float(np.degrees(np.angle(displacement)))]
        lines.append([str(number), *map(repr, values)])
    return "".join(",".join(_cell(cell) for cell in line) + "\n" for line in lines)


def _cell(text: str) -> str:
    """Return a cell of a CSV file; names come from a machine file."""
    return '"' + plain(text).replace('"', "'") + '"' if set(text) & set(',"\n') else plain(text)


def _mat(model: LinearModel, position: Any, found: list[Mode], machine: Machine, provenance: str) -> bytes:
    """Return the content of the MATLAB file (version 5)."""
    from scipy.io import savemat

    names = {
        key: np.array(getattr(model, key), dtype=object).reshape(-1, 1)
        for key in ("states", "state_units", "inputs", "outputs", "output_units")
    }
    content = {
        **{key: getattr(model, key) for key in "ABCD"},
        "bias": model.bias.reshape(-1, 1),
        **names,
        "operating_point": np.reshape(position, (-1, 1)),
        "coordinates": np.array(machine.coordinate_names, dtype=object).reshape(-1, 1),
        "input_delays_s": model.input_delays.reshape(-1, 1),
        "output_delays_s": model.output_delays.reshape(-1, 1),
        "mode_eigenvalues": np.array([[m.eigenvalue] for m in found]),
        "mode_frequencies_Hz": np.array([[m.frequency] for m in found]),
        "mode_damping_ratios": np.array([[m.damping] for m in found]),
        "mode_shapes": np.array([m.shape for m in found]).T,
        "provenance": provenance,
    }
    buffer = io.BytesIO()
    savemat(buffer, content)
    # The first 116 bytes are a text with the date, which would make equal exports differ.
    text = b"MATLAB 5.0 MAT-file, written by hframe_gym".ljust(116)
    return text + buffer.getvalue()[116:]
