"""Finding and refusing resources/model.bin."""

import shutil
import struct
from pathlib import Path
from urllib.parse import quote

import pytest
from fmu_fixture import POSITION, tiny_fmu
from fmu_importer import Instance, Unpacked

from tissue_contact.fmu import entry, model_bin


@pytest.fixture(scope="module", params=["plain", "with some spaces", "grün 腹腔鏡", "100%25 real#x+y"])
def place(request, fmu_path, tmp_path_factory):
    """The FMU unpacked in a directory with an awkward name."""
    return Unpacked(fmu_path, tmp_path_factory.mktemp("awkward") / request.param)


FORMS = {
    "file:///": lambda p: "file://" + quote(p),
    "file:/": lambda p: "file:" + quote(p),
    "file://localhost/": lambda p: "file://localhost" + quote(p),
    "file://host/": lambda p: "file://some.host" + quote(p),
    "FILE:///": lambda p: "FILE://" + quote(p),
    "slash at the end": lambda p: "file://" + quote(p) + "/",
    "all encoded": lambda p: "file:///" + "".join(f"%{b:02x}" for b in p[1:].encode()),
    "not encoded": lambda p: "file://" + p,
    "plain path": lambda p: p,
    "plain path, slash at the end": lambda p: p + "/",
}


@pytest.mark.parametrize("form", FORMS)
def test_location_is_found(place, form):
    location = FORMS[form](str(place.directory / "resources")).encode()
    made = Instance(place, location=location)
    assert made.c, made.text
    made.free()


@pytest.mark.parametrize("location", [None, b"", b"file:///nowhere/resources", b"http://host/x", b"file:", b"file://"])
def test_location_that_does_not_do_is_explained(fmu, location):
    made = Instance(fmu, location=location)
    assert made.c is None
    assert "model.bin" in made.text


def test_plain_path_is_not_decoded(fmu, tmp_path):
    (tmp_path / "a b").mkdir()
    (tmp_path / "a b" / "model.bin").write_bytes(b"not this one")
    shutil.copytree(fmu.directory / "resources", tmp_path / "a%20b")
    made = Instance(fmu, location=str(tmp_path / "a%20b").encode())
    assert made.c, made.text
    made.free()


def test_relative_path(fmu, monkeypatch):
    monkeypatch.chdir(fmu.directory)
    made = Instance(fmu, location=b"resources")
    assert made.c, made.text
    made.free()


def test_wrong_guid(fmu):
    made = Instance(fmu, guid="{00000000-0000-0000-0000-000000000000}")
    assert made.c is None
    assert "guid" in made.text and fmu.guid in made.text


@pytest.fixture
def broken(fmu, tmp_path):
    """Instantiates with a changed model.bin; returns what the log says."""

    def run(change):
        content = change((fmu.directory / "resources/model.bin").read_bytes())
        (tmp_path / "model.bin").write_bytes(content)
        made = Instance(fmu, location=str(tmp_path).encode())
        assert made.c is None, "a broken model.bin was accepted"
        return made.text

    return run


def test_other_layout(broken):
    text = broken(lambda c: model_bin.seal(c[:8] + bytes(8) + c[16:]))
    assert "layout 0000000000000000" in text and "different versions" in text.replace("\n", " ")


def test_other_magic(broken):
    assert "is not a model" in broken(lambda c: b"TCMODEL0" + c[8:])
    assert "is not a model" in broken(lambda c: b"")
    assert "is not a model" in broken(lambda c: c[:40])


def test_damage_anywhere_is_noticed(broken, fmu):
    n = len((fmu.directory / "resources/model.bin").read_bytes())
    for at in range(16, n, 101):
        text = broken(lambda c, at=at: c[:at] + bytes([c[at] ^ 1]) + c[at + 1 :])
        assert "damaged" in text, at


def test_truncated_or_longer(broken):
    assert "damaged" in broken(lambda c: c[:-8])
    assert "damaged" in broken(lambda c: c + bytes(8))


# Offsets in model.bin, see model_bin: counts begin at 96, variables at 192.
@pytest.mark.parametrize(
    ("at", "value"),
    [
        (96, 6),
        (96, 2**60),
        (104, 2**63),
        (112, 0),
        (120, 2**61),
        (144, 2**64 - 1),
        (152, 2**50),
        (160, 1),
        (192, 9),
        (192, 2**32 * 9),
    ],
)
def test_contradiction_is_refused_even_with_a_right_checksum(broken, at, value):
    text = broken(lambda c: model_bin.seal(c[:at] + struct.pack("<Q", value) + c[at + 8 :]))
    assert "contradicts itself" in text


@pytest.mark.parametrize(("field", "end"), [("model.rest_x", 10**6), ("scratch.detail", None)])
def test_span_beyond_its_block_is_refused(broken, field, end):
    place = [f"{bundle}.{name}" for bundle, name, _ in entry.fields()].index(field)

    def change(content):
        variables, names = struct.unpack_from("<2Q", content, 96)
        at = 192 + 40 * variables + names + 16 * place
        begin, before = struct.unpack_from("<2Q", content, at)
        # The kernels leave two figures in scratch.detail: one is too few.
        now = begin + 1 if end is None else end
        assert now != before
        return model_bin.seal(content[:at] + struct.pack("<2Q", begin, now) + content[at + 16 :])

    assert "contradicts itself" in broken(change)


def test_missing_model(fmu, tmp_path):
    made = Instance(fmu, location=tmp_path.as_uri().encode())
    assert made.c is None
    assert "cannot open" in made.text and str(tmp_path) in made.text


def test_two_scenes_in_one_process(fmu, tmp_path):
    other = Unpacked(tiny_fmu(tmp_path, name="second", vertices=9), tmp_path / "unpacked")
    assert other.guid != fmu.guid
    made = Instance(other)
    assert made.c, made.text
    assert made.value(POSITION) == 0.5
    crossed = Instance(other, location=fmu.location.encode())
    assert crossed.c is None
    assert "different FMUs" in crossed.text
    made.free()
    shutil.rmtree(Path(other.directory))
