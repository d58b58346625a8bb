"""Building an .fmu: what is in it, that it is the same every time, and what stops it."""

import dataclasses
import os
import re
import signal
import struct
import subprocess
import sys
import time
import zipfile
from pathlib import Path
from typing import get_args

import fmpy
import numpy as np
import pytest
from fmpy.model_description import read_model_description
from fmu_fixture import GAIN, KERNELS, PLATFORM, POSITION, PULL, VARIABLES, tiny_assembly, tiny_fmu
from lxml import etree

from tissue_contact import scenarios, status
from tissue_contact.assemble import INTEGRATORS
from tissue_contact.errors import InputError, WorkError
from tissue_contact.fmu import archive, compile, description, documentation, entry, machine_code, model_bin
from tissue_contact.fmu.build import build
from tissue_contact.fmu.check import check, fmi_functions
from tissue_contact.fmu.exports import exported
from tissue_contact.fmu.units import base_unit
from tissue_contact.kernels.bundle import Bundle
from tissue_contact.scene import Response
from tissue_contact.variables import Variable

PNG = bytes.fromhex(
    "89504e470d0a1a0a0000000d4948445200000001000000010802000000907753de0000000c49444154789c63f8ffff3f0005fe02fe"
    "dccc59e70000000049454e44ae426082"
)


@pytest.fixture(scope="module")
def everywhere(tmp_path_factory):
    """An .fmu for every platform, with a picture."""
    output = tmp_path_factory.mktemp("all") / "tiny.fmu"
    return build(tiny_assembly(), output, picture=PNG, kernels=KERNELS)


def entries(path):
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def test_reason_of_a_failed_compilation(tmp_path):
    sources = {
        "initialize(model, parameters, state, inputs, outputs, scratch)": "return parameters.no_such",
        "step(model, parameters, state, inputs, h, outputs, scratch)": "return 0",
    }
    functions = [f"@njit\ndef {head}:\n    {body}\n" for head, body in sources.items()]
    (tmp_path / "step.py").write_text("from numba import njit\n\n\n" + "\n\n".join(functions))
    with pytest.raises(WorkError, match="Unknown attribute 'no_such'") as caught:
        compile.kernels_ir(tmp_path / "step.py", lambda _: None)
    told = str(caught.value)
    assert "return parameters.no_such" in told and "step.py" in told
    assert "site-packages" not in told and "\x1b" not in told and told.count("\n") < 6


@pytest.mark.parametrize(
    ("trace", "told"),
    [
        ("Traceback:\n  File\nImportError: No module named 'x'\n", "ImportError: No module named 'x'"),
        ("Segmentation fault\n", "Segmentation fault"),
        ("", "it ended without a word"),
    ],
)
def test_reason_of_other_failures(trace, told):
    assert compile.reason(trace) == told


# --- what the checkers say ----------------------------------------------------------------------------------


def test_no_checker_finds_anything(everywhere):
    assert check(everywhere) == []


def test_content(everywhere):
    names = set(entries(everywhere))
    assert names >= {
        "modelDescription.xml",
        "model.png",
        "resources/model.bin",
        "resources/scene.toml",
        "documentation/index.html",
        "documentation/model.png",
        "documentation/licenses/license.txt",
        "binaries/linux64/tiny.so",
        "binaries/win64/tiny.dll",
        "binaries/darwin64/tiny.dylib",
        "binaries/aarch64-linux/tiny.so",
    }


def rewritten(path, output, change):
    """The .fmu with its entries changed by a function of the dictionary."""
    content = entries(path)
    change(content)
    archive.write(output, content)
    return output


def edit(name, old, new):
    def change(content):
        assert old in content[name]
        content[name] = content[name].replace(old, new)

    return change


@pytest.mark.parametrize(
    ("change", "finding"),
    [
        (edit("modelDescription.xml", b'name="N/m"', b'name="N/mm"'), "N/mm"),
        (edit("modelDescription.xml", b'<BaseUnit kg="1" s="-2"/>', b""), "not defined by a BaseUnit"),
        (
            edit("modelDescription.xml", b'<BaseUnit kg="1" s="-2"/>', b'<BaseUnit kg="1" s="-1"/>'),
            "instead of",
        ),
        (edit("modelDescription.xml", b"Tiny scene", b"Another scene"), "not the hash"),
        (edit("modelDescription.xml", b'guid="{', b'guid="{0'), "guid"),
        (edit("modelDescription.xml", b'index="4"', b'index="99"'), "fmutool"),
        (lambda c: c.pop("resources/model.bin"), "model.bin is missing"),
        (edit("resources/model.bin", b"tool.wish", b"tool.wash"), "damaged"),
        (
            lambda c: c.update({"binaries/linux64/other.so": c.pop("binaries/linux64/tiny.so")}),
            "must be called tiny.so",
        ),
        (lambda c: c.update({"binaries/linux32/tiny.so": c["binaries/linux64/tiny.so"]}), "no such platform"),
        (lambda c: c.update({"binaries/linux64/tiny.so": b"nonsense"}), "no shared library"),
        (lambda c: c.update({"binaries/linux64/tiny.so": b"\x7fELF" + bytes(28) + b"\xff" * 64}), "cannot be read"),
        (lambda c: c.update({"resources/model.bin": c["resources/model.bin"] + b"0"}), "damaged"),
        (edit("modelDescription.xml", b'Unit name="N/m"', b'Unit nam="N/m"'), "unknown factor"),
        (lambda c: [c.pop(n) for n in list(c) if n.startswith("binaries/")], "no binary"),
        (edit("binaries/linux64/tiny.so", b"fmi2SetTime\0", b"fmi2SatTime\0"), "exports fmi2SatTime"),
        (edit("binaries/win64/tiny.dll", b"fmi2SetTime\0", b"fmi2SatTime\0"), "lacks fmi2SetTime"),
        (lambda c: c.update({"../x": b""}), "no portable relative path"),
    ],
)
def test_check_finds(everywhere, tmp_path, change, finding):
    findings = check(rewritten(everywhere, tmp_path / "changed.fmu", change))
    assert any(finding in f for f in findings), findings


# What of resources/model.bin is overwritten: where in its local entry, where in the central directory, and by what.
UNREADABLE = {
    "Bad CRC-32": (14, 16, b"\1\2\3\4"),
    "encrypted": (6, 8, b"\1"),
    "compression": (8, 10, b"\x61"),
    "invalid block type": (30 + len("resources/model.bin"), None, b"\xff"),
}


@pytest.mark.parametrize("finding", UNREADABLE)
def test_check_finds_what_cannot_be_read(fmu_path, tmp_path, finding):
    name, content = b"resources/model.bin", bytearray(fmu_path.read_bytes())
    local, central, new = UNREADABLE[finding]
    for start, at in ((content.find(name) - 30, local), (content.rfind(name) - 46, central)):
        if at is not None:
            content[start + at : start + at + len(new)] = new
    (tmp_path / "x.fmu").write_bytes(content)
    told = check(tmp_path / "x.fmu")
    assert re.search(f"zip: resources/model.bin cannot be read: .*{finding}", "\n".join(told)), told


def test_check_needs_a_zip(fmu_path, tmp_path):
    content = fmu_path.read_bytes()
    for wrong in (b"nothing", content.replace(b"PK\1\2", b"PK\3\3")):
        (tmp_path / "x.fmu").write_bytes(wrong)
        with pytest.raises(InputError, match=r"must be a zip file; found .*x\.fmu"):
            check(tmp_path / "x.fmu")


@pytest.mark.parametrize("platform", compile.ALL)
def test_only_the_functions_of_fmi_are_exported(everywhere, platform):
    (name,) = [n for n in entries(everywhere) if n.startswith(f"binaries/{platform}/")]
    assert exported(entries(everywhere)[name]) == fmi_functions()
    assert len(fmi_functions()) == 44


def test_binaries_name_no_place_of_this_machine(everywhere):
    places = [str(Path.home()), str(Path(sys.prefix)), str(Path(__file__).parents[1]), "/tmp/"]
    for name, content in entries(everywhere).items():
        if name.startswith("binaries/"):
            for place in places:
                assert place.encode() not in content, (name, place)


def test_universal_binary_for_macos(everywhere):
    content = entries(everywhere)["binaries/darwin64/tiny.dylib"]
    magic, count = struct.unpack_from(">II", content)
    assert (magic, count) == (0xCAFEBABE, 2)
    for i, cpu in enumerate((0x01000007, 0x0100000C)):
        kind, _, begin, size, alignment = struct.unpack_from(">5I", content, 8 + 20 * i)
        assert kind == cpu
        assert begin % 2**alignment == 0
        assert content[begin : begin + 4] == b"\xcf\xfa\xed\xfe"
        assert struct.unpack_from("<I", content, begin + 4)[0] == cpu
        assert begin + size <= len(content)


# --- the same bytes -----------------------------------------------------------------------------------------


def test_same_assembly_gives_the_same_bytes(tmp_path, monkeypatch):
    one = tiny_fmu(tmp_path).read_bytes()
    monkeypatch.setenv("TISSUE_CONTACT_CACHE", str(tmp_path / "cache"))  # compiled again, from nothing
    monkeypatch.setenv("TZ", "Asia/Tokyo")
    monkeypatch.chdir(tmp_path)
    # zig's own libraries may come from where they are: they are the compiler's, not ours.
    monkeypatch.setenv("ZIG_GLOBAL_CACHE_DIR", str(tmp_path / "zig"))
    assert tiny_fmu(tmp_path).read_bytes() == one
    assert (tmp_path / "cache").is_dir()


def test_any_change_changes_the_guid(fmu_path, tmp_path):
    def guid(**changes):
        return read_model_description(str(tiny_fmu(tmp_path, **changes))).guid

    first = read_model_description(str(fmu_path)).guid
    described = tuple(v._replace(description="other") for v in VARIABLES)
    assert guid() == first
    assert re.fullmatch(r"\{[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}\}", first)
    others = [guid(vertices=4), guid(variables=described), guid(step_size=0.002), guid(name="tin_y")]
    assert len({first, *others}) == 5


def test_second_scene_takes_no_compiler(tmp_path, everywhere):
    said = []
    build(
        tiny_assembly(name="second", vertices=1000),
        tmp_path / "a.fmu",
        on_progress=said.append,
        kernels=KERNELS,
    )
    assert not [s for s in said if "compiling" in s]


def test_kernel_source_is_part_of_the_cache_key(tmp_path):
    copy = tmp_path / "step.py"
    copy.write_bytes(KERNELS.read_bytes())
    before = compile.library_hash(copy)
    (tmp_path / "law.py").write_text("")
    with_law = compile.library_hash(copy)
    copy.write_bytes(KERNELS.read_bytes() + b"\n")
    assert len({before, with_law, compile.library_hash(copy)}) == 3


def test_status_codes_are_part_of_the_cache_key(tmp_path, monkeypatch):
    before = compile.kernels_hash(KERNELS)
    changed = tmp_path / "status.py"
    changed.write_bytes(Path(status.__file__).read_bytes() + b"\n")
    monkeypatch.setattr(status, "__file__", str(changed))
    assert compile.kernels_hash(KERNELS) != before


# --- what stops it ------------------------------------------------------------------------------------------


def changed_kernels(tmp_path, old, new):
    text = KERNELS.read_text("utf-8")
    assert old in text
    path = tmp_path / "kernels" / "step.py"
    path.parent.mkdir()
    path.write_text(text.replace(old, new), "utf-8")
    return path


@pytest.mark.parametrize(
    ("new", "symbol"),
    [
        ("    state.y[0] += np.zeros(state.y.size)[0]\n    if h > 0.0:", "NRT_"),
        ("    state.y[:] = state.vx\n    if h > 0.0:", "NRT_"),  # shapes are compared, and it raises
        ("    print(h)\n    if h > 0.0:", "numba_gil_ensure"),
    ],
)
def test_kernel_that_needs_python_fails_the_build(tmp_path, new, symbol):
    kernels = changed_kernels(tmp_path, "    if h > 0.0:", new)
    kernels.write_text("import numpy as np\n" + kernels.read_text("utf-8"), "utf-8")
    output = tmp_path / "out" / "x.fmu"
    output.parent.mkdir()
    with pytest.raises(WorkError, match=f"needs .*({symbol}).*no C library has"):
        build(tiny_assembly(), output, [PLATFORM], kernels=kernels)
    assert list(output.parent.iterdir()) == []


def test_kernel_that_numba_refuses(tmp_path):
    kernels = changed_kernels(tmp_path, "    if h > 0.0:", "    if undefined_name > 0.0:")
    with pytest.raises(WorkError, match="undefined_name"):
        build(tiny_assembly(), tmp_path / "x.fmu", [PLATFORM], kernels=kernels)


def test_c_warning_fails_the_build(tmp_path):
    (tmp_path / "x.c").write_text("int f(void) { int unused; return 0; }", "utf-8")
    with pytest.raises(WorkError, match="unused"):
        compile.zig([*compile.C_FLAGS, "-c", "x.c"], tmp_path)


@pytest.mark.parametrize("machine", [m for t in compile.TARGETS.values() for m in t.machines], ids=lambda m: m.triple)
def test_what_kernels_may_take_is_there_everywhere(tmp_path, machine):
    taken = sorted(machine_code.ALLOWED_SYMBOLS)
    lines = [
        *(f"void {name}(void);" for name in taken),
        "void *all[] = {",
        *(f"(void *){name}," for name in taken),
        "};",
    ]
    (tmp_path / "x.c").write_text("\n".join(lines), "utf-8")
    flags = [
        "-O2",
        "-fno-builtin",
        "-w",
        "-shared",
        *(["-fPIC", "-lm", "-Wl,-z,defs"] if "linux" in machine.zig else []),
    ]
    assert compile.link(machine.zig, flags, ["x.c"], "x", tmp_path)
    (tmp_path / "x.c").write_text("\n".join(["void no_such(void);", *lines[:-1], "(void *)no_such };"]), "utf-8")
    with pytest.raises(WorkError, match="no_such"):
        compile.link(machine.zig, flags, ["x.c"], "x", tmp_path)


def test_platforms(tmp_path):
    with pytest.raises(InputError, match="must be one of linux64"):
        build(tiny_assembly(), tmp_path / "x.fmu", ["linux63"], kernels=KERNELS)
    with pytest.raises(InputError, match="at least one"):
        build(tiny_assembly(), tmp_path / "x.fmu", [], kernels=KERNELS)


def test_output_needs_a_directory(tmp_path):
    with pytest.raises(InputError, match="existing directory"):
        build(tiny_assembly(), tmp_path / "none" / "x.fmu", [PLATFORM], kernels=KERNELS)


class Fails(dict):
    """Entries of which one cannot be had."""

    def __getitem__(self, name):
        if name == "b":
            raise KeyboardInterrupt
        return super().__getitem__(name)


def test_interrupted_build_leaves_what_was_there(tmp_path):
    output = tmp_path / "x.fmu"
    output.write_bytes(b"before")
    with pytest.raises(KeyboardInterrupt):
        archive.write(output, Fails(a=b"1" * 10**6, b=b"2", c=b"3"))
    assert output.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [output]


@pytest.mark.skipif(os.name == "nt", reason="needs SIGINT")
def test_interrupted_compilation_leaves_nothing(tmp_path):
    (tmp_path / "out").mkdir()
    code = (
        f"import signal, sys; sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        # a shell makes what it starts in the background deaf to it
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from pathlib import Path\n"
        "from fmu_fixture import KERNELS, tiny_assembly\n"
        "from tissue_contact.fmu.build import build\n"
        "def tell(text): print(text, flush=True)\n"
        f"output = Path({str(tmp_path / 'out')!r}) / 'x.fmu'\n"
        "build(tiny_assembly(), output, on_progress=tell, kernels=KERNELS)"
    )
    environment = os.environ | {"TISSUE_CONTACT_CACHE": str(tmp_path / "cache")}
    run = subprocess.Popen(
        [sys.executable, "-c", code],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    while not run.stdout.readline().startswith("compiling for"):
        assert run.poll() is None
    time.sleep(0.5)
    run.send_signal(signal.SIGINT)
    assert run.wait(60) != 0
    assert list((tmp_path / "out").iterdir()) == []
    kept = [p for p in (tmp_path / "cache").iterdir() if p.is_file() and not p.name.startswith("kernels-")]
    assert kept == []


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"variables": (*VARIABLES, VARIABLES[0])}, "must be unique"),
        ({"variables": (VARIABLES[0]._replace(unit="furlong"), *VARIABLES[1:])}, "furlong"),
        ({"variables": (VARIABLES[0]._replace(start=np.nan), *VARIABLES[1:])}, "tool.pull starts at nan"),
        ({"variables": (VARIABLES[0]._replace(slot=2), *VARIABLES[1:]), "inputs": np.zeros(2)}, "slot 2"),
        ({"state_real": np.zeros(3)}, "ends beyond"),
        ({"inputs": np.zeros(2, np.float32)}, "assembly.inputs"),
    ],
)
def test_assembly_that_contradicts_itself(tmp_path, changes, message):
    with pytest.raises(WorkError, match=message):
        tiny_fmu(tmp_path, **changes)
    assert list(tmp_path.iterdir()) == []


# --- the description ----------------------------------------------------------------------------------------


def test_description_holds_the_table(fmu_path):
    about = read_model_description(str(fmu_path))
    assert [v.name for v in about.modelVariables] == [v.name for v in VARIABLES]
    for reference, (v, given) in enumerate(zip(about.modelVariables, VARIABLES, strict=True)):
        assert v.valueReference == reference
        assert (v.unit, v.description, v.type) == (given.unit, given.description, "Real")
        bounds = (float(v.min) if v.min else -np.inf, float(v.max) if v.max else np.inf)
        assert bounds == (given.minimum, given.maximum)
    assert float(about.modelVariables[PULL].start) == 0.25
    assert about.modelVariables[GAIN].variability == "tunable"
    assert about.modelVariables[POSITION].start is None
    experiment = about.defaultExperiment
    assert (experiment.startTime, experiment.stopTime, experiment.stepSize) == ("0.0", "1.0", "0.001")
    assert experiment.tolerance
    simulation = about.coSimulation
    assert simulation.canHandleVariableCommunicationStepSize
    assert simulation.canGetAndSetFMUstate and simulation.canSerializeFMUstate
    assert simulation.canNotUseMemoryManagementFunctions
    assert not simulation.canBeInstantiatedOnlyOncePerProcess
    assert not simulation.providesDirectionalDerivative


def test_structure_lists_every_output_with_its_dependencies(fmu_path):
    root = etree.fromstring(entries(fmu_path)["modelDescription.xml"])
    for element, knowns in (("Outputs", "1 2"), ("InitialUnknowns", "1 2 6 7")):
        unknowns = root.find(f"ModelStructure/{element}")
        assert [u.get("index") for u in unknowns] == ["3", "4", "5"]
        assert {u.get("dependencies") for u in unknowns} == {knowns}
        assert {u.get("dependenciesKind") for u in unknowns} == {" ".join(["dependent"] * len(knowns.split()))}


def test_description_has_no_time_stamp(fmu_path):
    assert b"generationDateAndTime" not in entries(fmu_path)["modelDescription.xml"]


@pytest.mark.parametrize(
    ("unit", "base"),
    [
        ("1", {}),
        ("m", {"m": 1}),
        ("N", {"kg": 1, "m": 1, "s": -2}),
        ("N.m", {"kg": 1, "m": 2, "s": -2}),
        ("N.s/m", {"kg": 1, "s": -1}),
        ("N/m", {"kg": 1, "s": -2}),
        ("N/m3", {"kg": 1, "m": -2, "s": -2}),
        ("N.s/m3", {"kg": 1, "m": -2, "s": -1}),
        ("kg/m2", {"kg": 1, "m": -2}),
        ("J", {"kg": 1, "m": 2, "s": -2}),
        ("Pa", {"kg": 1, "m": -1, "s": -2}),
        ("rad", {"rad": 1}),
        ("m/s", {"m": 1, "s": -1}),
        ("m/s2", {"m": 1, "s": -2}),
        ("1/s", {"s": -1}),
        ("s", {"s": 1}),
    ],
)
def test_units(unit, base):
    assert base_unit(unit) == base


@pytest.mark.parametrize("unit", ["", "mm", "N*m", "N/", "2m"])
def test_unknown_unit(unit):
    with pytest.raises(WorkError, match="unknown factor"):
        base_unit(unit)


@pytest.mark.parametrize(
    ("name", "identifier"),
    [("press", "press"), ("two tools", "two_tools"), ("3d", "_3d"), ("ä-b.c", "__b_c")],
)
def test_model_identifier(name, identifier):
    assert description.model_identifier(name) == identifier


def test_names_of_any_letters_and_numbers_survive(tmp_path):
    variables = (
        *VARIABLES[:2],
        *VARIABLES[2:5],
        VARIABLES[5]._replace(description="Größe <&>\"'", start=1 / 3 + 1),
        VARIABLES[6],
    )
    path = tiny_fmu(tmp_path, variables=variables, description="5 µm < x & y")
    about = read_model_description(str(path))
    assert about.description == "5 µm < x & y"
    assert about.modelVariables[GAIN].description == "Größe <&>\"'"
    assert float(about.modelVariables[GAIN].start) == 1 / 3 + 1
    assert check(path) == []


def test_documentation_names_every_variable(everywhere):
    page = entries(everywhere)["documentation/index.html"].decode()
    for v in VARIABLES:
        assert f"<code>{v.name}</code>" in page
    assert "<&>" not in page  # escaped
    etree.fromstring(
        page.replace("<!DOCTYPE html>", "")
        .replace('<meta charset="utf-8">', "")
        .replace('<img src="model.png" alt="tiny">', "")
    )


SHEET = """
name = "sheet"
[solver]
{solver}
[[tissue]]
name = "liver"
shape = {{ kind = "patch", size = [0.02, 0.02], triangles = 60 }}
areal_density = 1.0
stiffness = 100.0
{tissue}
[[instrument]]
shape = {{ kind = "sphere", radius = 0.003, triangles = 128 }}
[[contact]]
name = "touch"
{contact}
"""
FIELD, WHOLE = "stiffness_per_area = 1e7", "stiffness = 500.0"
HUNT = f'law = "hunt_crossley"\n{FIELD}'
EFFECTS = {
    "bending_stiffness": "opposite an edge", "preload": "shorter than meshed", "nonlinearity": "β e²",
    "damping": "d_ij", "area_stiffness": "k_A", "volume_stiffness": "k_V", "support_stiffness": "k_s",
    "support_damping": "c_s", "drag": "c_d",
}  # fmt: skip
DEPTHS = {
    "distance_field": "signed distance", "hull": "convex hull", "kdop": "k-DOP", "oobb": "corners of the object-orient",
    "oobb_literal": "|D·u|", "primitive": "body&#x27;s triangles",
}  # fmt: skip
LAWS = {"kelvin_voigt": "k δ + c dδ/dt", "hunt_crossley": "(δ/1 m)ⁿ⁻¹"}
SCHEMES = {
    "symplectic_euler": "M v′ = M v*", "explicit_euler": "x′ = x + dt v<", "implicit_euler": "Newton",
    "runge_kutta_4": "four evaluations", "projective_dynamics": "one constant matrix",
}  # fmt: skip
OTHERS = {"region": "share it", "pair": "every pair", "friction": "friction of", "limit": "moves fast", "g": "mᵢ g",
          "fixed": "A fixed number", "automatic": "As many"}  # fmt: skip
TOLD = EFFECTS | DEPTHS | LAWS | SCHEMES | OTHERS
USUAL = {"distance_field", "kelvin_voigt", "projective_dynamics", "limit", "automatic"}


def page_of(**keys):
    """Documentation of the sheet."""
    text = SHEET.format(**{"solver": "", "tissue": "", "contact": FIELD} | keys)
    return documentation.page(tiny_assembly(source=text.encode()), picture=False)


@pytest.mark.parametrize(
    ("keys", "has"),
    [
        ({}, USUAL),
        *(({"tissue": f"{key} = 0.5", "solver": 'preset = "accurate"'},
           {"distance_field", "kelvin_voigt", "symplectic_euler", "automatic", key}) for key in EFFECTS),
        *(({"contact": f'response = "{r}"\n{WHOLE}'}, {*USUAL - {"distance_field"}, r, "region"})
          for r in get_args(Response) if r != "distance_field"),
        ({"contact": f'response = "hull"\npair_weight = "none"\n{WHOLE}'},
         {*USUAL - {"distance_field"}, "hull", "pair"}),
        ({"contact": f"{HUNT}\nfriction = 0.3"}, {*USUAL - {"kelvin_voigt"}, "hunt_crossley", "friction"}),
        *(({"solver": f'integrator = "{i}"\nsubsteps = 2\ngravity = [0, 0, -9.81]'},
           {"distance_field", "kelvin_voigt", i, "fixed", "g"}) for i in INTEGRATORS),
    ],
)  # fmt: skip
def test_documentation_has_the_equations_of_its_scene_and_no_others(keys, has):
    page = page_of(**keys)
    assert {name for name, words in TOLD.items() if words in page} == has


def test_documentation_names_what_an_equation_holds_for():
    page = page_of(tissue="drag = 10.0")
    assert "<b>liver</b>: Drag" in page and "<b>touch</b>: Law of Kelvin" in page
    assert "takes effect at once in the next step" in page


def test_documentation_of_bodies_alone_knows_no_tissue():
    clash = Path(scenarios.__file__).parent / "clash" / "scene.toml"
    page = documentation.page(tiny_assembly(source=clash.read_bytes()), picture=False)
    assert "points of one body" in page and "Hunt" in page and "friction of" in page
    assert not re.search("tissue|<h3>Time", page[page.index("<h2>Model") : page.index("<h2>Use")])


def test_licences(everywhere):
    texts = {n: c.decode() for n, c in entries(everywhere).items() if n.startswith("documentation/licenses/")}
    assert "MIT License" in texts["documentation/licenses/license.txt"]
    assert "Modelica Association" in texts["documentation/licenses/fmi-headers.txt"]
    assert all(len(text) > 300 for text in texts.values())


# --- the generated parts ------------------------------------------------------------------------------------


def test_layout_hash_follows_the_status_table(monkeypatch):
    before = entry.layout_hash()
    changed = (*status.STATUSES[:-1], status.STATUSES[-1]._replace(discard=not status.STATUSES[-1].discard))
    monkeypatch.setattr(status, "STATUSES", changed)
    assert entry.layout_hash() != before


@pytest.mark.parametrize("message", ["only one %g", "%g %g %g", "%g %s", "100% of %g %g"])
def test_status_message_must_be_a_safe_format(monkeypatch, message):
    monkeypatch.setattr(status, "STATUSES", (status.STATUSES[0]._replace(message=message),))
    with pytest.raises(WorkError, match="exactly two %g"):
        compile.header()


def test_checksum_is_fnv1a_by_words():
    assert model_bin.checksum(b"") == 0xCBF29CE484222325
    first = ((0xCBF29CE484222325 ^ 1) * 0x100000001B3) % 2**64
    assert model_bin.checksum((1).to_bytes(8, "little")) == first


# --- it runs ------------------------------------------------------------------------------------------------


def test_fmpy_simulates_it(fmu_path):
    result = fmpy.simulate_fmu(str(fmu_path), output_interval=0.1, start_values={"contact.stiffness": 4.0})
    assert result["tool.force[1]"][-1] == 4.0 * 0.25
    assert result["solver.steps"][-1] == 10.0


def test_fmu_gives_the_bits_of_the_same_kernels_in_python(fmu):
    import math

    from fmu_importer import OK, Instance
    from fmu_kernels.step import initialize, step

    assembly = tiny_assembly()
    made = Instance(fmu).start()
    bundles = (Bundle(assembly.model), assembly.parameters, Bundle(assembly.state), assembly.inputs)
    scratch = Bundle(assembly.scratch)
    assert initialize(*bundles, assembly.outputs, scratch) == 0
    for k in range(500):
        assembly.inputs[0] = math.cos(0.1 * k)
        assert made.set({PULL: assembly.inputs[0]}) == OK
        assert made.step(k * 1e-3, 1e-3) == OK
        assert step(*bundles, 1e-3, assembly.outputs, scratch) == 0
        assert made.get(2, 3, 4)[1] == list(assembly.outputs)
    made.free()


def test_variable_without_bounds_has_none_in_the_description():
    variable = Variable("a", "inputs", 0, "1", 0.0, -np.inf, np.inf, "")
    assembly = dataclasses.replace(tiny_assembly(), variables=(variable,))
    assert b"min=" not in description.write(assembly, "")
