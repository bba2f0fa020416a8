"""The exported FMU is valid and moves like the simulator, to rounding: by its equations and integrator."""

from __future__ import annotations

import ctypes
import io
import shutil
import subprocess
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from hframe_gym.dynamics import simulate
from hframe_gym.errors import InputError
from hframe_gym.exporters import EXPORTERS
from hframe_gym.machine import Machine, rest_state
from hframe_gym.recordings import load_machine
from tests.effects.one_of_each import CASES

# What the header of the FMI standard defines; an importer brings it along.
HEADER = """
#ifndef fmi3Functions_h
#define fmi3Functions_h
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#define fmi3Version "3.0"
#define fmi3True true
#define fmi3False false
typedef void *fmi3Instance, *fmi3InstanceEnvironment, *fmi3FMUState;
typedef uint32_t fmi3ValueReference;
typedef float fmi3Float32; typedef double fmi3Float64; typedef bool fmi3Boolean, fmi3Clock;
typedef int8_t fmi3Int8; typedef uint8_t fmi3UInt8, fmi3Byte;
typedef int16_t fmi3Int16; typedef uint16_t fmi3UInt16;
typedef int32_t fmi3Int32; typedef uint32_t fmi3UInt32;
typedef int64_t fmi3Int64; typedef uint64_t fmi3UInt64;
typedef char fmi3Char; typedef const fmi3Char *fmi3String; typedef const fmi3Byte *fmi3Binary;
typedef enum {fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal} fmi3Status;
typedef enum {fmi3Independent, fmi3Constant} fmi3DependencyKind;
typedef enum {fmi3IntervalNotYetKnown, fmi3IntervalUnchanged, fmi3IntervalChanged} fmi3IntervalQualifier;
typedef void (*fmi3LogMessageCallback)(fmi3InstanceEnvironment, fmi3Status, fmi3String, fmi3String);
typedef void (*fmi3ClockUpdateCallback)(fmi3InstanceEnvironment);
typedef void (*fmi3IntermediateUpdateCallback)(fmi3InstanceEnvironment);
typedef void (*fmi3LockPreemptionCallback)(void); typedef void (*fmi3UnlockPreemptionCallback)(void);
#endif
"""
OPTIONS = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
SAMPLE, ROWS = 1e-3, 301


def exported(machine: Machine) -> bytes:
    files = EXPORTERS.get("fmu")(machine=machine).files(machine)  # type: ignore[call-arg, attr-defined]
    return bytes(files["stage.fmu"])


def voltages(machine: Machine) -> np.ndarray:
    """Return random voltages, V, held for 20 ms, shape (ROWS, drives)."""
    rated = np.array([d.rated_voltage for d in machine.drives])
    levels = np.random.default_rng(1).uniform(-0.25, 0.25, (ROWS // 20 + 1, len(rated))) * rated
    return np.repeat(levels, 20, axis=0)[:ROWS]


def outputs_of_library(library: ctypes.CDLL, machine: Machine, token: str, start: list[float]) -> np.ndarray:
    """Simulate with a compiled FMU, as an importer does; return its outputs, shape (ROWS, sensors)."""
    library.fmi3InstantiateCoSimulation.restype = ctypes.c_void_p
    nothing = [None] * 4
    create = library.fmi3InstantiateCoSimulation
    assert create(b"a", b"another machine", None, 0, 0, 0, 0, None, ctypes.c_size_t(0), *nothing[:3]) is None
    stage = ctypes.c_void_p(
        create(b"a", token.encode(), None, 0, 0, 0, 0, None, ctypes.c_size_t(0), *nothing[:3])
    )
    double = ctypes.c_double

    def exchange(function: str, first: int, values: list[float]) -> list[float]:
        count = len(values)
        references = (ctypes.c_uint32 * count)(*range(first, first + count))
        array = (double * count)(*values)
        size = ctypes.c_size_t(count)
        assert getattr(library, function)(stage, references, size, array, size) == 0
        return list(array)

    flags = [ctypes.byref(ctypes.c_bool()) for _ in range(3)]
    exchange("fmi3SetFloat64", 2001, start)
    library.fmi3EnterInitializationMode(stage, 0, double(0.0), double(0.0), 0, double(0.0))
    library.fmi3ExitInitializationMode(stage)
    none = [0.0] * len(machine.sensors)
    rows = [exchange("fmi3GetFloat64", 1001, none)]
    for row, volts in enumerate(voltages(machine)[:-1]):
        exchange("fmi3SetFloat64", 1, volts.tolist())
        step = library.fmi3DoStep
        assert step(stage, double(row * SAMPLE), double(SAMPLE), 1, *flags, ctypes.byref(double())) == 0
        rows.append(exchange("fmi3GetFloat64", 1001, none))
    assert exchange("fmi3GetFloat64", 0, [0.0]) == pytest.approx([(ROWS - 1) * SAMPLE])
    library.fmi3FreeInstance(stage)
    return np.array(rows)


@pytest.mark.parametrize(
    "name",
    [
        *("hframe", "axis", "corexy", "hframe-order20", "stribeck_friction", "presliding", "supply_sag"),
        *("belt_slack", "frame_resonance", "load_friction", "dead_band"),
    ],
)
def test_the_source_moves_like_the_simulator(name: str, tmp_path: Path) -> None:
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler (gcc or cc) is installed")
    machine = load_machine("hframe").with_effects(CASES[name].effect) if name in CASES else load_machine(name)
    zipfile.ZipFile(io.BytesIO(exported(machine))).extractall(tmp_path)
    sources = tmp_path / "sources"
    (sources / "fmi3Functions.h").write_text(HEADER)
    command = [compiler, *OPTIONS, "fmi3.c", "model.c", "-o", "stage.so", "-lm"]
    subprocess.run(command, cwd=sources, check=True)
    token = str(ElementTree.parse(tmp_path / "modelDescription.xml").getroot().get("instantiationToken"))
    start = [0.05, -0.03][: len(machine.tool_axes)]
    found = outputs_of_library(ctypes.CDLL(str(sources / "stage.so")), machine, token, start)
    linear = {c.name: 0.0 for c in machine.coordinates if c.kind == "linear"}
    linear |= dict(zip(machine.tool_axes, start, strict=True))
    initial = rest_state(machine, list(linear.values()))
    expected = simulate(machine, SAMPLE * np.arange(ROWS), voltages(machine), initial).outputs
    assert np.abs(expected - expected[0]).max() > 1e-3
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_fmpy_finds_no_problem_and_simulates_the_same(tmp_path: Path, hframe: Machine) -> None:
    fmpy = pytest.importorskip("fmpy", reason="needs FMPy: pip install '.[fmu]'")
    build = pytest.importorskip("fmpy.build")
    validation = pytest.importorskip("fmpy.validation")
    if shutil.which("cmake") is None:
        pytest.skip("FMPy compiles with cmake, which is not installed")
    (tmp_path / "stage.fmu").write_bytes(exported(hframe))
    assert validation.validate_fmu(str(tmp_path / "stage.fmu")) == []
    zipfile.ZipFile(tmp_path / "stage.fmu").extractall(tmp_path / "unzipped")
    (tmp_path / "build").mkdir()
    build.build_platform_binary(tmp_path / "unzipped", tmp_path / "build")
    names = ["time", *hframe.input_channels]
    table = np.column_stack([SAMPLE * np.arange(ROWS), voltages(hframe)])
    inputs = np.array([tuple(row) for row in table], dtype=[(name, float) for name in names])
    result = fmpy.simulate_fmu(
        str(tmp_path / "unzipped"),
        input=inputs,
        output=list(hframe.output_channels),
        stop_time=(ROWS - 1) * SAMPLE,
        output_interval=SAMPLE,
    )
    found = np.column_stack([result[channel] for channel in hframe.output_channels])
    expected = simulate(hframe, SAMPLE * np.arange(ROWS), voltages(hframe)).outputs
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


def test_equal_machines_give_equal_archives_and_variables_have_the_names_of_channels(hframe: Machine) -> None:
    archive = exported(hframe)
    assert archive == exported(hframe)
    with zipfile.ZipFile(io.BytesIO(archive)) as file:
        root = ElementTree.fromstring(file.read("modelDescription.xml"))
    names = {
        kind: [v.get("name") for v in root.iter("Float64") if v.get("causality") == kind]
        for kind in ("input", "output", "parameter")
    }
    assert names["input"] == list(hframe.input_channels)
    assert names["output"] == list(hframe.output_channels)
    assert names["parameter"] == ["start_x", "start_y"]
    assert "hframe_gym" in str(root.get("generationTool"))


@pytest.mark.parametrize("name", ["input_delay", "sensor_delay", "eccentric_pulley"])
def test_delays_and_eccentric_pulleys_are_refused(name: str, hframe: Machine) -> None:
    with pytest.raises(InputError, match=f"an FMU has no place for {CASES[name].effect.label}"):
        exported(hframe.with_effects(CASES[name].effect))
