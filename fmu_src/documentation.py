"""The documentation directory of an FMU: a page on the model and its variables, and the licences."""

import html
import importlib.metadata
import math
from pathlib import Path

import ziglang

from tissue_contact.assembly import Assembly
from tissue_contact.errors import WorkError
from tissue_contact.fmu.compile import FMI_HEADERS
from tissue_contact.fmu.description import generation_tool, number
from tissue_contact.fmu.equations import equations
from tissue_contact.scene import parse_scene
from tissue_contact.variables import CAUSALITY, Block

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 60em; margin: 2em auto; padding: 0 1em; color: #222; }
table { border-collapse: collapse; width: 100%; font-size: 14px; }
th, td { text-align: left; padding: 0.25em 0.6em; border-bottom: 1px solid #ddd; vertical-align: top; }
.equation { margin: 0.8em 2em; font-family: "Cambria Math", "STIX Two Math", serif; }
img { max-width: 100%; }
code { font-size: 0.9em; }
"""

_USE = """
<h2>Use</h2>
<p>Over a communication step the pose goes from the one of the last communication point to the one set now.
A parameter that is set takes effect at once in the next step. A call that returns an error leaves the instance as it
was, and the log says what to do. After fmi2Discard the state from before the step stands: take a smaller
step. The exact scene is <code>resources/scene.toml</code>.</p>
"""


def _bound(value: float) -> str:
    return number(value) if math.isfinite(value) else ""


def _table(assembly: Assembly, block: Block) -> str:
    rows = [
        f"<tr><td><code>{html.escape(v.name)}</code></td><td>{html.escape(v.unit)}</td>"
        f"<td>{'' if block == 'outputs' else number(v.start)}</td><td>{_bound(v.minimum)}</td>"
        f"<td>{_bound(v.maximum)}</td><td>{html.escape(v.description)}</td></tr>\n"
        for v in assembly.variables
        if v.block == block
    ]
    head = "<tr><th>Name</th><th>Unit</th><th>Start</th><th>Least</th><th>Greatest</th><th>Meaning</th></tr>"
    return f"<h3>{CAUSALITY[block].capitalize()}s</h3>\n<table>\n{head}\n{''.join(rows)}</table>\n" if rows else ""


def page(assembly: Assembly, picture: bool) -> str:
    """The HTML page, in English, complete in itself but for the picture beside it."""
    scene = parse_scene(assembly.source, Path())
    name = html.escape(assembly.name)
    tables = "".join(_table(assembly, block) for block in ("inputs", "outputs", "parameters"))
    image = f'<p><img src="model.png" alt="{name}"></p>\n' if picture else ""
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{name}</title>\n'
        f"<style>{_STYLE}</style>\n</head>\n<body>\n<h1>{name}</h1>\n<p>{html.escape(assembly.description)}</p>\n"
        f"{image}<h2>Model</h2>\n{equations(scene)}{_USE}<h2>Variables</h2>\n{tables}"
        f'<p>Made by {html.escape(generation_tool())}. <a href="licenses/license.txt">Licences</a>.</p>\n'
        "</body>\n</html>\n"
    )


def _distribution_license(package: str, name: str) -> str:
    for file in importlib.metadata.files(package) or ():
        if file.name == name and ".dist-info" in str(file):
            return file.read_text("utf-8")
    # An editable installation keeps the file in the checkout.
    beside = Path(__file__).parents[1] / name
    if package == "tissue-contact" and beside.exists():
        return beside.read_text("utf-8")
    raise WorkError(f"the installed package {package} has no file {name}: install it again")


def _headers_license() -> str:
    text = (FMI_HEADERS / "fmi2FunctionTypes.h").read_text("utf-8")
    return text[text.index("   Copyright (C)") : text.index("*/", text.index("   Copyright (C)"))]


def licenses() -> dict[str, str]:
    """File name -> text: our licence and those of everything that the binaries contain parts of."""
    zig = Path(ziglang.__file__).parent
    return {
        "license.txt": _distribution_license("tissue-contact", "LICENSE"),
        "fmi-headers.txt": _headers_license(),
        "numba.txt": _distribution_license("numba", "LICENSE"),
        "zig-compiler-rt.txt": (zig / "LICENSE").read_text("utf-8"),
        "mingw-w64-runtime.txt": (zig / "lib/libc/mingw/COPYING").read_text("utf-8"),
    }


def entries(assembly: Assembly, picture: bytes | None) -> dict[str, bytes]:
    """Zip entries of the documentation directory."""
    made = {"documentation/index.html": page(assembly, picture is not None).encode()}
    if picture is not None:
        made["documentation/model.png"] = picture
    for name, text in licenses().items():
        made[f"documentation/licenses/{name}"] = text.encode()
    return made
