"""C and Structured Text compute what the equations of motion do, and the simulator follows feedforward."""

from __future__ import annotations

import dataclasses
import math
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hframe_gym.dynamics import Equations, simulate
from hframe_gym.dynamics.physics.parameterized_machine import MotionPoint
from hframe_gym.effects import EFFECTS
from hframe_gym.errors import InputError
from hframe_gym.exporters import EXPORTERS
from hframe_gym.exporters.c_source import TOLERANCE
from hframe_gym.exporters.source.inverse_dynamics import InverseDynamics
from hframe_gym.exporters.source.motion_formulas import motion_formulas
from hframe_gym.machine import Machine
from hframe_gym.recordings import load_machine
from tests.effects.one_of_each import CASES

# Effects that the formulas contain: forces, dry and viscous friction, amplifiers, and structures.
CONTAINED = (
    *(
        "stribeck_friction",
        "tustin_friction",
        "constant_force",
        "asymmetric_viscous",
        "quadratic_drag",
        "cable_spring",
    ),
    *(
        "position_friction",
        "friction_slope",
        "friction_warm_up",
        "cogging",
        "unbalance",
        "voltage_offset",
        "gain_mismatch",
    ),
    *("dead_band", "bridge_yaw", "frame_resonance", "idler_inertia", "payload_swing"),
)


@pytest.fixture(scope="module")
def compiler() -> str:
    found = shutil.which("gcc") or shutil.which("cc")
    if found is None:
        pytest.skip("no C compiler (gcc or cc) is installed")
    return found


def identified(machine: Machine) -> Machine:
    """Return a machine with many effects of different kinds, as an identification may find them."""
    return machine.with_effects(
        *(
            CASES[name].effect
            for name in ("stribeck_friction", "cogging", "asymmetric_viscous", "friction_warm_up")
        ),
        EFFECTS["gain_mismatch"].at("motor1", g=0.1),
        EFFECTS["dead_band"].at("motor1", Vd=0.3, drop=1.0),
        EFFECTS["voltage_offset"].at("motor1", V0=0.2),
    )


@pytest.mark.filterwarnings("ignore:textbook-pid is unstable")
@pytest.mark.parametrize("name", ["hframe", "axis", "corexy", "hframe-order20", "identified"])
def test_the_test_bench_compiles_without_a_warning_and_agrees(
    name: str, compiler: str, tmp_path: Path
) -> None:
    machine = identified(load_machine("hframe")) if name == "identified" else load_machine(name)
    EXPORTERS.get("c")(machine=machine, prefix="my_stage").write(tmp_path)  # type: ignore[call-arg]
    options = ["-Wall", "-Wextra", "-Werror", "-std=c99"]
    sources = ["my_stage.c", "my_stage_test.c"]
    subprocess.run([compiler, *options, *sources, "-o", "bench", "-lm"], cwd=tmp_path, check=True)
    result = subprocess.run([tmp_path / "bench"], capture_output=True, text=True)
    assert result.returncode == 0, result.stdout
    errors = [float(line.rpartition(" ")[2]) for line in result.stdout.splitlines()]
    assert len(errors) == len(motion_formulas(machine, 0.01).formulas)
    assert max(errors) < TOLERANCE


def test_the_test_bench_notices_a_wrong_parameter(compiler: str, tmp_path: Path, hframe: Machine) -> None:
    EXPORTERS.get("c")(machine=hframe).write(tmp_path)  # type: ignore[call-arg]
    source = tmp_path / "stage.c"
    source.write_text(source.read_text().replace("p_x_mass = 4.07;", "p_x_mass = 4.0700001;"))
    subprocess.run(
        [compiler, "-std=c99", "stage.c", "stage_test.c", "-o", "bench", "-lm"], cwd=tmp_path, check=True
    )
    assert subprocess.run([tmp_path / "bench"], capture_output=True).returncode == 1


@pytest.mark.parametrize("name", CONTAINED)
def test_the_feedforward_gives_the_acceleration_in_the_equations_of_motion(
    name: str, hframe: Machine
) -> None:
    """Newton's law with the commanded voltages, projected on the axes: the belts' forces cancel."""
    machine = hframe.with_effects(CASES[name].effect)
    dynamics = InverseDynamics(machine)
    assert dynamics.left_out == ()
    rng = np.random.default_rng(0)
    equations = Equations(machine)
    for _ in range(20):
        t, p, v, a = 20.0 * rng.random(), *(rng.uniform(-1.0, 1.0, (3, 2)) * [[0.1], [0.4], [2.0]])
        total, _ = dynamics.coordinate_forces(None, t, p.tolist(), v.tolist(), a.tolist())
        commands = dynamics.commands(dynamics.motor_voltages(None, total), dynamics.command)
        point = MotionPoint([*(dynamics.rigid @ p)], [*(dynamics.rigid @ v)], t)
        net = np.array([float(f) for f in equations.net_forces(point, commands)])
        masses = np.array([equations.mass(i) for i in range(len(net))])
        expected = dynamics.rigid.T @ (masses * (dynamics.rigid @ a))
        np.testing.assert_allclose(dynamics.rigid.T @ net, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.integration
@pytest.mark.parametrize("effects", [(), ("stribeck_friction", "cogging", "quadratic_drag")])
def test_the_simulated_tool_follows_the_feedforward(effects: tuple[str, ...], hframe: Machine) -> None:
    """With belts a hundred times stiffer, the simulator's tool stays on its path without any feedback."""
    machine = hframe.replace({f"{b.name}.EA": 100.0 * b.EA for b in hframe.belts})
    machine = machine.with_effects(*(CASES[name].effect for name in effects))
    dynamics = InverseDynamics(machine)
    period, seconds = 1e-3, 0.6
    time_s = np.arange(round(seconds / period) + 1) * period

    def plan(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        s = t / seconds
        shape = (
            10 * s**3 - 15 * s**4 + 6 * s**5,
            30 * s**2 - 60 * s**3 + 30 * s**4,
            60 * s - 180 * s**2 + 120 * s**3,
        )
        way = np.array([0.15, -0.1])
        return tuple(np.outer(u / seconds**k, way) for k, u in enumerate(shape))  # type: ignore[return-value]

    middle = time_s + 0.5 * period  # the voltage is held from one sample to the next
    inputs = []
    for t, p, v, a in zip(middle, *plan(np.minimum(middle, seconds)), strict=True):
        total, _ = dynamics.coordinate_forces(None, t, p.tolist(), v.tolist(), a.tolist())
        inputs.append(dynamics.commands(dynamics.motor_voltages(None, total), dynamics.command))
    tool = simulate(machine, time_s, np.array(inputs)).positions[:, :2]
    assert np.abs(tool - plan(time_s)[0]).max() < 1e-3  # of 150 mm


def test_the_motor_reference_stretches_the_belts_to_the_needed_force(hframe: Machine) -> None:
    dynamics = InverseDynamics(hframe)
    equations = Equations(hframe)
    p, v, a = [0.1, -0.05], [0.3, -0.2], [2.0, 1.0]
    total, _ = dynamics.coordinate_forces(None, 0.0, p, v, a)
    motors = dynamics.motor_reference(None, p, total)
    point = equations.point(np.array([*p, *motors]))
    forces = equations.belt_forces(point, equations.belt_states(point))
    # The stretch is determined with the stiffness at the tool's position; its change with the stretch is
    # second order.
    assert [float(f) for f in forces[:2]] == pytest.approx([total[0], total[1]], rel=0.01)


def test_a_dead_band_is_left_by_the_smallest_command(hframe: Machine) -> None:
    machine = hframe.with_effects(EFFECTS["dead_band"].at("motor1", Vd=0.5, drop=1.0))
    dynamics = InverseDynamics(machine)
    assert dynamics.command(0, 0.0) == 0.0
    assert dynamics.command(0, 1.0) == pytest.approx(1.5)
    assert dynamics.command(0, -1.0) == pytest.approx(-1.5)
    assert dynamics.command(0, 100.0) == 12.0  # the limit of the drive


def test_effects_with_a_memory_are_named(hframe: Machine) -> None:
    machine = hframe.with_effects(*(CASES[n].effect for n in ("presliding", "load_friction", "input_delay")))
    text = str(EXPORTERS.get("c")(machine=machine).files(machine)["stage.c"])  # type: ignore[call-arg, attr-defined]
    assert "Effects that are not contained: presliding@x, load_friction@motor1, input_delay@drives." in text


def test_a_machine_without_one_drive_per_axis_is_refused(hframe: Machine) -> None:
    machine = dataclasses.replace(hframe, drives=hframe.drives[:1])
    with pytest.raises(InputError, match="one drive per axis; it has 2 axes and 1 drives"):
        motion_formulas(machine, 0.01)


# -- Structured Text -----------------------------------------------------------------------------------------


def interpreter(text: str) -> dict[str, Callable[..., Any]]:
    """Translate Structured Text, as exported, to Python functions; blocks return dictionaries."""
    text = re.sub(r"\(\*.*?\*\)", "", text, flags=re.DOTALL)
    library: dict[str, Any] = {
        "SEL": lambda g, no, yes: yes if g else no,
        "ABS": abs,
        "MIN": min,
        "MAX": max,
        "EXP": math.exp,
        "SIN": math.sin,
        "COS": math.cos,
        "SQRT": math.sqrt,
        "TRUNC": math.trunc,
    }
    for kind, name, result, block in re.findall(
        r"^(FUNCTION(?:_BLOCK)?) (\w+)( : LREAL)?\n(.*?)^END_\1", text, flags=re.DOTALL | re.MULTILINE
    ):
        inputs: list[str] = []
        fixed: list[str] = []
        outputs: list[str] = []
        for section, body in re.findall(r"(?ms)^(VAR\w*(?: CONSTANT)?)\n(.*?)^END_VAR", block):
            for variable, of in re.findall(r"(\w+) : ([^;]+);", body):
                value = of.partition(":=")[2].strip() or ("[0.0] * 2" if "ARRAY" in of else "0.0")
                if section == "VAR_INPUT":
                    inputs.append(variable)
                elif section == "VAR" and kind == "FUNCTION_BLOCK":
                    inputs.append(variable)
                    outputs.append(variable)
                else:
                    fixed.append(f"{variable} = {value}")
                if section == "VAR_OUTPUT":
                    outputs.append(variable)
        statements = re.sub(r"^VAR.*?^END_VAR\n", "", block, flags=re.DOTALL | re.MULTILINE)
        lines, depth = [], 1
        for line in map(str.strip, statements.splitlines()):
            if line in ("END_IF;", "END_FOR;", "ELSE"):
                depth -= 1
            if line in ("END_IF;", "END_FOR;", ""):
                continue
            line = re.sub(r"^FOR (\w+) := (\d+) TO (\d+) DO$", r"for \1 in range(\2, \3 + 1):", line)
            line = re.sub(r"^IF (.*) THEN$", r"if \1:", line).replace("ELSE", "else:")
            line = re.sub(r"(?<![:<>=])=(?!=)", "==", line) if ":=" in line else line
            line = (
                line.replace("<>", "!=")
                .replace(" AND ", " and ")
                .replace(" OR ", " or ")
                .replace(":==", ":=")
            )
            line = re.sub(rf"^{name} := ", "return ", line).replace(" := ", " = ").rstrip(";")
            lines.append("    " * depth + line)
            depth += line.endswith(":")
        if not result:
            lines.append(f"    return {{{', '.join(f'{o!r}: {o}' for o in outputs)}}}")
        source = "\n".join([f"def {name}({', '.join(inputs)}):", *(f"    {line}" for line in fixed), *lines])
        exec(source, library)
    return library


@pytest.mark.filterwarnings("ignore:textbook-pid is unstable")
@pytest.mark.parametrize("name", ["hframe", "axis", "identified"])
def test_structured_text_agrees(name: str) -> None:
    machine = identified(load_machine("hframe")) if name == "identified" else load_machine(name)
    exporter = EXPORTERS.get("st")(machine=machine)  # type: ignore[call-arg]
    functions = interpreter(exporter.files(machine)["stage.st"])  # type: ignore[attr-defined]
    motion = motion_formulas(machine, 0.01)
    for formula in motion.formulas:
        vectors = motion.vectors(formula, 60, seed=3)
        stored: dict[str, Any] = {s.name: [0.0] * s.size for s in formula.states}
        largest = np.abs(vectors.outputs).max()
        for row, expected in zip(vectors.inputs.tolist(), vectors.outputs.tolist(), strict=True):
            arguments: dict[str, Any] = {}
            for signal in formula.inputs:
                if signal.name not in stored:
                    arguments[signal.name] = row[: signal.size] if signal.size else row[0]
                    row = row[signal.size or 1 :]
            results = functions[f"stage_{formula.name}"](**arguments, **stored)
            stored = {key: results[key] for key in stored}
            [found] = [results[s.name] for s in formula.outputs if s.name not in stored]
            np.testing.assert_allclose(
                found[: len(expected)], expected, rtol=TOLERANCE, atol=1e-3 * TOLERANCE * largest
            )


def test_effects_use_the_helper_functions_of_structured_text(hframe: Machine) -> None:
    text = EXPORTERS.get("st")(machine=hframe).files(hframe)["stage.st"]  # type: ignore[call-arg, attr-defined]
    assert "FUNCTION stage_sign : LREAL" in text
    body = text[text.index("*)") :]
    assert not re.search(r"(?<![\d.])\d+[eE][+-]?\d", body), "a literal lacks its decimal point"
