"""Interface and registry of exporters, provenance of files, and writing them together or not at all."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from .. import option_texts
from ..errors import InputError
from ..files import output_folder, write_files
from ..line_log import LineLog
from ..machine import Coordinate, Machine, rest_positions_per_axis, rest_state
from ..recordings import load_machine, machine_to_dict
from ..registry import Registry
from ..version import NAME_AND_VERSION

Files = Mapping[str, str | bytes]
HELP, ARGUMENT, CLI_TYPE, RANGE = "help", "argument", "cli_type", "range"  # keys of the metadata of a field


def option(
    default: Any, text: str, *, cli_type: Any = None, least: int | None = None, most: int | None = None
) -> Any:
    """Declare a field of an exporter that `hframe export` offers as an option of the same name.

    Args:
        default: Value of the field where none is given.
        text: Help text; placeholders such as {sensors} stand for the registered names.
        cli_type: Type of the option on the command line, if it differs from the type of the field.
        least: Smallest value that the command line accepts; None for no limit.
        most: Largest value that the command line accepts; None for no limit. Ignored without `least`.

    Returns:
        Field of a dataclass, to be assigned to the name of the option.
    """
    limits = None if least is None else (least, most)
    return dataclasses.field(
        default=default, metadata={HELP: text, ARGUMENT: False, CLI_TYPE: cli_type, RANGE: limits}
    )


def argument(text: str) -> Any:
    """Declare a field of an exporter that `hframe export` takes as a positional argument.

    Args:
        text: Help text as for `option`.
    """
    return dataclasses.field(metadata={HELP: text, ARGUMENT: True, CLI_TYPE: None, RANGE: None})


@dataclass(frozen=True, kw_only=True)
class Exporter(ABC):
    """One kind of export, with its options as fields.

    A subclass is a frozen dataclass in a file of this folder. It registers itself with
    `@EXPORTERS.register("kind")`; `hframe export kind` then exists, with one option per field (`option`,
    `argument`). The docstring is its help page.
    """

    @property
    def kind(self) -> str:
        """Name under which the exporter is registered."""
        return next(name for name in EXPORTERS if EXPORTERS.get(name) is type(self))

    @abstractmethod
    def write(self, out: str | Path, log: LineLog = lambda line: None) -> None:
        """Write the export; its files appear together when they are complete, or none does.

        Args:
            out: Folder of the export, created if it does not exist.

        Raises:
            InputError: If the exporter cannot describe the machine or controller.
        """


EXPORTERS: Registry[type[Exporter]] = Registry("kind of export")


@dataclass(frozen=True, kw_only=True)
class MachineExporter(Exporter):
    """Export of a machine: a pure function from the machine and the options to the contents of files.

    Attributes:
        separable: Whether each file is of use without the others, so that --out may name one of them (class
            attribute).
        machine: Machine to export: object, built-in name, or path of a machine.json.
    """

    # Whether each file is of use without the others; --out may then name one of them.
    separable: ClassVar[bool] = True

    machine: str | Path | Machine = option("hframe", option_texts.MACHINE, cli_type=str)

    @abstractmethod
    def files(self, machine: Machine) -> Files:
        """Compute the files of the export.

        Returns:
            Content of each file, text or bytes, by its name in the folder of the export.

        Raises:
            InputError: If the files cannot describe the machine.
        """

    def loaded(self) -> Machine:
        """Load the machine of the field `machine`; InputError if there is none or its file is faulty."""
        return self.machine if isinstance(self.machine, Machine) else load_machine(self.machine)

    @override
    def write(self, out: str | Path, log: LineLog = lambda line: None) -> None:
        """Write the files of the export.

        Args:
            out: Folder for all files. If the files are `separable`, also a file: it gets the content of the
                one with the same suffix, and no other is written.
            log: Called with a line "wrote PATH" for each file. Existing files of the same names are replaced.

        Raises:
            InputError: If the files cannot describe the machine, or `out` is a file where a folder is needed.
        """
        out = Path(out)
        files = self.files(self.loaded())
        chosen = [name for name in files if out.suffix and name.endswith(out.suffix)]
        if out.is_dir() or not out.suffix:
            write_export(output_folder(out), files, log)
        elif self.separable and len(chosen) == 1:
            write_export(out.parent, {out.name: files[chosen[0]]}, log)
        else:
            raise InputError(
                f"--out {out}: the export {self.kind} has the files {', '.join(files)}; "
                "name a folder for them"
                + (" or a file with the suffix of one of them" if self.separable else "")
            )

    def provenance(self, machine: Machine) -> dict[str, Any]:
        """Return the origin of an export, without a date, so that equal exports have equal files.

        Returns:
            `software` (name and version of this package), `export` (kind), `options` (values by name, without
            those that are None), `machine` (name), `description`, `machine_sha256` (hash of its content in
            hexadecimal) and `effects` (labels).
        """
        content = json.dumps(machine_to_dict(machine), sort_keys=True)
        options = {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name != "machine"}
        return {
            "software": NAME_AND_VERSION,
            "export": self.kind,
            "options": {name: value for name, value in options.items() if value is not None},
            "machine": machine.name,
            "description": machine.description,
            "machine_sha256": hashlib.sha256(content.encode()).hexdigest(),
            "effects": [e.label for e in machine.effects],
        }

    def header(self, machine: Machine, *more: str) -> list[str]:
        """Return the first lines of a text file without comment signs: its origin, then more statements.

        The origin is the machine's name, the hash of its file, its effects, and the command with its options.
        """
        about = self.provenance(machine)
        options = ", ".join(f"{name} = {value}" for name, value in about["options"].items())
        lines = [
            f"Machine: {machine.name}" + (f" ({machine.description})" if machine.description else ""),
            f"Machine file (content) SHA-256: {about['machine_sha256']}",
            f"Effects of the machine: {', '.join(about['effects']) or 'none'}",
            f"Written by {about['software']}: hframe export {self.kind}"
            + (f" with {options}" if options else ""),
            *more,
        ]
        return [plain(line) for line in lines]


def write_export(folder: Path, files: Files, log: LineLog) -> None:
    """Write the files of an export to a folder, all together or none, and log the path of each.

    Args:
        folder: Folder, created if it does not exist. Existing files of the same names are replaced, others
            stay.
        files: Content of each file, text or bytes, by its name.
        log: Called with a line "wrote PATH" for each file.
    """
    contents = {name: text.encode() if isinstance(text, str) else text for name, text in files.items()}
    write_files(folder, contents)
    for name in files:
        log(f"wrote {folder / name}")


def refuse_drive_laws(machine: Machine, what: str) -> None:
    """Raise an InputError if a machine has drives with a control loop that a file format cannot represent.

    Args:
        what: The file with its article, for example "an FMU".

    Raises:
        InputError: If the torque of a drive follows a law of its own.
    """
    if machine.drive_laws:
        drives = " and ".join(law.site for law in machine.drive_laws)
        raise InputError(
            f"machine {machine.name!r}: {what} has no place for the loop of {drives}, "
            "which follows a set point; export a copy of the machine whose drives are of the kind torque"
        )


def plain(text: str) -> str:
    """Convert a text so that it is safe inside a comment of any exported language.

    The result is printable ASCII on one line, without signs that begin or end comments.
    """
    ascii_text = "".join(c if c.isascii() and c.isprintable() else "?" for c in " ".join(text.split()))
    for sign, substitute in (("*/", "* /"), ("/*", "/ *"), ("*)", "* )"), ("(*", "( *"), ("\\", "/")):
        ascii_text = ascii_text.replace(sign, substitute)
    return ascii_text


def xml_comment(lines: Sequence[str]) -> str:
    """Write lines as a comment of XML, which must not contain "--", with a line break at its end."""
    return "<!--\n" + "".join(f"  {line}\n".replace("--", "- -") for line in lines) + "-->\n"


def indented(xml: str) -> str:
    """Indent XML without declaration by its structure: one element a line, with a line break at the end."""
    element = ElementTree.fromstring(xml)
    ElementTree.indent(element)
    return ElementTree.tostring(element, encoding="unicode") + "\n"


def commented(lines: Sequence[str], sign: str) -> str:
    """Write lines as comments that begin with a sign, each with a line break at its end."""
    return "".join(f"{sign} {line}".rstrip() + "\n" for line in lines)


def json_text(content: Mapping[str, Any]) -> str:
    """Return the text of a JSON file; arrays become lists."""
    return json.dumps(content, indent=1, default=_plain_value) + "\n"


def _plain_value(value: Any) -> Any:
    """Return what JSON stores for a value that it does not know."""
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else str(value)


def axis_range(coordinate: Coordinate) -> tuple[float, float]:
    """Return the range of a coordinate, m or rad. By default it is -0.25 to 0.25 m, or 0 to 2 pi rad."""
    return coordinate.range or ((0.0, 2.0 * np.pi) if coordinate.kind == "rotary" else (-0.25, 0.25))


def require_linear_axes(machine: Machine, what: str) -> None:
    """Raise an InputError if a tool axis is rotary, because a file states the tool position in m.

    Args:
        what: The file, for example "an FMU".

    Raises:
        InputError: If a tool axis is rotary; the message lists what can be exported.
    """
    rotary = [axis for axis in machine.tool_axes if machine.coordinate(axis).kind == "rotary"]
    if rotary:
        raise InputError(
            f"machine {machine.name!r}: {what} has the tool position in m, and {' and '.join(rotary)} turns; "
            "export state-space, friction-map or, of an agent, policy"
        )


def operating_point(machine: Machine, at: Sequence[str] | None) -> NDArray[np.float64]:
    """Convert the option --at to the positions of all coordinates, with unstretched belts.

    Args:
        at: Items "AXIS=POSITION" of linear coordinates, m, or, on a machine without any, of the tool's axes,
            rad. All others are at 0. Default: all at 0.

    Returns:
        Position of every coordinate, m or rad, shape (coordinates,).

    Raises:
        InputError: If an item names no such axis, or its value is not a number in the axis' range.
    """
    linear = [c.name for c in machine.coordinates if c.kind == "linear"]
    positions = dict.fromkeys(linear or machine.tool_axes, 0.0)
    for item in at or ():
        name, _, value = item.partition("=")
        if name not in positions:
            raise InputError(
                f"--at {item}: write AXIS=POSITION with one of the axes {', '.join(positions) or '(none)'}"
            )
        axis = machine.coordinate(name)
        try:
            positions[name] = float(value)
        except ValueError:
            raise InputError(f"--at {item}: {value!r} is not a number in {axis.unit('position')}") from None
        low, high = axis.range or (-np.inf, np.inf)
        if not (low <= positions[name] <= high and np.isfinite(positions[name])):
            raise InputError(
                f"--at {item}: must be from {low:g} to {high:g} {axis.unit('position')}, the range of {name}"
            )
    if linear:
        return rest_state(machine, list(positions.values()))[: len(machine.coordinates)]
    return rest_positions_per_axis(machine) @ np.array(list(positions.values()))
