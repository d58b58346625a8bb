"""Accuracy: the error measure, the motions, refinement of one organ, and that the page tells what was measured."""

import importlib
import json
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tissue_contact import geometry, shapes
from tissue_contact.errors import WorkError
from tissue_contact.scenarios import accuracy
from tissue_contact.scenarios.accuracy import CASES

ROOT = Path(__file__).parents[1]
MESHES = ROOT.parent / "shared" / "meshes"


def page_module():
    """docs/accuracy.py."""
    return importlib.import_module("accuracy")


# --- refinement -------------------------------------------------------------------------------------------


def changes(forces) -> np.ndarray:
    """Relative change of the force from the coarsest to the finest mesh."""
    coarse, *_, fine = (np.array(force) for force in forces.values())
    assert fine.min() > 0.1  # N: it was pressed at all
    return np.abs(coarse / fine - 1.0)


@pytest.mark.shared_meshes
def test_force_on_a_gallbladder_changes_little_with_its_mesh(tmp_path):
    if not (MESHES / "lapgym_gallbladder_visual.stl").is_file():
        pytest.skip("lapgym_gallbladder_visual.stl is not in shared/meshes beside the checkout")
    organ = accuracy.gallbladder(MESHES, tmp_path)
    at = accuracy.places(organ.finest, 1)  # six are in the data of the page, see its claims
    # 3 % is what the project is held to.
    assert changes(accuracy.refinement(organ, at, meshes=("500", "14700"))).max() < 0.03


def test_force_on_an_ellipsoid_changes_little_with_its_mesh():
    organ = accuracy.ellipsoid()
    force = accuracy.refinement(organ, accuracy.places(organ.finest, 2))
    # Measured: 3.6 % and 5.3 %, always the coarse mesh the stiffer, as edges of 5 mm cannot follow a tip of 10 mm; the
    # wall without tension gives 8 and 10 %. Not the 3 % of the gallbladder, where two errors cancel.
    assert changes(force).max() < 0.06
    assert all(coarse > fine for coarse, fine in zip(*force.values(), strict=True))


def test_cut_surface_is_the_same_surface():
    coarse = shapes.ellipsoid((0.03, 0.016, 0.016), 200)
    fine = accuracy.cut(coarse)
    assert len(fine.triangles) == 16 * len(coarse.triangles)
    assert geometry.inspect(fine).watertight
    assert geometry.volume(fine) == pytest.approx(geometry.volume(coarse), rel=1e-9)
    assert geometry.triangle_areas(fine).max() == pytest.approx(geometry.triangle_areas(coarse).max() / 16, rel=1e-9)


def test_places_are_on_the_surface_and_their_normals_point_outward():
    surface = shapes.ellipsoid((0.03, 0.016, 0.016), 2000)
    found = accuracy.places(surface, 5)
    assert len({tuple(place.point) for place in found}) == 5
    for place in found:
        assert (place.point**2 / np.array([0.03, 0.016, 0.016]) ** 2).sum() == pytest.approx(1.0, abs=0.03)
        assert np.linalg.norm(place.normal) == pytest.approx(1.0)
        assert place.normal @ place.point > 0.0
        assert abs(place.normal[0]) < 0.5  # the broad side, not the tips


@pytest.mark.parametrize("lift", [-0.002, 0.0, 0.003])
def test_height_of_the_first_touch(lift):
    # A ball above the middle of a box's face touches it with its lowest point.
    surface = shapes.box((0.04, 0.04, 0.02), 3000)
    place = accuracy.Place(np.array([0.001, 0.002, 0.02 - lift]), np.array([0.0, 0.0, 1.0]))
    # The points that are looked at lie 0.5 mm apart, so one lies within 0.3 mm of it: 0.3²/(2 r) = 5 µm.
    assert accuracy.touch(surface, place, 0.01) == pytest.approx(lift, abs=5e-6)


# --- errors and motions -----------------------------------------------------------------------------------


def test_errors_are_relative_to_the_reference():
    true = np.array([[0.0, 0.0, 3.0], [0.0, 4.0, 0.0]])
    assert accuracy.errors(true, true) == (0.0, 0.0)
    assert_allclose(accuracy.errors(1.1 * true, true), (0.1, 0.1))
    turned = true[:, [1, 2, 0]]  # as large, along another axis
    assert_allclose(accuracy.errors(turned, true), (np.sqrt(2.0), 0.0))
    # What was refused is compared with the part that it did.
    assert_allclose(accuracy.errors(2.0 * true[:1], true), (1.0, 0.5))


def test_late_motion_touches_just_after_a_detection_of_every_rate():
    z = CASES["late"].inputs(np.array([0.1, 0.1005]))[:, 2]
    assert z[0] > 0.0
    assert z[1] == pytest.approx(0.0, abs=1e-6)
    for period in accuracy.DISCRETE.values():
        assert 0.1 / period == pytest.approx(round(0.1 / period))


def test_every_run_has_a_scene():
    asked = accuracy.runs()
    assert len({accuracy.key_of(run) for run in list(asked.values())[:20]}) == 20
    for run in asked.values():
        run.scene()


# --- keeping what was done --------------------------------------------------------------------------------


def test_measurement_goes_on_where_it_was_stopped(tmp_path, monkeypatch):
    asked = {name: accuracy.Run("poke", n, accuracy.FIELD) for name, n in (("poke, a", 32), ("poke, b", 50))}
    monkeypatch.setattr(accuracy, "runs", lambda: asked)
    built, done = accuracy.built, []

    def stopped(scene, folder):
        if len(done) == 1:
            raise KeyboardInterrupt
        done.append(scene)
        return built(scene, folder)

    output = tmp_path / "accuracy.json"
    monkeypatch.setattr(accuracy, "built", stopped)
    with pytest.raises(KeyboardInterrupt):
        accuracy.measure(output, ["poke"], tmp_path, lambda text: None)
    first = json.loads(output.read_text())["runs"]
    assert list(first) == ["poke, a"]
    monkeypatch.setattr(accuracy, "built", built)
    said: list[str] = []
    kept = accuracy.measure(output, ["poke"], tmp_path, said.append)
    assert said == ["run 2 of 2: poke, b"]
    assert kept["runs"]["poke, a"] == first["poke, a"]
    assert len(kept["runs"]["poke, b"]["force"]) == 61


def test_refused_run_keeps_its_rows(tmp_path, monkeypatch):
    def drive(slave, about, steps, inputs, parameters, trace):
        trace.done = 3
        raise WorkError("the step would have gained energy")

    fmu = accuracy.built(accuracy.Run("poke", 32, accuracy.FIELD).scene(), tmp_path)
    monkeypatch.setattr(accuracy, "drive", drive)
    kept = accuracy.record(*accuracy.followed(fmu, CASES["poke"]))
    assert kept["refusal"] == "the step would have gained energy"
    assert len(kept["force"]) == 3
    assert kept["steps"] == 60


# --- the page ---------------------------------------------------------------------------------------------


def test_page_tells_what_was_measured():
    module = page_module()
    page = module.PAGE.read_text("utf-8")
    data = json.loads(module.DATA.read_text("utf-8"))
    assert module.page_of(page, data) == page, "run python docs/accuracy.py"


def test_page_lacks_no_run():
    data = json.loads(page_module().DATA.read_text("utf-8"))
    assert [name for name in accuracy.runs() if name not in data["runs"]] == []
    assert {name.split(", ", 1)[1] for name in data["meshes"]} == set(accuracy.STUDIES)


def test_claims_of_the_page_hold_in_its_data():
    data = json.loads(page_module().DATA.read_text("utf-8"))
    runs = data["runs"]
    round_tip = ("press", "slide", "tilt")
    assert max(runs[f"{case}, distance_field"]["error"] for case in round_tip) < 0.033
    assert max(runs[f"{case}, hull"]["error"] for case in ("press", "tilt")) < 0.03
    assert min(runs[f"{case}, oobb"]["error"] for case in (*round_tip, "poke")) > 0.85
    assert runs["late, hull, 1 kHz, 0"]["error"] < 0.055
    assert max(runs[f"late, distance_field, 30 Hz, {k}"]["error"] for k in accuracy.DELAYS) > 1.0
    # The reference is much nearer to its limit than what is compared with it.
    assert max(runs[f"{case}, reference, 24000"]["error"] for case in accuracy.CASES) < 0.02
    forces = {mesh: np.array(f) for mesh, f in data["meshes"]["gallbladder, taut wall"]["forces"].items()}
    assert np.abs(forces["500"] / forces["14700"] - 1.0).max() < 0.03
    assert np.abs(forces["500"] / forces["500 cut"] - 1.0).min() > 0.1  # two errors cancel, as the page says
