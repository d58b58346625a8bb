"""Kernels run without Python in the FMU: they allocate nothing, raise nothing and only compute. Here it is checked."""

import ast
import builtins
from collections.abc import Iterator
from pathlib import Path

import pytest

import tissue_contact.kernels

FOLDER = Path(tissue_contact.kernels.__file__).parent
ARRANGING = {"__init__", "bundle", "compiled", "deferred", "dual", "layout"}  # run in Python, for compiler and arrays
DECORATORS = {"kernel", "inner", "pointwise"}
MODULES = {"math", "typing", "numpy", "numpy.typing", "tissue_contact.status"}
BUILTINS = {"abs", "bool", "float", "int", "len", "max", "min", "range"}
NUMPY = {"abs", "float32", "float64", "fmax", "fmin", "int32", "int64", "sqrt", "uint32", "uint64", "uint8"}
REFUSED = {
    ast.Raise: "raises",
    ast.Assert: "raises",
    ast.Try: "catches",
    ast.With: "catches",
    ast.Global: "has a global that varies",
    ast.Nonlocal: "has a global that varies",
    ast.List: "allocates a list",
    ast.ListComp: "allocates a list",
    ast.Dict: "allocates a dict",
    ast.DictComp: "allocates a dict",
    ast.Set: "allocates a set",
    ast.SetComp: "allocates a set",
    ast.GeneratorExp: "allocates a generator",
    ast.Yield: "allocates a generator",
    ast.JoinedStr: "makes a text",
    ast.Lambda: "has a function within",
    ast.FunctionDef: "has a function within",
    ast.ClassDef: "has a class within",
}


def broken(source: str) -> list[str]:
    """Every breach of the rules in the source of a module of kernels, with its line."""
    return [f"line {line}: {what}" for line, what in sorted(_module(ast.parse(source)))]


def _module(tree: ast.Module) -> Iterator[tuple[int, str]]:
    for node in tree.body:
        if isinstance(node, ast.FunctionDef):
            if [ast.unparse(d) for d in node.decorator_list] not in [[d] for d in DECORATORS]:
                yield node.lineno, f"{node.name} must have one decorator of {', '.join(sorted(DECORATORS))}"
            yield from (found for part in node.body for found in _statement(part))
        elif isinstance(node, ast.Import):
            yield from ((node.lineno, f"imports {a.name}") for a in node.names if a.name not in MODULES)
        elif isinstance(node, ast.ImportFrom):
            name = "." * node.level + (node.module or "")
            if name not in MODULES and not name.startswith("tissue_contact.kernels."):
                yield node.lineno, f"imports {name}"
        elif isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            continue
        elif isinstance(node, ast.Assign):
            if not all(isinstance(n, ast.Name) and n.id.isupper() for n in _names(node.targets)):
                yield node.lineno, "has a name that is no constant"
            if isinstance(node.value, (ast.List, ast.Dict, ast.Set, ast.ListComp, ast.DictComp, ast.SetComp)):
                yield node.lineno, "has a constant that can vary"
        elif not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)):
            yield node.lineno, f"has a {type(node).__name__} beside its kernels"


def _names(targets: list[ast.expr]) -> Iterator[ast.expr]:
    for target in targets:
        yield from _names(target.elts) if isinstance(target, ast.Tuple) else [target]


def _statement(statement: ast.stmt) -> Iterator[tuple[int, str]]:
    for node in ast.walk(statement):
        if type(node) in REFUSED:
            yield node.lineno, REFUSED[type(node)]  # type: ignore[attr-defined]
        elif isinstance(node, ast.Call):
            what = _call(node.func)
            if what:
                yield node.lineno, what
        elif isinstance(node, ast.Assign | ast.AugAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            sliced = any(isinstance(t, ast.Subscript) and isinstance(t.slice, ast.Slice) for t in _names(targets))
            if sliced and not (isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant)):
                yield node.lineno, "assigns to a slice what is no plain number"


def _call(function: ast.expr) -> str | None:
    if isinstance(function, ast.Name):
        foreign = function.id in dir(builtins) and function.id not in BUILTINS
        return f"calls {function.id}" if foreign else None
    whole = ast.unparse(function)
    owner, _, name = whole.rpartition(".")
    return None if owner == "math" or (owner == "np" and name in NUMPY) else f"calls {whole}"


@pytest.mark.parametrize("file", sorted(f.stem for f in FOLDER.glob("*.py") if f.stem not in ARRANGING))
def test_kernels_keep_the_rules(file: str) -> None:
    assert broken((FOLDER / f"{file}.py").read_text("utf-8")) == []


@pytest.mark.parametrize(
    ("body", "what"),
    [
        ("x = np.zeros(3)", "calls np.zeros"),
        ("x = np.array((1, 2))", "calls np.array"),
        ("x = a.reshape(2, 3)", "calls a.reshape"),
        ("x = a[1:].copy()", "calls a[1:].copy"),
        ("x = [0.0, 1.0]", "allocates a list"),
        ("x = max([b for b in a])", "allocates a list"),
        ("x = {1: 2}", "allocates a dict"),
        ("x = {1, 2}", "allocates a set"),
        ("x = max(b for b in a)", "allocates a generator"),
        ("x = list(a)", "calls list"),
        ("x = sorted(a)", "calls sorted"),
        ("print(a)", "calls print"),
        ("raise ValueError", "raises"),
        ("assert a", "raises"),
        ("try:\n        x = 1\n    except ValueError:\n        x = 2", "catches"),
        ("global x", "has a global that varies"),
        ("x = lambda: 1", "has a function within"),
        ("a[:] = b", "assigns to a slice what is no plain number"),
        ("a[1:3] = b[2:4]", "assigns to a slice what is no plain number"),
        ("a[:] += 1.0", "assigns to a slice what is no plain number"),
    ],
)
def test_a_breach_is_found(body: str, what: str) -> None:
    assert broken(f"@kernel\ndef f(a, b):\n    for _ in range(2):\n        pass\n    {body}\n") == [f"line 5: {what}"]


@pytest.mark.parametrize(
    ("source", "what"),
    [
        ("import scipy\n", "imports scipy"),
        ("from tissue_contact.scene import Scene\n", "imports tissue_contact.scene"),
        ("from .vectors import dot\n", "imports .vectors"),
        ("def f():\n    return 1\n", "f must have one decorator of inner, kernel, pointwise"),
        ("@njit\ndef f():\n    return 1\n", "f must have one decorator of inner, kernel, pointwise"),
        ("COUNTS = [0]\n", "has a constant that can vary"),
        ("count = 0\n", "has a name that is no constant"),
        ("for k in range(3):\n    pass\n", "has a For beside its kernels"),
    ],
)
def test_a_breach_beside_the_kernels_is_found(source: str, what: str) -> None:
    assert [found.partition(": ")[2] for found in broken(source)] == [what]


def test_what_is_allowed() -> None:
    source = (
        '"""Text."""\n\nimport math\n\nA, B = 0, 1\n\n\n@inner\ndef f(a, b):\n    """Text."""\n    a[:] = 0.0\n'
        "    x, y = b[2:5], (1.0, 2.0)\n"
        "    for k in range(len(x)):\n        a[k] = math.sqrt(x[k]) + np.fmax(y[0], 1.0)\n"
        "    return a[0], g(x)\n"
    )
    assert broken(source) == []
