"""Presets: what they fill in of a scene and what they leave, and that the page tells what was measured of them."""

import importlib
import json
from dataclasses import replace
from pathlib import Path
from typing import get_args

import pytest
from test_cli import command, one_line

from tissue_contact.assemble import assemble
from tissue_contact.edits import changed, with_preset
from tissue_contact.errors import InputError, WorkError
from tissue_contact.pool import in_line
from tissue_contact.presets import BEYOND_SPRINGS, DEFAULT, PRESETS, PresetName
from tissue_contact.scenarios import presets as measurement
from tissue_contact.scenarios.scenario import read_scenario
from tissue_contact.scene import Scene, parse_scene, scene_schema
from tissue_contact.study import levers

ROOT = Path(__file__).parents[1]
SCENE = """
name = "sheet"
[solver]
{solver}
[[tissue]]
shape = {{ kind = "patch", size = [0.02, 0.02], triangles = 100 }}
areal_density = 1.0
stiffness = 100.0
{tissue}
[[instrument]]
shape = {{ kind = "sphere", radius = 0.003, triangles = 128 }}
start_position = [0.0, 0.0, 0.001]
[[contact]]
stiffness_per_area = 1e7
"""
PROJECTIVE = [name for name, preset in PRESETS.items() if preset.integrator == "projective_dynamics"]


def scene_of(solver: str, tissue: str = "") -> Scene:
    return parse_scene(SCENE.format(solver=solver, tissue=tissue).encode(), Path())


# --- what a scene comes to --------------------------------------------------------------------------------


def test_every_name_has_its_preset():
    assert get_args(PresetName) == tuple(PRESETS)


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_fills_in_what_the_scene_does_not_say(name):
    solver = scene_of(f'preset = "{name}"\nsafety = 0.5').solver
    assert {key: getattr(solver, key) for key in PRESETS[name].keys} == PRESETS[name].keys
    assert (solver.safety, solver.substeps, solver.detection) == (0.5, 0, "continuous")


def test_without_a_preset_a_scene_has_the_default_one():
    plain = scene_of("").solver
    assert {key: getattr(plain, key) for key in PRESETS[DEFAULT].keys} == PRESETS[DEFAULT].keys
    named = scene_of('integrator = "projective_dynamics"').solver
    assert (named.iterations, named.tolerance, named.motion_limit) == (3, 0.0, 0.0), "none was asked for"


def test_the_default_takes_what_works_beyond_springs_without_a_word():
    """Nobody asked for anything that it could not give."""
    made = scene_of("", "nonlinearity = 1.0")
    assert (made.solver.integrator, made.remarks) == (BEYOND_SPRINGS.integrator, ())


@pytest.mark.parametrize("name", PROJECTIVE)
def test_what_the_scene_says_wins(name):
    preset = f'preset = "{name}"\n'
    solver = scene_of(f"{preset}iterations = 7").solver
    assert (solver.integrator, solver.iterations) == ("projective_dynamics", 7)
    other = scene_of(f'{preset}integrator = "implicit_euler"')
    assert (other.solver.integrator, other.remarks) == ("implicit_euler", ())
    assert "iterations" not in other.solver.model_fields_set, "which has no meaning for it"
    same = scene_of(f'{preset}integrator = "projective_dynamics"').solver
    assert same.iterations == PRESETS[name].iterations, "the preset's own integrator keeps the rest of it"


@pytest.mark.parametrize("effect", ["nonlinearity = 1.0", "area_stiffness = 1.0", "volume_stiffness = 1.0"])
@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_takes_what_works_beyond_springs_and_says_so(name, effect):
    made = scene_of(f'preset = "{name}"', effect)
    assert made.solver.integrator == BEYOND_SPRINGS.integrator
    if name in PROJECTIVE:
        (remark,) = made.remarks
        assert all(word in remark for word in (name, "symplectic_euler", effect.split()[0], "tissue tissue"))
    else:
        assert made.remarks == ()


def test_a_scheme_that_the_scene_names_itself_is_refused_all_the_same():
    made = scene_of('preset = "fast"\nintegrator = "projective_dynamics"', "nonlinearity = 1.0")
    with pytest.raises(InputError, match=r"solver\.integrator.*nonlinearity of tissue tissue"):
        assemble(made)


def test_an_edit_of_a_preset_keeps_the_file_and_the_reference_leaves_it_aside():
    scene = scene_of('preset = "balanced" # quick\niterations = 4')
    faster = with_preset(scene, "fast")
    assert faster.solver.preset == "fast" and faster.solver.iterations == 4 and b"# quick" in faster.source
    assert with_preset(scene, None) is scene
    known = levers.grounds(scene, assemble(scene).model.contact_reach)
    finer = changed(scene, levers.reference(scene, known, 4.0))
    assert finer.solver.integrator == "symplectic_euler"


def test_the_schema_knows_the_presets_and_what_they_are():
    key = scene_schema()["$defs"]["Solver"]["properties"]["preset"]
    assert key["enum"] == list(PRESETS)
    assert all(preset.words in key["description"] for preset in (*PRESETS.values(), BEYOND_SPRINGS))


def test_the_command_line_puts_a_preset_before_that_of_the_scene(tmp_path):
    done = command("run", "press", "--preset", "quick", "-o", tmp_path)
    assert done.returncode == 2
    line = one_line(done.stderr)
    assert "--preset: the value must be fast or balanced or accurate; found quick" in line
    assert read_scenario("press", "fast").scene.solver.integrator == PRESETS["fast"].integrator


# --- measured ---------------------------------------------------------------------------------------------


def test_every_preset_is_among_what_is_measured():
    assert set(PRESETS.values()) <= set(measurement.CANDIDATES)


def test_a_scenario_is_measured_only_with_what_it_can_have(tmp_path):
    found = {case.name: case for case in measurement.cases(tmp_path, lambda text: None)}
    assert {"press", "retract", *measurement.SHEETS} <= set(found) and "clash" not in found
    assert found["press"].candidates == measurement.CANDIDATES
    assert found["retract"].candidates == [BEYOND_SPRINGS]
    fast = found["press"].edited(PRESETS["fast"].keys).scene().solver
    assert (fast.integrator, fast.iterations) == ("projective_dynamics", 1)
    assert len(found["press"].job.expect) == len(read_scenario("press").expect)
    assert [job.scene().solver.safety for job in measurement.references(found["retract"])][:2] == [0.2, 0.1]


def test_a_measurement_is_kept_and_tells_what_fails(tmp_path):
    folder = tmp_path / "tiny"
    folder.mkdir()
    (folder / "scene.toml").write_text(SCENE.format(solver="stop_time = 0.04", tissue="drag = 500.0"))
    (folder / "scenario.toml").write_text("""
        [[stimulus]]
        kind = "press"
        point = [0.0, 0.0, 0.0]
        approach = 0.001
        depth = 0.002
        press_time = 0.02
        hold_time = 0.01
        [[expect]]
        output = "instrument.force[3]"
        statistic = "max"
        at_least = 1e3
    """)
    scenario = read_scenario(folder)
    job = replace(measurement.job_of(scenario, scenario.scene.source), expect=scenario.expect)
    case = measurement.Case("tiny", scenario.scene, job)
    said: list[str] = []
    kept, about = measurement.measured(case, tmp_path, in_line, said.append)
    assert list(about["runs"]) == [c.words for c in measurement.CANDIDATES]
    few, *_, more, euler = about["runs"].values()
    assert euler["error"]["force"] < more["error"]["force"] < few["error"]["force"]
    assert about["convergence"]["force"] < euler["error"]["force"] < about["mesh"]["force"]
    assert ["max of instrument.force[3]" in told for told in few["failed"]] == [True]

    def nothing_left(work, tasks, on_done):
        assert tasks == [], "nothing is run twice"

    again, same = measurement.measured(case, tmp_path, nothing_left, said.append)
    assert same == about and again.done == kept.done


def test_a_reference_that_is_refused_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(measurement, "follow", lambda job: {"refusal": "at 0.1 s: too much energy"})
    scenario = read_scenario("press")
    case = measurement.Case("press", scenario.scene, measurement.job_of(scenario, scenario.scene.source))
    with pytest.raises(WorkError, match=r"reference of press was refused: at 0\.1 s: too much energy\. Name others"):
        measurement.measured(case, tmp_path, in_line, print)


# --- the page ---------------------------------------------------------------------------------------------


def page_module():
    """docs/presets.py."""
    return importlib.import_module("presets")


def measured_data():
    return json.loads(page_module().DATA.read_text("utf-8"))


def test_page_tells_what_was_measured():
    module = page_module()
    page = module.PAGE.read_text("utf-8")
    assert module.page_of(page, measured_data()) == page, "run python docs/presets.py"


def test_the_presets_are_those_that_were_measured():
    assert measured_data()["presets"] == {name: preset.words for name, preset in PRESETS.items()}
