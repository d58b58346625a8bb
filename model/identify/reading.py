"""Reading: CSV files of an experiment become recordings, each row used, counted as left out, or an error."""

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from pydantic import Field

from tissue_contact.errors import InputError
from tissue_contact.identify.columns import QUANTITIES, VECTORS, Column, Mapping, find
from tissue_contact.identify.recording import Exclusion, Reading, Real, Recording
from tissue_contact.identify.treatment import FEWEST, Flags, Raw, Treatment, left_out, treat
from tissue_contact.scene import IDENTITY
from tissue_contact.settings import Settings, check_recording, read_toml, validate

HELD = 3  # equal values in a row at the largest force look like a sensor at its end
SHALLOW = 1e-6  # m; depths that are all below it have the wrong unit
NO_TURN = 1e-6  # norm of a quaternion that is none

FORCES = ("force", *VECTORS["force_vector"])
Row = tuple[int, list[str]]  # line and cells
Indices = npt.NDArray[np.intp]


class Description(Settings):
    """What a description file says of CSV files: what their columns hold and how they are treated."""

    columns: Mapping = Field(Mapping(), description="which column holds what")
    treatment: Treatment = Field(Treatment(), description="what is done to the samples")


AS_RECORDED = Treatment()


def read_description(path: Path) -> Description:
    """Read a TOML file with the tables [columns] and [treatment], both optional.

    Raises
    ------
    InputError
        With file and key.

    """
    _, data = read_toml(path, "description")
    return validate(Description, data, str(path))


def read(paths: Sequence[Path], mapping: Mapping | None = None, treatment: Treatment = AS_RECORDED) -> Reading:
    """Read CSV files, probe by probe in order of appearance.

    The header names quantities with their units: `time_s`, `depth_mm`, `rate_mm/s`, `force_N` (or `fn_N`, the
    normal force), `force_x_N` to z (or `fx_N`), `x_mm` to z, `qw` to `qz`, each in any unit of `columns`, and
    `probe` and `region`; a mapping goes before it. A force or a force vector, and a depth or a position must be
    there. A file without probes is one probe of its name. Separators are commas, semicolons or tabs; empty lines
    and lines that begin with # are skipped.

    Left out and counted is a row without a finite number in every column that is read, without a probe, with a
    quaternion without a norm, with the moment of the row before or with a saturated force; and a probe with fewer
    than FEWEST samples.

    Parameters
    ----------
    paths : files, none of them twice
    mapping : which column holds what, where the titles do not tell
    treatment : what is done to the samples

    Raises
    ------
    InputError
        With file and line: no such file; no CSV; a column that is missing or there twice; an option without the
        columns that it needs; a row with too few or too many fields; time that runs backwards; a unit that cannot
        be; a region that changes within a probe; what `treat` raises; no probe left.

    """
    files = [path.resolve() for path in paths]
    for i, path in enumerate(files):
        if path in files[:i]:
            raise InputError(str(paths[i]), "a file must be given once", "it twice", "Remove one of the two")
    raw: list[Raw] = []
    exclusions: list[Exclusion] = []
    said: dict[str, list[str]] = {}  # note, files that it is about
    for path in paths:
        file = _read_file(path, mapping or Mapping(), treatment)
        raw += file.raw
        exclusions += file.exclusions
        for note in file.notes:
            said.setdefault(note, []).append(path.name)
    treated = treat(raw, treatment)
    exclusions += treated.exclusions
    if not treated.recordings:
        found = "".join(
            [f"{len(exclusions)} exclusions", *(f", first {e.reason} ({e.place}:{e.line})" for e in exclusions[:1])]
        )
        rule = f"a probe with {FEWEST} samples must be left"
        way_out = "Mend the file, its mapping or the treatment" if paths else "Give a CSV file"
        raise InputError(_some([str(path) for path in paths]), rule, found, way_out)
    notes = [f"{_some(names)}: {note}" for note, names in said.items()]
    return Reading(treated.recordings, tuple(exclusions), (*notes, *treated.notes))


def _some(names: Sequence[str]) -> str:
    return f"{names[0]} and {len(names) - 1} more files" if len(names) > 2 else " and ".join(names) or "recordings"


# --- one file ---------------------------------------------------------------------------------------------


class _File(NamedTuple):
    raw: list[Raw]
    exclusions: list[Exclusion]
    notes: list[str]


def _read_file(path: Path, mapping: Mapping, treatment: Treatment) -> _File:
    (first, header), *rows = _rows(path)
    place = f"{path}:{first}"
    found = find(place, header, mapping)
    treatment.check(place, found.has)
    made = [column for name, column in found.numbers.items() if name in treatment.supersedes()]
    notes = [*found.notes, *(f"{c.title} not read, as the treatment makes the {c.quantity}" for c in made)]
    table = _Table(path, [column for column in found.numbers.values() if column not in made], rows)

    flaws: dict[int, str] = {}
    probes: dict[str, list[int]] = {}
    for i, (_, row) in enumerate(rows):
        empty = [header[k] for k in found.probe if not row[k]]
        if empty:
            flaws[i] = f"{empty[0]} is empty"
        else:
            probes.setdefault(_label(row, found.probe) or path.stem, []).append(i)
    flaws |= table.flaws()

    raw, small, held, kept, saturated = [], [], [], [], 0
    for name, members in probes.items():
        region = _region(path, [rows[i] for i in members], found.region, name)
        sound = np.array([i for i in members if i not in flaws], np.intp)
        again = table.repeated(sound)
        flaws |= dict.fromkeys(map(int, sound[again]), "the time is that of the sample before")
        used = sound[~again]
        if treatment.saturation is not None:
            over = table.force_size(used) >= treatment.saturation
            saturated += int(over.sum())
            flaws |= dict.fromkeys(map(int, used[over]), f"the force is at {treatment.saturation:g} N or beyond")
            used = used[~over]
        elif table.held(used):
            held.append(name)
        kept.append(used)
        if len(used) >= FEWEST:
            lost = np.cumsum(~np.isin(members, used) & ~np.isin(members, sound[again]))[np.isin(members, used)]
            raw.append(Raw(table.recording(name, region, used), np.append(np.diff(lost) > 0, False)))
        else:
            text = f"{len(used)} usable samples, and {FEWEST} are needed"
            small.append(left_out(name, str(path), rows[members[0]][0], text))
    if kept:
        table.check_units(np.concatenate(kept))
    if flaws:
        notes.append(f"{len(flaws)} of {len(rows)} rows left out")
    if treatment.saturation is not None:
        notes.append(f"{saturated} samples left out as saturated, the force at {treatment.saturation:g} N or beyond")
    if small:
        notes.append(f"{len(small)} of {len(probes)} probes left out, with fewer than {FEWEST} usable samples")
    if held:
        text = f"the force stays at its largest for {HELD} samples or more in {len(held)} probes, {held[0]} the first"
        notes.append(f"{text}; if the sensor was at its end there, give that force as saturation")
    exclusions = [Exclusion(str(path), rows[i][0], flaws[i]) for i in sorted(flaws)]
    return _File(raw, [*exclusions, *small], notes)


def _rows(path: Path) -> list[Row]:
    """The header and every row, all of one length."""
    check_recording(path)
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            # Blanked, not dropped, so that the reader counts the lines of the file.
            text = ["\n" if line.lstrip().startswith("#") else line for line in file]
    except UnicodeDecodeError as error:
        raise InputError(str(path), "a recording must be UTF-8 text", str(error), "Save it as CSV") from error
    title = next((line for line in text if line.strip()), "")
    reader = csv.reader(text, delimiter=max(",;\t", key=title.count))
    try:
        rows = [(reader.line_num, [cell.strip() for cell in row]) for row in reader if "".join(row).strip() or row[1:]]
    except csv.Error as error:
        raise InputError(f"{path}:{reader.line_num}", "a recording must be CSV", error, "Mend the line") from error
    if len(rows) < 2:
        way_out = "Record at least one line under the header"
        raise InputError(str(path), "a recording must have a header and a sample", f"{len(rows)} lines", way_out)
    wanted = len(rows[0][1])
    for line, row in rows:
        if len(row) != wanted:
            rule = f"a row must have as many fields as the header, {wanted}"
            raise InputError(f"{path}:{line}", rule, len(row), "Mend or remove the line")
    return rows


def _label(row: list[str], columns: tuple[int, ...]) -> str:
    return "/".join(row[k] for k in columns)


def _region(path: Path, rows: list[Row], columns: tuple[int, ...], probe: str) -> str:
    region = _label(rows[0][1], columns)
    for line, row in rows:
        if _label(row, columns) != region:
            rule, found = f"probe {probe} must be in one region", f"{_label(row, columns)} after {region}"
            raise InputError(f"{path}:{line}", rule, found, "Mend the line, or map probe to the columns of both")
    return region


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return float("nan")


class _Table:
    """The numbers of one file, in SI units; rows are counted from 0 below the header."""

    def __init__(self, path: Path, columns: list[Column], rows: list[Row]) -> None:
        self.path, self.columns = path, columns
        self.lines = np.array([line for line, _ in rows])
        self.words = [[row[column.index] for column in columns] for _, row in rows]
        numbers = np.array([[_number(word) for word in row] for row in self.words])
        self.values = {column.quantity: numbers[:, k] * column.factor for k, column in enumerate(columns)}

    def flaws(self) -> dict[int, str]:
        """What is wrong with which row by itself."""
        finite = np.isfinite(np.column_stack(list(self.values.values())))
        found = {}
        for i in map(int, np.flatnonzero(~finite.all(axis=1))):
            k = int(np.argmin(finite[i]))
            word = self.words[i][k]
            found[i] = f"{self.columns[k].title} is {f'{word}, no finite number' if word else 'empty'}"
        if "qw" in self.values:
            norm = np.linalg.norm(self._vector("orientation"), axis=1)
            found |= {int(i): f"the quaternion has a norm below {NO_TURN:g}" for i in np.flatnonzero(norm < NO_TURN)}
        return found

    def repeated(self, rows: Indices) -> Flags:
        """Which samples are of the moment of the one before; InputError where time runs backwards."""
        if "time" not in self.values:
            return np.zeros(len(rows), bool)
        time = self.values["time"][rows]
        step = np.diff(time, prepend=-np.inf)
        for k in np.flatnonzero(step < 0)[:1]:
            found = f"{time[k]:.9g} s after {time[k - 1]:.9g} s in line {self.lines[rows[k - 1]]}"
            way_out = "Sort the lines, or tell the probes apart by a column of probe"
            raise InputError(f"{self.path}:{self.lines[rows[k]]}", "time must not run backwards", found, way_out)
        return np.asarray(step == 0)

    def force_size(self, rows: Indices) -> Real:
        """Largest of the force and the parts of its vector, either sign."""
        return np.asarray(np.max([np.abs(self.values[name][rows]) for name in FORCES if name in self.values], axis=0))

    def held(self, rows: Indices) -> bool:
        """Whether a force that is recorded over time stays at its largest value."""
        size = self.force_size(rows)
        if "time" not in self.values or len(size) < HELD or not size.any():
            return False
        return bool((np.convolve(size == size.max(), np.ones(HELD), mode="valid") == HELD).any())

    def check_units(self, rows: Indices) -> None:
        """InputError for values that only a wrong unit explains."""
        for column in self.columns if len(rows) else ():
            quantity = QUANTITIES[column.quantity]
            size = np.abs(self.values[column.quantity][rows])
            largest = float(size.max())
            si = next(unit for unit, factor in quantity.units.items() if factor == 1.0)
            if largest > quantity.limit:
                rule = f"{column.quantity} must stay within {quantity.limit:g} {si}"
            elif column.quantity == "depth" and 0.0 < largest < SHALLOW:
                rule = f"the depth must reach {SHALLOW:g} m somewhere"
            else:
                continue
            place = f"{self.path}:{self.lines[rows[np.argmax(size)]]}, column {column.title}"
            found = f"{largest:.4g} {si} as the largest, the unit taken as {column.unit}"
            raise InputError(place, rule, found, column.likely_unit(largest))

    def recording(self, name: str, region: str, rows: Indices) -> Recording:
        plain = {key: self.values[key][rows] for key in ("time", "depth", "rate", "force") if key in self.values}
        vector = {key: self._vector(key)[rows] for key in VECTORS if VECTORS[key][0] in self.values}
        pose = None
        if "position" in vector:
            turn = vector.get("orientation", np.tile(IDENTITY, (len(rows), 1)))
            pose = np.hstack([vector["position"], turn / np.linalg.norm(turn, axis=1, keepdims=True)])
        force = vector.get("force_vector")
        return Recording(name, region, str(self.path), self.lines[rows], **plain, force_vector=force, pose=pose)

    def _vector(self, name: str) -> Real:
        return np.column_stack([self.values[part] for part in VECTORS[name]])
