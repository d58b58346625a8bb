"""Stimuli: generated paths against closed forms, jaws, recordings against hand-made files."""

from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from tissue_contact.errors import InputError
from tissue_contact.scenarios.scenario import read_scenario, shipped_names
from tissue_contact.scenarios.stimulus import (
    Circle,
    Declared,
    Poke,
    Press,
    Recording,
    Slide,
    Still,
    Stimulus,
    Tremor,
    Waypoints,
    minimum_jerk,
    read_recording,
    slerp,
)

SCENE = """\
name = "tiny"
[[tissue]]
shape = { kind = "patch", size = [0.02, 0.02], triangles = 200 }
areal_density = 1.0
stiffness = 200.0
[[instrument]]
name = "probe"
shape = { kind = "sphere", radius = 0.0025, triangles = 100 }
"""
GRASP = """\
grasp = { radius = 0.002, stiffness = 100.0, slip_force = 1.0 }
[[contact]]
stiffness_per_area = 1e6
"""
HALF = np.sqrt(0.5)


def sampled(path: object, times: object, folder: Path = Path()) -> dict[str, np.ndarray]:
    return Stimulus((path,), folder).sample(np.array(times, float))  # type: ignore[arg-type]


def place(path: object, times: object, folder: Path = Path()) -> np.ndarray:
    found = sampled(path, times, folder)
    return np.column_stack([found[f"probe.position[{k}]"] for k in (1, 2, 3)])


# --- generators -------------------------------------------------------------------------------------------


def test_minimum_jerk_is_at_rest_at_both_ends() -> None:
    assert minimum_jerk(np.array([-1.0, 0.0, 0.5, 1.0, 2.0])).tolist() == [0, 0, 0.5, 1, 1]
    near = minimum_jerk(np.array([1e-3, 1 - 1e-3]))
    assert near[0] == pytest.approx(10e-9, rel=2e-3)
    assert 1 - near[1] == pytest.approx(10e-9, rel=2e-3)


def test_press_goes_in_holds_and_leaves() -> None:
    press = Press(
        kind="press", instrument="probe", point=[0, 0, 0.01], axis=[0, 0, -2], approach=0.004, depth=0.006,
        begin=0.1, press_time=0.2, hold_time=0.3,
    )  # fmt: skip
    z = place(press, [0, 0.1, 0.2, 0.3, 0.6, 0.7, 0.8, 5])[:, 2]
    assert z == pytest.approx([0.014, 0.014, 0.009, 0.004, 0.004, 0.009, 0.014, 0.014])
    assert place(press.model_copy(update={"leave": False}), [5])[0, 2] == pytest.approx(0.004)


def test_pokes_follow_each_other() -> None:
    poke = Poke(
        kind="poke", instrument="probe", point=[0, 0, 0], axis=[1, 0, 0], approach=0.001, depth=0.002,
        duration=0.1, count=3, period=0.5,
    )  # fmt: skip
    x = place(poke, [0, 0.025, 0.05, 0.1, 0.4, 0.55, 1.05, 1.2, 1.55])[:, 0]
    assert x == pytest.approx([-0.001, 0.0005, 0.002, -0.001, -0.001, 0.002, 0.002, -0.001, -0.001])


def test_slide_goes_to_and_fro() -> None:
    slide = Slide(kind="slide", instrument="probe", start=[0, 0, 0], end=[0, 0.1, 0], stroke_time=1, strokes=2)
    y = place(slide, [0, 0.5, 1, 1.5, 2, 9])[:, 1]
    assert y == pytest.approx([0, 0.05, 0.1, 0.05, 0, 0])


def test_circle_runs_at_constant_speed_and_comes_to_rest() -> None:
    circle = Circle(kind="circle", instrument="probe", centre=[1, 2, 3], radius=0.01, period=0.5, turns=2)
    t = np.linspace(0, 2, 20001)
    p = place(circle, t) - [1, 2, 3]
    assert np.linalg.norm(p, axis=1) == pytest.approx(0.01)
    assert p[:, 2] == pytest.approx(0)
    angle = np.unwrap(np.arctan2(p[:, 1], p[:, 0]))
    assert angle[-1] - angle[0] == pytest.approx(4 * np.pi)
    rate = np.gradient(angle, t)
    assert rate[(t > 0.3) & (t < 0.9)] == pytest.approx(4 * np.pi, rel=1e-6)
    assert abs(rate[0]) < 1e-3 and abs(rate[-1]) < 1e-3
    assert rate.min() > -1e-9


def test_waypoints_turn_by_slerp() -> None:
    path = Waypoints(
        kind="waypoints",
        instrument="probe",
        waypoint=[
            {"time": 1.0, "position": [0, 0, 0]},
            {"time": 2.0, "position": [0.1, 0, 0], "orientation": [0, 0, 0, 1]},  # half a turn about z
        ],
    )
    found = sampled(path, [0, 1, 1.5, 2, 3])
    assert found["probe.position[1]"] == pytest.approx([0, 0, 0.05, 0.1, 0.1])
    assert found["probe.orientation[1]"] == pytest.approx([1, 1, HALF, 0, 0], abs=1e-12)
    assert found["probe.orientation[4]"] == pytest.approx([0, 0, HALF, 1, 1])


def test_slerp_takes_the_shorter_way() -> None:
    start, end = np.array([[1.0, 0, 0, 0]]), -np.array([[HALF, HALF, 0, 0]])
    middle = slerp(start, end, np.array([0.5]))[0]
    assert middle == pytest.approx([np.cos(np.pi / 8), np.sin(np.pi / 8), 0, 0])


def test_tremor_has_its_size_band_and_seed() -> None:
    tremor = Tremor(amplitude=0.0002, band=[8, 12], seed=3)
    t = np.arange(0, 1000, 5e-3)
    shift = tremor.shift(t)
    assert np.sqrt((shift**2).mean(axis=0)) == pytest.approx(0.0002, rel=0.05)
    power = (np.abs(np.fft.rfft(shift * np.hanning(len(t))[:, None], axis=0)) ** 2).sum(axis=1)
    rate = np.fft.rfftfreq(len(t), 5e-3)
    assert power[(rate > 7.9) & (rate < 12.1)].sum() > 0.999 * power.sum()
    assert np.array_equal(shift, tremor.shift(t))
    assert not np.allclose(shift, Tremor(amplitude=0.0002, seed=4).shift(t))


def test_tremor_comes_on_top() -> None:
    plain = Slide(kind="slide", instrument="probe", start=[0, 0, 0], end=[0, 0.1, 0], stroke_time=1)
    shaky = plain.model_copy(update={"tremor": Tremor(amplitude=0.001)})
    t = np.linspace(0, 1, 11)
    assert place(shaky, t) - place(plain, t) == pytest.approx(Tremor(amplitude=0.001).shift(t))


# --- jaws -------------------------------------------------------------------------------------------------

COURSE = [{"time": 1.0, "value": 1.0}, {"time": 1.5, "value": 0.0}, {"time": 3.0, "value": 0.5}]


def test_jaws_are_linear_between_moments_and_held_outside() -> None:
    slide = Slide(kind="slide", instrument="probe", start=[0, 0, 0], end=[0, 0.1, 0], stroke_time=1, jaw=COURSE)
    found = sampled(slide, [0, 1, 1.25, 1.5, 2.25, 3, 9])
    assert found["probe.jaw"] == pytest.approx([1, 1, 0.5, 0, 0.25, 0.5, 0.5])
    assert found["probe.position[2]"][-1] == pytest.approx(0.1)


def test_without_a_course_the_jaws_are_not_touched() -> None:
    slide = Slide(kind="slide", instrument="probe", start=[0, 0, 0], end=[0, 0.1, 0], stroke_time=1)
    assert "probe.jaw" not in sampled(slide, [0, 1])
    assert Stimulus((), Path()).sample(np.zeros(1)) == {}


def test_every_kind_may_have_jaws(folder: Path) -> None:
    (folder / "scene.toml").write_text(SCENE + GRASP)
    (folder / "pose.csv").write_text("time,x,y,z\n0,1,2,3\n")
    kinds = {
        "still": "",
        "press": "point = [0, 0, 0]\ndepth = 0.1\npress_time = 0.2\n",
        "poke": "point = [0, 0, 0]\ndepth = 0.1\nduration = 0.2\n",
        "slide": "start = [0, 0, 0]\nend = [0, 0.1, 0]\nstroke_time = 1.0\n",
        "circle": "centre = [0, 0, 0]\nradius = 0.1\nperiod = 0.2\n",
        "waypoints": "waypoint = [{ time = 0.0, position = [0, 0, 0] }]\n",
        "recording": 'file = "pose.csv"\n',
    }
    assert set(kinds) == {path.model_fields["kind"].annotation.__args__[0] for path in get_args(get_args(Declared)[0])}
    for kind, keys in kinds.items():
        jaw = "jaw = [{ time = 0.0, value = 1.0 }, { time = 0.5, value = 0.0 }]\n"
        (folder / "scenario.toml").write_text(f'[[stimulus]]\nkind = "{kind}"\n{keys}{jaw}')
        found = read_scenario(folder).stimulus.sample(np.array([0, 0.1, 9]))
        assert found["probe.jaw"] == pytest.approx([1, 0.8, 0]), kind


def test_an_instrument_that_stands_still_stays_where_the_scene_puts_it(folder: Path) -> None:
    start = "start_position = [1, 2, 3]\nstart_orientation = [0, 0, 0, 2]\n"
    (folder / "scene.toml").write_text(SCENE + start + GRASP)
    (folder / "scenario.toml").write_text('[[stimulus]]\nkind = "still"\njaw = [{ time = 0.0, value = 0.2 }]\n')
    found = read_scenario(folder).stimulus.sample(np.array([0.0, 5.0]))
    assert [found[f"probe.position[{k}]"].tolist() for k in (1, 2, 3)] == [[1, 1], [2, 2], [3, 3]]
    assert [found[f"probe.orientation[{k}]"].tolist() for k in (1, 2, 3, 4)] == [[0, 0], [0, 0], [0, 0], [1, 1]]
    assert found["probe.jaw"].tolist() == [0.2, 0.2]
    tremor = "tremor = { amplitude = 0.001 }\n"
    (folder / "scenario.toml").write_text(f'[[stimulus]]\nkind = "still"\n{tremor}')
    shaky = read_scenario(folder).stimulus.sample(np.array([0.0, 5.0]))["probe.position[3]"]
    assert shaky - 3 == pytest.approx(Tremor(amplitude=0.001).shift(np.array([0.0, 5.0]))[:, 2])
    assert place(Still(kind="still", instrument="probe"), [0]).tolist() == [[0, 0, 0]]


@pytest.mark.parametrize("name", ["jaw", "probe.jaw", "jaw [1]"])
@pytest.mark.parametrize("turn", ["", ",qw,qx,qy,qz"])
def test_a_column_of_a_recording_is_the_course_of_the_jaws(name: str, turn: str, tmp_path: Path) -> None:
    still = ",1,0,0,0" if turn else ""
    text = f"time,x,y,z{turn},{name}\n10,0,0,0{still},1\n10.5,0,0,0{still},0.5\n11,0,0,0{still},0\n"
    found = read_recording(recording(tmp_path, text), "probe")
    assert found.jaw.tolist() == [1, 0.5, 0]
    assert found.orientation.tolist() == [[1, 0, 0, 0]] * 3
    path = Recording(kind="recording", instrument="probe", file="pose.csv")
    times = np.array([0, 0.25, 1, 9])
    assert Stimulus((path,), tmp_path, frozenset({"probe"})).sample(times)["probe.jaw"] == pytest.approx(
        [1, 0.75, 0, 0]
    )
    with pytest.raises(InputError, match=r"pose\.csv: only an instrument with a grasp.*probe without.*the column"):
        Stimulus((path,), tmp_path).sample(times)


@pytest.mark.parametrize("value", ["1.5", "-0.1"])
def test_a_recorded_jaw_beyond_its_range_is_refused(value: str, tmp_path: Path) -> None:
    text = f"time,x,y,z,jaw\n0,0,0,0,1\n1,0,0,0,{value}\n"
    with pytest.raises(InputError, match=rf"pose\.csv:3: column jaw must lie between 0, closed, .*found {value}\."):
        read_recording(recording(tmp_path, text), "probe")


def test_a_recorded_jaw_moves_what_the_scene_lets_grasp(folder: Path) -> None:
    (folder / "pose.csv").write_text("time,x,y,z,jaw\n0,0,0,0,0.25\n")
    (folder / "scenario.toml").write_text('[[stimulus]]\nkind = "recording"\nfile = "pose.csv"\n')
    with pytest.raises(InputError, match=r"pose\.csv: only an instrument with a grasp"):
        read_scenario(folder).stimulus.sample(np.zeros(1))
    (folder / "scene.toml").write_text(SCENE + GRASP)
    assert read_scenario(folder).stimulus.sample(np.zeros(1))["probe.jaw"] == [0.25]


def test_the_jaw_of_another_instrument_is_not_read(tmp_path: Path) -> None:
    text = "time,x,y,z,other.jaw\n0,0,0,0,7\n"
    assert read_recording(recording(tmp_path, text), "probe").jaw is None


def test_jaws_have_one_course_only(tmp_path: Path) -> None:
    recording(tmp_path, "time,x,y,z,jaw\n0,0,0,0,1\n")
    path = Recording(kind="recording", instrument="probe", file="pose.csv", jaw=COURSE)
    with pytest.raises(InputError, match=r"pose\.csv: the jaws must have one course only"):
        Stimulus((path,), tmp_path, frozenset({"probe"})).sample(np.zeros(1))


JAW = "jaw = [{ time = 0.0, value = 1.0 }, { time = 0.5, value = 0.0 }]\n"
WRONG_JAW = {
    "no grasp": (GRASP, "", ["stimulus[0].jaw", "only an instrument with a grasp", "probe without", "remove the key"]),
    "above": ("value = 1.0", "value = 1.5", ["stimulus[0].jaw[0].value", "number between 0 and 1", "found 1.5"]),
    "below": ("value = 0.0", "value = -0.1", ["stimulus[0].jaw[1].value", "number between 0 and 1", "found -0.1"]),
    "order": ("time = 0.5", "time = 0.0", ["stimulus[0].jaw[1].time", "follow in time", "at 0 s", "found 0.0"]),
    "key": ("value = 1.0", "opening = 1.0", ["stimulus[0].jaw[0].opening", "not a key", "time, value"]),
    "no list": (JAW, "jaw = 0.5\n", ["stimulus[0].jaw", "0.5", "course of the jaws"]),
}


@pytest.mark.parametrize("case", WRONG_JAW)
def test_one_message_of_a_wrong_jaw(case: str, folder: Path) -> None:
    old, new, parts = WRONG_JAW[case]
    scene, scenario = SCENE + GRASP, f'[[stimulus]]\nkind = "still"\n{JAW}'
    assert old in scene + scenario
    (folder / "scene.toml").write_text(scene.replace(old, new, 1))
    (folder / "scenario.toml").write_text(scenario.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_scenario(folder)
    assert [part for part in parts if part not in str(caught.value)] == [], str(caught.value)


# --- recordings -------------------------------------------------------------------------------------------


def recording(tmp_path: Path, text: str) -> Path:
    (tmp_path / "pose.csv").write_text(text)
    return tmp_path / "pose.csv"


def test_short_names_units_comments_and_separators(tmp_path: Path) -> None:
    text = "# a tracker\ntime [ms]; x[mm]; y [cm]; z; qw; qx; qy; qz; quality\n\n"
    text += "1000; 1; 2; 3; 2; 0; 0; 0; good\n1500; 2; 2; 3; 0; 0; 0; 5; bad\n"
    found = read_recording(recording(tmp_path, text), "probe")
    assert found.time.tolist() == [1.0, 1.5]
    assert found.position == pytest.approx(np.array([[0.001, 0.02, 3], [0.002, 0.02, 3]]))
    assert found.orientation.tolist() == [[1, 0, 0, 0], [0, 0, 0, 1]]


def test_names_of_the_fmu_with_outputs_beside_them(tmp_path: Path) -> None:
    names = [f"probe.position[{k}] [m]" for k in (1, 2, 3)] + [f"probe.orientation[{k}] [1]" for k in (1, 2, 3, 4)]
    text = ",".join(["time [s]", *names, "probe.force[1] [N]"]) + "\n0,1,2,3,1,0,0,0,9\n1,4,5,6,1,0,0,0,nan\n"
    found = read_recording(recording(tmp_path, text), "probe")
    assert found.position.tolist() == [[1, 2, 3], [4, 5, 6]]


def test_gaps_are_bridged_and_told(tmp_path: Path) -> None:
    recording(tmp_path, "time,x,y,z\n10,0,0,0\n10.1,1,0,0\n10.9,3,0,0\n11,4,0,0\n")
    path = Recording(kind="recording", instrument="probe", file="pose.csv")
    x = place(path, [-1, 0, 0.05, 0.5, 1, 9], tmp_path)[:, 0]
    assert x == pytest.approx([0, 0, 0.5, 2, 4, 4])
    (remark,) = Stimulus((path,), tmp_path).remarks()
    assert "4 poses over 1 s" in remark and "longest gap 0.8 s at 0.1 s" in remark
    later = path.model_copy(update={"begin": 10.5})
    assert place(later, [0], tmp_path)[0, 0] == pytest.approx(2)


def test_one_pose_is_held(tmp_path: Path) -> None:
    recording(tmp_path, "time,x,y,z\n0,1,2,3\n")
    path = Recording(kind="recording", instrument="probe", file="pose.csv")
    assert place(path, [0, 5], tmp_path).tolist() == [[1, 2, 3], [1, 2, 3]]


GOOD = "time,x,y,z,qw,qx,qy,qz\n0,0,0,0,1,0,0,0\n1,0,0,0,1,0,0,0\n2,0,0,0,1,0,0,0\n"
WRONG = {
    "nan": ("1,0,0,0,1", "1,nan,0,0,1", ["pose.csv:3", "column x", "nan"]),
    "word": ("1,0,0,0,1", "1,lost,0,0,1", ["pose.csv:3", "column x", "lost"]),
    "short line": ("2,0,0,0,1,0,0,0", "2,0,0", ["pose.csv:4", "column z", "nothing"]),
    "back in time": ("2,0,0,0,1", "0.5,0,0,0,1", ["pose.csv:4", "backwards", "0.5 s after 1 s"]),
    "twice the same time": ("2,0,0,0,1", "1,0,0,0,1", ["pose.csv:4", "must not repeat", "1 s after 1 s"]),
    "zero quaternion": (
        "1,0,0,0,1,0,0,0",
        "1,0,0,0,0,0,0,0",
        ["pose.csv:3", "norm above 1e-6", "[0.0, 0.0, 0.0, 0.0]"],
    ),
    "no time": ("time,", "tme,", ["pose.csv:1", "a column time", "nearest", "tme"]),
    "misspelt": ("qy", "qyy", ["pose.csv:1", "a column qy", "qyy"]),
    "unit": ("x,", "x [inch],", ["pose.csv:1", "column x", "mm", "[inch]"]),
    "column twice": ("y,", "x,", ["pose.csv:1", "once", "x twice"]),
    "only a header": (GOOD[GOOD.index("\n") :], "\n", ["pose.csv", "header and a pose", "1 lines"]),
}


@pytest.mark.parametrize("case", WRONG)
def test_one_message_of_a_wrong_recording(case: str, tmp_path: Path) -> None:
    old, new, parts = WRONG[case]
    assert old in GOOD
    with pytest.raises(InputError) as caught:
        read_recording(recording(tmp_path, GOOD.replace(old, new, 1)), "probe")
    assert [part for part in parts if part not in str(caught.value)] == [], str(caught.value)


def test_missing_recording_names_the_nearest(tmp_path: Path) -> None:
    recording(tmp_path, GOOD)
    with pytest.raises(InputError, match=r"poses\.csv.*must exist.*pose\.csv"):
        read_recording(tmp_path / "poses.csv", "probe")


# --- scenario file ----------------------------------------------------------------------------------------

SLIDE = '[[stimulus]]\nkind = "slide"\nstart = [0, 0, 0]\nend = [0, 0.1, 0]\nstroke_time = 1.0\n'
EXPECT = '[[expect]]\noutput = "probe.depth"\nstatistic = "max"\nat_most = 0.001\n'
WRONG_SCENARIO = {
    "unknown key": (SLIDE, "scen = 'a'\n" + SLIDE, ["scenario.toml, scen", "spelling is scene"]),
    "unknown kind": ('"slide"', '"slid"', ["stimulus[0].kind", '"slid"', "spelling is slide"]),
    "unknown key of a kind": ("end =", "ende =", ["stimulus[0].ende", "spelling is end"]),
    "out of range": (
        "stroke_time = 1.0",
        "stroke_time = 0",
        ["stimulus[0].stroke_time", "1e+06 s", "found 0"],
    ),
    "instrument": (
        'kind = "s',
        'instrument = "prob"\nkind = "s',
        ["stimulus[0].instrument", '"prob"', "is probe"],
    ),
    "twice": (SLIDE, SLIDE + SLIDE, ["stimulus[1].instrument", "one stimulus only", '"probe"']),
    "statistic": ('"max"', '"maximum"', ["expect[0].statistic", '"maximum"', "max"]),
    "no bound": ("at_most = 0.001\n", "", ["expect[0]", "must have a bound", "neither"]),
    "bounds": (
        "at_most",
        "at_least = 1.0\nat_most",
        ["expect[0]", "at_least must not exceed", "1 and 0.001"],
    ),
    "scene": (SLIDE, "scene = 'scen.toml'\n" + SLIDE, ["scen.toml", "must exist", "scene.toml"]),
    "waypoints": (
        SLIDE,
        '[[stimulus]]\nkind = "waypoints"\n'
        "waypoint = [{ time = 1.0, position = [0, 0, 0] }, { time = 1.0, position = [0, 0, 0] }]\n",
        ["stimulus[0].waypoint[1].time", "at 1 s", "found 1"],
    ),
    "poke": (
        SLIDE,
        '[[stimulus]]\nkind = "poke"\npoint = [0, 0, 0]\ndepth = 0.1\nduration = 0.2\nperiod = 0.1\n',
        ["stimulus[0].period", "over before", "0.1", "duration = 0.2"],
    ),
    "axis": (
        SLIDE,
        '[[stimulus]]\nkind = "press"\npoint = [0, 0, 0]\naxis = [0, 0, 0]\ndepth = 0.1\npress_time = 0.2\n',
        ["stimulus[0].axis", "a direction", "[0, 0, -1]"],
    ),
    "normal": (
        SLIDE,
        '[[stimulus]]\nkind = "circle"\ncentre = [0, 0, 0]\nnormal = [0, 0, 0]\nradius = 0.1\nperiod = 0.2\n',
        ["stimulus[0].normal", "a direction"],
    ),
    "band": (
        "stroke_time",
        "tremor = { amplitude = 0.001, band = [12, 8] }\nstroke_time",
        ["stimulus[0].tremor.band", "least frequency", "[12"],
    ),
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = tmp_path / "tiny"
    made.mkdir()
    (made / "scene.toml").write_text(SCENE)
    (made / "scenario.toml").write_text(SLIDE + EXPECT)
    return made


def test_scenario_is_found_by_folder_file_and_name(folder: Path) -> None:
    for word in (folder, folder / "scenario.toml"):
        found = read_scenario(word)
        assert (found.name, found.duration) == ("tiny", 1.0)
        assert found.stimulus.paths[0].instrument == "probe"
    (folder / "other.toml").write_text("stop_time = 2.5\n" + SLIDE)
    other = read_scenario(folder / "other.toml")
    assert (other.name, other.duration) == ("other", 2.5)
    assert read_scenario("press").name == "press"


def test_no_such_scenario(folder: Path) -> None:
    with pytest.raises(InputError, match=r"pres: .*no such file.*press"):
        read_scenario("pres")
    with pytest.raises(InputError, match=r"without scenario\.toml"):
        read_scenario(folder.parent)


@pytest.mark.parametrize("case", WRONG_SCENARIO)
def test_one_message_of_a_wrong_scenario(case: str, folder: Path) -> None:
    old, new, parts = WRONG_SCENARIO[case]
    text = SLIDE + EXPECT
    assert old in text
    (folder / "scenario.toml").write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_scenario(folder)
    assert [part for part in parts if part not in str(caught.value)] == [], str(caught.value)


@pytest.mark.parametrize("word", ["press/../press", "../scenarios/press", "./press"])
def test_a_shipped_scenario_is_meant_by_its_name_only(
    word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="The nearest right spelling is press"):
        read_scenario(word)
    assert read_scenario("press").name == "press"


@pytest.mark.parametrize("name", shipped_names())
def test_shipped_scenarios_begin_where_the_scene_puts_the_instrument(name: str) -> None:
    scenario = read_scenario(name)
    poses = scenario.stimulus.poses(np.zeros(1))
    for instrument in scenario.scene.instrument:
        if instrument.name not in poses:  # without a stimulus it stays there
            continue
        start = poses[instrument.name]
        assert start.position[0] == pytest.approx(instrument.start_position, abs=1e-3)  # recordings are noisy
        assert abs(start.orientation[0] @ instrument.start_orientation) == pytest.approx(1, abs=1e-3)
