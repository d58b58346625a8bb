"""Recordings: what the columns mean, which rows are left out, what a treatment does, and the one message of each error.

Files are made by hand here, so that every line number and every value is known.
"""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tissue_contact.errors import InputError
from tissue_contact.identify.columns import METRES, NEWTONS, QUANTITIES, SECONDS, Mapping
from tissue_contact.identify.reading import read, read_description
from tissue_contact.identify.treatment import Treatment
from tissue_contact.settings import validate

MEASURED = Path(__file__).parents[1].parent / "shared" / "data" / "pig_liver_probing.csv"

GOOD = """\
# a remark
time_s,depth_mm,force_N,operator

0.0,0.0,0.00,ann
0.1,0.5,0.10,ann
0.2,1.0,0.30,ann
0.3,1.5,0.60,ann
0.4,2.0,1.00,ann
"""
FIRST = 4  # line of the first sample


def written(folder, text, name="liver.csv"):
    path = folder / name
    path.write_text(text)
    return path


def mapping(**columns):
    return validate(Mapping, columns, "map.toml")


def only(folder, text, treatment=None, named=None):
    """The one recording of a file, and the reading."""
    reading = read([written(folder, text)], named, treatment or Treatment())
    assert len(reading.recordings) == 1
    return reading.recordings[0], reading


def course(force, **columns):
    """Text of a file of 100 Hz, 1 mm deep at the end."""
    n = len(force)
    columns = {"time_s": np.arange(n) / 100, "depth_mm": np.linspace(0, 1, n), "force_N": force} | columns
    rows = zip(*columns.values(), strict=True)
    return "\n".join([",".join(columns), *(",".join(repr(float(v)) for v in row) for row in rows)]) + "\n"


def refused(folder, text, parts, treatment=None, named=None):
    with pytest.raises(InputError) as caught:
        read([written(folder, text)], named, treatment or Treatment())
    assert [part for part in parts if part not in str(caught.value)] == [], str(caught.value)


# --- columns ----------------------------------------------------------------------------------------------


def test_a_plain_file(tmp_path):
    r, reading = only(tmp_path, GOOD)
    assert (r.name, r.region, r.place) == ("liver", "", str(tmp_path / "liver.csv"))
    assert r.lines.tolist() == [4, 5, 6, 7, 8]
    assert r.time == pytest.approx([0, 0.1, 0.2, 0.3, 0.4])
    assert r.depth == pytest.approx([0, 5e-4, 1e-3, 1.5e-3, 2e-3])
    assert r.force.tolist() == [0, 0.1, 0.3, 0.6, 1]
    assert r.rate == pytest.approx(np.full(5, 5e-3))
    assert r.force_vector is None and r.pose is None
    assert reading.exclusions == ()
    assert [note.split(" (")[0] for note in reading.notes] == [
        "liver.csv: operator not recognised and not read",
        "rate of the depth differentiated from depth over time",
    ]


# Title, a number under it, the field of the recording, its value in SI units.
TITLES = {
    "depth_m": ("0.002", "depth", 0.002),
    "Depth [mm]": ("2", "depth", 0.002),
    "depth[um]": ("2000", "depth", 0.002),
    "depth_cm": ("0.2", "depth", 0.002),
    "rate_mm/s": ("3", "rate", 0.003),
    "rate_mm_s": ("3", "rate", 0.003),
    "rate_m/s": ("0.003", "rate", 0.003),
    "force_mN": ("1500", "force", 1.5),
    "force_gf": ("100", "force", 0.980665),
    "fn_N": ("1.5", "force", 1.5),
    "FN [N]": ("1.5", "force", 1.5),
}


@pytest.mark.parametrize("title", TITLES)
def test_titles_and_units(title, tmp_path):
    word, name, value = TITLES[title]
    rest = {"depth": ("depth_mm", "1"), "force": ("force_N", "1")}
    rest.pop(name, None)
    titles, words = zip((title, word), *rest.values(), strict=True)
    r, _ = only(tmp_path, "\n".join([",".join(titles)] + 3 * [",".join(words)]))
    assert getattr(r, name) == pytest.approx([value] * 3, rel=1e-14)


@pytest.mark.parametrize(("title", "factor"), [("time_s", 1), ("time_ms", 1e-3), ("time_us", 1e-6)])
def test_units_of_time(title, factor, tmp_path):
    r, _ = only(tmp_path, GOOD.replace("time_s", title))
    assert r.time == pytest.approx(np.arange(5) * 0.1 * factor)


def test_vectors_and_pose(tmp_path):
    text = "fx_mN,fy_mN,force_z_N,x_mm,y_mm,z_m,qw,qx,qy,qz\n" + 3 * "1,2,3,4,5,0.006,0,0,2,0\n"
    r, _ = only(tmp_path, text)
    assert r.force is None and r.depth is None
    assert r.force_vector[0] == pytest.approx([0.001, 0.002, 3])
    assert r.pose[0] == pytest.approx([0.004, 0.005, 0.006, 0, 0, 1, 0])
    unturned, _ = only(tmp_path, text.replace("qx", "nx"))
    assert unturned.pose[0, 3:].tolist() == [1, 0, 0, 0]


def test_a_part_of_a_vector_is_not_read(tmp_path):
    _, reading = only(tmp_path, GOOD.replace("operator", "fx_N").replace("ann", "x"))
    assert "liver.csv: fx_N not read, without force_y, force_z" in reading.notes


def test_orientation_without_position_is_not_read(tmp_path):
    _, reading = only(tmp_path, "depth_mm,force_N,qw,qx,qy,qz\n" + 3 * "1,1,,,,\n")
    assert "liver.csv: qw, qx, qy, qz not read, without the position" in reading.notes


@pytest.mark.parametrize("separator", [";", "\t"])
def test_separators_and_byte_order_mark(separator, tmp_path):
    r, _ = only(tmp_path, "\ufeff" + GOOD.replace(",", separator))
    assert r.force.tolist() == [0, 0.1, 0.3, 0.6, 1]


def test_samples_are_grouped_by_probe_in_order_of_appearance(tmp_path):
    rows = [f"{probe},{side},{i},{i}" for i in range(3) for probe, side in (("b", "left"), ("a", "right"))]
    text = "probe,region,depth_mm,force_N\n" + "\n".join(rows)
    paths = [written(tmp_path, text, "one.csv"), written(tmp_path, text, "two.csv")]
    found = [(r.name, r.region, Path(r.place).name, r.lines.tolist()) for r in read(paths).recordings]
    assert found == [
        (name, region, file, lines)
        for file in ("one.csv", "two.csv")
        for name, region, lines in (("b", "left", [2, 4, 6]), ("a", "right", [3, 5, 7]))
    ]


def test_mapping_from_a_description(tmp_path):
    text = """\
[columns]
depth = { column = "d", unit = "mm" }
force = "load N_mN"
probe = ["organ", "spot"]
region = "organ"
[treatment]
sign = -1
bias = "before_touch"
"""
    description = read_description(written(tmp_path, text, "liver.toml"))
    text = "organ,spot,d,load N_mN,depth_mm\n" + "".join(f"liver,7,{d},{100 - 200 * d},9\n" for d in range(4))
    r, reading = only(tmp_path, text, description.treatment, description.columns)
    assert (r.name, r.region) == ("liver/7", "liver")
    assert r.depth == pytest.approx([0, 0.001, 0.002, 0.003])
    assert r.force == pytest.approx([0, 0.2, 0.4, 0.6])
    assert "liver.csv: depth_mm is not read, as the mapping gives d as depth" in reading.notes


HEADERS = {
    "misspelt": ("depth_mm", "dpeth_mm", ["liver.csv:2", "the depth or the position", "dpeth_mm is near depth_mm"]),
    "no force": ("force_N", "load", ["a column of the force", "time_s, depth_mm, load, operator", "force_N"]),
    "no unit": ("depth_mm", "depth", ["liver.csv:2", "depth must tell its unit", '"depth"', "Rename it depth_mm"]),
    "no such unit": ("depth_mm", "depth [inch]", ["one of mm, m, cm, um", '"depth [inch]"']),
    "two of one": ("operator", "fn_N", ["liver.csv:2", "one column", "force_N and fn_N for force", "a mapping"]),
    "twice": ("time_s", "depth_mm", ["one column", "depth_mm and depth_mm for depth"]),
}  # fmt: skip


@pytest.mark.parametrize("case", HEADERS)
def test_one_message_of_a_wrong_header(case, tmp_path):
    old, new, parts = HEADERS[case]
    refused(tmp_path, GOOD.replace(old, new), parts)


MAPPINGS = {
    "no such column": ({"depth": "depth_m"}, ["liver.csv:2, mapping of depth", '"depth_m"', "is depth_mm"]),
    "no unit": ({"depth": "operator"}, ["mapping of depth", '"operator"', "one of mm, m, cm, um"]),
    "no such unit": ({"depth": {"column": "operator", "unit": "N"}}, ["mapping of depth", '"N"', "mm, m, cm, um"]),
    "column of two": ({"depth": "time_s", "time": "time_s"}, ["depth must tell its unit", '"time_s"']),
    "shared": (
        {"force_x": {"column": "force_N", "unit": "N"}, "force": "force_N"},
        ["one quantity", "force_N for force and force_x"],
    ),
    "label": ({"probe": ["operator", "sopt"]}, ["mapping of probe", '"sopt"', "Known columns: time_s"]),
}


@pytest.mark.parametrize("case", MAPPINGS)
def test_one_message_of_a_wrong_mapping(case, tmp_path):
    columns, parts = MAPPINGS[case]
    refused(tmp_path, GOOD, parts, named=mapping(**columns))


DESCRIPTIONS = {
    "key": ("[columns]\ndpeth = 'd'", ["liver.toml, columns.dpeth", "spelling is depth"]),
    "form": ("[columns]\ndepth = 3", ["columns.depth", "forms allowed", "title of its column"]),
    "unit": ("[columns]\ndepth = { column = 'd', units = 'mm' }", ["columns.depth.units", "spelling is unit"]),
    "bias word": ("[treatment]\nbias = 'before'", ["treatment.bias", "before_touch", '"before"']),
    "bias number": ("[treatment]\nbias = 1e9", ["treatment.bias", "number between -10000 and 10000 N"]),
    "bias list": ("[treatment]\nbias = [1, 2]", ["treatment.bias", "3 entries"]),
    "sign": ("[treatment]\nsign = 0", ["treatment.sign", "1 or -1", "found 0"]),
    "frame": ("[treatment]\nframe = 'wold'", ["treatment.frame", "spelling is world"]),
    "normal": ("[treatment]\nnormal = [0, 0, 0]", ["treatment.normal", "must have a direction", "[0, 0, 1]"]),
    "resample": ("[treatment]\nresample = 0", ["treatment.resample", "between 0.001 and 1e+06 Hz", "found 0"]),
    "low_pass": ("[treatment]\nlow_pass = -1", ["treatment.low_pass", "1e+06 Hz", "Butterworth"]),
    "rate": ("[treatment]\nrate = 'give'", ["treatment.rate", "given or differentiated", "is given"]),
    "first_touch": ("[treatment]\nfirst_touch = 0", ["treatment.first_touch", "between 1e-06 and 10000 N"]),
    "min_force": ("[treatment]\nmin_force = true", ["treatment.min_force", "number between 0 and 10000 N", "true"]),
    "saturation": ("[treatment]\nsaturation = 'high'", ["treatment.saturation", "number", '"high"']),
}


@pytest.mark.parametrize("case", DESCRIPTIONS)
def test_one_message_of_a_wrong_description(case, tmp_path):
    text, parts = DESCRIPTIONS[case]
    with pytest.raises(InputError) as caught:
        read_description(written(tmp_path, text, "liver.toml"))
    assert [part for part in parts if part not in str(caught.value)] == [], str(caught.value)


def test_every_quantity_has_a_key_in_the_mapping():
    assert set(Mapping.model_fields) == {*QUANTITIES, "probe", "region"}


NUMBERS = st.lists(st.tuples(st.floats(1e-5, 0.5), st.floats(-100, 100), st.integers(1, 1000)), min_size=3, max_size=12)


@settings(max_examples=60, deadline=None)
@given(
    rows=NUMBERS,
    units=st.tuples(st.sampled_from(list(METRES)), st.sampled_from(list(NEWTONS)), st.sampled_from(list(SECONDS))),
    order=st.permutations(range(3)),
    separator=st.sampled_from(",;\t"),
)
def test_what_is_written_in_any_unit_is_read(rows, units, order, separator, tmp_path_factory):
    depth, force, step = np.array(rows).T
    time = np.cumsum(step) / 1000
    metre, newton, second = units
    columns = [
        (f"depth_{metre}", depth / METRES[metre]),
        (f"force [{newton}]", force / NEWTONS[newton]),
        (f"time_{second}", time / SECONDS[second]),
    ]
    shuffled = [columns[k] for k in order]
    lines = zip(*([title, *map(repr, map(float, values))] for title, values in shuffled), strict=True)
    r, reading = only(tmp_path_factory.getbasetemp(), "\n".join(map(separator.join, lines)))
    assert reading.exclusions == ()
    assert r.depth == pytest.approx(depth, rel=1e-14)
    assert r.force == pytest.approx(force, rel=1e-14, abs=1e-300)
    assert r.time == pytest.approx(time, rel=1e-14)


# --- rows -------------------------------------------------------------------------------------------------

# What replaces the third sample, and the reason that is given.
LEFT_OUT = {
    "empty": ("0.2,,0.30,ann", "depth_mm is empty"),
    "word": ("0.2,1.0,off,ann", "force_N is off, no finite number"),
    "nan": ("0.2,NaN,0.30,ann", "depth_mm is NaN, no finite number"),
    "infinite": ("0.2,1.0,-inf,ann", "force_N is -inf, no finite number"),
    "no time": (" ,1.0,0.30,ann", "time_s is empty"),
    "decimal comma": ('0.2,"1,0",0.30,ann', "depth_mm is 1,0, no finite number"),
    "same time": ("0.1,1.0,0.30,ann", "the time is that of the sample before"),
    "saturated": ("0.2,1.0,-5,ann", "the force is at 5 N or beyond"),
}


@pytest.mark.parametrize("case", LEFT_OUT)
def test_a_bad_row_is_left_out_and_counted(case, tmp_path):
    row, reason = LEFT_OUT[case]
    r, reading = only(tmp_path, GOOD.replace("0.2,1.0,0.30,ann", row), Treatment(saturation=5.0))
    assert r.lines.tolist() == [4, 5, 7, 8]
    assert [(e.place, e.line, e.reason) for e in reading.exclusions] == [(r.place, FIRST + 2, reason)]
    assert "liver.csv: 1 of 5 rows left out" in reading.notes
    saturated = int(case == "saturated")
    assert f"liver.csv: {saturated} samples left out as saturated, the force at 5 N or beyond" in reading.notes


def test_a_quaternion_without_a_norm_and_a_row_without_a_probe_are_left_out(tmp_path):
    text = "probe,fn_N,x_m,y_m,z_m,qw,qx,qy,qz\n" + 4 * "a,1,0,0,0,1,0,0,0\n"
    rows = "a,1,0,0,0,0,0,0,0\n,1,0,0,0,1,0,0,0\n"
    _, reading = only(tmp_path, text + rows)
    assert [(e.line, e.reason) for e in reading.exclusions] == [
        (6, "the quaternion has a norm below 1e-06"),
        (7, "probe is empty"),
    ]


def test_a_probe_with_too_few_samples_is_left_out_as_a_whole(tmp_path):
    text = "probe,depth_mm,force_N\n" + "a,1,1\n" * 2 + "a,x,1\n" + "b,1,1\n" * 3
    r, reading = only(tmp_path, text)
    assert r.name == "b"
    assert [(e.line, e.reason) for e in reading.exclusions] == [
        (4, "depth_mm is x, no finite number"),
        (2, "probe a as a whole: 2 usable samples, and 3 are needed"),
    ]
    assert "liver.csv: 1 of 2 probes left out, with fewer than 3 usable samples" in reading.notes


def test_a_force_that_stays_at_its_largest_is_told(tmp_path):
    held = GOOD + "0.5,2.5,1.00,ann\n0.6,3.0,1.00,ann\n"
    _, reading = only(tmp_path, held)
    assert [note for note in reading.notes if "saturation" in note and "1 probes, liver the first" in note]
    for other in (GOOD + "0.5,2.5,1.00,ann\n", held.replace("0.5,2.5,1.00", "0.5,2.5,0.99")):
        assert not [note for note in only(tmp_path, other)[1].notes if "saturation" in note]
    without_time = held.replace("time_s", "moment")
    assert not [note for note in only(tmp_path, without_time)[1].notes if "saturation" in note]


ROWS = {
    "too few": ("0.2,1.0,0.30,ann", "0.2,1.0,0.30", ["liver.csv:6", "header, 4", "found 3"]),
    "too many": ("0.2,1.0,0.30,ann", "0.2,1.0,0.30,ann,", ["liver.csv:6", "header, 4", "found 5"]),
    "backwards": ("0.3,", "0.15,", ["liver.csv:7", "backwards", "0.15 s after 0.2 s in line 6"]),
    "metres": ("depth_mm", "depth_m", ["liver.csv:8, column depth_m", "within 1 m", "2 m as", "likely mm"]),
    "micrometres": ("2.0,1.00", "2.0,2e7", ["liver.csv:8, column force_N", "10000 N", "2e+07 N", "taken as N"]),
    "no rows": (GOOD[GOOD.index("\n0.0") :], "\n", ["liver.csv", "header and a sample", "1 lines"]),
    "all bad": ("0.", "0;", ["liver.csv", "3 samples must be left", "6 exclusions", "liver.csv:4"]),
}  # fmt: skip


@pytest.mark.parametrize("case", ROWS)
def test_one_message_of_wrong_rows(case, tmp_path):
    old, new, parts = ROWS[case]
    assert old in GOOD
    refused(tmp_path, GOOD.replace(old, new), parts)


def test_depths_below_a_micrometre_have_another_unit(tmp_path):
    text = "depth_um,force_N\n0,0\n0.4,0.1\n0.9,0.2\n"
    refused(tmp_path, text, ["liver.csv:4, column depth_um", "reach 1e-06 m", "9e-07 m", "as um", "likely mm"])


def test_a_probe_that_never_touched_is_no_matter_of_units(tmp_path):
    r, _ = only(tmp_path, "depth_mm,force_N\n" + 3 * "0,0.1\n")
    assert r.depth.tolist() == [0, 0, 0]


def test_a_probe_is_in_one_region(tmp_path):
    text = "probe,region,depth_mm,force_N\n" + "a,left,1,1\n" * 3 + "a,right,1,1\n"
    refused(tmp_path, text, ["liver.csv:5", "probe a must be in one region", "right after left"])


def test_files(tmp_path):
    path = written(tmp_path, GOOD)
    with pytest.raises(InputError, match="must be given once"):
        read([path, tmp_path / "." / "liver.csv"])
    with pytest.raises(InputError, match=r"livre\.csv: the recording must exist.*liver\.csv"):
        read([tmp_path / "livre.csv"])
    with pytest.raises(InputError, match="Give a CSV file"):
        read([])
    path.write_bytes(GOOD.replace("ann", "Zoë").encode("latin-1"))
    with pytest.raises(InputError, match="UTF-8"):
        read([path])


def test_notes_of_many_files_are_told_once(tmp_path):
    paths = [written(tmp_path, GOOD, f"{name}.csv") for name in "abc"]
    assert read(paths[:2]).notes[0] == "a.csv and b.csv: operator not recognised and not read"
    assert read(paths).notes[0] == "a.csv and 2 more files: operator not recognised and not read"


@settings(max_examples=60, deadline=None)
@given(
    rows=st.lists(
        st.tuples(st.sampled_from("ab"), st.sampled_from(["1", "", "nan", "?", "9"])), min_size=1, max_size=15
    )
)
def test_every_row_is_used_or_left_out_once(rows, tmp_path_factory):
    sound = "".join(f"c,{i},1,1\n" for i in range(3))
    text = "probe,time_s,depth_mm,force_N\n" + sound + "".join(f"{p},{i},1,{f}\n" for i, (p, f) in enumerate(rows))
    reading = read([written(tmp_path_factory.getbasetemp(), text)], None, Treatment(saturation=9.0))
    whole = {e.reason.split()[1] for e in reading.exclusions if "as a whole" in e.reason}
    bad = [e.line for e in reading.exclusions if "as a whole" not in e.reason]
    assert bad == [5 + i for i, (_, force) in enumerate(rows) if force != "1"]
    assert sorted(line for r in reading.recordings for line in r.lines) == [2, 3, 4] + [
        5 + i for i, (probe, force) in enumerate(rows) if force == "1" and probe not in whole
    ]
    counts = {probe: rows.count((probe, "1")) for probe, _ in rows}
    assert whole == {probe for probe, n in counts.items() if n < 3}


# --- treatment --------------------------------------------------------------------------------------------


def test_bias_and_sign(tmp_path):
    r, reading = only(tmp_path, GOOD, Treatment(bias=0.1, sign=-1))
    assert r.force == pytest.approx([0.1, 0, -0.2, -0.5, -0.9])
    assert "bias of 0.1 N subtracted from the force" in reading.notes
    assert "sign of the force turned" in reading.notes
    assert any("negative in 1 of 1 probes" in note for note in reading.notes)
    text = "fx_N,fy_N,fz_N,depth_mm\n" + 3 * "1,2,3,1\n"
    r, _ = only(tmp_path, text, Treatment(bias=(1.0, 1.0, 1.0)))
    assert r.force_vector[0].tolist() == [0, 1, 2]


def test_bias_from_before_the_touch(tmp_path):
    text = "depth_mm,force_N\n-1,0.5\n0,0.7\n1,1.6\n2,2.6\n"
    r, reading = only(tmp_path, text, Treatment(bias="before_touch"))
    assert r.force == pytest.approx([-0.1, 0.1, 1, 2])
    assert "bias subtracted: the mean force before the touch, 0.6 N" in reading.notes
    refused(tmp_path, text.replace("-1,", "1,").replace("\n0,", "\n1,"), ["liver.csv:2", "0 or less", "0.001 m"],
            Treatment(bias="before_touch"))  # fmt: skip
    # With first_touch it is the force that tells, however large the bias and whatever the sign.
    force = -np.array([5, 5.02, 4.98, 5, 5.5, 6, 6.5, 7])
    r, _ = only(tmp_path, course(force), Treatment(bias="before_touch", first_touch=0.1, sign=-1))
    assert r.force == pytest.approx([0.5, 1, 1.5, 2])
    assert r.lines.tolist() == [6, 7, 8, 9]


def test_frame_and_normal(tmp_path):
    half = np.sqrt(0.5)  # a quarter of a turn about x: y of the instrument is z of the world
    text = "fx_N,fy_N,fz_N,force_N,x_m,y_m,z_m,qw,qx,qy,qz\n" + 3 * f"1,2,3,9,0,0,0,{half},{half},0,0\n"
    r, reading = only(tmp_path, text, Treatment(frame="instrument", normal=(0, 0, 2)))
    assert r.force_vector[0] == pytest.approx([1, -3, 2])
    assert r.force == pytest.approx([2, 2, 2])
    assert "liver.csv: force_N not read, as the treatment makes the force" in reading.notes
    assert "force vector turned from the frame of the instrument into the world" in reading.notes
    assert "normal force taken from the force vector, along [0.0, 0.0, 2.0]" in reading.notes


def test_first_touch(tmp_path):
    force = np.array([0, 0.3, 0.3, 0, 0.2, 0.4, 0.6, 0.8, 0.1, 0])
    r, reading = only(tmp_path, course(force), Treatment(first_touch=0.2))
    assert r.force == pytest.approx(force[4:])  # two samples above are not yet staying, and leaving is kept
    assert r.lines.tolist() == list(range(6, 12))
    assert r.depth == pytest.approx(np.arange(6) / 9e3, abs=1e-15)
    assert "the force stays at 0.2 N or above; 4 samples before it left out" in reading.notes[-1]
    refused(tmp_path, course(force), ["never stays at first_touch = 0.9 N"], Treatment(first_touch=0.9))


def test_min_force(tmp_path):
    text = "probe,depth_mm,force_N\n" + "".join(
        f"{p},{i},{i * f}\n" for p, f in (("a", 0.25), ("b", 1)) for i in range(4)
    )
    r, reading = only(tmp_path, text, Treatment(min_force=1.0))
    assert r.name == "b"
    assert [(e.line, e.reason) for e in reading.exclusions] == [
        (2, "probe a as a whole: its largest force is 0.75 N, below min_force = 1 N")
    ]
    assert reading.notes == ("1 of 2 probes left out as noise, their force staying below 1 N",)
    assert len(read([written(tmp_path, text)], None, Treatment(min_force=0.75)).recordings) == 2


def test_rate(tmp_path):
    text = course(np.ones(4), **{"rate_mm/s": np.full(4, 7.0)})
    given_, reading = only(tmp_path, text)
    assert given_.rate.tolist() == pytest.approx([7e-3] * 4)
    assert not [note for note in reading.notes if "rate" in note]
    assert only(tmp_path, text, Treatment(rate="given"))[0].rate == pytest.approx(given_.rate)
    made, reading = only(tmp_path, text, Treatment(rate="differentiated"))
    assert made.rate == pytest.approx([1e-3 / 0.03] * 4)
    assert "liver.csv: rate_mm/s not read, as the treatment makes the rate" in reading.notes
    assert "rate of the depth differentiated from depth over time (central differences)" in reading.notes


def test_resample(tmp_path):
    r, reading = only(tmp_path, GOOD, Treatment(resample=20.0))
    assert r.time == pytest.approx(np.arange(9) / 20)
    assert r.force == pytest.approx([0, 0.05, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 1])
    assert r.lines.tolist() == [4, 4, 5, 5, 6, 6, 7, 7, 8]
    assert "resampled from 10 Hz to 20 Hz by straight lines" in reading.notes
    same, _ = only(tmp_path, GOOD, Treatment(resample=10.0))
    assert same.lines.tolist() == [4, 5, 6, 7, 8]
    assert same.force == pytest.approx([0, 0.1, 0.3, 0.6, 1])


def test_resampled_orientation_takes_the_shorter_way(tmp_path):
    text = "time_s,fn_N,x_mm,y_mm,z_mm,qw,qx,qy,qz\n0,1,0,0,0,1,0,0,0\n2,1,2,0,0,-0.6,-0.8,0,0\n4,1,4,0,0,1,0,0,0\n"
    r, _ = only(tmp_path, text, Treatment(resample=1.0))
    middle = np.array([1.6, 0.8, 0, 0]) / np.hypot(1.6, 0.8)
    assert np.abs(r.pose[[1, 3], 3:] @ middle) == pytest.approx(1)
    assert np.linalg.norm(r.pose[:, 3:], axis=1) == pytest.approx(1)
    assert r.pose[:, 0] == pytest.approx([0, 1e-3, 2e-3, 3e-3, 4e-3])


def test_samples_inside_a_gap_are_left_out(tmp_path):
    text = course(np.arange(40) / 40)
    # Line 12 loses its number, and after line 30 (0.28 s) the recording pauses for 0.5 s.
    lines = text.splitlines()
    lines[11] = lines[11].rsplit(",", 1)[0] + ","
    lines[30:] = [f"{float(t) + 0.5},{rest}" for t, rest in (line.split(",", 1) for line in lines[30:])]
    for low_pass in (None, 30.0):
        treatment = Treatment(resample=200.0, low_pass=low_pass)
        r, reading = only(tmp_path, "\n".join(lines), treatment)
        assert not ((r.time > 0.0901) & (r.time < 0.1099)).any()
        assert not ((r.time > 0.2801) & (r.time < 0.7899)).any()
        assert len(r) == 2 * 89 + 1 - 3 - 101
        assert "2 gaps bridged by straight lines, the 104 samples on them left out in the end" in reading.notes
    assert reading.notes.index("low-passed at 30 Hz (Butterworth 2nd order, both ways)") > 0


def test_low_pass_takes_fast_and_leaves_slow_without_delay(tmp_path):
    t = np.arange(1000) / 100
    slow, fast = 1 + np.sin(2 * np.pi * 0.5 * t), np.sin(2 * np.pi * 30 * t)
    r, reading = only(tmp_path, course(slow + fast), Treatment(low_pass=5.0))
    middle = slice(100, -100)
    assert r.force[middle] == pytest.approx(slow[middle], abs=2e-3)
    assert "low-passed at 5 Hz (Butterworth 2nd order, both ways)" in reading.notes
    at_cutoff, _ = only(tmp_path, course(2 + np.sin(2 * np.pi * 5 * t)), Treatment(low_pass=5.0))
    assert np.ptp(at_cutoff.force[middle]) == pytest.approx(1, rel=1e-3)  # half of 2, both ways


@settings(max_examples=30, deadline=None)
@given(force=st.floats(-50, 50), n=st.integers(10, 60), low_pass=st.floats(1, 45), rate=st.floats(30, 400))
def test_a_constant_force_survives_resampling_and_filter(force, n, low_pass, rate, tmp_path_factory):
    low_pass = min(low_pass, 0.4 * rate)
    text = course(np.full(n, force))
    r, _ = only(tmp_path_factory.getbasetemp(), text, Treatment(resample=max(rate, 1100 / n), low_pass=low_pass))
    assert r.force == pytest.approx(force, rel=1e-9, abs=1e-9)


def test_too_short_for_the_filter(tmp_path):
    text = "probe," + course(np.ones(30))
    lines = [text.splitlines()[0], *(f"{'ab'[i > 8]},{line}" for i, line in enumerate(text.splitlines()[1:]))]
    r, reading = only(tmp_path, "\n".join(lines), Treatment(low_pass=10.0))
    assert r.name == "b"
    assert reading.exclusions[0].reason == (
        "probe a as a whole: 9 samples to resample or filter, 0 of them in gaps; 10 are needed"
    )


TREATMENTS = {
    "uneven": (
        {"low_pass": 3.0}, ("0.3,", "0.32,"), ["liver.csv:7", "even time stamps", "0.12 s", "resample = 10"],
    ),
    "left out": ({"low_pass": 3.0}, ("0.2,1.0", "0.2,x"), ["liver.csv:7", "0.2 s after", "0.1 s is usual"]),
    "Nyquist": ({"low_pass": 5.0}, ("", ""), ["liver.csv:4", "half the 10 Hz", "found 5 Hz", "less than 5"]),
    "Nyquist resampled": (
        {"low_pass": 30.0, "resample": 60.0}, ("", ""), ["half the 60 Hz", "found 30 Hz", "less than 30"],
    ),
    "too many": ({"resample": 1e6}, ("\n1.0,", "\n40,"), ["liver.csv:4", "10000000 samples", "over 40 s", "lower"]),
    "no time": ({"resample": 10.0}, ("time_s", "t"), ["liver.csv:2", "resample = 10.0 needs", "of time"]),
    "no time to filter": ({"low_pass": 3.0}, ("time_s", "t"), ["low_pass = 3.0 needs a column of time"]),
    "no rate": ({"rate": "given"}, ("", ""), ['rate = "given" needs a column of rate', "Remove rate"]),
    "no slope": ({"rate": "differentiated"}, ("time_s", "t"), ['"differentiated" needs a column of time']),
    "no vector": ({"normal": (0, 0, 1)}, ("", ""), ["normal = [0.0, 0.0, 1.0] needs", "of force_vector"]),
    "no frame": ({"frame": "instrument"}, ("", ""), ['frame = "instrument" needs', "of force_vector"]),
    "no bias": ({"bias": (1, 2, 3)}, ("", ""), ["bias = [1.0, 2.0, 3.0] needs a column of force_vector"]),
}  # fmt: skip


@pytest.mark.parametrize("case", TREATMENTS)
def test_one_message_of_a_wrong_treatment(case, tmp_path):
    options, (old, new), parts = TREATMENTS[case]
    long = GOOD + "".join(f"{0.5 + i / 10},2,1,ann\n" for i in range(6))
    refused(tmp_path, long.replace(old, new), parts, validate(Treatment, options, "t"))


def test_a_turned_force_needs_a_pose_and_a_bias_its_force(tmp_path):
    text = "fx_N,fy_N,fz_N,depth_mm,force_N\n" + 3 * "1,2,3,1,1\n"
    refused(tmp_path, text, ["liver.csv:1", "needs a column of position"], Treatment(frame="instrument"))
    text = text.replace("depth_mm,force_N", "x_mm,y_mm,z_mm").replace("3,1,1", "3,1,1,1")
    refused(tmp_path, text, ["needs a column of orientation"], Treatment(frame="instrument"))
    refused(tmp_path, text, ["needs a column of force", "found none"], Treatment(bias=0.1))
    refused(tmp_path, text, ["needs a column of depth"], Treatment(bias="before_touch"))


# --- measured data ----------------------------------------------------------------------------------------


@pytest.mark.shared_data
def test_probes_of_pig_liver():
    if not MEASURED.is_file():
        pytest.skip(f"{MEASURED.name} is not in shared/data beside the checkout")
    named = mapping(probe=["file", "probe"], region="file")
    every = read([MEASURED], named)
    assert len(every.recordings) == 211
    assert {len(r) for r in every.recordings} == {10}
    assert len({r.region for r in every.recordings}) == 3
    assert every.exclusions == ()
    assert every.notes == (f"{MEASURED.name}: sample, nx, ny, nz not recognised and not read",)
    assert max(r.depth.max() for r in every.recordings) == pytest.approx(3.0061e-3)
    assert max(r.force.max() for r in every.recordings) == pytest.approx(4.86178)
    strong = read([MEASURED], named, Treatment(min_force=0.1))
    assert len(strong.recordings) == 176
    assert len(strong.exclusions) == 35
