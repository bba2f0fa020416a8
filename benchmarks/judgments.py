"""Record the judgments of an identification with their evidence, and judge again without a simulation.

    python -m benchmarks.judgments record example:rig_a other:3 closed:5 random:7:0 outside:3:1
    python -m benchmarks.judgments thresholds     # which judgments change if a threshold is halved or doubled
    python -m benchmarks.judgments again          # which ones change by the present rules

The rules of `hframe_gym.identification.judge` are functions of evidence; a record of their arguments suffices
to call them again. A number that no rule asked for is missing in it, and a judgment that asks for it is
unknown. A record shows the next judgment, not the path that the search would take from there: where one
changes, identify again.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import importlib
import inspect
import io
import pickle
import pkgutil
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, NamedTuple

from rich.console import Console
from rich.table import Table

from benchmarks import closed_loop_rigs, other_simulator_rigs
from benchmarks.results_file import data_root
from benchmarks.scoring import score_names
from hframe_gym.files import atomic_file
from hframe_gym.identification import Fit, SelectionCriteria, identify, judge
from hframe_gym.identification.judge.criteria import SearchEffort
from hframe_gym.identification.judge.effect import EffectEvidence
from hframe_gym.machine import BUILTIN_MACHINES, Machine
from hframe_gym.recordings import Recording, load_machine, load_recordings
from tests.rigs import outside_rigs, random_rigs
from tests.rigs.random_effects import DrawnEffect
from tools.command_line import command_line
from tools.repository import ROOT

FOLDER = Path("out/judgments")
FACTORS = (0.5, 2.0)
RULES: tuple[ModuleType, ...] = tuple(
    importlib.import_module(f"{judge.__name__}.{entry.name}")
    for entry in pkgutil.iter_modules(judge.__path__)
)


class UnknownEvidenceError(LookupError):
    """A rule asks for a number that was not computed when the judgment was recorded."""


class Number:
    """Number of an evidence record that is computed when a rule asks for it, and kept.

    Args:
        compute: Function that computes it.
    """

    def __init__(self, compute: Callable[..., Any]) -> None:
        self._compute: Callable[..., Any] | None = compute
        self._known: list[tuple[tuple[Any, ...], Any]] = []

    def __call__(self, *arguments: Any) -> Any:
        """Return the number, for arguments where a rule passes some."""
        for known, value in self._known:
            if known == arguments:
                return value
        if self._compute is None:
            raise UnknownEvidenceError
        value = self._compute(*arguments)
        self._known.append((arguments, tuple(value) if isinstance(value, Iterator) else value))
        return self._known[-1][1]

    def __getstate__(self) -> list[tuple[tuple[Any, ...], Any]]:
        """Return what is pickled: the known numbers by arguments."""
        return self._known

    def __setstate__(self, known: list[tuple[tuple[Any, ...], Any]]) -> None:
        """Restore a pickled number."""
        self._compute, self._known = None, known


class Numbers:
    """Numbers of an evidence record, computed one after the other while a rule asks for them, and kept.

    Args:
        compute: Iterator that computes them.
    """

    def __init__(self, compute: Iterator[Any]) -> None:
        self._compute: Iterator[Any] | None = compute
        self._known: list[Any] = []
        self._complete = False

    def __iter__(self) -> Iterator[Any]:
        """Yield the numbers."""
        yield from self._known
        while not self._complete:
            if self._compute is None:
                raise UnknownEvidenceError
            try:
                self._known.append(next(self._compute))
            except StopIteration:
                self._complete = True
            else:
                yield self._known[-1]

    def __getstate__(self) -> tuple[list[Any], bool]:
        """Return what is pickled: the known numbers, and whether they are all."""
        return self._known, self._complete

    def __setstate__(self, known: tuple[list[Any], bool]) -> None:
        """Restore pickled numbers."""
        self._compute, (self._known, self._complete) = None, known


class Limit(float):
    """Limit that a rule returned and another receives; `judgment` and `added` say how to compute it again."""

    judgment: Judgment
    added: float

    @classmethod
    def of(cls, judgment: Judgment, added: float = 0.0) -> Limit:
        """Return the result of a judgment plus a number that does not depend on it."""
        limit = cls(judgment.result + added)
        limit.judgment, limit.added = judgment, added
        return limit

    def __add__(self, other: float) -> Limit:
        return Limit.of(self.judgment, self.added + other)

    def __reduce__(self) -> tuple[Any, ...]:
        return Limit.of, (self.judgment, self.added)


@dataclasses.dataclass
class Judgment:
    """Call of a rule.

    Attributes:
        module: Name of its module in `judge`.
        rule: Name of the function.
        arguments: Its positional and keyword arguments.
        result: What it returned.
    """

    module: str
    rule: str
    arguments: tuple[Sequence[Any], dict[str, Any]]
    result: Any = None

    def again(self, changes: dict[str, float]) -> Any:
        """Judge again, by the present rules and with other values of fields of the criteria.

        Raises:
            UnknownEvidenceError: If a rule asks for a number that the record does not have.
        """

        def present(value: Any) -> Any:
            if isinstance(value, SelectionCriteria):
                return dataclasses.replace(value, **changes)
            return value.judgment.again(changes) + value.added if isinstance(value, Limit) else value

        positional, by_name = self.arguments
        rule = getattr(sys.modules[f"{judge.__name__}.{self.module}"], self.rule)
        return rule(*map(present, positional), **{name: present(value) for name, value in by_name.items()})


def _recordable(value: Any) -> Any:
    """Return an argument whose numbers that are computed on demand are kept."""
    if isinstance(value, FunctionType | functools.partial):
        return Number(value)
    if isinstance(value, Iterator):
        return Numbers(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type | SelectionCriteria):
        fields = {f.name: _recordable(getattr(value, f.name)) for f in dataclasses.fields(value) if f.init}
        return dataclasses.replace(value, **fields)
    return value


@contextlib.contextmanager
def recorded() -> Iterator[list[Judgment]]:
    """Record the rules that are called from outside `judge`, in order, while the context is open."""
    judgments: list[Judgment] = []
    inside = 0

    def recording(module: str, function: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(function)
        def call(*positional: Any, **by_name: Any) -> Any:
            nonlocal inside
            if inside:
                return function(*positional, **by_name)
            kept = (
                [_recordable(value) for value in positional],
                {n: _recordable(v) for n, v in by_name.items()},
            )
            judgment = Judgment(module, function.__name__, kept)
            inside += 1
            try:
                judgment.result = function(*kept[0], **kept[1])
            finally:
                inside -= 1
            judgments.append(judgment)
            return Limit.of(judgment) if type(judgment.result) is float else judgment.result

        return call

    replaced: list[tuple[ModuleType, str, Any]] = []
    rules = {
        function: recording(module.__name__.rsplit(".", 1)[1], function)
        for module in RULES
        for function in vars(module).values()
        if isinstance(function, FunctionType) and function.__module__ == module.__name__
    }
    for module in [m for name, m in sys.modules.items() if name.startswith("hframe_gym.identification")]:
        for name, value in list(vars(module).items()):
            if isinstance(value, FunctionType) and value in rules:
                replaced.append((module, name, value))
                setattr(module, name, rules[value])
    try:
        yield judgments
    finally:
        for module, name, value in replaced:
            setattr(module, name, value)


class NamedRig(NamedTuple):
    """A rig with its recordings and the truth about it."""

    recordings: Sequence[Recording]
    machine: Machine
    truth: Sequence[DrawnEffect]
    hidden: str


def named_rig(name: str) -> NamedRig:
    """Return the rig of example:FOLDER, other:NUMBER, closed:NUMBER, random:SEED:INDEX or outside:SEED:INDEX.

    Args:
        name: Set and number of the rig, separated by colons.
    """
    group, *numbers = name.split(":")
    machine = BUILTIN_MACHINES["hframe"]()
    if group == "example":
        return NamedRig(load_recordings(ROOT / "examples" / numbers[0], machine), machine, (), "see its page")
    if group in ("other", "closed"):
        module, number = (other_simulator_rigs if group == "other" else closed_loop_rigs), int(numbers[0])
        root = other_simulator_rigs.DATA if group == "other" else data_root() / "closed_loop_rigs"
        folder = root / f"rig_{number:02d}"
        if group == "closed":
            machine = load_machine(folder / "machine.json")
        truth = module.TRUTH[number]
        return NamedRig(
            load_recordings(folder / "runs", machine), machine, truth, random_rigs.describe_effects(truth)
        )
    seed, index = map(int, numbers)
    if group == "outside":
        rig = outside_rigs.draw_rig(seed, index)
        return NamedRig(rig.record().recordings, machine, (), f"outside the library: {rig.describe()}")
    drawn = random_rigs.draw_rig(seed, index)
    return NamedRig(drawn.record().recordings, machine, drawn.hidden_effects, drawn.describe())


@dataclasses.dataclass
class Record:
    """The judgments of one identification.

    Attributes:
        rig: Name of the rig.
        hidden: What it hides, in words.
        verdict: Verdict of the identification.
        named: Effects that it names, each with its rivals.
        extra: Those that the rig does not have; of a rig without a list of the truth, empty.
        cpu_s: Processor time, s.
        judgments: All judgments in order.
    """

    rig: str
    hidden: str
    verdict: str
    named: dict[str, list[str]]
    extra: list[str]
    cpu_s: float
    judgments: list[Judgment]


# Numbers about an effect that are computed for the record if no rule asked for them. The others need further
# fits.
_COMPLETED = ("confirmed", "fault", "chance", "forces", "drives", "additions")


def record(name: str) -> Record:
    """Identify a rig and return its judgments, with the numbers of effects for which no rule asked as well.

    Args:
        name: Name of the rig (`named_rig`).
    """
    rig, began = named_rig(name), time.process_time()
    with recorded() as recording:
        result = identify(rig.recordings, rig.machine)
        cpu_s, judgments = time.process_time() - began, list(recording)
        for judgment in judgments:
            for argument in judgment.arguments[0]:
                if isinstance(argument, EffectEvidence):
                    for field in _COMPLETED:
                        getattr(argument, field)()
    named = {s.effect.label: list(s.rivals) for s in result.effects}
    extra = list(score_names(rig.truth, result.verdict, named).extra)
    return Record(name, rig.hidden, result.verdict, named, extra, round(cpu_s, 1), judgments)


def write(found: Record, folder: Path = FOLDER) -> Path:
    """Write a record to a folder and return its path."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{found.rig.replace(':', '_')}.pickle"
    with atomic_file(path) as stream:
        stream.write(as_bytes(found))
    return path


def read(folder: Path = FOLDER) -> list[Record]:
    """Read all records of a folder that `write` wrote; a pickle of another origin must not be read."""
    return [from_bytes(path.read_bytes()) for path in sorted(folder.glob("*.pickle"))]


class Chosen(NamedTuple):
    """What stands in a record for a fit, between which a rule only chooses.

    Attributes:
        number: Number of the fit in the record.
    """

    number: int


class _Writer(pickle.Pickler):
    """Pickles records without the fits."""

    def __init__(self, stream: io.BytesIO) -> None:
        super().__init__(stream)
        self._fits: list[Fit] = []

    def persistent_id(self, obj: Any) -> Chosen | None:
        if not isinstance(obj, Fit):
            return None
        if not any(obj is fit for fit in self._fits):
            self._fits.append(obj)
        return Chosen(next(i for i, fit in enumerate(self._fits) if fit is obj))


class _Reader(pickle.Unpickler):
    """Reads records without the fits."""

    def persistent_load(self, pid: Chosen) -> Chosen:
        return pid


def as_bytes(found: Record) -> bytes:
    """Return a record as bytes."""
    stream = io.BytesIO()
    _Writer(stream).dump(found)
    return stream.getvalue()


def from_bytes(content: bytes) -> Record:
    """Return the record of `as_bytes`."""
    found: Record = _Reader(io.BytesIO(content)).load()
    return found


class Threshold(NamedTuple):
    """A field of `SelectionCriteria`, or a constant beside a rule (then `module` is that of the rule)."""

    name: str
    module: ModuleType | None = None

    @property
    def value(self) -> float:
        """Its value."""
        return float(getattr(self.module or SelectionCriteria(), self.name))


def thresholds() -> list[Threshold]:
    """Return the numbers by which the rules decide: fields of the criteria, except effort, and constants."""
    of_effort = {f.name for f in dataclasses.fields(SearchEffort)}
    fields = [f.name for f in dataclasses.fields(SelectionCriteria) if f.name not in of_effort]
    constants = [
        Threshold(name, module)
        for module in RULES
        for name, value in vars(module).items()
        if name.isupper() and isinstance(value, float | int) and f"\n{name} = " in inspect.getsource(module)
    ]
    return [*map(Threshold, fields), *constants]


@contextlib.contextmanager
def changed(threshold: Threshold, factor: float) -> Iterator[dict[str, float]]:
    """Multiply a threshold; yields the changes of fields of the criteria."""
    if threshold.module is None:
        yield {threshold.name: factor * threshold.value}
        return
    sharing = [m for m in RULES if threshold.name in vars(m)]
    value = threshold.value
    for module in sharing:
        setattr(module, threshold.name, factor * value)
    try:
        yield {}
    finally:
        for module in sharing:
            setattr(module, threshold.name, value)


def decided(result: Any) -> Any:
    """Return what is decided: of a verdict with a reason the verdict, of a doubt whether there is one."""
    if isinstance(result, tuple) and result and isinstance(result[0], tuple | str):
        return result[0]
    is_doubt = isinstance(result, str) and (" " in result or not result)
    return bool(result) if is_doubt else result


def changed_judgments(
    records: Iterable[Record], changes: dict[str, float]
) -> Iterator[tuple[Record, Judgment, Any]]:
    """Yield judgments that the present rules decide otherwise than the recorded ones, with the new result.

    The new result is `UnknownEvidenceError` if a rule asks for a number that was not recorded.

    Args:
        changes: Other values of fields of the criteria.
    """
    for each in records:
        for judgment in each.judgments:
            if isinstance(judgment.result, float):  # a limit, which other rules compare
                continue
            try:
                result = judgment.again(changes)
            except UnknownEvidenceError:
                result = UnknownEvidenceError
            if decided(result) != decided(judgment.result):
                yield each, judgment, result


def show_thresholds(records: Sequence[Record], console: Console) -> None:
    """Print for each threshold how many judgments change if it is halved or doubled."""
    table = Table("threshold", "value", *(f"changed at {factor:g} times" for factor in FACTORS))
    for threshold in thresholds():
        cells = []
        for factor in FACTORS:
            with changed(threshold, factor) as changes:
                counts = Counter(
                    "unknown" if result is UnknownEvidenceError else judgment.rule
                    for _, judgment, result in changed_judgments(records, changes)
                )
            cells.append(", ".join(f"{rule} {count}" for rule, count in counts.most_common()))
        table.add_row(threshold.name, f"{threshold.value:g}", *cells)
    console.print(table)


def show_changes(records: Sequence[Record], console: Console) -> None:
    """Print the judgments that the present rules decide in another way than those of the recording."""
    for each, judgment, result in changed_judgments(records, {}):
        new = "unknown" if result is UnknownEvidenceError else repr(result)
        console.print(
            f"{each.rig}: {judgment.module}.{judgment.rule}: {judgment.result!r} -> {new}", markup=False
        )


def main() -> None:
    """Record rigs, or judge recorded ones again."""
    parser = command_line(__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("record").add_argument("rigs", nargs="+", metavar="RIG")
    commands.add_parser("thresholds")
    commands.add_parser("again")
    arguments, console = parser.parse_args(), Console(width=170)
    if arguments.command == "record":
        for name in arguments.rigs:
            found = record(name)
            write(found)
            names = ", ".join(found.named) or found.verdict
            console.print(
                f"{name}: {found.hidden} -> {names}; {found.cpu_s:.0f} s", markup=False, soft_wrap=True
            )
    elif arguments.command == "thresholds":
        show_thresholds(read(), console)
    else:
        show_changes(read(), console)


if __name__ == "__main__":
    main()
