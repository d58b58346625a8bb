"""Identification of a whole model: recovery from the FMU's own data, both routes, derivatives, resuming."""

import json
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import least_squares as scipy_least_squares
from scipy.spatial.transform import Rotation
from test_cli import command

from tissue_contact.assemble import assemble
from tissue_contact.errors import InputError
from tissue_contact.identify import scene_fit
from tissue_contact.identify.recording import Recording
from tissue_contact.identify.result import read_result
from tissue_contact.identify.rollouts import (
    Drive,
    SceneForce,
    SceneMaker,
    as_casadi,
    drive_of,
    instrument_of,
    wanted_variables,
)
from tissue_contact.identify.scene_fit import SceneOptions, fit_scene
from tissue_contact.pool import Kept, pool
from tissue_contact.scenarios.fit import Request
from tissue_contact.scenarios.fit import fit as fit_data
from tissue_contact.scenarios.fmu_force import FmuForce, FmuMaker, variables_of
from tissue_contact.scenarios.run import Interrupted, fmu_of
from tissue_contact.scene import parse_scene
from tissue_contact.variables import Variable

SCENE = b"""
name = "soft"
[solver]
preset = "accurate"  # derivatives do not see that iterations become more or fewer
[[tissue]]
shape = { kind = "patch", size = [0.03, 0.03], triangles = 300 }
areal_density = 1.0
stiffness = 100.0
support_stiffness = 1e5
support_damping = 2000.0
[[instrument]]
shape = { kind = "sphere", radius = 0.004, triangles = 128 }
start_position = [0.0, 0.0, 0.001]
[[contact]]
stiffness_per_area = 2e7
damping_per_area = 1e4
"""
NAMES = ("contact.stiffnessPerArea", "contact.dampingPerArea", "tissue.supportStiffness")
TRUTH = np.array([3e7, 6e3, 7e4])
STEPS = 150


@pytest.fixture(scope="module")
def scene():
    return parse_scene(SCENE, Path())


@pytest.fixture(scope="module")
def assembly(scene):
    return assemble(scene)


@pytest.fixture(scope="module")
def fmu(scene, assembly):
    return fmu_of(scene, lambda: assembly, lambda text: None)


def poses(depth: float = 2.5e-3) -> np.ndarray:
    """A press with a tremble, so that dampers are felt, with time in the first column."""
    t = 1e-3 * np.arange(STEPS + 1)
    z = 1e-3 - (1e-3 + depth) * np.sin(np.pi * t / t[-1]) ** 2 + 1e-4 * np.sin(2 * np.pi * 60 * t)
    return np.stack([t, 0 * t, 0 * t, z, 1 + 0 * t, 0 * t, 0 * t, 0 * t], axis=1)


def recorded(fmu, depth: float = 2.5e-3, values=TRUTH) -> Recording:
    """What the FMU gives as if it had been measured."""
    drive = blank(depth)
    force = FmuForce(fmu, "instrument", [drive], NAMES).values(np.asarray(values))
    pose = poses(depth)
    return Recording(
        "a", "", "soft.csv", np.arange(STEPS + 1), time=pose[:, 0], pose=pose[:, 1:], force_vector=force.reshape(-1, 3)
    )  # fmt: skip


def blank(depth: float) -> Drive:
    return Drive(poses(depth)[:, 1:], 1e-3, np.empty(0))


def fit(make, drives, assembly, tmp_path, spread=None, **options):
    wanted = wanted_variables(assembly.variables, NAMES)
    start = np.array([v.start for v in wanted])
    kept = Kept(tmp_path / "starts.json", "problem")
    more = () if spread is None else (spread,)
    return fit_scene(make, drives, wanted, start, SceneOptions(**options), kept, *more)


def test_both_routes_give_the_same_force_and_both_the_truth(fmu, assembly, tmp_path):
    drive = drive_of(recorded(fmu), assembly.variables, "instrument")
    in_python = SceneForce(assembly, "instrument", [drive], NAMES)
    # One set of kernels, compiled for this processor and for any: they differ by rounding.
    assert in_python.values(TRUTH) == pytest.approx(drive.measured, rel=1e-9, abs=1e-12)
    for make in (SceneMaker(assembly, "instrument", NAMES), FmuMaker(fmu.read_bytes(), "instrument", NAMES)):
        found = fit(make, [drive], assembly, tmp_path / type(make).__name__)
        assert found.values == pytest.approx(TRUTH, rel=1e-6), type(make)
        assert {e.verdict for e in found.fitted.estimates} == {"identified"}


def test_jacobian_through_casadi_agrees_with_differences_through_the_fmu(fmu, assembly):
    drive = blank(2e-3)
    exact = SceneForce(assembly, "instrument", [drive], NAMES)
    force = as_casadi(exact, 3 * (STEPS + 1))
    symbol = ca.MX.sym("p", 3)
    jacobian = ca.Function("j", [symbol], [ca.jacobian(force(symbol), symbol)])
    # Where the number of substeps changes, or a contact damper jumps at touch, differences see a jump and the
    # derivative of a branch does not: the two agree to some per cent, and to a fifth where a stiff contact hardly
    # matters. What is exact is shown in test_sensitivity.
    for damping, columns, tolerance in ((0.0, (0, 2), 0.05), (TRUTH[1], (0, 1, 2), 0.25)):
        values = np.array([TRUTH[0], damping, TRUTH[2]])
        by_difference = FmuForce(fmu, "instrument", [drive], NAMES).slopes(values)
        for k in columns:
            off = np.linalg.norm(np.asarray(jacobian(values))[:, k] - by_difference[:, k])
            assert off < tolerance * np.linalg.norm(by_difference[:, k]), (damping, NAMES[k])


def test_noise_is_told_in_the_intervals(fmu, assembly, tmp_path):
    drive = drive_of(recorded(fmu), assembly.variables, "instrument")
    seed = 4
    noise = 0.02 * np.abs(drive.measured).max() * np.random.default_rng(seed).standard_normal(drive.measured.size)
    noisy = Drive(drive.inputs, drive.step, drive.measured + noise)
    found = fit(SceneMaker(assembly, "instrument", NAMES), [noisy], assembly, tmp_path)
    for e, truth in zip(found.fitted.estimates, TRUTH, strict=True):
        # Four standard errors: chance leaves them once in 10,000.
        assert abs(e.value - truth) < 4 * e.standard_error, (seed, e)
    assert found.fitted.rmse == pytest.approx(noise.std(), rel=0.02)


def test_a_force_without_touch_identifies_nothing(assembly, tmp_path):
    still = Drive(np.tile(assembly.inputs, (11, 1)), 1e-3, np.zeros(33))
    found = fit(SceneMaker(assembly, "instrument", NAMES), [still], assembly, tmp_path)
    assert {e.verdict for e in found.fitted.estimates} == {"not identifiable"}
    assert {e.value for e in found.fitted.estimates} == {None}


def test_the_optimum_is_that_of_scipy_with_differences(fmu, assembly, tmp_path):
    drive = drive_of(recorded(fmu), assembly.variables, "instrument")
    noise = 0.02 * np.abs(drive.measured).max() * np.random.default_rng(5).standard_normal(drive.measured.size)
    noisy = Drive(drive.inputs, drive.step, drive.measured + noise)
    found = fit(SceneMaker(assembly, "instrument", NAMES), [noisy], assembly, tmp_path)
    force = SceneForce(assembly, "instrument", [noisy], NAMES)
    other = scipy_least_squares(lambda u: force.values(u * TRUTH) - noisy.measured, np.ones(3), diff_step=1e-2)
    # Of 450 samples with 3 constants the cost is known to a thousandth by more than one standard error.
    assert found.fitted.rmse**2 * noise.size / 2 <= other.cost * (1 + 1e-3)


def test_starts_folds_and_grid_are_spread_kept_and_gone_on_with(fmu, assembly, tmp_path):
    drives = [drive_of(recorded(fmu, d), assembly.variables, "instrument") for d in (1.5e-3, 2.5e-3)]
    make = SceneMaker(assembly, "instrument", NAMES)
    options = {"starts": 2, "folds": 2, "grid": {NAMES[0]: (1e7, 5e7, 3)}}
    with pool(2) as spread:
        found = fit(make, drives, assembly, tmp_path, spread, **options)
    assert found.values == pytest.approx(TRUTH, rel=1e-6)
    assert found.grid is not None and found.grid[0][:, 0].tolist() == [1e7, 3e7, 5e7]
    make_cost = SceneForce(assembly, "instrument", drives, NAMES)
    away = make_cost.values(found.grid[0][2]) - np.concatenate([d.measured for d in drives])
    assert found.grid[1][2] == pytest.approx(0.5 * away @ away)
    (held_out,) = found.held_out
    assert held_out.folds == 2 and held_out.rmse < 1e-6
    kept = json.loads((tmp_path / "starts.json").read_text())["done"]
    assert len(kept) == 3 + 2 + 2

    def none_left(work, tasks, on_done):
        assert tasks == []
        return []

    again = fit(make, drives, assembly, tmp_path, none_left, **options)
    assert again.values.tolist() == found.values.tolist()
    # Of another problem what was kept says nothing.
    assert Kept(tmp_path / "starts.json", "other").done == {}


GONE = [50, 51, 90]  # while the ball is in


def test_samples_that_are_missing_are_driven_through_and_not_compared(fmu, assembly):
    whole = recorded(fmu)
    kept = np.delete(np.arange(STEPS + 1), GONE)
    pose = whole.pose.copy()
    pose[:, 2] = np.interp(whole.time, whole.time[kept], pose[kept, 2])
    angle = np.interp(whole.time, whole.time[kept], whole.time[kept] ** 2)  # [rad]
    pose[:, 3:] = Rotation.from_rotvec(np.outer(angle, [1.0, 20.0, 0.0])).as_quat(scalar_first=True)
    pose[kept[::2], 3:] *= -1.0  # the same orientation
    full = drive_of(replace(whole, pose=pose), assembly.variables, "instrument")
    courses = {name: getattr(whole, name)[kept] for name in ("lines", "time", "force_vector")}
    drive = drive_of(replace(whole, pose=pose[kept], **courses), assembly.variables, "instrument")
    assert (drive.step, drive.inputs.shape) == (pytest.approx(1e-3), full.inputs.shape)
    assert drive.measured.tolist() == whole.force_vector[kept].ravel().tolist()
    for of in (lambda d: SceneForce(assembly, "instrument", d, NAMES), lambda d: FmuForce(fmu, "instrument", d, NAMES)):
        alone, both = of([full]), of([drive, full])
        for found, all_rows in ((both.values(TRUTH), alone.values(TRUTH)), (both.slopes(TRUTH), alone.slopes(TRUTH))):
            rows = all_rows.reshape(STEPS + 1, -1)
            expected = np.concatenate([rows[kept].reshape(-1, *all_rows.shape[1:]), all_rows])
            assert found == pytest.approx(expected, rel=1e-6, abs=1e-9 * abs(expected).max())


@pytest.mark.parametrize("treatment", [[], ["resample=1000"]])
def test_a_faulty_row_does_not_stop_a_fit_of_the_whole_model(fmu, tmp_path, treatment):
    recording = recorded(fmu, values=(2e7, 1e4, 7e4))
    rows = np.concatenate([poses()[:, :4], recording.force_vector], axis=1)
    rows[GONE, 3] = np.nan
    file, scene_file = tmp_path / "measured.csv", tmp_path / "scene.toml"
    np.savetxt(file, rows, delimiter=",", header="time_s,x_m,y_m,z_m,fx_N,fy_N,fz_N", comments="")
    scene_file.write_bytes(SCENE)
    wanted = ["tissue.supportStiffness"]
    result = fit_data(
        Request([file], tmp_path / "out", treatment=treatment, scene=scene_file, parameters=wanted, progress=False)
    )
    # Tremble and curve of the press are missing for three samples.
    assert result.parameters == pytest.approx({"tissue.supportStiffness": 7e4}, rel=0.01)
    assert (result.samples, len(result.excluded)) == (STEPS + 1 - len(GONE), len(GONE))
    assert any(note.startswith("3 samples are missing") for note in result.notes)


def test_what_cannot_be_rolled_out_is_refused(assembly):
    pose = poses()
    recording = Recording("a", "", "x.csv", np.arange(STEPS + 1), time=pose[:, 0], pose=pose[:, 1:])
    with pytest.raises(InputError, match=r"x\.csv, probe a: .*time, pose and force vector.*time and pose"):
        drive_of(recording, assembly.variables, "instrument")
    uneven = pose[:, 0] ** 1.1
    recording = Recording(
        "a", "", "x.csv", np.arange(STEPS + 1), time=uneven, pose=pose[:, 1:], force_vector=np.zeros((STEPS + 1, 3))
    )
    with pytest.raises(InputError, match=r"even time stamps.*resample"):
        drive_of(recording, assembly.variables, "instrument")
    with pytest.raises(InputError, match=r"contact\.stiffness.*stiffnessPerArea"):
        wanted_variables(assembly.variables, ["contact.stiffness"])
    with pytest.raises(InputError, match="probe"):
        instrument_of(assembly.variables, "probe")


def test_parameters_of_an_fmu_are_those_of_its_scene(fmu, assembly):
    import fmpy

    found = variables_of(fmpy.read_model_description(str(fmu)))
    # Slots of the FMU's own are not told; inputs count the same either way.
    own = [v for v in assembly.variables if v.block != "outputs"]
    assert [v._replace(slot=0) for v in found] == [v._replace(slot=0) for v in own]
    assert [v.slot for v in found if v.block == "inputs"] == list(range(len(assembly.inputs)))


class Line:
    """A force that is known in closed form: a x + b, with x from 0 to 1."""

    variables = (
        Variable("a", "parameters", 0, "N", 1.0, 0.0, 10.0, ""),
        Variable("b", "parameters", 1, "N", 1.0, 0.0, 10.0, ""),
    )
    x = np.linspace(0.0, 1.0, 300)

    def __init__(self, drives=()):
        pass

    def values(self, parameters):
        return parameters[0] * self.x + parameters[1]

    def slopes(self, parameters):
        return np.stack([self.x, np.ones_like(self.x)], axis=1)


def test_errors_of_a_robust_fit_are_those_of_its_weights(tmp_path):
    seed = 12
    measured = Line().values([2.0, 3.0]) + 0.01 * np.random.default_rng(seed).standard_normal(300)
    measured[::10] += 5.0
    drive = Drive(np.empty((0, 0)), 1.0, measured)
    error = {}
    for loss in ("linear", "huber"):
        kept = Kept(tmp_path / loss, "")
        found = fit_scene(Line, [drive], Line.variables, np.ones(2), SceneOptions(loss=loss), kept)
        error[loss] = found.fitted.estimates[0].standard_error
    # Outliers 500 times the noise count by their square in one and by their size in the other.
    assert error["huber"] < 0.2 * error["linear"], (seed, error)


@pytest.mark.parametrize(
    "options, told",
    [
        ({"bounds": {"aa": (0.0, 1.0)}}, r"--bounds: .*--parameter names.*aa"),
        ({"grid": {"c": (0.0, 1.0, 2)}}, r"--grid: .*--parameter names"),
        ({"grid": {"a": (0.0, 11.0, 2)}}, r"--grid: .*between 0 and 10 N.*0:11:2"),
        ({"bounds": {"a": (2.0, 1.0)}}, r"--bounds: .*in order"),
    ],
)
def test_options_for_what_is_not_fitted_are_refused(tmp_path, options, told):
    drive = Drive(np.empty((0, 0)), 1.0, np.zeros(300))
    with pytest.raises(InputError, match=told):
        fit_scene(Line, [drive], Line.variables, np.ones(2), SceneOptions(**options), Kept(tmp_path / "kept", ""))


def test_an_fmu_alone_is_fitted_by_the_command(fmu, tmp_path):
    recording = recorded(fmu, values=(2e7, 1e4, 7e4))
    rows = np.concatenate([poses()[:, :4], recording.force_vector], axis=1)
    file = tmp_path / "measured.csv"
    np.savetxt(file, rows, delimiter=",", fmt="%.9g", header="time_s,x_m,y_m,z_m,fx_N,fy_N,fz_N", comments="")
    words = ["fit", file, "--fmu", fmu, "--parameter", "tissue.supportStiffness", "-o", tmp_path / "out"]
    done = command(*words)
    assert done.returncode == 0, done.stderr
    # Nine digits are written.
    found = read_result(tmp_path / "out" / "result.json").parameters
    assert found == pytest.approx({"tissue.supportStiffness": 7e4}, rel=1e-5)


@pytest.fixture
def unfelt(tmp_path):
    """A short fit to a force of 0."""
    file = tmp_path / "measured.csv"
    scene_file = tmp_path / "scene.toml"
    scene_file.write_bytes(SCENE)
    rows = np.concatenate([poses()[:40, :4], np.zeros((40, 3))], axis=1)
    np.savetxt(file, rows, delimiter=",", header="time_s,x_m,y_m,z_m,fx_N,fy_N,fz_N", comments="")
    return Request(
        [file], tmp_path / "out", scene=scene_file, parameters=["tissue.supportStiffness"], starts=3, progress=False
    )


def test_an_interrupted_fit_says_what_it_kept_and_goes_on_there(unfelt, monkeypatch):
    done = []

    def stopping(task):
        if len(done) == 2:
            raise KeyboardInterrupt
        done.append(task)
        return from_start(task)

    from_start = scene_fit._from_start
    monkeypatch.setattr(scene_fit, "_from_start", stopping)
    with pytest.raises(Interrupted, match=r"Kept what is finished in .*starts\.json: the same command goes on there"):
        fit_data(unfelt)
    assert len(json.loads((unfelt.output / "starts.json").read_text())["done"]) == 2
    assert [p.name for p in unfelt.output.iterdir()] == ["starts.json"]
    done.clear()
    fit_data(unfelt)
    assert len(done) == 1
    assert not (unfelt.output / "starts.json").exists()


def test_an_interrupted_fit_does_not_take_what_another_kept_for_its_own(unfelt, monkeypatch, capsys):
    def stopping(task):
        raise KeyboardInterrupt

    monkeypatch.setattr(scene_fit, "_from_start", stopping)
    unfelt.output.mkdir()
    (unfelt.output / "starts.json").write_text('{"problem": "another", "done": {"start": 1}}')
    with pytest.raises(Interrupted, match="Nothing kept"):
        fit_data(unfelt)
    assert f"{unfelt.output / 'starts.json'} has 1 finished tasks of another scene" in capsys.readouterr().err
