"""Draw public functions by seed and print them with file and docstring, for a reader's review.

    python -m tools.sample_functions [--seed 12] [--count 30] [--source]

The reader answers for each function: are arguments, result, shapes and units documented, and is it understood
at first reading? The same seed and the same source tree give the same sample. A property reads as an
attribute: its docstring describes the value in one sentence, without sections. A method is followed by the
docstring of its class, which describes the attributes that the method reads. The docstring of a command is
its help page; the help texts of its options, printed behind it, describe its arguments. Words in braces such
as {tasks} become lists of names there.
"""

from __future__ import annotations

import ast
import copy
import random
from collections.abc import Iterator
from functools import cache
from itertools import takewhile
from pathlib import Path

from tools.command_line import command_line
from tools.house import Function, measure
from tools.repository import ROOT


def draw(root: Path, seed: int, count: int) -> list[Function]:
    """Draw public functions without replacement.

    Args:
        root: Repository with the folders hframe_gym/ and agents/.
    """
    functions = sorted(measure(root).public_functions, key=lambda f: (str(f.path), f.name, f.node.lineno))
    return random.Random(seed).sample(functions, min(count, len(functions)))


class _PlainTypes(ast.NodeTransformer):
    """Replace Annotated[type, ...] by type."""

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        if ast.unparse(node.value) == "Annotated" and isinstance(node.slice, ast.Tuple):
            return node.slice.elts[0]
        return node


def option_helps(function: Function, root: Path = ROOT) -> dict[str, str]:
    """Collect the help texts of a command's options (typer), which describe its arguments.

    Args:
        function: Any function. Its arguments may be annotated with an alias such as `OutOption` of
            hframe_gym/cli/.
        root: Repository that contains its file.

    Returns:
        Help text by name of the argument; empty for a function without options.
    """
    aliases: dict[str, ast.expr] = {}
    for path in sorted((root / function.path).parent.glob("*.py")):
        for node in ast.parse(path.read_text("utf-8")).body:
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
                aliases[node.targets[0].id] = node.value
    helps: dict[str, str] = {}
    for argument in [
        *function.node.args.posonlyargs,
        *function.node.args.args,
        *function.node.args.kwonlyargs,
    ]:
        annotation = argument.annotation
        if isinstance(annotation, ast.Name):
            annotation = aliases.get(annotation.id)
        if isinstance(annotation, ast.Subscript) and ast.unparse(annotation.value) == "Annotated":
            for call in ast.walk(annotation.slice):
                for keyword in call.keywords if isinstance(call, ast.Call) else ():
                    if keyword.arg == "help" and isinstance(keyword.value, ast.Constant):
                        helps[argument.arg] = str(keyword.value.value)
    return helps


@cache
def _classes(root: Path) -> dict[str, list[tuple[Path, ast.ClassDef]]]:
    """Return the classes of the packages, with their files relative to the repository, by name."""
    found: dict[str, list[tuple[Path, ast.ClassDef]]] = {}
    for folder in ("hframe_gym", "agents"):
        for path in sorted((root / folder).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text("utf-8"))):
                if isinstance(node, ast.ClassDef):
                    found.setdefault(node.name, []).append((path.relative_to(root), node))
    return found


def _bases(name: str, path: Path, root: Path) -> Iterator[ast.ClassDef]:
    """Yield the base classes of a class, nearest first, without those of other packages.

    Of several classes with one name, the one whose file has the most folders in common with `path` is meant.
    """
    classes = _classes(root)
    if name not in classes:
        return

    def common_folders(named: tuple[Path, ast.ClassDef]) -> int:
        pairs = zip(named[0].parts, path.parts, strict=False)
        return len([*takewhile(lambda pair: pair[0] == pair[1], pairs)])

    where, node = max(classes[name], key=common_folders)
    for base in node.bases:
        plain = base.value if isinstance(base, ast.Subscript) else base
        base_name = ast.unparse(plain).rpartition(".")[2]
        if base_name in classes:
            yield max(classes[base_name], key=common_folders)[1]
            yield from _bases(base_name, where, root)


def inherited_docstring(function: Function, root: Path = ROOT) -> str:
    """Return the docstring of the method that a method overrides, with the name of its class; "" without one.

    Args:
        function: Any function.
        root: Repository that contains its file.
    """
    owner, _, method = function.name.rpartition(".")
    for base in _bases(owner, function.path, root):
        for node in base.body:
            if isinstance(node, ast.FunctionDef) and node.name == method and ast.get_docstring(node):
                return f"(of {base.name})\n{ast.get_docstring(node)}"
    return ""


def class_docstring(function: Function, root: Path = ROOT) -> str:
    """Return the docstring of the class of a method; "" for a function, or without one.

    Args:
        function: Any function.
        root: Repository that contains its file.
    """
    owner = function.name.rpartition(".")[0].rpartition(".")[2]
    for path, node in _classes(root).get(owner, []):
        if path == function.path:
            return ast.get_docstring(node) or ""
    return ""


def describe(function: Function, *, root: Path = ROOT, source: bool = False) -> str:
    """Format a function for the reader.

    Args:
        root: Repository that contains its file.
        source: Whether to print the complete source instead of signature and docstring.

    Returns:
        Heading with file and line, then the signature, the docstring and, for a command, its options, and the
        docstring of a method's class; or the source.
    """
    node = function.node
    heading = f"{function.path}:{node.lineno}  {function.name}"
    if source:
        lines = (root / function.path).read_text("utf-8").splitlines()
        first = min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])
        return "\n".join([heading, *lines[first - 1 : node.end_lineno]])
    returns = f" -> {ast.unparse(node.returns)}" if node.returns else ""
    docstring = ast.get_docstring(node) or inherited_docstring(function, root) or "(no docstring)"
    if options := option_helps(function, root):
        docstring += "\n\nOptions:\n" + "\n".join(f"    {name}: {text}" for name, text in options.items())
    if described := class_docstring(function, root):
        docstring += f"\n\nIts class, {function.name.rpartition('.')[0]}:\n{described}"
    indented = "\n".join(f"    {line}".rstrip() for line in docstring.splitlines())
    decorators = "".join(f"@{ast.unparse(decorator)}\n" for decorator in node.decorator_list)
    arguments = ast.unparse(_PlainTypes().visit(copy.deepcopy(node.args)))
    return f"{heading}\n{decorators}{node.name}({arguments}){returns}\n{indented}"


def main() -> None:
    """Print the sample."""
    parser = command_line(__doc__)
    parser.add_argument("--seed", type=int, default=12)
    parser.add_argument("--count", type=int, default=30)
    parser.add_argument("--source", action="store_true", help="print the complete source")
    parser.add_argument("--root", type=Path, default=ROOT, help="repository to sample (default: this one)")
    arguments = parser.parse_args()
    root = arguments.root.resolve()
    for number, function in enumerate(draw(root, arguments.seed, arguments.count), start=1):
        print(f"{number}. {describe(function, root=root, source=arguments.source)}\n")


if __name__ == "__main__":
    main()
