"""Read the vectors of a MATLAB file; run as a program of its own, because damaged files can crash SciPy's reader.

    python matlab_vectors.py LOG.mat VECTORS.npz

The program imports nothing of this package, so that it starts quickly. It ends with exit code 2 and one line on
standard error if the file cannot be read.
"""

import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import io


def vectors(name: str, value: Any) -> Iterator[tuple[str, NDArray[np.float64]]]:
    """Yield all numeric vectors in a variable of a MATLAB file, also in its fields and cells; skip scalars and texts.

    A matrix gives its columns if it has more rows than columns, else its rows.

    Args:
        name: Name of the variable.
        value: Array, structure (dictionary) or cell array (list) as SciPy returns it.

    Yields:
        Name of a vector ("log.t" for a field, "data.2" for the second column of a matrix, or the label of a Simulink
        signal) and its values, shape (N,).
    """
    if isinstance(value, dict):
        # A signal of Simulink's structure with time has a label, one of dSPACE ControlDesk a name.
        labels = {"values": value.get("label"), "Data": value.get("Name")}
        for key, member in value.items():
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


def main() -> None:
    """Read a MATLAB file and write its vectors and their names to an .npz file.

    The command line gives the two paths. The program runs in a process of its own, because SciPy's reader can crash on
    a damaged file. If the file cannot be read, the process ends with exit code 2.
    """
    source, target = sys.argv[1:]
    try:
        content = io.loadmat(source, simplify_cells=True)
    except Exception as error:  # SciPy raises many types for damaged files
        print(" ".join(str(error).split()), file=sys.stderr)
        sys.exit(2)
    pairs = [pair for key, value in content.items() if not key.startswith("__") for pair in vectors(key, value)]
    np.savez(target, *[vector for _, vector in pairs], names=np.array([name for name, _ in pairs], dtype=str))


if __name__ == "__main__":
    main()
