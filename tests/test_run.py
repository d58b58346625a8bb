"""Runs: rows, summary, expectations, files that appear whole or are called partial, figures."""

import csv
import io
import itertools
import struct
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
from tissue_contact.scenarios.run import Interrupted, communication_points, run, scene_key
from tissue_contact.scenarios.scenario import Expectation, Scenario, read_scenario
from tissue_contact.scenarios.stimulus import read_recording
from tissue_contact.shapes import capsule, patch
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
stiffness = 300.0
damping = 1.0
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


def test_unknown_output_names_the_nearest() -> None:
    given = Expectation(output="probe.forc[1]", statistic="max", at_most=1.0)
    with pytest.raises(InputError, match=r"s\.toml, expect\[0\]\.output.*probe\.forc\[1\].*probe\.force\[1\]"):
        check_names([given], ["probe.force[1]", "probe.depth"], "s.toml")


def test_summary_of_a_made_up_trace() -> None:
    made = trace(
        **{
            "p.force_1": [0, 3, 0, 0],
            "p.force_2": [0, 0, 0, 0],
            "p.force_3": [0, 4, 1, 0],
            "p.depth": [0, 0, 0.001, 0.002],
            "energy.balance": [0, 0, 0, 1e-6],
            "energy.work": [0, 4e-3, 3e-3, 2e-3],
        }
    )
    made.time[:] = [0, 0.1, 0.3, 0.7]
    found = summarise(made)
    assert found.peak_force == {"p": 5.0} and found.peak_time == {"p": pytest.approx(0.1)}
    assert found.deepest == {"p": 0.002}
    assert found.contact_time == {"p": pytest.approx(0.6)}
    assert (found.balance, found.work) == (1e-6, 4e-3)
    assert found.step_median == pytest.approx(2e-4)
    assert found.step_tail == pytest.approx(3e-4, rel=1e-3)
    assert found.step_max == pytest.approx(3e-4)
    assert found.real_time_factor == pytest.approx(0.7 / 6e-4)


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
    found = run(tiny, tmp_path, {"contact.stiffness": 400.0}, figures=False).trace
    made = run_module.tuned(assemble(tiny.scene), {"contact.stiffness": 400.0})
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
        run(tiny, tmp_path, {"contact.stiffness": k}, figures=False).summary.peak_force["probe"]
        for k in (100.0, 1000.0)
    )
    assert stiff > soft
    cases = {
        "contact.stifness": (1.0, r"must have the parameter.*contact\.stiffness"),
        "contact.stiffness": (1e9, r"between 1 and 1e\+07 N/m.*starts at 300"),
        "contact.damping": (np.nan, "between 0 and"),
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


# --- figures ----------------------------------------------------------------------------------------------


def pixels(png: bytes) -> np.ndarray:
    return np.asarray(imread(io.BytesIO(png)))[:, :, :3]


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
    assembly = assemble(tiny.scene)
    first = still(assembly)
    assert first == still(assembly)
    image = pixels(first)
    red = image[:, :, 0] - image[:, :, 2]
    assert (red > 0.1).mean() > 0.1 and (red < -0.02).any()  # the tissue, the steel
    assembly.inputs[2] += 0.01
    assert still(assembly) != first


def test_rendering_is_not_cut_at_the_edge_of_the_canvas() -> None:
    rod = capsule(0.003, 0.03, 200)
    faces = 1e3 * rod.vertices[rod.triangles]
    for scale in ([1, 1, 1], [20, 1, 1], [1, 20, 1], [20, 20, 1]):
        n = len(faces)
        image = _rendered(faces * scale, np.tile([0.5, 0.5, 0.5, 1.0], (n, 1)), np.ones(n, bool))
        assert max(image.shape[:2]) < CANVAS


def test_history_draws_every_instrument() -> None:
    one = {f"a.force_{k}": [0, k, 0] for k in (1, 2, 3)} | {"a.depth": [0, 0.001, 0]}
    two = one | {name.replace("a.", "b."): values for name, values in one.items()}
    assert pixels(history(trace(**two), ["a", "b"], "t")).shape[0] > pixels(history(trace(**one), ["a"], "t")).shape[0]
