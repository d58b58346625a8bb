"""The commands trade and tune: what is run, kept, timed, chosen and written."""

import itertools
import json
import pickle
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes import write_mesh
from test_cli import refused

from tissue_contact.assemble import assemble
from tissue_contact.edits import Edit, edited
from tissue_contact.errors import InputError, WorkError
from tissue_contact.pool import pool
from tissue_contact.scenarios import trade as trade_module
from tissue_contact.scenarios import tune as tune_module
from tissue_contact.scenarios.run import Interrupted
from tissue_contact.scenarios.scenario import Scenario, read_scenario
from tissue_contact.scenarios.trade import Request, follow, job_of, measured, rows_of, trade
from tissue_contact.scenarios.tune import Wish, tune, written
from tissue_contact.scene import read_scene
from tissue_contact.shapes import patch
from tissue_contact.simulate import rollout
from tissue_contact.study import levers
from tissue_contact.study.deviation import DEPTH, FORCE
from tissue_contact.study.levers import Option

SCENE = """\
# A sheet, and a ball over it.
name = "tiny"
[solver]
preset = "accurate"
stop_time = 0.06
[[tissue]]
{source}
areal_density = 1.0 # light
stiffness = 100.0
drag = 500.0
[[instrument]]
name = "probe"
shape = {{ kind = "sphere", radius = 0.003, triangles = 128 }}
start_position = [0, 0, 0.001]
[[contact]]
stiffness_per_area = 1e7
damping_per_area = 1e4
"""
PATCH = 'shape = { kind = "patch", size = [0.02, 0.02], triangles = 300 }'
SCENARIO = """\
[[stimulus]]
kind = "press"
point = [0, 0, {height}]
approach = 0.001
depth = 0.003
press_time = 0.04
hold_time = 0.02
"""
# Few runs, and small ones: the reference has as many triangles as the finest that is swept elsewhere.
REQUEST = Request(runs=12, rounds=1, refine=4.0, progress=False)
FEW = ("mesh", "integration")


def made(folder: Path, source: str = PATCH, height: float = 0.0) -> Scenario:
    folder.mkdir(exist_ok=True)
    (folder / "scene.toml").write_text(SCENE.format(source=source))
    (folder / "scenario.toml").write_text(SCENARIO.format(height=height))
    return read_scenario(folder)


@pytest.fixture(scope="module")
def few_levers():
    """Two levers and few settings of them."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(levers, "LEVERS", {k: v for k, v in levers.LEVERS.items() if k in FEW})
        patched.setattr(levers, "MESH_FACTORS", (1 / 4, 2))
        patched.setattr(levers, "SAFETIES", (0.95, 0.5))
        patched.setattr(levers, "IMPLICIT_SUBSTEPS", (1,))
        yield


@pytest.fixture(scope="module")
def swept(few_levers, tmp_path_factory):
    folder = tmp_path_factory.mktemp("trade")
    scenario = made(folder / "tiny")
    return scenario, folder / "out", trade(scenario, folder / "out", REQUEST)


# --- trade ------------------------------------------------------------------------------------------------


def test_a_sweep_has_the_scene_every_change_and_what_was_refused(swept):
    _, _, sweep = swept
    by_label = {p.label: p for p in sweep.points}
    own, coarse, fine = (by_label[n] for n in ("the scene as it is", "75 triangles", "600 triangles"))
    assert sweep.points[0] is own and own.timed
    refused = by_label["explicit_euler"]  # 1,320 substeps
    assert "stable step needs" in refused.refusal and refused.refusal.startswith("at 0 s") and refused.us is None
    # The finer the slower and the nearer, by far more than chance.
    assert coarse.error["force"] > 2 * own.error["force"] > 2 * fine.error["force"] > 0.0
    assert by_label["runge_kutta_4"].balance < own.balance < 0.05 and own.substeps > coarse.substeps
    assert by_label["implicit_euler, 1 substep"].substeps == 1
    # The reference at one and at four times the triangles: one is the scene's own mesh.
    assert 0.0 < sweep.convergence["force"] < 0.3 and sweep.references == (1.0, 4.0)
    assert any("differ by" in r for r in sweep.remarks)


def test_the_files_of_a_sweep_are_there_and_whole(swept):
    _, out, sweep = swept
    assert sorted(p.name for p in out.iterdir()) == ["runs.json", "trade.csv", "trade.json", "trade.png"]
    found = json.loads((out / "trade.json").read_text())
    assert len(found["points"]) == len(sweep.points) <= REQUEST.runs
    assert any(p["front"] for p in found["points"]) and found["scenario"] == "tiny"


def test_a_run_is_that_of_the_scene_with_its_changes(swept):
    scenario, _, sweep = swept
    (option,) = next(p.configuration for p in sweep.points if p.label == "75 triangles")
    job = job_of(scenario, edited(scenario.scene, option.edits))
    assert job.scene().tissue[0].shape.triangles == 75
    assembly = assemble(job.scene())
    names = [v.name for v in assembly.variables if v.block == "inputs"]
    true = rollout(assembly, np.column_stack([job.inputs[n] for n in names]), 1e-3).outputs
    slots = [v.slot for v in assembly.variables if v.name.startswith("probe.force[")]
    # Kept in single precision.
    assert rows_of(follow(job))[:, 0, FORCE] == pytest.approx(true[:, slots], rel=1e-6, abs=1e-9)


def test_another_process_runs_a_job_all_the_same(swept):
    scenario, _, _ = swept
    job = job_of(scenario, scenario.scene.source)
    with pool(2) as spread:
        (there,) = spread(follow, [pickle.loads(pickle.dumps(job))], lambda n, result: None)
    assert there["rows"] == follow(job)["rows"]


def test_what_is_within_reach_without_a_force_is_not_touched(tmp_path):
    """Withdrawn faster than the tissue follows, a damped contact has a depth and no force, so no point of contact."""
    scene = SCENE.replace("start_position = [0, 0, 0.001]", "start_position = [0.2, 0, 0.001]")
    scene = scene.replace("damping_per_area = 1e4", "damping_per_area = 1e5")
    tissue = f"{PATCH}\nposition = [0.2, 0, 0]\nsupport_stiffness = 1e5\nsupport_damping = 2e4"
    job = job_of(made(tmp_path / "tiny"), scene.format(source=tissue).encode())
    z = 0.001 - 0.003 * np.sin(np.linspace(0.0, np.pi, len(job.times)))
    job = replace(job, inputs={"probe.position[1]": np.full_like(z, 0.2), "probe.position[3]": z})
    found = follow(job)
    rows = rows_of(found)[:, 0]
    assert ((rows[:, DEPTH] > 0.0) & ~rows[:, FORCE].any(axis=1)).any()
    ((low, high),) = found["touched"]
    assert 0.19 < low[0] < high[0] < 0.21


def test_a_scene_that_is_refused_at_the_start_is_refused_at_0_s(tmp_path):
    contact = 'response = "hull"\nstiffness = 200.0'
    scene = SCENE.replace("stiffness_per_area = 1e7\ndamping_per_area = 1e4", contact)
    scene = scene.replace('preset = "accurate"', "max_pairs = 16").replace("[0, 0, 0.001]", "[0, 0, -0.002]")
    job = job_of(made(tmp_path / "tiny"), scene.format(source=PATCH.replace("300", "2000")).encode())
    found = follow(replace(job, inputs={}))
    assert found["refusal"].startswith("at 0 s: ") and "fmi2" not in found["refusal"], found


def test_changes_that_so_few_runs_leave_out_are_told(few_levers, tmp_path, monkeypatch):
    monkeypatch.setattr(trade_module, "step_times", lambda fmu, job: [1.0])
    sweep = measured(made(tmp_path / "tiny"), tmp_path / "out", replace(REQUEST, runs=3)).sweep
    assert [p.label for p in sweep.points] == ["the scene as it is", "75 triangles", "600 triangles"]
    (told,) = (r for r in sweep.remarks if "single changes" in r)
    number = re.fullmatch(r"Stopped at 3 runs with (\d+) single changes untried, of integration: --runs (\d+) .*", told)
    assert number and int(number[1]) + 3 == int(number[2])


def test_what_is_interrupted_goes_on_and_gives_the_same(swept, tmp_path, monkeypatch):
    _, _, whole = swept
    scenario, out, calls, stops = made(tmp_path / "tiny"), tmp_path / "out", [], [KeyboardInterrupt]

    def counted(job):
        if len(calls) == 3 and stops:
            raise stops.pop()
        calls.append(job.key)
        return follow(job)

    monkeypatch.setattr(trade_module, "follow", counted)
    with pytest.raises(Interrupted, match=r"Kept what is finished in .*runs\.json: the same command goes on there"):
        trade(scenario, out, REQUEST)
    assert [p.name for p in out.iterdir()] == ["runs.json"]
    sweep = trade(scenario, out, REQUEST)
    assert len(calls) == len(set(calls)) > 3, "nothing is run twice"
    errors = {p.label: p.error for p in whole.points}
    assert {p.label: p.error for p in sweep.points if len(p.configuration) < 2} == {
        p.label: errors[p.label] for p in whole.points if len(p.configuration) < 2
    }
    # Nothing is left to do, timing included.
    monkeypatch.setattr(trade_module, "step_times", None)
    assert [p.us for p in trade(scenario, out, REQUEST).points] == [p.us for p in sweep.points]


def test_times_are_taken_after_all_the_runs_in_turn(few_levers, tmp_path, monkeypatch):
    events = []
    monkeypatch.setattr(trade_module, "follow", lambda job: events.append("run") or follow(job))
    own_times = [1.0, 9.0, 9.0], [9.0, 2.0, 9.0], [9.0, 9.0, 8.0]
    coarse_times = [5.0, 6.0, 7.0], [7.0, 6.0, 5.0], [9.0, 9.0, 9.0]
    times = itertools.chain(*zip(own_times, coarse_times, strict=True))
    monkeypatch.setattr(trade_module, "step_times", lambda fmu, job: events.append(job.key) or next(times))
    monkeypatch.setattr(levers, "LEVERS", {"mesh": levers.LEVERS["mesh"]})
    monkeypatch.setattr(levers, "MESH_FACTORS", (1 / 4,))
    request = Request(runs=12, rounds=3, refine=4.0, progress=False)
    own, coarse = measured(made(tmp_path / "tiny"), tmp_path / "out", request).sweep.points
    last = max(n for n, event in enumerate(events) if event == "run")
    timed = events[last + 1 :]
    assert timed[:2] == timed[2:4] == timed[4:] and timed[0] != timed[1]
    assert (own.us, coarse.us) == (2.0, 5.0), "of every step the fastest of three rounds"


def test_a_refused_reference_and_a_touch_of_nothing_are_told(few_levers, tmp_path, monkeypatch):
    with pytest.raises(InputError, match=r"something must be touched; found no force in the whole run\. Lengthen"):
        measured(made(tmp_path / "above", height=0.005), tmp_path / "out", REQUEST)
    refused = {"refusal": "at 0.01 s: too much energy"}
    finest = 4 * 300

    def refuse(job):
        return refused if job.scene().tissue[0].shape.triangles == finest else follow(job)

    monkeypatch.setattr(trade_module, "follow", refuse)
    with pytest.raises(WorkError, match=r"the reference of tiny was refused: at 0\.01 s"):
        measured(made(tmp_path / "tiny"), tmp_path / "out", REQUEST)


def test_a_measure_that_the_references_do_not_agree_on_is_not_told(swept, tmp_path):
    scenario, _, sweep = swept  # the ball presses at its own origin: the torque is chance
    assert any(r.startswith("No error of the torque is told") for r in sweep.remarks)
    assert all("torque" not in p.error for p in sweep.points)
    out = swept[1]
    with pytest.raises(WorkError, match=r"no error of the torque can be told: the references at 1 and 4"):
        measured(scenario, out, Request("torque", 12, 1, 4.0, progress=False))


# --- tune -------------------------------------------------------------------------------------------------


def test_the_most_accurate_within_a_time_is_written_with_its_comments(swept, tmp_path, monkeypatch):
    scenario, data, sweep = swept
    monkeypatch.setattr(trade_module, "follow", None)  # nothing is swept anew
    coarse = next(p for p in sweep.points if p.label == "75 triangles")
    found = tune(scenario, data, REQUEST, Wish(us=1.5 * coarse.us + 1.0), tmp_path / "fast.toml")
    text = (tmp_path / "fast.toml").read_text()
    assert found.configuration and found.us <= 1.5 * coarse.us + 1.0
    assert text.startswith("# Chosen by tissue-contact tune for at most ") and "# A sheet, and a ball over it." in text
    assert f"error of the force {tune_module.percent(found.error['force'])}; the scene before had" in text
    assert "areal_density = 1.0 # light" in text
    same = next(p for p in sweep.points if p.configuration == found.configuration)
    assert found.error == pytest.approx(same.error), "measured anew, and the same"
    written_scene = read_scene(tmp_path / "fast.toml")
    assert written_scene.model_dump() == levers.variant(scenario.scene, found.configuration).model_dump()


def test_the_fastest_within_an_error_is_chosen(swept, tmp_path):
    scenario, data, sweep = swept
    own = sweep.points[0]
    found = tune(scenario, data, REQUEST, Wish(error=1.01 * own.error["force"]), tmp_path / "out.toml")
    timed = [p for p in sweep.points if p.timed and p.error["force"] <= 1.01 * own.error["force"]]
    assert found.configuration == min(timed, key=lambda p: p.us).configuration


def test_a_choice_that_fails_its_check_makes_room_for_the_next(swept, tmp_path, monkeypatch, capsys):
    scenario, data, sweep = swept
    times = iter([[1e9]])
    monkeypatch.setattr(tune_module, "step_times", lambda fmu, job: next(times, [1.0]))
    budget = 1.01 * max(p.us for p in sweep.points if p.timed)
    found = tune(scenario, data, REQUEST, Wish(us=budget), tmp_path / "out.toml")
    out = " ".join(capsys.readouterr().out.split())
    best, second, *_ = Wish(us=budget).candidates(sweep.points, "force")
    assert f"Measured anew, {best.label} has 1,000,000,000.0 µs a step in contact" in out and "the next best" in out
    assert found.configuration == second.configuration and found.us == 1.0


def test_a_wish_that_nothing_keeps_names_the_best_there_is(swept, tmp_path):
    scenario, data, sweep = swept
    best = min((p for p in sweep.points if p.timed), key=lambda p: p.us)
    told = re.escape(f"nothing that was tried keeps at most 0.01 µs. The fastest is {best.label}, with ")
    with pytest.raises(WorkError, match=told):
        tune(scenario, data, REQUEST, Wish(us=0.01), tmp_path / "out.toml")
    with pytest.raises(WorkError, match=r"keeps an error of at most 0\.00 %\. The most accurate is "):
        tune(scenario, data, REQUEST, Wish(error=1e-9), tmp_path / "out.toml")
    assert list(tmp_path.iterdir()) == []


def test_the_scene_itself_is_overwritten_only_when_told(swept, tmp_path, monkeypatch):
    scenario, data, _ = swept
    own = Path(scenario.scene.place)
    before = own.read_bytes()
    monkeypatch.chdir(own.parent)
    with pytest.raises(InputError, match=r"must not be overwritten unasked; found scene\.toml"):
        tune(scenario, data, REQUEST, Wish(us=1e9), Path("scene.toml"))
    assert own.read_bytes() == before
    tune(scenario, data, REQUEST, Wish(us=1e9), own, overwrite=True)
    assert own.read_bytes() != before and read_scene(own)
    own.write_bytes(before)


def test_mesh_paths_are_right_from_where_the_scene_is_written(tmp_path):
    flat = patch((0.02, 0.02), 300)
    (tmp_path / "tiny").mkdir()
    file = write_mesh(tmp_path / "tiny" / "sheet.obj", flat.vertices, flat.triangles)
    scenario = made(tmp_path / "tiny", f'mesh = "{file}" # measured\nopen_surface = true')
    option = Option("integration", "x", (Edit(("solver", "safety"), 0.5),))
    there = tmp_path / "other" / "folder" / "scene.toml"
    text = written(scenario.scene, (option,), there, ("Chosen.",)).decode()
    assert 'mesh = "../../tiny/sheet.obj" # measured' in text and text.startswith("# Chosen.\n")
    there.parent.mkdir(parents=True)
    there.write_text(text)
    assert assemble(read_scene(there)).model.rest_x == pytest.approx(assemble(scenario.scene).model.rest_x)


# --- the commands -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["trade", "press", "--measure", "forse"], "--measure: the value must be force or peak"),
        (["trade", "presss"], "The nearest right spelling is press"),
        (["tune", "press", "-o", "x.toml"], "exactly one of the two must be given; found neither"),
        (["tune", "press", "-o", "x.toml", "--error", "1%", "--budget-us", "5"], "found both"),
        (["tune", "press", "-o", "x.toml", "--error", "some"], "a positive share of the reference; found some"),
        (["tune", "press", "-o", "x.toml", "--error", "-1%"], "Write for instance 1% or 0.01"),
        (["tune", "press", "-o", "x.toml", "--error", "nan"], "a positive share"),
    ],
)
def test_wrong_words_are_told_in_one_line(tmp_path, words, told):
    assert told in refused(*words, cwd=tmp_path)


def test_an_error_is_a_percentage_or_a_share():
    assert Wish.of(None, "1%") == Wish.of(None, "0.01") == Wish(error=0.01)
    assert Wish.of(50.0, None) == Wish(us=50.0)
    assert (Wish(us=50.0).text, Wish(error=0.01).text) == ("at most 50 µs", "an error of at most 1.0 %")
