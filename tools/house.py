"""Measure how readable and how well cut the package is: words, module and function sizes, docstring sections.

    python -m tools.house [--list]

`--list` also prints every word that counts, every docstring that lacks a section, and every array without a shape and
number without a unit in a docstring. tests/test_house.py holds the limits on these. Sizes are printed, not limited: a
module is one idea and a function does one thing, with the length that this needs.
"""

from __future__ import annotations

import argparse
import ast
import re
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# Words of the private dialect that docs and code no longer use; see CONTRIBUTING.md.
WORDS = ("own", "told", "stands", "asked", "badly", "whole", "share", "shown", "missed", "judged")
MAX_WORDS_PER_1000_LINES = 5.0

_WORD = re.compile(rf"\b({'|'.join(WORDS)})\b", re.IGNORECASE)
_Function = ast.FunctionDef | ast.AsyncFunctionDef
# Decorated functions that read as attributes, or whose documentation is elsewhere.
_EXEMPT_DECORATORS = ("property", "cached_property", "overload", "setter", "override")
_COMMAND_DECORATORS = ("command", "callback")  # Typer prints the docstring; each option has its help text
_PROPERTY_DECORATORS = ("property", "cached_property")

# Annotations of arrays, and of quantities that may be arrays. Their description states a shape, "shape (n, drives)" or
# "any shape"; where many operands have the same one, the text above the sections may state it.
_ARRAY = re.compile(r"\b(Array|ArrayLike|NDArray|Positions|Tensor|Value)\b")
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

    def missing_sections(self) -> list[str]:
        """Return the docstring sections that the signature calls for and the docstring lacks.

        Returns:
            Some of "docstring", "Args" and "Returns".
        """
        decorators = {_last_name(decorator) for decorator in self.node.decorator_list}
        if decorators.intersection(_EXEMPT_DECORATORS):
            return []
        docstring = ast.get_docstring(self.node)
        if docstring is None:
            return ["docstring"]
        if decorators.intersection(_COMMAND_DECORATORS):
            return []
        missing = []
        if self._arguments() and not re.search(r"^Args:$", docstring, re.MULTILINE):
            missing.append("Args")
        if self._returns_value() and not re.search(r"^(Returns|Yields):$", docstring, re.MULTILINE):
            missing.append("Returns")
        return missing

    def vague_entries(self, array_classes: Collection[str] = ()) -> list[str]:
        """Return the entries of the docstring that describe an array without a shape or a float without a unit.

        A parameter without annotation counts as an array. Parameters and results without an entry do not count.

        Args:
            array_classes: Names of classes that hold arrays; a result of such a class must state a shape as well.

        Returns:
            Entries as "name: no shape", "name: no unit"; the name is "Returns" for results and properties.
        """
        decorators = {_last_name(decorator) for decorator in self.node.decorator_list}
        docstring = ast.get_docstring(self.node)
        if docstring is None or decorators.intersection(_COMMAND_DECORATORS):
            return []
        annotation = ast.unparse(self.node.returns) if self.node.returns else "Array"
        if decorators.intersection(_PROPERTY_DECORATORS):
            described = {"Returns": (annotation, docstring)}
        else:
            entries = _entries(_section(docstring, "Args"))
            described = {x.arg: (_annotation(x), entries.get(x.arg, "")) for x in self._arguments()}
            result = _section(docstring, "Returns") or _section(docstring, "Yields")
            described["Returns"] = (annotation, result)
        prose = re.split(r"^(?:Args|Returns|Yields|Raises):$", docstring, flags=re.MULTILINE)[0]
        vague = []
        for name, (annotated, text) in described.items():
            is_array = _ARRAY.search(annotated) is not None
            if name == "Returns" and "cli" not in self.path.parts:  # the tables of the command line are those of rich
                is_array |= not set(re.findall(r"\w+", annotated)).isdisjoint(array_classes)
            if text and is_array and "shape" not in text and "shape (" not in prose:
                vague.append(f"{name}: no shape")
            elif text and _NUMBER.fullmatch(annotated) and not _UNIT.search(" ".join(text.split())):
                vague.append(f"{name}: no unit")
        return vague

    def _arguments(self) -> list[ast.arg]:
        """Return the documented parameters: all but self, cls and those with a leading underscore."""
        a = self.node.args
        every = [*a.posonlyargs, *a.args, *a.kwonlyargs, *(x for x in (a.vararg, a.kwarg) if x)]
        return [x for x in every if x.arg not in ("self", "cls") and not x.arg.startswith("_")]

    def _returns_value(self) -> bool:
        """Return whether the annotation promises a value."""
        returns = self.node.returns
        return returns is not None and ast.unparse(returns) not in ("None", "NoReturn", "Never")


@dataclass
class House:
    """Measures of a source tree.

    Attributes:
        lines: Number of lines of all modules.
        words: Occurrences of `WORDS` as "path:line: word".
        modules: Number of lines by module of hframe_gym without effects/, agents and the packages' __init__ files.
        packages: Number of lines by __init__ file of the same packages.
        module_lines: Number of lines by module, all of them.
        functions: All functions and methods that are not nested in a function.
        bases: Names of the base classes by the name of a class.
        array_classes: Names of the classes with a field that is annotated as an array.
    """

    lines: int = 0
    words: list[str] = field(default_factory=list)
    modules: dict[Path, int] = field(default_factory=dict)
    packages: dict[Path, int] = field(default_factory=dict)
    module_lines: dict[Path, int] = field(default_factory=dict)
    functions: list[Function] = field(default_factory=list)
    bases: dict[str, list[str]] = field(default_factory=dict)
    array_classes: set[str] = field(default_factory=set)

    @property
    def words_per_1000_lines(self) -> float:
        """Return the occurrences of `WORDS` per 1000 lines."""
        return 1000.0 * len(self.words) / max(self.lines, 1)

    @property
    def public_functions(self) -> list[Function]:
        """Return the public functions that need all sections.

        Effects document their formulas in one line each; the formulas of registers have the contract of the functions
        of the same name in `elementwise`.
        """
        return [
            f for f in self.functions if f.public and "effects" not in f.path.parts and f.path.stem != "lane_formulas"
        ]

    @property
    def undocumented(self) -> list[str]:
        """Return the public functions whose docstring lacks a section as "path:line: name lacks ...".

        A method with a docstring inherits the sections of the base class's method.
        """
        complete = {f.name for f in self.public_functions if not f.missing_sections()}
        return [
            f"{_where(f)} lacks {', '.join(missing)}"
            for f in self.public_functions
            if (missing := f.missing_sections()) and (missing == ["docstring"] or not self._inherits(f.name, complete))
        ]

    @property
    def vague(self) -> list[str]:
        """Return the public functions' arrays without a shape and floats without a unit, "path:line: name (...)"."""
        return [
            f"{_where(f)} ({', '.join(vague)})"
            for f in self.public_functions
            if (vague := f.vague_entries(self.array_classes))
        ]

    def _inherits(self, name: str, complete: set[str]) -> bool:
        """Return whether a base class of this repository has a completely documented method of the same name."""
        class_name, _, method = name.rpartition(".")
        return any(
            f"{base}.{method}" in complete or self._inherits(f"{base}.{method}", complete)
            for base in self.bases.get(class_name, ())
        )


def measure(root: Path = ROOT) -> House:
    """Measure hframe_gym and agents.

    Args:
        root: Repository with the folders hframe_gym/ and agents/.

    Returns:
        The measures.
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
            if isinstance(node, ast.ClassDef):
                house.bases[node.name] = [_last_name(base) for base in node.bases]
                fields = [ast.unparse(item.annotation) for item in node.body if isinstance(item, ast.AnnAssign)]
                if any(map(_ARRAY.search, fields)):
                    house.array_classes.add(node.name)
    return house


def source_files(root: Path) -> list[Path]:
    """List the modules of hframe_gym and agents.

    Args:
        root: Repository with the folders hframe_gym/ and agents/.

    Returns:
        Paths in alphabetical order, each module once although hframe_gym/agents may be a link.
    """
    package = (p for p in (root / "hframe_gym").rglob("*.py") if p.relative_to(root).parts[1] != "agents")
    return sorted([*package, *(root / "agents").rglob("*.py")])


def _functions(tree: ast.Module | ast.ClassDef, prefix: str = "") -> Iterator[tuple[str, _Function]]:
    """Yield the qualified names and syntax trees of functions and methods, not of nested functions."""
    for node in tree.body:
        if isinstance(node, ast.ClassDef):
            yield from _functions(node, f"{prefix}{node.name}.")
        elif isinstance(node, _Function):
            yield prefix + node.name, node


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
    """Return the last part of a dotted name, without arguments or subscripts: "Base" of `module.Base[int]`."""
    return re.split(r"[(\[]", ast.unparse(expression))[0].rpartition(".")[2]


def _where(function: Function) -> str:
    return f"{function.path}:{function.node.lineno}: {function.name}"


def main() -> None:
    """Print the measures beside their limits."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--list", action="store_true", help="print every finding")
    parser.add_argument("--root", type=Path, default=ROOT, help="repository to measure (default: this one)")
    arguments = parser.parse_args()
    house = measure(arguments.root.resolve())
    counts = Counter(entry.rsplit(" ", 1)[1].lower() for entry in house.words)
    listed = ", ".join(f"{word} {count}" for word, count in counts.most_common())
    longest = sorted(house.module_lines.items(), key=lambda item: -item[1])[:5]
    long_functions = sorted(house.functions, key=lambda function: -function.lines)[:5]
    print(f"words per 1000 lines: {house.words_per_1000_lines:.1f} (limit {MAX_WORDS_PER_1000_LINES:g}): {listed}")
    print(f"lines of hframe_gym and agents: {house.lines}")
    print(f"in hframe_gym without effects/: {len(house.modules)} modules, {len(house.packages)} package __init__ files")
    print(f"longest modules: {', '.join(f'{path} {count}' for path, count in longest)}")
    print(f"longest functions: {', '.join(f'{_where(f)} {f.lines}' for f in long_functions)}")
    print(f"public functions that lack a section: {len(house.undocumented)} of {len(house.public_functions)}")
    print(f"public functions with an array without shape or a number without unit: {len(house.vague)}")
    if arguments.list:
        for entry in (*house.words, *house.undocumented, *house.vague):
            print(entry)


if __name__ == "__main__":
    main()
