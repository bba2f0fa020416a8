"""C of 1999 with math.h: declarations and definitions of formulas as functions."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import ClassVar

from typing_extensions import override

from .formula import Formula, Parameter
from .language import Language, write_body

# Functions that math.h lacks.
_HELPERS = {"sign": "static double {p}_sign(double x)\n{{\n    return (double)((x > 0.0) - (x < 0.0));\n}}\n"}


class C99(Language):
    """C of 1999 with math.h."""

    functions: ClassVar[Mapping[str, str]] = {
        **{name: name for name in ("exp", "log", "sin", "cos", "tanh", "sqrt", "copysign", "floor", "rint")},
        "absolute": "fabs",
        "minimum": "fmin",
        "maximum": "fmax",
    }
    signs: ClassVar[Mapping[str, str]] = {"&": "&&", "|": "||"}

    @override
    def number(self, text: str) -> str:
        """Return the text itself: C writes numbers as Python does."""
        return text

    @override
    def choice(self, condition: str, yes: str, no: str) -> str:
        """Write "condition ? yes : no"."""
        return f"{condition} ? {yes} : {no}"

    @override
    def assignment(self, target: str, value: str, *, kind: str) -> str:
        """Write "target = value;", after "const double" for a number or "const int" for a condition."""
        declared = {"number": "const double ", "condition": "const int ", "output": ""}[kind]
        return f"{declared}{target} = {value};"


def c_comment(lines: Sequence[str]) -> str:
    """Write lines as one comment of C."""
    return "/*\n" + "".join(f" * {line}".rstrip() + "\n" for line in lines) + " */\n"


def constants(parameters: Iterable[Parameter], used: Collection[str]) -> str:
    """Write the definitions of parameters as static constants, one line each.

    Args:
        parameters: All parameters.
        used: Identifiers of those to write, as `definition` returns them; other texts in it are ignored.
    """
    return "".join(
        f"static const double {p.identifier} = {p.value!r}; /* {p.comment} */\n"
        for p in parameters
        if p.identifier in used
    )


def helper_functions(language: C99) -> list[str]:
    """Write the functions that the formulas written so far use and math.h lacks, one text each."""
    return [_HELPERS[name].format(p=language.prefix) for name in sorted(language.helpers & set(_HELPERS))]


def declaration(formula: Formula, prefix: str) -> str:
    """Declare a formula as a function, after a comment that explains its arguments.

    Args:
        prefix: Prefix of the function's name, to which the name of the formula is appended.
    """
    signals = dict.fromkeys((*formula.inputs, *formula.outputs))
    about = [formula.comment, "", *(f"{signal.name}: {signal.comment}" for signal in signals)]
    return f"{c_comment(about)}{_signature(formula, prefix)};\n"


def definition(formula: Formula, language: C99) -> tuple[str, frozenset[str]]:
    """Define a formula as a function.

    Args:
        language: Writer; its prefix precedes the function's name, and the helper functions that the text uses
            are added to its `helpers`.

    Returns:
        Text of the function, and the texts of the parameters (identifiers) and inputs that it uses.
    """
    body = write_body(formula, language)
    unused = [s.name for s in formula.inputs if not body.used & set(s.elements()) and s not in formula.states]
    lines = [*(f"(void){name};" for name in unused), *body.lines]
    return f"/* {formula.comment} */\n{function_text(_signature(formula, language.prefix), lines)}", body.used


def function_text(signature: str, lines: Sequence[str]) -> str:
    """Write a function.

    Args:
        signature: Return type, name and arguments, such as "double f(double x)".
        lines: Lines of its body, without indentation and line breaks.
    """
    return signature + "\n{\n" + "".join(f"    {line}\n" for line in lines) + "}\n"


def _signature(formula: Formula, prefix: str) -> str:
    """Return the first line of a function without the brace."""
    states = set(formula.states)
    arguments = [
        f"double {s.name}" if not s.size else f"{'' if s in states else 'const '}double {s.name}[{s.size}]"
        for s in formula.inputs
    ]
    arguments += [f"double {s.name}[{s.size}]" for s in formula.outputs if s not in states]
    return f"void {prefix}_{formula.name}({', '.join(arguments)})"
