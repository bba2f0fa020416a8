"""Measure how readable and how well cut the package is: words, module and function sizes, docstrings.

    python -m tools.house [--list]

`--list` also prints every word that counts, every function without docstring, every array without a shape and
number without a unit, and every method that overrides another without saying so. tests/test_house.py holds
the limits on these. Sizes are printed, not limited: a module is one idea and a function does one thing, with
the length that this needs.
"""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from tools.command_line import command_line
from tools.repository import ROOT

# Words of the private dialect that docs and code no longer use; see CONTRIBUTING.md.
WORDS = ("own", "told", "stands", "asked", "badly", "whole", "share", "shown", "missed", "judged")
MAX_WORDS_PER_1000_LINES = 5.0

_WORD = re.compile(rf"\b({'|'.join(WORDS)})\b", re.IGNORECASE)
_Function = ast.FunctionDef | ast.AsyncFunctionDef
_Documented = ast.Module | ast.ClassDef | _Function
# Decorated functions that read as attributes, or whose documentation is elsewhere.
_EXEMPT_DECORATORS = ("property", "cached_property", "overload", "setter", "override")
_COMMAND_DECORATORS = ("command", "callback")  # Typer prints the docstring; each option has its help text
_PROPERTY_DECORATORS = ("property", "cached_property")

# Annotations of arrays, and of quantities that may be arrays. Their description states a shape,
# "shape (n, drives)" or "any shape"; where many operands have the same one, the text above the sections may
# state it.
_ARRAY = re.compile(r"\b(Array|ArrayLike|NDArray|Positions|Tensor)\b")
_NUMBER = re.compile(r"float( \| None)?|tuple\[float(, float)*\]")
# The description of a number states its unit, ", m/s" or "in the unit of ...", or says that it has none.
_UNIT = re.compile(
    r"(, |\(|in )(m|s|kg|N|Nm|V|Vs|A|J|Hz|rad|Nms|Ns|mm|ms|SI|%|in|bits|turns|1)([/^][\w^]+)*(?=[\s,.;:)*]|$)"
    r"|(?i:\bunits?\b|dimensionless|ratio|fraction|factor|multiple|relative|theta)|\[-?[01], 1\]"
)


@dataclass(frozen=True)
class Function:
    """Function or method of a module.

    Attributes:
        path: Source file, relative to the repository.
        name: Qualified name within the module, for example "Machine.simulate".
        node: Its syntax tree.
    """

    path: Path
    name: str
    node: _Function

    @property
    def lines(self) -> int:
        """Return the number of lines from the signature to the end, without decorators."""
        return (self.node.end_lineno or self.node.lineno) - self.node.lineno + 1

    @property
    def public(self) -> bool:
        """Return whether neither the function, nor its class, nor its module has a leading underscore."""
        return not any(
            part.startswith("_") for part in (*self.name.split("."), self.path.stem.removeprefix("__init__"))
        )

    @property
    def inherits(self) -> bool:
        """Return whether the function is marked as an override, whose contract is that of the base class."""
        return "override" in self._decorators()

    @property
    def needs_docstring(self) -> bool:
        """Return whether the function must have a docstring and has none."""
        exempt = self._decorators().intersection(_EXEMPT_DECORATORS)
        return not exempt and ast.get_docstring(self.node) is None

    def vague_entries(self) -> list[str]:
        """Return the arrays whose shape the docstring does not state, and the numbers without a unit.

        An argument is described by its entry in Args, or in the text if this names it in backquotes; a result
        by Returns, or by the text. A named type of `hframe_gym.arrays` states shape and unit itself. An
        override may leave out what the base class says. A parameter without annotation counts as an array. A
        class that holds arrays states their shapes once, at its attributes.

        Returns:
            Entries as "name: no shape", "name: no unit", "name: not described"; the name is "Returns" for
            results and properties.
        """
        docstring = ast.get_docstring(self.node)
        if docstring is None or self._decorators().intersection(_COMMAND_DECORATORS):
            return []
        prose = re.split(r"^(?:Args|Returns|Yields|Raises):$", docstring, flags=re.MULTILINE)[0]
        entries = _entries(_section(docstring, "Args"))
        vague = []
        if not self._decorators().intersection(_PROPERTY_DECORATORS):
            for x in self._arguments():
                annotated = _annotation(x)
                text = entries.get(x.arg) or (prose if f"`{x.arg}`" in prose else "")
                is_array = _ARRAY.search(annotated) is not None
                if text:
                    vague += _lacking(x.arg, text, is_array and "shape (" not in prose, annotated)
                elif (is_array or _NUMBER.fullmatch(annotated)) and not self.inherits:
                    vague.append(f"{x.arg}: not described")
        result = _section(docstring, "Returns") or _section(docstring, "Yields")
        if result or not self.inherits:
            annotated = ast.unparse(self.node.returns) if self.node.returns else "Array"
            is_array = _ARRAY.search(annotated) is not None
            vague += _lacking("Returns", result or prose, is_array and "shape (" not in prose, annotated)
        return vague

    def _decorators(self) -> set[str]:
        """Return the last parts of the names of the decorators."""
        return {_last_name(decorator) for decorator in self.node.decorator_list}

    def _arguments(self) -> list[ast.arg]:
        """Return the documented parameters: all but self, cls and those with a leading underscore."""
        a = self.node.args
        every = [*a.posonlyargs, *a.args, *a.kwonlyargs, *(x for x in (a.vararg, a.kwarg) if x)]
        return [x for x in every if x.arg not in ("self", "cls") and not x.arg.startswith("_")]


@dataclass
class House:
    """Measures of a source tree.

    Attributes:
        lines: Number of lines of all modules.
        words: Occurrences of `WORDS` as "path:line: word".
        modules: Number of lines by module of hframe_gym without effects/, agents and the packages' __init__
            files.
        packages: Number of lines by __init__ file of the same packages.
        module_lines: Number of lines by module, all of them.
        docstring_lines: Number of lines of docstrings by module.
        functions: All functions and methods that are not nested in a function.
        bases: Names of the base classes by name of the class.
    """

    lines: int = 0
    words: list[str] = field(default_factory=list)
    modules: dict[Path, int] = field(default_factory=dict)
    packages: dict[Path, int] = field(default_factory=dict)
    module_lines: dict[Path, int] = field(default_factory=dict)
    docstring_lines: Counter[Path] = field(default_factory=Counter)
    functions: list[Function] = field(default_factory=list)
    bases: dict[str, set[str]] = field(default_factory=dict)

    @property
    def words_per_1000_lines(self) -> float:
        """Return the occurrences of `WORDS` per 1000 lines."""
        return 1000.0 * len(self.words) / max(self.lines, 1)

    @property
    def public_functions(self) -> list[Function]:
        """Return the public functions whose docstrings must state shapes and units.

        Effects document their formulas in one line each; the formulas of registers have the contract of the
        functions of the same name in `elementwise`.
        """
        return [
            f
            for f in self.functions
            if f.public and "effects" not in f.path.parts and f.path.stem != "lane_formulas"
        ]

    @property
    def undocumented(self) -> list[str]:
        """Return the public functions without a docstring as "path:line: name"; overrides inherit theirs."""
        return [_where(f) for f in self.public_functions if f.needs_docstring]

    @property
    def docstring_shares(self) -> dict[str, tuple[int, int]]:
        """Return the numbers of lines and of docstring lines by package, and of all under "total"."""
        shares: Counter[str] = Counter()
        totals: Counter[str] = Counter()
        for path, count in self.module_lines.items():
            room = "/".join(path.parts[:2]) if len(path.parts) > 2 else path.parts[0]
            for name in (room, "total"):
                totals[name] += count
                shares[name] += self.docstring_lines[path]
        return {name: (totals[name], shares[name]) for name in totals}

    @property
    def vague(self) -> list[str]:
        """Return public functions' arrays without shape and floats without unit, "path:line: name (...)"."""
        return [
            f"{_where(f)} ({', '.join(vague)})" for f in self.public_functions if (vague := f.vague_entries())
        ]

    @property
    def unmarked_overrides(self) -> list[str]:
        """Return the methods, of classes with a base class here, that override one without `@override`."""
        methods: dict[str, set[str]] = {}
        for f in self.functions:
            owner, _, name = f.name.rpartition(".")
            methods.setdefault(owner, set()).add(name)

        def inherited(name: str) -> set[str]:
            bases = self.bases.get(name, set()) - {name}
            return set().union(*(methods.get(base, set()) | inherited(base) for base in bases))

        return [
            _where(f)
            for f in self.functions
            if not f.inherits
            and (parts := f.name.rpartition("."))[2] in inherited(parts[0])
            and not parts[2].startswith("__")
        ]


def measure(root: Path = ROOT) -> House:
    """Measure hframe_gym and agents.

    Args:
        root: Repository with the folders hframe_gym/ and agents/.
    """
    house = House()
    for path in source_files(root):
        text, relative = path.read_text("utf-8"), path.relative_to(root)
        count = len(text.splitlines())
        house.lines += count
        house.module_lines[relative] = count
        if relative.parts[0] == "hframe_gym" and relative.parts[1] != "effects":
            (house.packages if path.stem == "__init__" else house.modules)[relative] = count
        for number, line in enumerate(text.splitlines(), start=1):
            house.words += [f"{relative}:{number}: {word}" for word in _WORD.findall(line)]
        tree = ast.parse(text)
        house.functions += [Function(relative, name, node) for name, node in _functions(tree)]
        for node in ast.walk(tree):
            if isinstance(node, _Documented) and ast.get_docstring(node) is not None:
                house.docstring_lines[relative] += (node.body[0].end_lineno or 0) - node.body[0].lineno + 1
            if isinstance(node, ast.ClassDef):
                house.bases.setdefault(node.name, set()).update(map(_last_name, node.bases))
    return house


def source_files(root: Path) -> list[Path]:
    """List the modules of hframe_gym and agents, each once although hframe_gym/agents may be a link."""
    package = (p for p in (root / "hframe_gym").rglob("*.py") if p.relative_to(root).parts[1] != "agents")
    return sorted([*package, *(root / "agents").rglob("*.py")])


def _functions(tree: ast.Module | ast.ClassDef, prefix: str = "") -> Iterator[tuple[str, _Function]]:
    """Yield the qualified names and syntax trees of functions and methods, not of nested functions."""
    for node in tree.body:
        if isinstance(node, ast.ClassDef):
            yield from _functions(node, f"{prefix}{node.name}.")
        elif isinstance(node, _Function):
            yield prefix + node.name, node


def _lacking(name: str, text: str, is_array: bool, annotated: str) -> list[str]:
    """Return "name: no shape" or "name: no unit" if the text lacks what the annotation calls for."""
    if is_array and "shape" not in text:
        return [f"{name}: no shape"]
    if _NUMBER.fullmatch(annotated) and not _UNIT.search(" ".join(text.split())):
        return [f"{name}: no unit"]
    return []


def _annotation(argument: ast.arg) -> str:
    """Return the annotation of a parameter as text; "Array" if it has none."""
    return ast.unparse(argument.annotation) if argument.annotation else "Array"


def _section(docstring: str, name: str) -> str:
    """Return the text of a section of a docstring, "" if it has none."""
    found = re.search(rf"^{name}:\n((?:(?: .*)?\n?)*)", docstring, re.MULTILINE)
    return found[1] if found else ""


def _entries(section: str) -> dict[str, str]:
    """Return the descriptions of a section's entries by name, without the stars of `*args`."""
    found = re.findall(r"^    \**(\w+)(?: \(.*?\))?: (.*(?:\n {5,}.*)*)", section, re.MULTILINE)
    return dict(found)


def _last_name(expression: ast.expr) -> str:
    """Return a dotted name's last part, without arguments or subscripts: "Base" of `module.Base[int]`."""
    return re.split(r"[(\[]", ast.unparse(expression))[0].rpartition(".")[2]


def _where(function: Function) -> str:
    return f"{function.path}:{function.node.lineno}: {function.name}"


def main() -> None:
    """Print the measures beside their limits."""
    parser = command_line(__doc__)
    parser.add_argument("--list", action="store_true", help="print every finding")
    parser.add_argument("--root", type=Path, default=ROOT, help="repository to measure (default: this one)")
    arguments = parser.parse_args()
    house = measure(arguments.root.resolve())
    counts = Counter(entry.rsplit(" ", 1)[1].lower() for entry in house.words)
    listed = ", ".join(f"{word} {count}" for word, count in counts.most_common())
    longest = sorted(house.module_lines.items(), key=lambda item: -item[1])[:5]
    long_functions = sorted(house.functions, key=lambda function: -function.lines)[:5]
    print(
        f"words per 1000 lines: {house.words_per_1000_lines:.1f} (limit "
        f"{MAX_WORDS_PER_1000_LINES:g}): {listed}"
    )
    print(f"lines of hframe_gym and agents: {house.lines}")
    print(
        f"in hframe_gym without effects/: {len(house.modules)} modules, "
        f"{len(house.packages)} package __init__ files"
    )
    print(f"longest modules: {', '.join(f'{path} {count}' for path, count in longest)}")
    print(f"longest functions: {', '.join(f'{_where(f)} {f.lines}' for f in long_functions)}")
    shares = sorted(house.docstring_shares.items(), key=lambda item: -item[1][0])
    print(
        "docstrings: "
        f"{', '.join(f'{room} {100 * part / count:.0f} % of {count}' for room, (count, part) in shares)}"
    )
    print(f"public functions without docstring: {len(house.undocumented)} of {len(house.public_functions)}")
    print(f"public functions with an array without shape or a number without unit: {len(house.vague)}")
    print(f"methods that override without @override: {len(house.unmarked_overrides)}")
    if arguments.list:
        for entry in (*house.words, *house.undocumented, *house.vague, *house.unmarked_overrides):
            print(entry)


if __name__ == "__main__":
    main()
