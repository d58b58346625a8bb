"""Runs: rows, summary, expectations, files that appear whole or are called partial, figures."""

import csv
import functools
import io
import itertools
import shutil
import struct
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from tissue_contact.assemble import assemble
from tissue_contact.errors import InputError, WorkError
from tissue_contact.files import publish
from tissue_contact.scenarios import run as run_module
from tissue_contact.scenarios.outcome import Trace, check_names, judge, summarise, write_csv
from tissue_contact.scenarios.report import CANVAS, Mesh, _rendered, history, picture, still
from tissue_contact.scenarios.run import Interrupted, Outcome, communication_points, run, scene_key, too_slow
from tissue_contact.scenarios.scenario import SHIPPED, Expectation, Scenario, read_scenario, shipped_names
from tissue_contact.scenarios.stimulus import read_recording
from tissue_contact.scene import parse_scene
from tissue_contact.shapes import capsule, ellipsoid, patch
from tissue_contact.simulate import rollout

SCENE = """\
name = "tiny"
[solver]
stop_time = 0.1
[[tissue]]
shape = { kind = "patch", size = [0.02, 0.02], triangles = 300 }
areal_density = 1.0
stiffness = 100.0
drag = 500.0
[[instrument]]
name = "probe"
shape = { kind = "sphere", radius = 0.003, triangles = 128 }
start_position = [0, 0, 0.001]
[[contact]]
stiffness_per_area = 1e7
damping_per_area = 1e4
"""
SCENARIO = """\
[[stimulus]]
kind = "press"
point = [0, 0, 0]
approach = 0.001
depth = 0.003
press_time = 0.05
hold_time = 0.05
"""
EXPECT = '[[expect]]\noutput = "probe.force[3]"\nstatistic = "max"\nat_least = 0.01\n'


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("scenarios") / "tiny"
    made.mkdir()
    (made / "scene.toml").write_text(SCENE)
    (made / "scenario.toml").write_text(SCENARIO + EXPECT)
    return made


@pytest.fixture
def tiny(folder: Path) -> Scenario:
    return read_scenario(folder)


def trace(**columns: list[float]) -> Trace:
    values = np.array(list(columns.values()), float).T
    names = tuple(name.replace("_1", "[1]").replace("_2", "[2]").replace("_3", "[3]") for name in columns)
    n = len(values)
    return Trace(0.1 * np.arange(n), names, ("N",) * len(names), values, 1e-4 * np.arange(n), n)


# --- outcome ----------------------------------------------------------------------------------------------


def test_csv_reads_back_the_same_with_units(tmp_path: Path) -> None:
    made = trace(**{"p.force_1": [0.1, 1 / 3, 1e-300], "p.depth": [0.0, -0.0, 2.0]})
    made.done = 2
    write_csv(made, tmp_path / "new" / "a.csv")
    rows = list(csv.reader((tmp_path / "new" / "a.csv").open()))
    assert rows[0] == ["time [s]", "p.force[1] [N]", "p.depth [N]"]
    assert [[float(x) for x in row] for row in rows[1:]] == [[0, 0.1, 0], [0.1, 1 / 3, 0]]
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["a.csv"]


def test_a_file_that_cannot_be_written_leaves_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "a.csv"
    publish(file, b"old")

    def refuse(*_: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr("tissue_contact.files.Path.replace", refuse)
    with pytest.raises(OSError, match="disk full"):
        publish(file, b"new")
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("a.csv", b"old")]


@pytest.mark.parametrize(
    ("statistic", "value"), [("max", 2.0), ("min", -3.0), ("mean", 0.25), ("final", 1.0), ("peak", 3.0)]
)
def test_statistics_of_expectations(statistic: str, value: float) -> None:
    made = trace(a=[1, -3, 2, 1])
    for low, high, holds in ((value, value, True), (value + 1e-9, None, False), (None, value - 1e-9, False)):
        given = Expectation(output="a", statistic=statistic, at_least=low, at_most=high)  # type: ignore[arg-type]
        (verdict,) = judge([given], made)
        assert verdict.value == pytest.approx(value)
        assert verdict.holds is holds


def test_nan_never_holds() -> None:
    given = Expectation(output="a", statistic="final", at_most=1.0)
    assert not judge([given], trace(a=[0, np.nan]))[0].holds


def test_bounds_as_shares_of_the_greatest_magnitude_of_another_output() -> None:
    made = trace(work=[0, -4, 1], balance=[0, 0.01, -0.03])
    given = {"output": "balance", "statistic": "peak", "of": "work"}
    for low, high, holds in (
        (None, 0.0076, True), (None, 0.0074, False), (0.0074, None, True), (0.0076, None, False), (0, 1, True)
    ):  # fmt: skip
        (verdict,) = judge([Expectation(**given, at_least=low, at_most=high)], made)
        assert (verdict.value, verdict.whole, verdict.holds) == (0.03, 4.0, holds)
    assert (verdict.bounds, verdict.found) == ("0 to 1 of work", "0.0075 of work")
    (plain,) = judge([Expectation(output="balance", statistic="peak", at_most=0.02)], made)
    assert (plain.bounds, plain.found, plain.holds) == ("at most 0.02 N", "0.03 N", False)
    low_only = Expectation(output="balance", statistic="max", at_least=0.01, of="balance")  # of itself
    assert (judge([low_only], made)[0].bounds, judge([low_only], made)[0].found) == (
        "at least 0.01 of balance",
        "0.333 of balance",
    )


def test_a_share_of_nothing_holds_for_nothing_only() -> None:
    given = Expectation(output="balance", statistic="peak", at_most=0.01, of="work")
    assert judge([given], trace(work=[0, 0], balance=[0, 0]))[0].holds
    (verdict,) = judge([given], trace(work=[0, 0], balance=[0, 1e-300]))
    assert not verdict.holds and verdict.found == "1e-300 N"
    assert not judge([given], trace(work=[0, np.nan], balance=[0, 0]))[0].holds


def test_unknown_output_names_the_nearest() -> None:
    for key, others in (("output", {}), ("of", {"output": "probe.depth"})):
        given = Expectation(**{key: "probe.forc[1]"}, **others, statistic="max", at_most=1.0)
        with pytest.raises(InputError, match=rf"s\.toml, expect\[0\]\.{key}: .*probe\.forc\[1\].*probe\.force\[1\]"):
            check_names([given], ["probe.force[1]", "probe.depth"], "s.toml")


def test_summary_of_a_made_up_trace(tmp_path: Path) -> None:
    made = trace(
        **{
            "p.force_1": [0, 3, 0, 0],
            "p.force_2": [0, 0, 0, 0],
            "p.force_3": [0, 4, 1, 0],
            "p.depth": [0, 0, 0.001, 0.002],
            "energy.balance": [0, 1e-6, -3e-6, 1e-6],
            "energy.work": [0, 4e-3, 3e-3, 2e-3],
        }
    )
    made.time[:] = [0, 0.1, 0.3, 0.7]
    found = summarise(made)
    assert found.peak_force == {"p": 5.0} and found.peak_time == {"p": pytest.approx(0.1)}
    assert found.deepest == {"p": 0.002}
    assert found.contact_time == {"p": pytest.approx(0.6)}
    assert (found.balance, found.work) == (-3e-6, 4e-3)
    assert (found.leader, found.held) == (None, {})  # a body without a pose to set is rigid
    assert found.step_median == pytest.approx(2e-4)
    assert found.step_tail == pytest.approx(3e-4, rel=1e-3)
    assert found.step_max == pytest.approx(3e-4)
    assert found.real_time_factor == pytest.approx(0.7 / 6e-4)
    press = read_scenario("press")
    assert not list(too_slow(found, press))
    (remark,) = too_slow(replace(found, real_time_factor=0.4), press)
    assert "slower than real time" in remark and "tune press --budget-us 500" in remark
    assert "balanced" in remark
    for name in ("clash", "palpation"):  # no tissue to integrate, and one that every preset integrates alike
        (remark,) = too_slow(replace(found, real_time_factor=0.4), read_scenario(name))
        assert f"tune {name} " in remark and "preset" not in remark
    own = tmp_path / "own"
    shutil.copytree(SHIPPED / "press", own)
    (remark,) = too_slow(replace(found, real_time_factor=0.4), read_scenario(own))
    assert f"tune {own / 'scenario.toml'} " in remark, "what the command finds it by"


def moved(name: str, force: list[float], **more: list[float]) -> dict[str, list[float]]:
    """Columns of an instrument that is pushed along x."""
    still = [0.0] * len(force)
    return {f"{name}.position_1": still} | pushed(name, force) | {f"{name}.{key}": v for key, v in more.items()}


def pushed(name: str, force: list[float]) -> dict[str, list[float]]:
    still = [0.0] * len(force)
    return {f"{name}.force_1": force, f"{name}.force_2": still, f"{name}.force_3": still, f"{name}.depth": still}


def test_the_leader_is_the_instrument_with_the_greatest_force() -> None:
    made = trace(
        **moved("left", [0, 1, 0], grasped=[0, 5, 2]), **moved("right", [0, 0, -2]), **pushed("bone", [9, 9, 9])
    )
    found = summarise(made)
    assert found.peak_force == {"left": 1, "right": 2, "bone": 9}
    assert found.leader == "right"
    assert found.held == {"left": 5}
    untouched = summarise(trace(**moved("left", [0, 0]), **pushed("bone", [1, 1])))
    assert untouched.leader is None
    assert (untouched.balance, untouched.work) == (None, None)


def test_communication_points() -> None:
    times, steps = communication_points(1.0, 0.1)
    assert times[3] == 3 * 0.1 and times[-1] == 1.0  # by multiples, not by a sum that drifts
    assert (steps == 0.1).all() and steps.shape == (10,)
    times, steps = communication_points(0.0025, 0.001)
    assert times == pytest.approx([0, 0.001, 0.002, 0.0025])
    assert steps == pytest.approx([0.001, 0.001, 0.0005])
    assert communication_points(0.0005, 0.001)[1].tolist() == [0.0005]


def test_the_key_follows_the_content(tiny: Scenario, folder: Path) -> None:
    same = read_scenario(folder).scene
    assert scene_key(tiny.scene) == scene_key(same)
    same._source = same.source + b"#"
    assert scene_key(tiny.scene) != scene_key(same)


# --- runs -------------------------------------------------------------------------------------------------


def test_a_run_from_end_to_end(tiny: Scenario, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    outcome = run(tiny, tmp_path, figures=True)
    assert outcome.holds
    assert sorted(p.name for p in tmp_path.iterdir()) == ["tiny-peak.png", "tiny.csv", "tiny.png"]
    for png in tmp_path.glob("*.png"):
        width, height = struct.unpack(">II", png.read_bytes()[16:24])
        assert width > 600 and height > 400
    rows = list(csv.reader((tmp_path / "tiny.csv").open()))
    assert len(rows) == 102
    assert rows[0][:2] == ["time [s]", "probe.position[1] [m]"] and "probe.force[3] [N]" in rows[0]
    printed = capsys.readouterr()
    for part in (
        "peak force",
        "deepest penetration",
        "energy balance",
        "real-time factor",
        "holds",
        "tiny.csv",
    ):
        assert part in printed.out
    assert printed.err == ""  # no bar where there is no terminal


def test_the_fmu_and_the_rollout_agree_to_the_bit(tiny: Scenario, tmp_path: Path) -> None:
    found = run(tiny, tmp_path, {"contact.stiffnessPerArea": 2e7}, figures=False).trace
    made = run_module.tuned(assemble(tiny.scene), {"contact.stiffnessPerArea": 2e7})
    inputs = np.tile(made.inputs, (found.done, 1))
    for v in made.variables:
        if v.block == "inputs":
            inputs[:, v.slot] = found.column(v.name)
    again = rollout(made, inputs, 0.001).outputs
    for v in made.variables:
        if v.block == "outputs":
            assert np.array_equal(again[:, v.slot], found.column(v.name)), v.name


def test_a_csv_of_a_run_is_a_recording(tiny: Scenario, tmp_path: Path) -> None:
    found = run(tiny, tmp_path, figures=False).trace
    again = read_recording(tmp_path / "tiny.csv", "probe")
    assert np.array_equal(again.position, found.vector("probe.position"))


def test_parameters_are_set_and_checked(tiny: Scenario, tmp_path: Path) -> None:
    soft, stiff = (
        run(tiny, tmp_path, {"contact.stiffnessPerArea": k}, figures=False).summary.peak_force["probe"]
        for k in (1e6, 1e7)
    )
    assert stiff > soft
    cases = {
        "contact.stifnessPerArea": (1e6, r"must have the parameter.*contact\.stiffnessPerArea"),
        "contact.stiffnessPerArea": (1e20, r"between 100 and 1e\+12 N/m3.*starts at 1e7|10000000"),
        "contact.dampingPerArea": (np.nan, "between 0 and"),
    }
    for name, (value, message) in cases.items():
        with pytest.raises(InputError, match=message):
            run(tiny, tmp_path / "none", {name: value}, figures=False)
    assert not (tmp_path / "none").exists()


def test_a_failing_step_keeps_the_rows_before(tiny: Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = run(tiny, tmp_path, figures=False).trace
    before = (tmp_path / "tiny.csv").read_bytes()
    sample = type(tiny.stimulus).sample

    def broken(self: object, times: np.ndarray) -> dict[str, np.ndarray]:
        found = sample(self, times)  # type: ignore[arg-type]
        found["probe.position[1]"][40] = np.nan
        return found

    monkeypatch.setattr(type(tiny.stimulus), "sample", broken)
    with pytest.raises(WorkError, match=r"fmi2\w+: .*finite.* Kept the 40 rows up to 0\.039 s in .*tiny\.partial\.csv"):
        run(tiny, tmp_path, figures=False)
    rows = list(csv.reader((tmp_path / "tiny.partial.csv").open()))
    assert len(rows) == 41
    assert [float(x) for x in rows[40][1:]] == whole.values[39].tolist()
    assert (tmp_path / "tiny.csv").read_bytes() == before
    monkeypatch.undo()
    run(tiny, tmp_path, figures=False)
    assert not (tmp_path / "tiny.partial.csv").exists()


def test_an_interrupt_keeps_the_rows_before(tiny: Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read, count = run_module._Port.read, itertools.count()

    def stopped(self: run_module._Port, slave: object) -> None:
        if next(count) == 21:
            raise KeyboardInterrupt
        read(self, slave)  # type: ignore[arg-type]

    monkeypatch.setattr(run_module._Port, "read", stopped)
    with pytest.raises(Interrupted, match=r"interrupted\. Kept the 21 rows up to 0\.02 s"):
        run(tiny, tmp_path, figures=False)
    assert [p.name for p in tmp_path.iterdir()] == ["tiny.partial.csv"]


# --- shipped ----------------------------------------------------------------------------------------------


@functools.cache
def ran(name: str, parameter: str = "", value: float = 0.0) -> Outcome:
    """A shipped scenario as it is, or with one parameter changed."""
    with tempfile.TemporaryDirectory() as folder:
        return run(read_scenario(name), Path(folder), {parameter: value} if parameter else {}, figures=False)


@pytest.mark.parametrize("name", shipped_names())
def test_shipped_scenarios_keep_their_expectations(name: str) -> None:
    scene = read_scenario(name).scene
    meshes = [scene.folder / body.mesh for body in (*scene.tissue, *scene.bodies) if body.mesh]
    missing = [mesh for mesh in meshes if not mesh.is_file()]
    if missing:
        pytest.skip(f"{missing[0].name} is not in shared/meshes beside the checkout")
    broken = [
        (v.expectation.output, v.expectation.statistic, v.bounds, v.found) for v in ran(name).verdicts if not v.holds
    ]
    assert broken == []


@pytest.mark.parametrize("name", shipped_names())
def test_shipped_scenarios_account_for_energy_and_give_reasons(name: str) -> None:
    expected = read_scenario(name).expect
    (balance,) = [e for e in expected if e.output == "energy.balance"]
    assert (balance.statistic, balance.of) == ("peak", "energy.work")
    assert balance.at_most is not None and balance.at_most <= 0.01
    assert all(e.reason for e in expected)


def test_friction_is_its_share_of_the_normal_force() -> None:
    rough, smooth = (o.trace.vector("tip.force") for o in (ran("slide"), ran("slide", "contact.friction", 0.0)))
    pressed = rough[:, 2] > 0.05
    assert pressed.sum() > 1000
    # What is left without friction is the slope of the dome. The share of the vertical force alone is greater, as
    # friction goes with the pressure on all of the curved dent.
    share = np.abs(rough[pressed, 0] - smooth[pressed, 0]) / rough[pressed, 2]
    assert share.min() > 0.19
    assert share.max() < 0.23


def test_an_organ_that_keeps_its_volume_is_harder() -> None:
    full, empty = (
        o.summary.peak_force["finger"] for o in (ran("palpation"), ran("palpation", "organ.volumeStiffness"))
    )
    assert full > 2 * empty


@pytest.mark.parametrize(("stiffness", "least", "most"), [(5e6, 0.998, 1.0), (0.0, 0.5, 0.996)])
def test_the_volume_under_the_finger(stiffness: float, least: float, most: float) -> None:
    scenario = read_scenario("palpation")
    assembly = run_module.tuned(assemble(scenario.scene), {"organ.volumeStiffness": stiffness})
    inputs = np.tile(assembly.inputs, (446, 1))  # up to the peak of the first stroke
    sampled = scenario.stimulus.sample(1e-3 * np.arange(446))
    for variable in assembly.variables:
        if variable.block == "inputs" and variable.name in sampled:
            inputs[:, variable.slot] = sampled[variable.name]
    state, model = rollout(assembly, inputs, 1e-3).state, assembly.model
    corners = np.column_stack([state.x, state.y, state.z])[
        np.column_stack([model.triangle_a, model.triangle_b, model.triangle_c])
    ]
    volume = np.linalg.det(corners).sum() / 6
    assert least < volume / model.tissue_volume[0] < most


def test_bone_stiffens_the_force() -> None:
    trace = ran("bone").trace
    going = np.flatnonzero(np.diff(trace.column("probe.position[3]")) < 0)
    z, force = trace.column("probe.position[3]")[going], trace.column("probe.force[3]")[going]
    soft, hard = (z > -0.0029) & (z < -0.002), z < -0.0031
    slopes = [-np.polyfit(z[part], force[part], 1)[0] for part in (soft, hard)]
    assert slopes[0] > 30
    assert slopes[1] > 20 * slopes[0]


def test_two_graspers_feel_the_same_pull() -> None:
    trace = ran("stretch").trace
    left, right = trace.vector("left.force"), trace.vector("right.force")
    pulled = left[:, 0] > 0.1
    assert pulled.sum() > 400
    assert np.abs(left + right)[pulled].max() < 0.02 * left[:, 0].max()


def test_jaws_that_grip_harder_do_not_slip() -> None:
    slipping, firm = ran("retract"), ran("retract", "grasper.graspSlipForce", 20.0)
    held = [o.trace.column("grasper.grasped") for o in (slipping, firm)]
    assert held[0].max() == held[1].max()
    open_again = int(np.flatnonzero(slipping.trace.column("grasper.jaw") == 0).max())
    assert held[0][open_again] == 0
    assert held[1][open_again] == held[1].max()
    assert held[1][-1] == 0
    # in between the tissue does not leave the jaws all at once
    assert ((held[0] > 0) & (held[0] < held[0].max())).sum() > 20
    assert firm.summary.peak_force["grasper"] > 2 * slipping.summary.peak_force["grasper"]


def test_the_poke_goes_through_at_two_metres_a_second() -> None:
    trace = ran("poke").trace
    z = trace.column("rod.position[3]")
    assert np.abs(np.diff(z) / np.diff(trace.time)).max() == pytest.approx(2.0, rel=0.01)
    # once pierced, the near side bears the rod no more, and the far side never does
    beyond = (z < -0.01) & (np.gradient(z) < 0)
    assert beyond.sum() > 10
    peak = trace.column("rod.force[3]").max()
    assert np.abs(trace.vector("rod.force")[beyond]).max() < 0.1 * peak


# --- figures ----------------------------------------------------------------------------------------------


def pixels(png: bytes) -> np.ndarray:
    return np.asarray(imread(io.BytesIO(png)))[:, :, :3]


def ivory(image: np.ndarray) -> int:
    """Pixels in the colour of bone, lit or not."""
    return int(((image[:, :, 0] - image[:, :, 2] > 0.05) & (image[:, :, 0] > 0.3)).sum())


def test_picture_shows_tissue_and_instrument_uncut() -> None:
    sheet, rod = patch((0.04, 0.04), 400), capsule(0.003, 0.03, 200)
    dented = sheet.vertices - [0, 0, 0.004] * np.exp(-(sheet.vertices**2).sum(axis=1) / 4e-5)[:, None]
    for up in ([0, 0, 1.0], [1.0, 0.2, 0]):
        image = pixels(
            picture(
                Mesh(dented, sheet.triangles),
                sheet.vertices,
                [Mesh(rod.vertices, rod.triangles)],
                np.array(up),
                "dent",
            )
        )
        drawn = (image < 0.98).any(axis=2)
        assert drawn.mean() > 0.2
        assert not drawn[0].any() and not drawn[-1].any() and not drawn[:, 0].any() and not drawn[:, -1].any()
        assert ((image[:, :, 0] - image[:, :, 2]) > 0.3).any()  # the red of the dent
        assert ((image[:, :, 2] - image[:, :, 0]) > 0.02).any()  # the steel


def test_a_scene_at_rest(tiny: Scenario) -> None:
    first = still(tiny.scene, assemble(tiny.scene))
    assert first == still(tiny.scene, assemble(tiny.scene))
    image = pixels(first)
    red = image[:, :, 0] - image[:, :, 2]
    assert (red > 0.1).mean() > 0.1 and (red < -0.02).any()  # the tissue, the steel
    higher = parse_scene(SCENE.replace("[0, 0, 0.001]", "[0, 0, 0.011]").encode(), Path())
    assert still(higher, assemble(higher)) != first


def test_a_scene_without_tissue_at_rest() -> None:
    text = 'name = "alone"\n[[instrument]]\nshape = { kind = "box", size = [0.01, 0.01, 0.01] }\n'
    bone = '[[rigid]]\nshape = { kind = "sphere", radius = 0.01, triangles = 128 }\nposition = [0.02, 0, 0]\n'
    scenes = [parse_scene(t.encode(), Path()) for t in (text, text + bone)]
    alone, both = (pixels(still(scene, assemble(scene))) for scene in scenes)
    assert (alone[:, :, 2] - alone[:, :, 0] > 0.02).any() and not ivory(alone)
    assert ivory(both) > 1000


def test_rendering_is_not_cut_at_the_edge_of_the_canvas() -> None:
    rod = capsule(0.003, 0.03, 200)
    faces = 1e3 * rod.vertices[rod.triangles]
    for scale in ([1, 1, 1], [20, 1, 1], [1, 20, 1], [20, 20, 1]):
        n = len(faces)
        image = _rendered(faces * scale, np.tile([0.5, 0.5, 0.5, 1.0], (n, 1)), np.ones(n, bool))
        assert max(image.shape[:2]) < CANVAS


def test_picture_shows_rigid_bodies_and_needs_no_tissue() -> None:
    rod, ball = capsule(0.003, 0.03, 200), ellipsoid((0.01, 0.01, 0.01), 300)
    nothing = Mesh(np.empty((0, 3)), np.empty((0, 3), int))
    bone = Mesh(ball.vertices - [0, 0, 0.01], ball.triangles)
    steel = [Mesh(rod.vertices, rod.triangles)]
    up = np.array([0.0, 0, 1])
    alone, both = (pixels(picture(nothing, nothing.vertices, steel, up, "clash", r)) for r in ([], [bone]))
    assert not ivory(alone) and ivory(both) > 1000
    assert (alone[:, :, 2] - alone[:, :, 0] > 0.02).any()  # the steel


def test_history_draws_every_body() -> None:
    one = moved("a", [0, 1, 0])
    two = one | pushed("b", [0, 1, 0])
    assert pixels(history(trace(**two), ["a", "b"], "t")).shape[0] > pixels(history(trace(**one), ["a"], "t")).shape[0]


def test_history_shows_when_jaws_hold() -> None:
    grey = [
        (np.abs(pixels(history(trace(**moved("a", [0, 1, 0, 0], grasped=held)), ["a"], "t")) - 0.9) < 0.01).mean()
        for held in ([0, 0, 0, 0], [0, 4, 4, 0])
    ]
    assert grey[1] > grey[0] + 0.1  # the grid is as grey


def test_history_of_a_grasper_that_touches_nothing_shows_how_much_it_holds() -> None:
    def drawn(held: list[float], depth: list[float]) -> np.ndarray:
        return pixels(history(trace(**moved("a", [0, 1, 1, 0], grasped=held, depth=depth)), ["a"], "t"))

    all_of_it, less = [0, 4, 4, 0], [0, 4, 2, 0]
    nothing, some = [0, 0, 0, 0], [0, 1e-3, 1e-3, 0]
    assert not np.array_equal(drawn(all_of_it, nothing), drawn(less, nothing))
    assert np.array_equal(drawn(all_of_it, some), drawn(less, some))


def test_an_instrument_deeper_than_its_field_can_press_is_remarked(tmp_path, capsys):
    """A contact a hundred times too soft lets the tip through: the run says so, and what to do."""
    from tissue_contact.scenarios.run import run

    run(read_scenario("press"), tmp_path, {"contact.stiffnessPerArea": 5e5}, progress=False, figures=False)
    told = " ".join(capsys.readouterr().err.split())
    assert "instrument went" in told and "Raise the stiffness of contact" in told
