"""The command: help, exit codes, one line of error, files whole or absent."""

import contextlib
import errno
import io
import json
import os
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import pytest

from tissue_contact import geometry
from tissue_contact.cli import app
from tissue_contact.shapes import ellipsoid
from tissue_contact.surfaces import stl_bytes

SCENE = """\
name = "tiny"
[solver]
stop_time = 0.02
[[tissue]]
shape = { kind = "patch", size = [0.02, 0.02], triangles = 300 }
areal_density = 1.0
stiffness = 100.0
[[instrument]]
shape = { kind = "sphere", radius = 0.003, triangles = 128 }
start_position = [0, 0, 0.001]
[[contact]]
stiffness_per_area = 1e7
"""
SCENARIO = '[[expect]]\noutput = "instrument.force[3]"\nstatistic = "max"\nat_most = 1.0\n'
COMMANDS = ("build", "run", "check", "fit", "trade", "tune", "stability", "mesh", "schema")


def command(*words: str | Path, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    code = "from tissue_contact.cli import main; main()"
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, words)], capture_output=True, text=True, cwd=cwd, timeout=600
    )


def refused(*words: str | Path, cwd: Path) -> str:
    """What the command says of words that it refuses; in this process, as a new one imports for seconds."""
    said = io.StringIO()
    with contextlib.chdir(cwd), contextlib.redirect_stderr(said), pytest.raises(SystemExit) as ended:
        app([str(word) for word in words])
    assert ended.value.code == 2, said.getvalue()
    return one_line(said.getvalue())


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = tmp_path / "tiny"
    made.mkdir()
    (made / "scene.toml").write_text(SCENE)
    (made / "scenario.toml").write_text(SCENARIO)
    return made


def one_line(text: str, name: str = "tissue-contact") -> str:
    assert text.count("\n") == 1 and "Traceback" not in text, text
    assert text.startswith(f"{name}: ")
    return text


def test_help_is_quick_and_lists_the_commands() -> None:
    taken = []
    for _ in range(3):
        begin = time.perf_counter()
        done = command("--help")
        taken.append(time.perf_counter() - begin)
    assert done.returncode == 0
    assert all(name in done.stdout for name in COMMANDS)
    assert min(taken) < 0.5


@pytest.mark.parametrize("name", COMMANDS)
def test_every_help_shows_an_example(name: str) -> None:
    assert f"Example: tissue-contact {name}" in command(name, "--help").stdout


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["foo"], "No such command"),
        (["run"], "Missing argument"),
        (["build", "scene.toml"], "Missing option"),
        (["run", "press", "--sett", "a=1"], "No such option"),
    ],
)
def test_wrong_usage_is_2(words: list[str], message: str) -> None:
    done = command(*words)
    assert done.returncode == 2
    assert message in done.stderr and done.stdout == ""


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["run", "pres"], "press"),
        (["run", "press", "--set", "contact.stiffness"], "NAME=VALUE"),
        (["run", "press", "--set", "contact.stiffness=stiff"], "NAME=VALUE"),
        (["run", "press", "--set", "=3"], "NAME=VALUE"),
        (["build", "none.toml", "-o", "x.fmu"], "none.toml"),
        (["build", "tiny/scene.toml", "-o", "x.zip"], ".fmu"),
        (["build", "tiny/scene.toml", "-o", "x.fmu", "--platform", "linux"], "linux64"),
        (["check", "none.fmu"], "none.fmu"),
        (["mesh", "none.stl"], "none.stl"),
    ],
)
def test_wrong_input_is_2_in_one_line(words: list[str], message: str, folder: Path) -> None:
    done = command(*words, cwd=folder.parent)
    assert done.returncode == 2
    assert message in one_line(done.stderr) and done.stdout == ""
    assert [p.name for p in folder.parent.iterdir()] == ["tiny"]


@pytest.mark.parametrize(
    ("tool", "option", "value", "message"),
    [
        ("bench", "--output", ".", "Name a file in it"),
        ("presets", "--output", ".", "Name a file in it"),
        ("growth", "--levels", "7K", "1.5K, 6K"),
        ("accuracy", "--parts", "capsules", "meshes"),
    ],
)
def test_wrong_input_of_a_tool_is_2_in_one_line(tool: str, option: str, value: str, message: str, folder: Path) -> None:
    words = ["-m", f"tissue_contact.scenarios.{tool}", option, value]
    done = subprocess.run([sys.executable, *words], capture_output=True, text=True, cwd=folder, timeout=600)
    assert done.returncode == 2, done.stderr
    assert message in one_line(done.stderr, tool) and done.stdout == ""


@pytest.fixture
def organ(tmp_path: Path) -> Path:
    file = tmp_path / "organ.stl"
    file.write_bytes(stl_bytes(ellipsoid((0.02, 0.03, 0.04), 300)))
    return file


@pytest.mark.parametrize(
    ("words", "place"),
    [
        (f"mesh organ.stl --repair {300 * 'x'}", 300 * "x"),
        (f"check {300 * 'x'}", 300 * "x"),
        ("run press --parameters tiny", "tiny"),
        ("run press --parameters organ.stl/x", "organ.stl/x"),
    ],
)
def test_a_path_that_cannot_be_used_is_2_in_one_line(words, place, folder, organ):
    said = refused(*words.split(), cwd=folder.parent)
    assert said.startswith(f"tissue-contact: {place}: it must be possible to read or write it; found ")
    assert sorted(p.name for p in folder.parent.iterdir()) == ["organ.stl", "tiny"]


@pytest.mark.parametrize(
    ("words", "option", "found"),
    [
        ("build tiny/scene.toml -o organ.stl/x.fmu", "--output", "file organ.stl"),
        ("run tiny -o organ.stl", "--output", "file organ.stl"),
        ("trade tiny -o organ.stl/deeper", "--output", "file organ.stl"),
        ("tune tiny --error 1% -o tiny", "--output", "folder tiny"),
        ("tune tiny --error 1% -o x.toml --data organ.stl", "--data", "file organ.stl"),
        ("stability tiny/scene.toml -o organ.stl", "--output", "file organ.stl"),
        ("mesh none.stl --repair organ.stl/x.stl", "--repair", "file organ.stl"),
    ],
)
def test_where_results_cannot_be_is_told_before_the_work(words, option, found, folder, organ):
    rule = "results need a folder" if found.startswith("file") else "the result is a file"
    said = refused(*words.split(), cwd=folder.parent)
    assert said.startswith(f"tissue-contact: {option}: {rule}; found the {found}. ")
    assert sorted(p.name for p in folder.parent.iterdir()) == ["organ.stl", "tiny"]


def test_a_full_disk_is_2_in_one_line(organ, monkeypatch):
    def full(handle: int, mode: str) -> None:
        os.close(handle)
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fdopen", full)
    said = refused("mesh", "organ.stl", "--repair", "mended.stl", cwd=organ.parent)
    assert said.startswith("tissue-contact: mended.stl: ") and "found No space left" in said and "make room" in said
    assert list(organ.parent.iterdir()) == [organ]


def test_a_reader_that_has_gone_is_no_wrong_path(monkeypatch, capsys):
    def gone() -> None:
        raise BrokenPipeError(errno.EPIPE, os.strerror(errno.EPIPE))

    monkeypatch.setattr("tissue_contact.scene.scene_schema", gone)
    with pytest.raises(SystemExit) as ended:
        app(["schema"])
    assert ended.value.code == 1 and capsys.readouterr().err == ""


def test_run_is_0_or_1_as_expected(folder: Path) -> None:
    done = command("run", folder, "--no-figures", cwd=folder.parent)
    assert done.returncode == 0, done.stderr
    assert (folder.parent / "build/tiny/tiny.csv").is_file()
    (folder / "scenario.toml").write_text(SCENARIO.replace("at_most = 1.0", "at_least = 1000.0"))
    done = command("run", folder, "-o", folder.parent / "out", "--no-figures")
    assert done.returncode == 1
    assert "fails" in done.stdout and (folder.parent / "out/tiny.csv").is_file()


def test_a_step_that_cannot_be_done_is_1(folder: Path) -> None:
    (folder / "scene.toml").write_text(SCENE.replace("[solver]", '[solver]\npreset = "accurate"\nmax_substeps = 1'))
    done = command("run", folder, "-o", folder.parent / "out", "--no-figures")
    assert done.returncode == 1
    assert "substeps" in one_line(done.stderr) and "Kept the 1 rows" in done.stderr
    assert [p.name for p in (folder.parent / "out").iterdir()] == ["tiny.partial.csv"]


def test_build_and_check(folder: Path) -> None:
    fmu, again = folder / "x.fmu", folder / "again.fmu"
    for path in (fmu, again):
        done = command("build", folder / "scene.toml", "-o", path, "--platform", "linux64")
        assert done.returncode == 0, done.stderr
    assert fmu.read_bytes() == again.read_bytes()
    with zipfile.ZipFile(fmu) as archive:
        picture = archive.read("model.png")
        assert picture.startswith(b"\x89PNG") and b"Software" not in picture and len(picture) > 10_000
        assert archive.read("documentation/model.png") == picture
    done = command("check", fmu)
    assert (done.returncode, "no findings" in done.stdout) == (0, True), done.stdout
    fmu.write_bytes(b"no zip")
    assert command("check", fmu).returncode == 2


def test_mesh_reports_repairs_and_judges(organ: Path, tmp_path: Path) -> None:
    done = command("mesh", organ, "--repair", tmp_path / "mended.stl")
    assert done.returncode == 0
    for part in (
        "triangles",
        "boundary edges",
        "equal vertices merged",
        "suits a tissue",
        "suits an instrument",
    ):
        assert part in done.stdout
    same = [geometry.inspect(geometry.read(tmp_path / name)).volume for name in ("organ.stl", "mended.stl")]
    assert same[0] == pytest.approx(same[1], rel=1e-5)
    done = command("mesh", organ, "--scale", "1000")
    assert done.returncode == 1
    assert "no tissue" in done.stdout and "scale" in done.stdout


def test_schema_is_json() -> None:
    found = json.loads(command("schema").stdout)
    assert "tissue" in found["properties"]


@pytest.mark.parametrize(
    "words",
    [
        "build gone -o out.fmu",
        "run gone",
        "fit gone -o out",
        "trade gone -o out",
        "tune gone --error 1% -o out",
        "stability gone -o out",
    ],
)
def test_what_is_not_there_is_told_before_imports_that_take_seconds(words, tmp_path):
    code = (
        "import sys; from tissue_contact.cli import main\n"
        "try: main()\n"
        "except SystemExit as end: print(end.code, 'numba' in sys.modules, 'scipy' in sys.modules)"
    )
    ended = subprocess.run([sys.executable, "-c", code, *words.split()], capture_output=True, text=True, cwd=tmp_path)
    assert ended.stdout.split() == ["2", "False", "False"], ended.stderr
    assert "gone: " in ended.stderr and "no such file" in ended.stderr
