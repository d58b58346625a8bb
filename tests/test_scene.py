"""The scene file: what it may say, what it means, and the one message of every wrong one."""

import inspect
import subprocess
import sys
import tomllib
from pathlib import Path

import jsonschema
import pytest
from scipy.spatial.transform import Rotation

from tissue_contact import geometry, scene, shapes
from tissue_contact.errors import InputError
from tissue_contact.scene import Tissue, parse_scene, read_scene, scene_schema
from tissue_contact.settings import setting
from tissue_contact.surfaces import rotation_matrix, stl_bytes, surface_of

TEXT = """\
name = "press"
[[tissue]]
shape = { kind = "patch", size = [0.06, 0.06], triangles = 600 }
areal_density = 1.0
stiffness = 200.0
[[instrument]]
shape = { kind = "capsule", radius = 0.0025, length = 0.04, triangles = 200 }
start_position = [0, 0, 0.005]
[[contact]]
response = "hull"
stiffness = 500.0
"""
SHIPPED = sorted((Path(scene.__file__).parents[1] / "scenarios").glob("*/scene.toml"))

TWO_TISSUES = """[[tissue]]
name = "fat"
shape = { kind = "patch", size = [0.06, 0.06], triangles = 600 }
areal_density = 1.0
stiffness = 200.0
"""
TWO_RIGIDS = "".join(
    f'[[rigid]]\nname = "{name}"\nshape = {{ kind = "sphere", radius = 0.01, triangles = 100 }}\n' for name in "ab"
)

# What to replace in TEXT by what, and the parts that the message must have.
WRONG = {
    "syntax": ('name = "press"', 'name = "press', ["bad.toml", "TOML", "line 1"]),
    "unknown key": (
        "stiffness = 200.0",
        "stifness = 200.0",
        ["tissue[0].stifness", "200", "spelling is stiffness"],
    ),
    "unknown table": ("[[contact]]", "[[contct]]", ["contct", "spelling is contact"]),
    "far from any key": ("[[contact]]", "[[bones]]", ["bones", "Known keys: name,", "contact"]),
    "missing key": ("areal_density = 1.0", "", ["tissue[0].areal_density", "must be given", "mass per area"]),
    "no name": ('name = "press"', "", ["bad.toml, name", "must be given"]),
    "no tissue to touch": (TEXT[TEXT.index("[[t") : TEXT.index("[[i")], "", ["contact[0].between", "0 tissues"]),
    "single brackets": ("[[tissue]]", "[tissue]", ["bad.toml, tissue", "[[…]]"]),
    "table for a word": ('name = "press"', "name = { a = 1 }", ["name", "letter first", "a = 1"]),
    "word for a number": (
        "stiffness = 200.0",
        'stiffness = "stiff"',
        ["tissue[0].stiffness", "number", '"stiff"'],
    ),
    "truth for a number": (
        "stiffness = 200.0",
        "stiffness = true",
        ["tissue[0].stiffness", "number", "true"],
    ),
    "nan": ("stiffness = 200.0", "stiffness = nan", ["tissue[0].stiffness", "nan", "1e+07 N/m"]),
    "inf": ("stiffness = 200.0", "stiffness = inf", ["tissue[0].stiffness", "inf", "1e+07 N/m"]),
    "below range": (
        "stiffness = 200.0",
        "stiffness = -1",
        ["tissue[0].stiffness", "0.01 and 1e+07 N/m", "found -1"],
    ),
    "above range": (
        "areal_density = 1.0",
        "areal_density = 1e9",
        ["areal_density", "1000 kg/m2", "found 1000000000"],
    ),
    "fraction for a count": (
        "triangles = 600",
        "triangles = 600.5",
        ["shape.triangles", "whole number", "600.5"],
    ),
    "number for a list": ("size = [0.06, 0.06]", "size = 0.06", ["shape.size", "a list", "0.06"]),
    "short list": (
        "size = [0.06, 0.06]",
        "size = [0.06]",
        ["shape.size", "2 entries", "[0.06]", "along x and y"],
    ),
    "empty list": (
        "areal",
        "fixed = []\nareal",
        ["tissue[0].fixed", "the list must have 1 or more entries", "found []"],
    ),
    "long text": (
        'name = "press"',
        f'name = "press"\ndescription = "{1001 * "a"}"',
        ["bad.toml, description", "the text must have at most 1000 characters", '"aaa'],
    ),
    "empty text": (
        TEXT[TEXT.index("shape") : TEXT.index("areal")],
        'mesh = ""\n',
        ["tissue[0].mesh", "the text must have 1 or more characters", 'found ""'],
    ),
    "long name": (
        'name = "press"',
        f'name = "{65 * "a"}"',
        ["bad.toml, name", "letter first", "64 at most"],
    ),
    "item out of range": ("size = [0.06, 0.06]", "size = [0.06, 60]", ["shape.size[1]", "1 m", "found 60"]),
    "unknown kind": ('kind = "patch"', 'kind = "pach"', ["shape.kind", '"pach"', "spelling is patch"]),
    "no kind": ('kind = "patch",', "", ["shape", "kind must say", "capsule", "patch"]),
    "unknown key of a shape": ("size =", "sise =", ["shape.sise", "spelling is size"]),
    "missing key of a shape": ("size = [0.06, 0.06],", "", ["shape.size", "must be given", "along x and y"]),
    "bad name": ('name = "press"', 'name = "2 press"', ["bad.toml, name", "letter first", '"2 press"']),
    "no source": (
        TEXT[TEXT.index("shape") : TEXT.index("areal")],
        "",
        ["tissue[0]", "mesh or shape", "neither"],
    ),
    "two sources": ("areal", 'mesh = "a.stl"\nareal', ["tissue[0]", "only one of mesh and shape", "both"]),
    "scale of a shape": (
        "areal",
        "scale = 0.001\nareal",
        ["tissue[0].scale", "no meaning for a shape", "0.001"],
    ),
    "no stiffness": (
        "stiffness = 200.0",
        "",
        ["tissue[0].stiffness", "youngs_modulus and thickness", "neither"],
    ),
    "half a stiffness": (
        "stiffness = 200.0",
        "youngs_modulus = 1e3",
        ["tissue[0].thickness", "youngs_modulus alone"],
    ),
    "two stiffnesses": (
        "areal",
        "thickness = 0.01\nareal",
        ["tissue[0].thickness", "stiffness and thickness"],
    ),
    "unknown fixed": (
        "areal",
        'fixed = "bondary"\nareal',
        ["tissue[0].fixed", '"bondary"', "spelling is boundary"],
    ),
    "fixed index": ("areal", "fixed = [3, -1]\nareal", ["tissue[0].fixed[1]", "whole number", "found -1"]),
    "fixed number": ("areal", "fixed = 3\nareal", ["tissue[0].fixed", "a list", "found 3", "a box"]),
    "fixed box key": ("areal", "fixed = { bx = [] }\nareal", ["tissue[0].fixed.bx", "spelling is box"]),
    "growth alone": (
        "triangles = 600",
        "triangles = 600, growth = 0.2",
        ["tissue[0].shape.growth", "all over", "Give reach"],
    ),
    "reach of rows": (
        "triangles = 600",
        "triangles = 600, irregular = false, reach = [[0, 0, 0], [1, 1, 1]]",
        ["tissue[0].shape.reach", "rows of equal triangles", "Remove"],
    ),
    "reach order": (
        "triangles = 600",
        "triangles = 600, reach = [[0, 0, 1], [1, 1, 0]]",
        ["tissue[0].shape.reach:", "least", "[0.0, 0.0, 1.0]"],
    ),
    "reach beside a shape": (
        "areal",
        "reach = [[0, 0, 0], [1, 1, 1]]\nareal",
        ["tissue[0].reach", "part of the shape", "Move it to shape"],
    ),
    "numbers of a mesh with a reach": (
        TEXT[TEXT.index("shape") : TEXT.index("areal")],
        'mesh = "a.stl"\nreach = [[0, 0, 0], [1, 1, 1]]\nfixed = [0, 1]\n',
        ["tissue[0].fixed", "other numbers than in its file", "2 numbers", "remove reach"],
    ),
    "growth of a mesh alone": (
        TEXT[TEXT.index("shape") : TEXT.index("areal")],
        'mesh = "a.stl"\ngrowth = 0.2\n',
        ["tissue[0].growth", "all over", "Give reach"],
    ),
    "fixed box order": (
        "areal",
        "fixed = { box = [[0, 0, 1], [1, 1, 0]] }\nareal",
        ["tissue[0].fixed.box:", "least", "[0.0, 0.0, 1.0]"],
    ),
    "short probe": ("areal", "probes = [[0, 0]]\nareal", ["tissue[0].probes[0]", "3 entries", "[0, 0]"]),
    "zero quaternion": (
        "start_position",
        "rotation = [0, 0, 0, 0]\nstart_position",
        ["rotation", "norm", "[1, 0, 0, 0]"],
    ),
    "far away": ("[0, 0, 0.005]", "[0, 0, 5000]", ["instrument[0].start_position[2]", "100 m", "5000"]),
    "contact range": (
        "stiffness = 500.0",
        "stiffness = 0",
        ["contact[0].stiffness", "1 and 1e+10 N/m", "found 0"],
    ),
    "unknown law": ("= 500.0", '= 500.0\nlaw = "hertz"', ["contact[0].law", '"hertz"', "kelvin_voigt"]),
    "unknown response": ('"hull"', '"sdf"', ["contact[0].response", '"sdf"', "oobb"]),
    "unknown weight": (
        "= 500.0",
        '= 500.0\npair_weight = "lenght"',
        ["pair_weight", '"lenght"', "spelling is length"],
    ),
    "undeclared object": (
        "= 500.0",
        '= 500.0\nbetween = ["tisue", "instrument"]',
        ["contact[0].between", '"tisue"', "is tissue"],
    ),
    "tissue–tissue": (
        "[[contact]]",
        TWO_TISSUES + '[[contact]]\nbetween = ["fat", "tissue"]',
        ["contact[0].between", "tissue–tissue contact is not built", '["fat", "tissue"]'],
    ),
    "rigid–rigid": (
        "[[contact]]",
        TWO_RIGIDS + '[[contact]]\nbetween = ["a", "b"]',
        ["rigid–rigid contact is none", '["a", "b"]'],
    ),
    "self-contact": (
        "= 500.0",
        '= 500.0\nbetween = ["tissue", "tissue"]',
        ["contact[0].between", "two objects", "with itself"],
    ),
    "one object": ("= 500.0", '= 500.0\nbetween = ["tissue"]', ["contact[0].between", "two objects", "Name two"]),
    "three objects": (
        "= 500.0",
        '= 500.0\nbetween = ["tissue", "a", "b"]',
        ["contact[0].between", "the list must have at most 2 entries"],
    ),
    "hull between bodies": (
        "[[contact]]",
        TWO_RIGIDS + '[[contact]]\nbetween = ["a", "instrument"]',
        ["contact[0].response", "instrument and rigid must be distance_field", '"hull"'],
    ),
    "no instrument to touch": (
        TEXT[TEXT.index("[[i") : TEXT.index("[[c")],
        "",
        ["contact[0].between", "one tissue and one instrument", "0 instruments"],
    ),
    "which of two": (
        "[[contact]]",
        '[[instrument]]\nname = "other"\nshape = { kind = "box", size = [0.01, 0.01, 0.01] }\n[[contact]]',
        ["contact[0].between", "2 instruments", "instrument, other"],
    ),
    "stiffness of a field": (
        '"hull"\nstiffness',
        '"distance_field"\nstiffness',
        ["stiffness_per_area", "N/m3", "instead"],
    ),
    "no stiffness of a field": ('response = "hull"\nstiffness = 500.0', "", ["stiffness_per_area", "nothing", "1e6"]),
    "no meaning": ("= 500.0", "= 500.0\nexponent = 2.0", ["contact[0].exponent", "no meaning", "kelvin_voigt", "2.0"]),
    "slip without friction": ("= 500.0", "= 500.0\nslip_speed = 0.01", ["slip_speed", "without friction"]),
    "odd k-DOP": ('"hull"', '"kdop"\nkdop = 8', ["contact[0].kdop", "6 or 14 or 26", "found 8"]),
    "side of a hull": ("= 500.0", '= 500.0\nside = "both"', ["contact[0].side", "distance_field"]),
    "grasper alone": (
        TEXT[TEXT.index("[[c") :],
        "[instrument.grasp]\nradius = 0.01\nstiffness = 10.0\nslip_force = 1.0\n",
        ["instrument[0].grasp", "in contact with a tissue", "no such contact"],
    ),
    "jaws without hysteresis": (
        "[[contact]]",
        "[instrument.grasp]\nradius = 0.01\nstiffness = 10.0\nslip_force = 1.0\nclose_below = 0.8\n[[contact]]",
        ["grasp.close_below", "must not exceed", "0.8 and 0.5"],
    ),
    "nothing at all": (TEXT[TEXT.index("[[t") :], "", ["a tissue or an instrument", "neither"]),
    "same pair twice": (
        "[[contact]]",
        "[[contact]]\nstiffness_per_area = 1e5\n[[contact]]",
        ["contact[1]", "one contact only"],
    ),
    "same name twice": (
        "[[instrument]]",
        '[[instrument]]\nname = "tissue"',
        ["name of its own", "tissue[0]"],
    ),
    "reserved name": (
        "[[instrument]]",
        '[[instrument]]\nname = "energy"',
        ["instrument[energy].name", "energy and solver"],
    ),
    "step": (
        "[[contact]]",
        "[solver]\nstep = 2.0\n[[contact]]",
        ["solver.step", "1e-06 and 1 s", "found 2.0"],
    ),
    "stop before step": (
        "[[contact]]",
        "[solver]\nstep = 0.1\nstop_time = 0.01\n[[contact]]",
        ["solver.stop_time", "0.01 and 0.1"],
    ),
    "substeps": (
        "[[contact]]",
        "[solver]\nsubsteps = 2000\n[[contact]]",
        ["solver.substeps", "2000 and 1000"],
    ),
    "integrator": (
        "[[contact]]",
        '[solver]\nintegrator = "rk4"\n[[contact]]',
        ["solver.integrator", '"rk4"', "symplectic"],
    ),
    "preset": (
        "[[contact]]",
        '[solver]\npreset = "fats"\n[[contact]]',
        ["solver.preset", "fast or balanced or accurate", '"fats"', "spelling is fast"],
    ),
    "iterations of nothing": (
        "[[contact]]",
        '[solver]\npreset = "accurate"\niterations = 2\n[[contact]]',
        ["solver.iterations", "no meaning for integrator symplectic_euler", "found 2", "or take projective_dynamics"],
    ),
    "iterations of a preset that cannot have any": (
        "[[tissue]]",
        '[solver]\npreset = "fast"\niterations = 2\n[[tissue]]\nnonlinearity = 2.0',
        ["solver.iterations", "no meaning for integrator symplectic_euler", "found 2. Remove it."],
    ),
    "motion": (
        "[[contact]]",
        '[motion]\nkind = "extrapolate"\n[[contact]]',
        ["motion.kind", '"extrapolate"', "ramp"],
    ),
}


def parsed(text: str) -> scene.Scene:
    return parse_scene(text.encode(), Path(), "bad.toml")


@pytest.mark.parametrize("case", WRONG)
def test_one_message_of_a_wrong_scene(case: str) -> None:
    old, new, parts = WRONG[case]
    assert TEXT.count(old) >= 1
    with pytest.raises(InputError) as caught:
        parsed(TEXT.replace(old, new, 1))
    message = str(caught.value)
    assert message.startswith("bad.toml")
    assert "\n" not in message
    assert [part for part in parts if part not in message] == [], message


def test_missing_and_undecodable_file(tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text(TEXT)
    with pytest.raises(InputError, match=r"scen\.toml.*must exist.*scene\.toml"):
        read_scene(tmp_path / "scen.toml")
    (tmp_path / "scene.toml").write_bytes(b"name = '\xff'")
    with pytest.raises(InputError, match="UTF-8"):
        read_scene(tmp_path / "scene.toml")


def test_defaults_are_filled_in() -> None:
    made = parsed(TEXT)
    (contact,) = made.contact
    assert (contact.name, contact.between, contact.side) == ("contact", ("tissue", "instrument"), "outer")
    assert made.instrument[0].start_position == (0, 0, 0.005)
    assert made.solver.step == 0.001 and made.solver.substeps == 0
    assert made.source == TEXT.encode()


def test_names_of_several_contacts() -> None:
    more = """
[[instrument]]
name = "hook"
shape = { kind = "hook", radius = 0.001, length = 0.05, hook_length = 0.01 }
[[contact]]
between = ["hook", "tissue"]
stiffness_per_area = 1e6
[[rigid]]
name = "bone"
shape = { kind = "sphere", radius = 0.01, triangles = 100 }
[[contact]]
between = ["bone", "hook"]
stiffness_per_area = 1e6
[[contact]]
between = ["bone", "tissue"]
stiffness_per_area = 1e6
"""
    made = parsed(TEXT.replace("[[contact]]", '[[contact]]\nbetween = ["instrument", "tissue"]') + more)
    assert [c.name for c in made.contact] == ["instrument_tissue", "hook_tissue", "bone_hook", "bone_tissue"]
    assert [c.between for c in made.contact[1:]] == [("tissue", "hook"), ("hook", "bone"), ("tissue", "bone")]
    assert [c.side for c in made.contact] == ["outer", "outer", "both", "both"], "a tissue may lie on a bone"


def test_a_scene_without_contact_or_instrument_is_legal() -> None:
    assert parsed(TEXT[: TEXT.index("[[contact]]")]).contact == ()
    assert parsed(TEXT[: TEXT.index("[[instrument]]")]).instrument == ()


def test_a_scene_is_frozen() -> None:
    with pytest.raises(ValueError, match="frozen"):
        parsed(TEXT).tissue[0].stiffness = 1.0


def test_quaternions_are_normalised() -> None:
    made = parsed(TEXT.replace("start_position", "start_orientation = [0, 0, 3, 4]\nstart_position"))
    assert made.instrument[0].start_orientation == pytest.approx((0, 0, 0.6, 0.8))


def test_setting_tells_unit_and_range() -> None:
    assert setting(Tissue, "stiffness")[:3] == ("N/m", 1e-2, 1e7)
    assert setting(Tissue, "position")[:3] == ("m", -100, 100)
    assert setting(Tissue, "support_stiffness").unit == "N/m3"


def test_every_number_has_unit_range_and_description() -> None:
    for name, table in scene_schema()["$defs"].items():
        for key, field in table["properties"].items():
            branches = [field, *field.get("anyOf", []), field.get("items", {}), *field.get("prefixItems", [])]
            if any(b.get("type") in ("number", "integer") for b in branches):
                assert "unit" in field and field["description"], f"{name}.{key}"
                assert any("minimum" in b and "maximum" in b for b in branches) or "items" in field, f"{name}.{key}"


@pytest.mark.parametrize("path", SHIPPED, ids=lambda p: p.parent.name)
def test_schema_and_reader_accept_the_shipped_scenes(path: Path) -> None:
    jsonschema.validate(tomllib.loads(path.read_text()), scene_schema())
    assert read_scene(path).folder == path.parent


@pytest.mark.parametrize(
    "case", ["unknown key", "unknown kind", "below range", "unknown law", "missing key of a shape"]
)
def test_schema_refuses_what_the_reader_refuses(case: str) -> None:
    old, new, _ = WRONG[case]
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(tomllib.loads(TEXT.replace(old, new, 1)), scene_schema())


def test_importing_the_scene_is_light() -> None:
    heavy = "('numba', 'trimesh', 'matplotlib')"
    code = f"import sys, tissue_contact.scene; print([m for m in {heavy} if m in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


# --- surfaces ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "kind",
    ["patch", "ellipsoid", "abdominal_wall", "capsule", "sphere", "box", "cylinder", "grasper", "hook"],
)
def test_shape_tables_have_the_arguments_of_their_generators(kind: str) -> None:
    table = scene_schema()["$defs"]["".join(part.title() for part in kind.split("_"))]["properties"]
    generator = inspect.signature(getattr(shapes, kind)).parameters
    assert set(table) - {"kind"} == set(generator)
    given = {k: p.default for k, p in generator.items() if p.default is not inspect.Parameter.empty}
    for name, default in given.items():
        assert table[name]["default"] == default, name


def test_a_shape_is_put_in_its_place() -> None:
    quarter = "position = [0.1, 0, 0]\nrotation = [1, 0, 1, 0]\nareal"  # a quarter turn about y: z becomes x
    flat, turned = (surface_of(parsed(t).tissue[0], Path()) for t in (TEXT, TEXT.replace("areal", quarter)))
    assert turned.vertices == pytest.approx(flat.vertices[:, [2, 1, 0]] * (1, 1, -1) + (0.1, 0, 0), abs=1e-15)
    assert geometry.triangle_normals(turned).mean(axis=0)[0] == pytest.approx(1)


def test_rotation_matrix_against_scipy() -> None:
    w, x, y, z = quaternion = (0.5, -0.1, 0.7, 0.5)  # of norm 1
    assert rotation_matrix(quaternion) == pytest.approx(Rotation.from_quat([x, y, z, w]).as_matrix())


def test_axes_of_an_instrument_move_with_it() -> None:
    made = parsed(TEXT.replace("start_position", "offset = [0, 0, 0.01]\nstart_position"))
    axes = surface_of(made.instrument[0], Path()).axes
    assert axes is not None
    assert axes[0].ravel() == pytest.approx([0, 0, 0.0125, 0, 0, 0.05])


def test_mesh_beside_the_scene(tmp_path: Path) -> None:
    ball = shapes.ellipsoid((20.0, 30.0, 40.0), 300)  # in millimetres
    (tmp_path / "organ.stl").write_bytes(stl_bytes(ball))
    shape = TEXT[TEXT.index("shape") : TEXT.index("areal")]
    text = TEXT.replace(shape, 'mesh = "organ.stl"\nscale = 0.001\n', 1)
    (tmp_path / "scene.toml").write_text(text)
    made = read_scene(tmp_path / "scene.toml")
    surface = surface_of(made.tissue[0], made.folder, made.place)
    assert geometry.extent(surface) == pytest.approx(0.08, rel=0.02)

    wrong = made.tissue[0].model_copy(update={"scale": 1.0})
    with pytest.raises(InputError, match=r"scene\.toml, tissue\[tissue\].*organ\.stl.*1 m.*scale = 0\.001"):
        surface_of(wrong, made.folder, made.place)
    missing = made.tissue[0].model_copy(update={"mesh": "orgn.stl"})
    with pytest.raises(InputError, match=r"tissue\[tissue\].*orgn\.stl.*must exist.*organ\.stl"):
        surface_of(missing, made.folder, made.place)


def test_arguments_that_make_no_shape_are_named() -> None:
    text = TEXT.replace("triangles = 600", "triangles = 600, curvature_radius = 0.01")
    with pytest.raises(InputError, match=r"bad\.toml, tissue\[tissue\], patch, curvature_radius"):
        made = parsed(text)
        surface_of(made.tissue[0], made.folder, made.place)
