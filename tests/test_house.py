"""Hold the limits on language and docstrings."""

import ast
from pathlib import Path

import pytest

from tools import house
from tools.house import Function, House, measure
from tools.repository import ROOT
from tools.sample_functions import describe, draw, inherited_docstring


@pytest.fixture(scope="module")
def repository() -> House:
    return measure()


def test_words_of_the_private_dialect_are_rare(repository: House) -> None:
    assert repository.words_per_1000_lines <= house.MAX_WORDS_PER_1000_LINES, repository.words


def test_public_functions_have_docstrings(repository: House) -> None:
    assert repository.undocumented == []


def test_docstrings_state_shapes_and_units(repository: House) -> None:
    assert repository.vague == []


def test_methods_that_override_say_so(repository: House) -> None:
    assert repository.unmarked_overrides == []


def test_an_override_is_recognized_over_several_classes(tmp_path: Path) -> None:
    for folder in ("hframe_gym", "agents"):
        (tmp_path / folder).mkdir()
    (tmp_path / "hframe_gym" / "base.py").write_text(
        "class A(Generic[T]):\n    def f(self): ...\n    def g(self): ...\nclass B(base.A[int]):\n    x = 1\n"
    )
    (tmp_path / "agents" / "derived.py").write_text(
        "class C(B):\n"
        "    @override\n"
        "    def f(self): ...\n"
        "    def g(self): ...\n"
        "    def __init__(self): ...\n"
    )
    assert measure(tmp_path).unmarked_overrides == ["agents/derived.py:4: C.g"]


def _function(source: str) -> Function:
    node = ast.parse(source).body[0]
    assert isinstance(node, ast.FunctionDef)
    return Function(Path("module.py"), node.name, node)


@pytest.mark.parametrize(
    ("source", "needed"),
    [
        ("def f(x: int) -> int:\n    return x", True),
        ("def f(x: int) -> int:\n    '''Return x.'''", False),
        ("@override\ndef f(self) -> int:\n    return 1", False),
        ("@app.command()\ndef f(x: int) -> None:\n    print(x)", True),
        ("@property\ndef f(self) -> int:\n    return 1", False),
    ],
)
def test_functions_that_need_a_docstring(source: str, needed: bool) -> None:
    assert _function(source).needs_docstring is needed


@pytest.mark.parametrize(
    ("source", "vague"),
    [
        ("def f(x: Array) -> None:\n    '''Take x.'''", ["x: not described"]),
        ("def f(x: float) -> None:\n    '''Take x.'''", ["x: not described"]),
        ("def f(x: float) -> None:\n    '''Wait for the time `x`, s.'''", []),
        ("def f(x: Array) -> None:\n    '''Take the `x`, m.'''", ["x: no shape"]),
        ("def f(x: Volts) -> Volts:\n    '''Take x.'''", []),
        ("@override\ndef f(x: Array) -> Array:\n    '''Take x otherwise.'''", []),
        ("def f() -> Array:\n    '''Return the force, N.'''", ["Returns: no shape"]),
        ("def f() -> Array:\n    '''Return the force, N, shape (n,).'''", []),
        ("def f() -> float:\n    '''Return the force.'''", ["Returns: no unit"]),
        ("def f() -> float:\n    '''Return the force, N.'''", []),
    ],
)
def test_shapes_and_units_without_sections(source: str, vague: list[str]) -> None:
    assert _function(source).vague_entries() == vague


@pytest.mark.parametrize(
    ("signature", "entry", "result", "vague"),
    [
        ("x: Array) -> Array", "State, m.", "Force, N.", ["x: no shape", "Returns: no shape"]),
        ("x: NDArray[Any] | None) -> None", "State, m, shape (n,).", "", []),
        ("x: Sequence[Array]) -> Array", "States, m, shape (...) each.", "Force, N, any shape.", []),
        ("x) -> float", "State, m.", "The machine's force.", ["x: no shape", "Returns: no unit"]),
        ("x: float) -> float", "A period.", "Force, N", ["x: no unit"]),
        ("x: float | None) -> float", "Speed, m/s; None at rest.", "Value in the unit of x.", []),
        ("*x: float) -> int", "Fractions of the voltage.", "Number.", []),
        ("x: int) -> dict[str, float]", "Number.", "Values by name.", []),
    ],
)
def test_vague_entries(signature: str, entry: str, result: str, vague: list[str]) -> None:
    returns = f"\n\n    Returns:\n        {result}" if result else ""
    docstring = f"Do it.\n\n    Args:\n        x: Quantity.\n            {entry}{returns}\n    "
    assert _function(f"def f({signature}:\n    '''{docstring}'''").vague_entries() == vague
    shaped = docstring.replace("Do it.", "Do it.\n\n    Operands have one shape (n,).")
    assert _function(f"def f({signature}:\n    '''{shaped}'''").vague_entries() == [
        entry for entry in vague if "unit" in entry
    ]


@pytest.mark.parametrize(
    ("returns", "docstring", "vague"),
    [
        ("Array", "Speeds, m/s.", ["Returns: no shape"]),
        ("Array", "Speeds, m/s, shape (n,).", []),
        ("float", "Period of the controller.", ["Returns: no unit"]),
        ("float", "Period, s.", []),
        ("str", "Name.", []),
    ],
)
def test_vague_properties(returns: str, docstring: str, vague: list[str]) -> None:
    source = f"@property\ndef f(self) -> {returns}:\n    '''{docstring}'''"
    assert _function(source).vague_entries() == vague


def test_measures_of_a_small_tree(tmp_path: Path) -> None:
    for folder in ("hframe_gym/effects", "agents"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "hframe_gym" / "long.py").write_text(
        "def f() -> None:\n    '''Do it its own way.'''\n    x = 1\n"
    )
    (tmp_path / "hframe_gym" / "__init__.py").write_text("x = 1\n")
    (tmp_path / "hframe_gym" / "effects" / "spring.py").write_text("x = 1\n")
    (tmp_path / "agents" / "big.py").write_text("x = 'owner'\n" * 400)
    found = measure(tmp_path)
    assert found.words == ["hframe_gym/long.py:2: own"]
    assert [str(path) for path in found.modules] == ["hframe_gym/long.py"]
    assert [str(path) for path in found.packages] == ["hframe_gym/__init__.py"]
    assert found.module_lines[Path("agents/big.py")] == 400
    assert found.docstring_shares == {
        "agents": (400, 0),
        "hframe_gym": (4, 1),
        "hframe_gym/effects": (1, 0),
        "total": (405, 1),
    }
    assert [(function.name, function.lines) for function in found.functions] == [("f", 3)]


def test_the_sample_depends_on_the_seed_only(repository: House, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tools.sample_functions.measure", lambda root: repository)
    first, again, other = (draw(ROOT, seed, 30) for seed in (12, 12, 13))
    assert [f.name for f in first] == [f.name for f in again]
    assert [f.name for f in first] != [f.name for f in other]
    assert len({(f.path, f.name) for f in first}) >= 29


def test_the_sample_shows_the_docstrings_of_the_overridden_method_and_of_the_class(tmp_path: Path) -> None:
    package = tmp_path / "hframe_gym"
    package.mkdir()
    (package / "base.py").write_text(
        "class Base(Generic[T]):\n    def name(self) -> str:\n        '''Return the name.'''\n"
    )
    source = "class Part(Base[int]):\n    '''A part.'''\n    def name(self) -> str:\n        return ''\n"
    (package / "part.py").write_text(source)
    method = ast.parse(source).body[0].body[1]  # type: ignore[attr-defined]
    function = Function(Path("hframe_gym/part.py"), "Part.name", method)
    assert describe(function, root=tmp_path).splitlines()[2:] == [
        "    (of Base)",
        "    Return the name.",
        "",
        "    Its class, Part:",
        "    A part.",
    ]


def test_of_two_base_classes_with_one_name_that_of_the_same_folder_is_meant(tmp_path: Path) -> None:
    for folder, text in (("agents", "far"), ("hframe_gym/app", "near"), ("hframe_gym/other", "far")):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "base.py").write_text(
            f"class Base:\n    def name(self) -> str:\n        '''Return the {text} name.'''\n"
        )
    (tmp_path / "hframe_gym/app/part.py").write_text(
        "class Part(Base):\n    @override\n    def name(self) -> str: ...\n"
    )
    (function,) = (f for f in measure(tmp_path).public_functions if f.name == "Part.name")
    assert inherited_docstring(function, tmp_path) == "(of Base)\nReturn the near name."


def test_the_sample_shows_the_options_of_a_command(tmp_path: Path) -> None:
    (tmp_path / "app.py").write_text('OutOption = Annotated[Path, typer.Option(help="Folder.")]\n')
    source = (
        "def run(out: OutOption, seed: Annotated[int, typer.Option(help='Seed.')] = 0) -> None:\n"
        "    '''Run it.'''"
    )
    (tmp_path / "module.py").write_text(source)
    assert describe(_function(source), root=tmp_path).splitlines()[1:] == [
        "run(out: OutOption, seed: int=0) -> None",
        "    Run it.",
        "",
        "    Options:",
        "        out: Folder.",
        "        seed: Seed.",
    ]
