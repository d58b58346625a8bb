"""Findings on an .fmu: what the standard's checkers say, and what they do not look at."""

import logging
import re
import struct
import zipfile
from pathlib import Path, PurePosixPath

from fmpy.validation import validate_fmu
from lxml import etree

from tissue_contact.errors import InputError, WorkError
from tissue_contact.fmu import model_bin
from tissue_contact.fmu.build import guid_of
from tissue_contact.fmu.compile import FMI_HEADERS, TARGETS
from tissue_contact.fmu.exports import exported
from tissue_contact.fmu.units import base_unit


def fmi_functions() -> set[str]:
    """Names of all functions of FMI 2.0, from its header."""
    text = (FMI_HEADERS / "fmi2Functions.h").read_text("utf-8")
    return set(re.findall(r"FMI2_Export\s+fmi2\w+TYPE\s+(fmi2\w+)\s*;", text))


def check(path: Path) -> list[str]:
    """Findings on an .fmu, one sentence each; empty if all is well. Nothing of the .fmu is run.

    Raises
    ------
    InputError
        There is no such file, or it is no zip.
    """
    path = Path(path)
    try:
        with zipfile.ZipFile(path) as archive:
            findings = _zip(archive)
            content, unreadable = _content(archive)
    except (zipfile.BadZipFile, NotImplementedError, ValueError) as error:
        raise InputError("fmu", "must be a zip file", f"{path}: {error}", "Build it again") from error
    findings += unreadable
    if unreadable:
        return findings
    findings += [f"fmpy: {finding}" for finding in validate_fmu(str(path))]
    findings += _toolbox(path)
    if "modelDescription.xml" not in content:
        return [*findings, "there is no modelDescription.xml"]
    try:
        root = etree.fromstring(content["modelDescription.xml"])
    except etree.XMLSyntaxError as error:
        return [*findings, f"modelDescription.xml: {error}"]
    findings += _units(root)
    findings += _guid(content, root.get("guid", ""))
    simulation = root.find("CoSimulation")
    identifier = "" if simulation is None else simulation.get("modelIdentifier", "")
    findings += _binaries(content, identifier)
    return findings


def _zip(archive: zipfile.ZipFile) -> list[str]:
    findings = []
    names = [info.orig_filename for info in archive.infolist()]
    for info in archive.infolist():
        name = info.orig_filename
        parts = PurePosixPath(name).parts
        if "\\" in name or name.startswith("/") or ".." in parts or ":" in name or not name.isascii():
            findings.append(f"zip: {name!r} is no portable relative path")
        if info.compress_type not in (zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED):
            findings.append(f"zip: {name} is not compressed by deflate, the only method that every importer reads")
        if names.count(name) > 1:
            findings.append(f"zip: {name} is there more than once")
    return findings


def _content(archive: zipfile.ZipFile) -> tuple[dict[str, bytes], list[str]]:
    """Bytes of every entry that can be read, and a finding on every other."""
    content, findings = {}, []
    for info in archive.infolist():
        try:
            content[info.filename] = archive.read(info)
        except Exception as error:  # zipfile tells damage, encryption and other methods by many kinds
            findings.append(f"zip: {info.orig_filename} cannot be read: {error!r}")
    return content, findings


def _toolbox(path: Path) -> list[str]:
    """Findings of fmu-manipulation-toolbox (``fmutool -check``), if it is installed."""
    try:
        from fmu_manipulation_toolbox.checker import get_checkers
        from fmu_manipulation_toolbox.operations import FMU
    except ImportError:
        return []
    records: list[str] = []
    handler = logging.Handler(logging.ERROR)
    handler.emit = lambda record: records.append(f"fmutool: {record.getMessage()}")  # type: ignore[method-assign]
    logger = logging.getLogger("fmu_manipulation_toolbox")
    logger.addHandler(handler)
    try:
        with FMU(str(path)) as fmu:
            for checker in get_checkers():
                fmu.apply_operation(checker())
    except Exception as error:  # what it cannot read makes it fail in many ways, and each is a finding
        records.append(f"fmutool: {error!r}")
    finally:
        logger.removeHandler(handler)
    return records


def _units(root: etree._Element) -> list[str]:
    findings = []
    defined = {unit.get("name", ""): unit.find("BaseUnit") for unit in root.iter("Unit")}
    for variable in root.iter("ScalarVariable"):
        real = variable.find("Real")
        unit = None if real is None else real.get("unit")
        if unit is None:
            findings.append(f"{variable.get('name')} has no unit; dimensionless is 1")
        elif defined.get(unit) is None:
            findings.append(f"{variable.get('name')}: the unit {unit} is not defined by a BaseUnit")
    for unit, base in defined.items():
        try:
            wanted = {name: str(power) for name, power in base_unit(unit).items()}
        except WorkError as error:
            findings.append(str(error))
            continue
        if base is not None and dict(base.attrib) != wanted:
            findings.append(f"the unit {unit} is defined as {dict(base.attrib)} instead of {wanted}")
    return findings


def _guid(content: dict[str, bytes], guid: str) -> list[str]:
    model = content.get("resources/model.bin", b"")
    if not model.startswith(model_bin.MAGIC) or len(model) < 96:
        return ["resources/model.bin is missing or is no model"]
    inside = model[32:96].rstrip(b"\0").decode("ascii", "replace")
    if inside != guid:
        return [f"the guid of modelDescription.xml is {guid} and that of resources/model.bin is {inside}"]
    if len(model) % 8 or model_bin.seal(model) != model:
        return ["resources/model.bin is damaged: its size or checksum differs"]
    blank = model_bin.seal(model[:32] + bytes(64) + model[96:])
    description = content["modelDescription.xml"].replace(f'guid="{guid}"'.encode(), b'guid=""', 1)
    if guid_of(description, blank) != guid:
        return ["the guid is not the hash of modelDescription.xml and model.bin: one of them was changed"]
    return []


def _binaries(content: dict[str, bytes], identifier: str) -> list[str]:
    findings = []
    binaries = [PurePosixPath(name) for name in content if name.startswith("binaries/")]
    if not binaries:
        return ["there is no binary"]
    functions = fmi_functions()
    for path in binaries:
        target = TARGETS.get(path.parent.name)
        if target is None or len(path.parts) != 3:
            findings.append(f"{path}: no such platform is known")
            continue
        if path.name != identifier + target.suffix:
            findings.append(f"{path} must be called {identifier}{target.suffix}, after the modelIdentifier")
        try:
            names = exported(content[str(path)])
        except (WorkError, struct.error, ValueError, IndexError, OverflowError) as error:
            findings.append(f"{path} cannot be read: {error}")
            continue
        if missing := sorted(functions - names):
            findings.append(f"{path} lacks {', '.join(missing)}")
        if surplus := sorted(names - functions):
            findings.append(f"{path} exports {', '.join(surplus)}; only the functions of FMI may be visible")
    return findings
