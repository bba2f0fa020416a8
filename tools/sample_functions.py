"""Draw public functions by seed and print them with file and docstring, for a reader's review.

    python -m tools.sample_functions [--seed 12] [--count 30] [--source]

The reader answers for each function: are arguments, result, shapes and units documented, and is it understood at first
reading? The same seed and the same source tree give the same sample. A property reads as an attribute: its docstring
describes the value in one sentence, without sections. The docstring of a command is its help page, and the options'
help texts (in the source) describe its arguments.
"""

from __future__ import annotations

import argparse
import ast
import random
from pathlib import Path

from tools.house import ROOT, Function, measure


def draw(root: Path, seed: int, count: int) -> list[Function]:
    """Draw public functions without replacement.

    Args:
        root: Repository with the folders hframe_gym/ and agents/.
        seed: Seed of the draw.
        count: Number of functions.

    Returns:
        The functions, in the order of the draw.
    """
    functions = sorted(measure(root).public_functions, key=lambda f: (str(f.path), f.name, f.node.lineno))
    return random.Random(seed).sample(functions, min(count, len(functions)))


def describe(function: Function, *, root: Path = ROOT, source: bool = False) -> str:
    """Format a function for the reader.

    Args:
        function: Function to print.
        root: Repository that contains its file.
        source: Whether to print the complete source instead of signature and docstring.

    Returns:
        Heading with file and line, then the signature and the docstring, or the source.
    """
    node = function.node
    heading = f"{function.path}:{node.lineno}  {function.name}"
    if source:
        lines = (root / function.path).read_text("utf-8").splitlines()
        first = min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])
        return "\n".join([heading, *lines[first - 1 : node.end_lineno]])
    returns = f" -> {ast.unparse(node.returns)}" if node.returns else ""
    docstring = ast.get_docstring(node) or "(no docstring)"
    indented = "\n".join(f"    {line}".rstrip() for line in docstring.splitlines())
    decorators = "".join(f"@{ast.unparse(decorator)}\n" for decorator in node.decorator_list)
    return f"{heading}\n{decorators}{node.name}({ast.unparse(node.args)}){returns}\n{indented}"


def main() -> None:
    """Print the sample."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
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
