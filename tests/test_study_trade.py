"""The trade between time and accuracy: what is changed of a scene, what errors are, what lies on the front."""

import csv
import functools
import io
import itertools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from rich.console import Console
from scenes import write_mesh

from tissue_contact.assemble import assemble
from tissue_contact.edits import Edit, changed, edited
from tissue_contact.errors import InputError
from tissue_contact.fields import CUTS_MAX, longest_edges
from tissue_contact.scenarios.scenario import SHIPPED
from tissue_contact.scene import Scene, parse_scene, read_scene
from tissue_contact.shapes import patch
from tissue_contact.study import levers
from tissue_contact.study.deviation import DEPTH, MEAN_FORCE, MEASURES, TORQUE, WIDTH, errors, known
from tissue_contact.study.front import (
    NOISE,
    WORTH,
    Point,
    Sweep,
    advice,
    front,
    percent,
    promising,
    solver_settings,
    unresolved,
    within_error,
    within_time,
)
from tissue_contact.study.levers import Grounds, Option
from tissue_contact.study.trade_report import csv_text, figure, ordered, raw, table
from tissue_contact.surfaces import surface_of, touched_edge

WHOLE = """
name = "whole"
[[tissue]]
{source}
areal_density = 1.0
stiffness = 100.0
[[instrument]]
shape = {{ kind = "sphere", radius = 0.003, triangles = 128 }}
[[contact]]
response = "kdop"
kdop = 6
stiffness = 300.0
"""
PATCH = 'shape = { kind = "patch", size = [0.02, 0.02], triangles = 300 }'


def press() -> Scene:
    return read_scene(SHIPPED / "press" / "scene.toml")


def known_of(scene: Scene, **area: float) -> Grounds:
    found = _grounds(scene.source, scene.folder)
    return replace(found, area=area)


@functools.cache
def _grounds(source: bytes, folder: Path) -> Grounds:
    scene = parse_scene(source, folder)
    return levers.grounds(scene, assemble(scene).model.contact_reach)


def chosen(options: list[Option], lever: str) -> dict[str, Option]:
    return {o.label: o for o in options if o.lever == lever}


# --- levers -----------------------------------------------------------------------------------------------


def test_every_option_is_another_scene_and_the_scene_itself_is_none():
    scene = press()
    known = replace(known_of(scene, contact=6e-6), touched={"contact": np.array([[-0.006, 0, -0.008], [0.006, 0, 0]])})
    options = levers.options(scene, known)
    made = [levers.variant(scene, (o,)) for o in options]
    assert len(set(options)) == len(options), "what was tried is known by them"
    dumps = [m.model_dump_json() for m in made] + [scene.model_dump_json()]
    assert len(set(dumps)) == len(dumps) and {o.lever for o in options} == set(levers.LEVERS)
    # What press has already: symplectic Euler with a safety of 0.95, detection that follows the motion.
    assert "symplectic_euler, safety 0.95" not in chosen(options, "integration")
    assert list(chosen(options, "detection")) == ["discrete"]
    assert list(chosen(options, "mesh")) == [f"{n} triangles" for n in ("750", "1,500", "3,000", "12,000", "24,000")]
    assert chosen(options, "integration")["implicit_euler, 2 substeps"].edits == (
        Edit(("solver", "integrator"), "implicit_euler"),
        Edit(("solver", "substeps"), 2),
    )


@pytest.mark.parametrize("name", ["palpation", "clash", "probing"])
def test_the_reference_of_a_shipped_scene_can_be_assembled(name):
    scene = read_scene(SHIPPED / name / "scene.toml")
    finer = changed(scene, levers.reference(scene, known_of(scene), 4.0))
    assemble(finer)  # no spacing is refused
    assert [t.shape.triangles for t in finer.tissue] == [4 * t.shape.triangles for t in scene.tissue]
    assert [c.response for c in finer.contact] == [c.response for c in scene.contact]


def test_an_edit_keeps_comments_and_makes_the_table_that_it_needs():
    scene = parse_scene(WHOLE.format(source=PATCH).encode(), Path())
    text = edited(scene, [Edit(("solver", "safety"), 0.5), Edit(("contact", 0, "side"), None)]).decode()
    assert text.startswith(WHOLE.format(source=PATCH).rstrip()) and "[solver]\nsafety = 0.5" in text
    text = edited(press(), [Edit(("tissue", 0, "areal_density"), 3.0)]).decode()
    assert "areal_density = 3.0 # about 2 mm of tissue" in text


@pytest.mark.parametrize(("law", "exponent"), [("kelvin_voigt", 1.0), ("hunt_crossley", 1.5)])
def test_the_area_is_that_which_gives_the_force_at_the_depth(law, exponent):
    scene = press()
    if law == "hunt_crossley":
        scene = changed(scene, [Edit(("contact", 0, "law"), law), Edit(("contact", 0, "damping_per_area"), None)])
    depth = 1e-3 * np.linspace(0.0, 1.0, 50) ** 3  # shallow most of the time
    force = np.zeros((50, 3))
    force[:, 2] = 5e7 * 4e-6 * depth**exponent
    force[depth < 0.5e-3] *= 7.0  # what is not deep does not count
    area = levers.areas(scene, {"instrument": force}, {"instrument": depth})
    assert area["contact"] == pytest.approx(4e-6)
    assert levers.areas(scene, {"instrument": force}, {"instrument": 0 * depth}) == {}


def test_a_response_is_as_stiff_as_the_field_over_its_area():
    scene = press()
    made = levers.variant(scene, (chosen(levers.options(scene, known_of(scene, contact=4e-6)), "response")["hull"],))
    assert (made.contact[0].response, made.contact[0].stiffness, made.contact[0].damping) == ("hull", 200.0, 0.08)
    assert chosen(levers.options(scene, known_of(scene)), "response") == {}, "nobody knows the area"


def test_forces_of_several_contacts_or_of_a_grasp_tell_no_area():
    for name in ("bone", "retract"):
        scene = read_scene(SHIPPED / name / "scene.toml")
        rows = {b.name: np.ones((9, 3)) for b in scene.bodies}
        assert levers.areas(scene, rows, {b: r[:, 0] for b, r in rows.items()}) == {}, name


def test_a_whole_contact_keeps_its_stiffness_and_becomes_no_field():
    scene = parse_scene(WHOLE.format(source=PATCH).encode(), Path())
    options = levers.options(scene, known_of(scene))
    made = [levers.variant(scene, (o,)).contact[0] for o in options if o.lever == "response"]
    assert {c.response for c in made} == {"hull", "kdop", "oobb", "primitive"}
    assert {c.stiffness for c in made} == {300.0}
    assert not chosen(options, "quadrature_spacing")


def test_meshes_from_files_and_vertices_held_by_number_stay(tmp_path):
    flat = patch((0.02, 0.02), 300)
    file = write_mesh(tmp_path / "sheet.obj", flat.vertices, flat.triangles)
    for source in (f'mesh = "{file}"\nopen_surface = true', f"{PATCH}\nfixed = [0, 1]"):
        scene = parse_scene(WHOLE.format(source=source).encode(), tmp_path)
        assert levers.meshes_left(scene) == ["tissue"]
        assert not chosen(levers.options(scene, known_of(scene)), "mesh")
        finer = changed(scene, levers.reference(scene, known_of(scene), 16.0))
        assert finer.solver.safety == pytest.approx(0.95 / 4, rel=1e-3), "substeps are refined instead"


def test_the_reference_is_finer_in_all_that_it_can_be():
    scene = press()
    known = known_of(scene)
    finer = changed(scene, levers.reference(scene, known, 16.0))
    assert finer.tissue[0].shape.triangles == 96000
    assert finer.contact[0].quadrature_spacing == pytest.approx(known.spacing["contact"] / 4, rel=1e-3)
    assert (finer.solver.safety, finer.solver.detection_period) == (0.95, 0.00025)
    edge = longest_edges(surface_of(scene.tissue[0], Path())).max()
    assert known.edge["contact"] == edge and known.spacing["contact"] >= edge / CUTS_MAX


def test_a_mesh_is_fine_around_what_was_touched():
    scene = press()
    known = replace(known_of(scene), touched={"contact": np.array([[-0.006, -0.001, -0.008], [0.006, 0.001, 0.0]])})
    gradings = chosen(levers.options(scene, known), "grading")
    assert len(gradings) == len(levers.GRADINGS), "it is as fine all over as it is"
    made = [levers.variant(scene, (option,)).tissue[0] for option in gradings.values()]
    half = known.half["contact"]
    assert half == pytest.approx(0.0025, rel=0.03), "that of the capsule's mesh"
    for tissue, (margin, growth) in zip(made, levers.GRADINGS, strict=True):
        low, high = np.array(tissue.shape.reach)
        assert low == pytest.approx(np.array([-0.006, -0.001, -0.008]) - margin * half, rel=1e-3)
        assert high == pytest.approx(np.array([0.006, 0.001, 0.0]) + margin * half, rel=1e-3)
        assert tissue.shape.growth == growth and tissue.shape.triangles == 6000
        assert len(surface_of(tissue, Path()).triangles) < 3000
    graded = levers.variant(scene, (next(iter(gradings.values())),))
    assert "as fine all over" in chosen(levers.options(graded, known), "grading")
    finer = changed(graded, levers.reference(graded, known, 16.0)).tissue[0].shape
    assert finer.growth == pytest.approx(graded.tissue[0].shape.growth / 4), "every edge is a quarter as long"
    assert finer.triangles == 96000
    assert not chosen(levers.options(scene, known_of(scene)), "grading"), "nobody knows what is touched"


def test_a_reach_turns_with_the_tissue_and_held_or_regular_meshes_stay():
    turned = f"{PATCH}\nrotation = [0.7071067811865476, 0.0, 0.0, 0.7071067811865476]\nposition = [0.1, 0.2, 0.3]"
    scene = parse_scene(WHOLE.format(source=turned).encode(), Path())
    touched = {"contact": np.array([[0.1, 0.195, 0.299], [0.102, 0.2, 0.3]])}  # x of the world is -y of the shape
    known = replace(known_of(scene), touched=touched)
    option = next(iter(chosen(levers.options(scene, known), "grading").values()))
    low, high = np.array(levers.variant(scene, (option,)).tissue[0].shape.reach)
    margin = 2 * known.half["contact"]
    assert low == pytest.approx([-0.005 - margin, -0.002 - margin, -0.001 - margin], rel=1e-3)
    assert high == pytest.approx([margin, margin, margin], rel=1e-3)
    held, rows = f"{PATCH}\nfixed = [0, 1]", PATCH.replace("triangles", "irregular = false, triangles")
    for source in (held, rows):
        scene = parse_scene(WHOLE.format(source=source).encode(), Path())
        assert not chosen(levers.options(scene, replace(known_of(scene), touched=touched)), "grading")


def test_a_mesh_from_a_file_is_coarser_beyond_what_was_touched(tmp_path):
    flat = patch((0.02, 0.02), 300)
    mesh = f'mesh = "{write_mesh(tmp_path / "sheet.obj", flat.vertices, flat.triangles)}"\nopen_surface = true'
    touched = {"contact": np.array([[-0.002, -0.001, -0.001], [0.002, 0.001, 0.0]])}
    scene = parse_scene(WHOLE.format(source=mesh).encode(), tmp_path)
    option = chosen(levers.options(scene, replace(known_of(scene), touched=touched)), "grading")
    made = levers.variant(scene, (next(iter(option.values())),))
    low, _ = np.array(made.tissue[0].reach)
    assert low == pytest.approx(touched["contact"][0] - 2 * known_of(scene).half["contact"], rel=1e-3)
    assert len(surface_of(made.tissue[0], tmp_path).triangles) < 300
    finest = changed(made, levers.reference(made, known_of(made), 16.0))
    assert finest.tissue[0] == scene.tissue[0], "nothing of a file is finer than all of it"
    assert "as fine all over" in chosen(levers.options(made, replace(known_of(made), touched=touched)), "grading")


def test_points_are_as_close_as_a_graded_mesh_is_fine_where_it_is_touched():
    """Its coarse edges, which nothing gets to, do not forbid it."""
    near = "reach = [[-0.002, -0.002, 0], [0.002, 0.002, 0]]"
    contact = "[[contact]]\nstiffness_per_area = 1e7\nquadrature_spacing = {}"
    text = WHOLE[: WHOLE.index("[[contact]]")].format(source=PATCH.replace("triangles", f"{near}, triangles"))
    scene = parse_scene(text.encode(), Path())
    surface = surface_of(scene.tissue[0], Path())
    edge = touched_edge(scene.tissue[0], surface)
    assert edge < 0.75 * longest_edges(surface).max()
    assemble(parse_scene((text + contact.format(1.01 * edge / CUTS_MAX)).encode(), Path()))
    with pytest.raises(InputError, match="cut an edge of a triangle"):
        assemble(parse_scene((text + contact.format(0.9 * edge / CUTS_MAX)).encode(), Path()))


def test_levers_are_set_anew_in_their_order_and_contradictions_are_no_scenes():
    scene = press()
    options = levers.options(scene, known_of(scene, contact=6e-6))
    hull, primitive = (chosen(options, "response")[name] for name in ("hull", "primitive"))
    coarse = chosen(options, "mesh")["750 triangles"]
    spacing = next(iter(chosen(options, "quadrature_spacing").values()))
    both = levers.with_option((hull,), coarse)
    assert both == (coarse, hull) == levers.with_option((coarse,), hull)
    assert levers.with_option(both, primitive) == (coarse, primitive)
    assert levers.label_of(both) == "750 triangles; hull" and levers.label_of(()) == "the scene as it is"
    assert levers.variant(scene, levers.with_option((hull,), spacing)) is None


# --- errors -----------------------------------------------------------------------------------------------


def rows(n: int = 40, bodies: int = 2) -> np.ndarray:
    seed = 5
    return np.random.default_rng(seed).standard_normal((n + 1, bodies, WIDTH))


def test_a_run_that_is_a_tenth_too_strong_errs_by_a_tenth_in_everything():
    true, steps = np.abs(rows()), np.full(40, 1e-3)
    true[..., MEAN_FORCE][..., 1:] = 0.0  # one way, so that the impulse is the integral of the magnitude
    assert errors(1.1 * true, true, steps) == pytest.approx(dict.fromkeys(MEASURES, 0.1))
    assert errors(true, true, steps) == dict.fromkeys(MEASURES, 0.0)


def test_errors_are_those_of_their_own_columns():
    true, steps = rows(), np.full(40, 1e-3)
    for measure, column in (("depth", DEPTH), ("torque", TORQUE), ("impulse", MEAN_FORCE)):
        other = true.copy()
        other[..., column] += 1.0
        found = errors(other, true, steps)
        assert [m for m in MEASURES if found[m] > 0.0] == [measure]
    late = np.roll(true, 1, axis=0)
    assert errors(late, true, steps)["peak"] == 0.0 < errors(late, true, steps)["force"]


def test_an_impulse_to_and_fro_is_measured_by_all_that_was_pressed():
    true, steps = np.zeros((5, 1, WIDTH)), np.array([1.0, 1.0, 1.0, 0.5])
    true[1:, 0, MEAN_FORCE.start] = [1.0, -1.0, 1.0, -1.0]
    other = true.copy()
    other[4, 0, MEAN_FORCE.start] = 0.4
    assert errors(other, true, steps)["impulse"] == pytest.approx(0.7 / 3.5)


def test_where_the_reference_is_nothing_there_is_no_error():
    true, steps = rows(), np.full(40, 1e-3)
    true[..., TORQUE] = 0.0
    found = errors(rows() + 1.0, true, steps)
    assert found["torque"] is None and found["force"] > 0.0
    assert known(found | {"force": 0.2, "peak": 0.3}) == ["force"] + [
        m for m in ("impulse", "depth") if found[m] < 0.25
    ]
    with pytest.raises(ValueError, match="must belong together"):
        errors(true[1:], true, steps)


# --- front ------------------------------------------------------------------------------------------------


def option(lever: str, label: str, *edits: Edit) -> Option:
    return Option(lever, label, edits)


def point(us: float | None, error: float | None, *options: Option, timed: bool = True, **more: object) -> Point:
    return Point(options, {"force": error} if us is not None else {}, us, timed, **more)


def test_the_front_has_what_nothing_beats_and_all_else_is_beaten():
    for seed in range(30):
        rng = np.random.default_rng(seed)
        points = [
            point(*np.exp(rng.standard_normal(2)), *[option("mesh", "x")] * rng.integers(0, 2)) for _ in range(40)
        ]
        best = front(points, "force")
        places = [p.at("force") for p in best]
        assert places == sorted(places), seed
        for p in points:
            us, error = p.at("force")
            # A simpler point may stand for one that is as fast and as accurate within the tolerances.
            assert p in best or any(u <= NOISE * us and e <= WORTH**2 * error for u, e in places), (seed, p)
            assert not (p in best and any(u * NOISE < us and e < error for u, e in places)), (seed, p)


def test_small_steps_do_not_hide_what_they_come_to():
    """Each a little slower and a little more accurate than the one before, none by as much as is worth it."""
    points = [point(100.0 * 1.06**k, 0.03 / 1.015**k, option("mesh", f"{k}")) for k in range(20)]
    places = [p.at("force") for p in front(points, "force")]
    assert len(places) == 10 and places[-1][1] < WORTH * points[-1].at("force")[1]
    assert all(e > WORTH * after for (_, e), (_, after) in itertools.pairwise(places))


def test_a_reach_may_hold_one_vertex_that_rounding_puts_beside_it():
    corner = "reach = [[0.01, 0.01, 0], [0.01, 0.01, 0]]"
    for turn in ("[0.6, 0.0, 0.8, 0.0]", "[0.9, 0.1, 0.3, 0.3]", "[0.5, 0.5, -0.1, 0.7]"):
        source = f"{PATCH.replace('triangles', f'{corner}, triangles')}\nrotation = {turn}\nposition = [0.1, 0.2, 0.3]"
        scene = parse_scene(WHOLE.format(source=source).encode(), Path())
        surface = surface_of(scene.tissue[0], Path())
        assert touched_edge(scene.tissue[0], surface) < longest_edges(surface).max()


def test_what_is_most_promising_is_tried_first():
    finer, graded, fast, coarse = (option(*o) for o in (("mesh", "f"), ("grading", "g"), ("x", "fast"), ("mesh", "c")))
    points = [
        point(100, 0.04), point(260, 0.012, finer), point(40, 0.04, graded), point(20, 0.042, fast),
        point(50, 0.08, coarse), point(80, 0.04, coarse, graded),
    ]  # fmt: skip
    wanted = [(finer, graded, fast), (graded, fast), (finer, graded), (coarse, graded)]
    assert promising(reversed(wanted), points, "force") == wanted
    points[0] = point(None, None)  # the scene as it is was refused
    assert set(promising(wanted, points, "force")) == set(wanted)


def test_refused_points_are_on_no_front_and_equal_ones_only_the_simpler():
    a, b, c = option("mesh", "a"), option("response", "b"), option("detection", "c")
    refused = point(None, None, a, refusal="at 0 s")
    assert front([refused, point(5.0, None, b)], "force") == []
    fast, simple, same = point(100.0, 0.1, a, c), point(103.0, 0.1, a), point(109.0, 0.0999, a, b)
    assert front([fast, simple, same, refused], "force") == [simple]
    assert front([fast, point(110.0, 0.1, a)], "force") == [fast], "too slow to be equal"
    assert front([fast, same, point(190.0, 0.3)], "force", slack=2.0) == [fast, same, point(190.0, 0.3)]


SCENE = point(400.0, 0.05)
COARSE = point(100.0, 0.2, option("mesh", "coarse"))
BETTER = point(300.0, 0.04, option("integration", "better", Edit(("solver", "safety"), 0.5)))
FINE = point(1600.0, 0.01, option("mesh", "fine"))
ROUGH = point(50.0, 0.001, option("mesh", "rough"), timed=False)


def test_the_best_within_a_time_and_within_an_error():
    points = [SCENE, COARSE, BETTER, FINE, ROUGH]
    assert within_time(points, "force", 500.0) == [BETTER, COARSE], "what was not timed is not chosen"
    assert within_error(points, "force", 0.06) == [BETTER, SCENE, FINE]
    assert within_time(points, "force", 10.0) == [] == within_error(points, "force", 1e-3)


def test_the_advice_is_one_sentence_that_fits():
    assert advice([SCENE, COARSE, BETTER, FINE], "force") == (
        "Take better: 300 µs a step at 4.0 % error of the force; the scene as it is takes 400 µs a step at 5.0 % error "
        "of the force."
    )
    bargain = point(350.0, 0.01, option("mesh", "bargain", Edit(("tissue", 0, "stiffness"), 2.0)))
    assert advice([SCENE, COARSE, BETTER, bargain], "force").startswith("Take bargain: 350 µs a step at 1.0 % error")
    assert advice([SCENE, COARSE, FINE], "force").startswith("Leave the scene as it is, 400 µs")
    refused = point(None, None, refusal="at 0 s")
    assert advice([refused, COARSE], "force").startswith("The scene as it is is refused: take coarse, 100 µs")
    assert advice([refused], "force").startswith("Nothing that was tried ran to its end")


def test_errors_below_three_differences_of_the_references_are_doubtful():
    assert unresolved([SCENE, FINE], "force", {"force": 0.004}) == [FINE]
    assert unresolved([SCENE, FINE], "force", {"force": 0.003}) == []


def test_settings_for_several_scenarios_are_the_fastest_that_keep_the_error_in_all():
    def solver(label: str, **keys: object) -> Option:
        return option("integration", label, *(Edit(("solver", k), v) for k, v in keys.items()))

    a, b = solver("a", integrator="implicit_euler", substeps=1), solver("b", safety=0.7)
    mesh = option("mesh", "x", Edit(("tissue", 0, "shape", "triangles"), 10))
    one = [point(100.0, 0.1), point(50.0, 0.02, a), point(80.0, 0.01, b), point(10.0, 1e-4, mesh)]
    two = [point(10.0, 0.1), point(7.0, 0.02, a), point(9.0, 0.01, b), point(1.0, 1e-4, mesh)]
    assert solver_settings([one, two], "force", 0.03) == {"integrator": "implicit_euler", "substeps": 1}
    assert solver_settings([one, two], "force", 0.015) == {"safety": 0.7}
    assert solver_settings([one, two], "force", 0.2) == {"integrator": "implicit_euler", "substeps": 1}
    assert solver_settings([one, two], "force", 0.001) is None and solver_settings([], "force", 1.0) is None


@pytest.mark.parametrize(
    ("share", "text"), [(0.1, "10 %"), (0.0994, "9.9 %"), (0.01234, "1.2 %"), (0.00999, "1.0 %"), (12.0, "1,200 %")]
)
def test_percent_has_two_digits(share, text):
    assert percent(share) == text


# --- what is written --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def sweep():
    full = dict.fromkeys(MEASURES, 0.002)
    refused = point(None, None, option("response", "hull"), refusal="at 0.1 s: the step would have gained too much")
    slow = point(9000.0, 0.3, option("response", "slow"), timed=False)
    return Sweep("dome", 1e-3, [SCENE, refused, COARSE, BETTER, FINE, slow], full, (4.0, 16.0), ["a remark"])


def test_the_csv_has_every_point_and_reads_back(sweep):
    found = list(csv.DictReader(io.StringIO(csv_text(sweep, "force"))))
    assert [int(r["number"]) for r in found] == [1, 2, 3, 4, 5, 6]
    assert [r["time [us]"] for r in found] == ["100.0", "300.0", "400.0", "1600.0", "9000.0", ""]
    assert [r["front"] for r in found] == ["1", "1", "0", "1", "0", "0"]
    assert found[1]["integration"] == "better" and found[5]["refusal"].startswith("at 0.1 s")


def test_the_raw_data_have_edits_convergence_and_advice(sweep):
    found = json.loads(raw(sweep, "force"))
    assert found["convergence"]["force"] == 0.002 and found["remarks"] == ["a remark"]
    assert found["points"][1]["edits"] == [[["solver", "safety"], 0.5]] and found["advice"].startswith("Take better")
    assert [p["label"] for p in found["points"]] == [p.label for p in ordered(sweep, "force")]


def test_the_table_shows_the_front_the_scene_and_what_was_refused(sweep):
    out = Console(record=True, width=160, file=io.StringIO())
    out.print(table(sweep, "force"))
    text = out.export_text()
    assert all(word in text for word in ("better", "fine", "coarse", "the scene as it is", "hull: refused, at 0.1 s"))
    assert "slow" not in text and "4 against 16 times the triangles" in text and "2 are beaten" in text


def test_a_sweep_of_which_all_was_refused_is_drawn_and_told(sweep):
    nothing = replace(sweep, points=[point(None, None, *p.configuration, refusal="at 0.1 s") for p in sweep.points])
    assert imread(io.BytesIO(figure(nothing, "force"))).shape[0] > 600
    assert advice(nothing.points, "force") == "Nothing that was tried ran to its end: change the scene."


def test_the_figure_is_drawn(sweep):
    picture = imread(io.BytesIO(figure(sweep, "force")))
    orange = (np.abs(picture[..., :3] - [0.85, 0.37, 0.01]) < 0.02).all(axis=2)
    assert picture.shape[0] > 600 and orange.sum() > 200, "the front is marked"
