"""Read the vectors of a MATLAB or HDF5 file; a separate program, as damaged files can crash readers.

    python matlab_vectors.py LOG.mat VECTORS.npz LIMIT

LIMIT is the largest accepted size of the arrays in an HDF5 file, bytes. The program imports nothing of this
package, so that it starts quickly. It ends with exit code 2 and one line on standard error if the file cannot
be read.
"""

import importlib.util
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

_DEEPEST = 32  # structures in structures
# Names under which SciPy and HDF5 return what MATLAB's objects consist of.
_OBJECTS = {"__function_workspace__", "#subsystem#"}
# Fields of an iddata object of the System Identification Toolbox, and units of time by the names that it has
# for them.
_IDDATA = {"Domain", "OutputData", "InputData", "OutputName", "InputName", "Ts", "SamplingInstants"}
_TIME_UNITS = {
    "milliseconds": "ms",
    "microseconds": "us",
    "nanoseconds": "ns",
    "minutes": "min",
    "hours": "h",
}
# Where files of version 7.3 keep the signals of a Simulink data set, and what their values are stored as.
_STREAMS = "#sigstream#"
_STREAM_TYPES = {"double": "f8", "single": "f4", "logical": "u1", "boolean": "u1"} | {
    f"{sign}int{bits}": f"{sign or 'i'}{bits // 8}" for sign in ("", "u") for bits in (8, 16, 32, 64)
}


def vectors(name: str, value: Any) -> Iterator[tuple[str, NDArray[np.float64]]]:
    """Yield all numeric vectors in a MATLAB variable, also in fields and cells; skip scalars and texts.

    A matrix gives its columns if it has more rows than columns, else its rows.

    Args:
        value: Array, structure (dictionary) or cell array (list) as SciPy returns it.

    Yields:
        Name of a vector ("log.t" for a field, "data.2" for the second column of a matrix, the label of a
        Simulink signal, or "time" for the axis of dSPACE ControlDesk) and its values, shape (N,).
    """
    if isinstance(value, dict):
        # A signal of Simulink's structure with time has a label, one of dSPACE ControlDesk a name.
        labels = {"values": value.get("label"), "Data": value.get("Name")}
        for key, member in _with_named_axis(value).items():
            label = labels.get(key)
            yield from vectors(label if isinstance(label, str) and label else f"{name}.{key}", member)
    elif isinstance(value, list) or (isinstance(value, np.ndarray) and value.dtype == object):
        for number, member in enumerate(value, start=1):
            yield from vectors(f"{name}.{number}", member)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
        if value.ndim == 1 and len(value) > 1:
            yield name, value.astype(float)
        elif value.ndim == 2 and value.size:
            for number, column in enumerate(value.T if value.shape[0] > value.shape[1] else value, start=1):
                yield f"{name}.{number}", column.astype(float)


def _with_named_axis(structure: dict[str, Any]) -> dict[str, Any]:
    """Name the axis of time of dSPACE ControlDesk, a structure named after its file: X, without a name."""
    axis = structure.get("X")
    if "Y" not in structure or not isinstance(axis, dict) or "Data" not in axis:
        return structure
    name = axis.get("Name")
    return structure if isinstance(name, str) and name else {**structure, "X": {**axis, "Name": "time"}}


def experiments(name: str, value: Any) -> Iterator[tuple[str, list[tuple[str, NDArray[np.float64]]]]]:
    """Yield the experiments of an iddata object of MATLAB, if the variable is one in time.

    Args:
        name: Name of the variable.
        value: Its content as SciPy returns it: a dictionary of the object's fields.

    Yields:
        Name of the experiment ("data", or "data_Exp2" if the object has several), and headers with units and
        values of its columns, shape (N,) each: the time, the inputs and the outputs.
    """
    if not isinstance(value, dict) or not value.keys() >= _IDDATA or value["Domain"] != "Time":
        return
    outputs, inputs = _experiment_list(value["OutputData"]), _experiment_list(value["InputData"])
    names = _texts(value.get("ExperimentName"))
    for number, output in enumerate(outputs):
        time_unit = _member(_texts(value.get("TimeUnit", "")), 0)
        columns = [(f"time [{_TIME_UNITS.get(time_unit, 's')}]", _sample_times(value, number, len(output)))]
        for kind, signals in (("Input", inputs[number : number + 1]), ("Output", [output])):
            labels, units = _texts(value[f"{kind}Name"]), _texts(value.get(f"{kind}Unit"))
            for k, column in enumerate(signals[0].T if signals else ()):
                unit = _member(units, k)
                label = _member(labels, k) or f"{kind}{k + 1}"
                columns.append((f"{label} [{unit}]" if unit else label, column.astype(float)))
        called = _member(names, number) or str(number + 1)
        yield name if len(outputs) == 1 else f"{name}_{called}", columns


def _experiment_list(values: Any) -> list[NDArray[Any]]:
    """Return the signals of each experiment, shape (N, signals): an array for one, or cells."""
    several = isinstance(values, list) or (isinstance(values, np.ndarray) and values.dtype == object)
    arrays = [np.asarray(member) for member in (values if several else [values])]
    return [array.reshape(len(array), -1) for array in arrays if array.ndim and array.size]


def _texts(value: Any) -> list[str]:
    """Return the texts of a cell array, of which SciPy returns a single one without its cell."""
    return [value] if isinstance(value, str) else [str(text) for text in np.ravel(value)]


def _member(texts: list[str], index: int) -> str:
    """Return a text of a list, or "" beyond its end."""
    return texts[index] if index < len(texts) else ""


def _sample_times(data: dict[str, Any], number: int, count: int) -> NDArray[np.float64]:
    """Return the sample times of an experiment of iddata: those stored, or equal steps from its start."""
    stored = _experiment_list(data["SamplingInstants"])
    instants = np.ravel(stored[number]) if number < len(stored) else np.zeros(0)
    if len(instants) == count:
        return instants.astype(np.float64)

    def number_of(field: str, otherwise: float) -> float:
        values = np.ravel(np.array(data.get(field), dtype=object)).tolist()
        value = values[min(number, len(values) - 1)] if values else None
        return float(value) if isinstance(value, (int, float)) and np.isfinite(value) else otherwise

    return number_of("Tstart", 0.0) + number_of("Ts", 1.0) * np.arange(count, dtype=np.float64)


def objects(path: str) -> dict[str, Any]:
    """Read the tables, timetables and timeseries of a MATLAB file, which Simulink writes by default.

    Returns:
        Dictionaries by name of the variable, with the properties as MATLAB names them: columns of a table;
        Time, s, and Data of a timeseries. Other objects are left out. Empty without the package mat-io, or if
        it cannot read an object of the file, such as a stream of Simulink.
    """
    if importlib.util.find_spec("matio") is None:
        return {}
    from matio import load_from_mat

    try:
        content = load_from_mat(path)
    except Exception:  # it raises many types; the arrays beside the objects are read in any case
        return {}
    found = {}
    for name, value in content.items():
        if hasattr(value, "columns"):  # a table is a data frame, of a timetable with times as its index
            columns = {str(key): np.asarray(value[key]) for key in value.columns}
            if value.index.dtype.kind in "mM":
                since = np.asarray(value.index) - np.asarray(value.index)[0]
                columns = {"Time": since / np.timedelta64(1, "s"), **columns}
            found[name] = columns
        elif getattr(value, "classname", "") == "timeseries":
            found[name] = _timeseries(value.properties)
    return found


def _timeseries(properties: dict[str, Any]) -> dict[str, Any]:
    """Return Time and Data of a timeseries.

    Equal steps have a start and an increment in place of times. What Simulink logged while it ran is in a
    storage of its own, with the time as the last dimension.
    """
    info = properties["TimeInfo"].properties
    times = np.ravel(info["Time_"])
    if not times.size:
        count = int(np.ravel(info["Length"])[0])
        times = np.ravel(info["Start_"])[0] + np.ravel(info["Increment_"])[0] * np.arange(count)
    data = np.squeeze(properties["Data_"])
    if not data.size and "Storage_" in properties:
        data = np.squeeze(properties["Storage_"].properties["Data"])
    return {"Time": times, "Data": data if data.shape[:1] == times.shape else data.T}


def _hdf5_content(path: str, limit: int) -> dict[str, Any]:
    """Return the variables of a MATLAB file of version 7.3 (HDF5) as SciPy returns those of older files.

    Tables, timetables and other objects are left out.
    """
    import h5py

    remaining = limit

    def is_reference(item: Any) -> bool:
        """Return whether a member points to others and is no cell array."""
        is_pointer = isinstance(item, h5py.Dataset) and h5py.check_ref_dtype(item.dtype) is not None
        return is_pointer and "MATLAB_class" not in item.attrs

    def convert(item: Any, depth: int) -> Any:
        nonlocal remaining
        if depth > _DEEPEST:
            raise ValueError("structures are nested too deeply")
        if isinstance(item, h5py.Group):
            fields = {name: convert(member, depth + 1) for name, member in item.items()}
            if fields and all(map(is_reference, item.values())):  # an array of structures
                lists = [value if isinstance(value, list) else [value] for value in fields.values()]
                return [dict(zip(fields, element, strict=True)) for element in zip(*lists, strict=True)]
            return fields
        if not isinstance(item, h5py.Dataset) or "MATLAB_object_decode" in item.attrs or item.shape is None:
            return None
        remaining -= item.size * item.dtype.itemsize
        if remaining < 0:
            raise ValueError(f"its arrays have more than {limit} bytes, which no recording has")
        kind = item.attrs.get("MATLAB_class", b"")
        if "MATLAB_empty" in item.attrs:
            return None
        if h5py.check_ref_dtype(item.dtype) is not None:
            members = [
                convert(item.file[reference], depth + 1) for reference in item[()].ravel() if reference
            ]
            return members[0] if len(members) == 1 else members
        if kind == b"char":
            return "".join(map(chr, item[()].ravel()))
        if item.dtype.kind not in "fiub":
            return None
        values = item[()]
        return np.squeeze(values.T if kind else values)  # MATLAB stores arrays column by column

    with h5py.File(path, "r") as file:
        variables = {name: convert(member, 0) for name, member in file.items() if not name.startswith("#")}
        return variables | dict.fromkeys(_OBJECTS & file.keys())


def _simulink_signals(path: str, limit: int) -> dict[str, Any]:
    """Return time, s, and data of each signal of a Simulink data set, by its name or that of its block.

    Each signal is described by a structure and has its values, and its times unless its steps are equal, in
    streams of bytes. Signals of other types than numbers are left out.
    """
    import h5py

    found: dict[str, Any] = {}
    with h5py.File(path, "r") as file:
        if _STREAMS not in file:
            return found
        streams = file[_STREAMS]
        if sum(stream["#data#"].size for stream in streams.values() if "#data#" in stream) > limit:
            raise ValueError(f"its signals have more than {limit} bytes, which no recording has")

        def text(item: Any) -> str:
            """Return a text, which a cell may hold; "" where there is none."""
            if item is None or "MATLAB_empty" in item.attrs:
                return ""
            if h5py.check_ref_dtype(item.dtype) is not None:
                return text(file[item[()].ravel()[-1]])
            return "".join(map(chr, item[()].ravel()))

        def values(number: Any, kind: str) -> NDArray[Any]:
            """Return the values of a stream, shape (rows, values a row)."""
            stream = streams[str(int(number[()].ravel()[0]))]
            rows, size = (int(stream[name][()].ravel()[0]) for name in ("#length#", "#sampleSize#"))
            content = stream["#data#"][()].tobytes()[: rows * size]
            return np.frombuffer(content, _STREAM_TYPES[kind]).reshape(rows, -1)

        def visit(structure: Any, name: str) -> None:
            """Add the signals in a structure, which has this name unless it has one of its own."""
            block = text(structure.get("BlockPath")).rpartition("/")[2]
            name = text(structure.get("Name")) or name or block
            if "DataR2" not in structure:
                for key, member in structure.items():
                    if isinstance(member, h5py.Group):
                        visit(member, name if key == "Values" else f"{name}.{key}".lstrip("."))
                return
            kind = text(structure["SignalAttributes/ClassName"])
            if kind not in _STREAM_TYPES:
                return
            data = values(structure["DataR2"], kind)
            if "MATLAB_empty" in structure["TimeR2"].attrs:
                start, step = structure["CompressedTime"][()].ravel()[:2]
                times = start + step * np.arange(len(data))
            else:
                times = values(structure["TimeR2"], "double")[:, 0]
            unused = name if name not in found else f"{name}.{len(found) + 1}"
            found[unused] = {"Time": times, "Data": np.squeeze(data)}

        for item in file["#refs#"].values():
            if isinstance(item, h5py.Group) and "Values" in item:
                visit(item, "")
    return found


def main() -> None:
    """Read a MATLAB or HDF5 file and write its vectors and their names to an .npz file.

    The command line gives the two paths and the largest size of an HDF5 file's arrays in memory, bytes. If
    the file cannot be read or exceeds it, the process ends with exit code 2 and a message on standard error.
    """
    source, target, limit = sys.argv[1:]
    try:
        with open(source, "rb") as file:
            start = file.read(520)
        if b"\x89HDF\r\n\x1a\n" in (start[:8], start[512:]):
            content = _hdf5_content(source, int(limit))
            content |= _simulink_signals(source, int(limit))
        else:
            from scipy import io

            content = io.loadmat(source, simplify_cells=True)
        if _OBJECTS & content.keys():
            content |= objects(source)
    except Exception as error:  # the readers raise many types for damaged files
        print(" ".join(str(error).split()), file=sys.stderr)
        sys.exit(2)
    variables = {key: value for key, value in content.items() if not key.startswith("__")}
    logs = [log for key, value in variables.items() for log in experiments(key, value)]
    named = {key for key, value in variables.items() if next(experiments(key, value), None)}
    pairs = [pair for key, value in variables.items() if key not in named for pair in vectors(key, value)]
    if pairs:  # one log, with the experiments beside the other vectors
        pairs += [(f"{part}.{name}", vector) for part, columns in logs for name, vector in columns]
        logs = [("", pairs)]
    entries = [(part, name, vector) for part, columns in logs for name, vector in columns]
    np.savez(
        target,
        *[vector for _, _, vector in entries],
        names=np.array([name for _, name, _ in entries], dtype=str),
        parts=np.array([part for part, _, _ in entries], dtype=str),
    )


if __name__ == "__main__":
    main()
