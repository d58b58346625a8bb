"""What moves an instrument: a recorded or a generated path of its pose, and the course of its jaws, over time.

Positions are of the origin of the instrument's body frame in the world [m], orientations unit quaternions
w, x, y, z from body to world, jaws 0 closed to 1 open. Before its first moment a path stands at its first pose,
after its last at its last; so do the jaws.
"""

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PrivateAttr, model_validator

from tissue_contact.errors import InputError
from tissue_contact.scene import IDENTITY, ORIGIN, Point, Quaternion
from tissue_contact.settings import Settings, broken, check_recording, items, nearest, quantity

FloatArray = NDArray[np.float64]

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
METRES = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "um": 1e-6}
PURE = {"1": 1.0}

TREMOR_WAVES = 64  # sinusoids that make up a tremor: enough for it not to be heard to repeat


@dataclass(frozen=True, eq=False)
class Poses:
    """A pose at every moment.

    Parameters
    ----------
    position : float64 [m], shape (n, 3)
    orientation : float64, unit quaternions w, x, y, z, shape (n, 4)
    jaw : float64, 0 closed to 1 open, shape (n,), None where nothing moves the jaws

    """

    position: FloatArray
    orientation: FloatArray
    jaw: FloatArray | None = None


def minimum_jerk(u: FloatArray) -> FloatArray:
    """Share of a movement that is done after the share `u` of its time (Flash and Hogan 1985).

    s = 10 u³ − 15 u⁴ + 6 u⁵
    """
    u = np.clip(u, 0.0, 1.0)
    return np.asarray(u**3 * (10 - 15 * u + 6 * u**2))


def slerp(start: FloatArray, end: FloatArray, share: FloatArray) -> FloatArray:
    """Between unit quaternions along the shorter way, shapes (n, 4), (n, 4), (n,)."""
    end = np.where((start * end).sum(axis=1, keepdims=True) < 0, -end, end)
    cosine = np.clip((start * end).sum(axis=1), -1.0, 1.0)
    angle = np.arccos(cosine)
    sine = np.sin(angle)
    small = sine < 1e-9  # the chord is as good as the arc, and does not divide by zero
    safe = np.where(small, 1.0, sine)
    a = np.where(small, 1 - share, np.sin((1 - share) * angle) / safe)
    b = np.where(small, share, np.sin(share * angle) / safe)
    mixed = a[:, None] * start + b[:, None] * end
    return np.asarray(mixed / np.linalg.norm(mixed, axis=1, keepdims=True))


# --- generators -------------------------------------------------------------------------------------------


def _seconds(description: str, default: Any = ..., low: float = 1e-6) -> Any:
    return quantity("s", low, 1e6, description, default)


class Tremor(Settings):
    """The hand's tremor: band-limited noise, independent along x, y and z, on top of a path."""

    amplitude: float = quantity("m", 0, 0.01, "root mean square along each axis")
    band: Annotated[tuple[Annotated[float, Field(ge=0.01, le=1000)], ...], Field(min_length=2, max_length=2)] = items(
        "Hz", "least and greatest frequency", (8.0, 12.0)
    )
    seed: int = quantity("1", 0, 2**31 - 1, "number that picks the noise", 0)

    @model_validator(mode="after")
    def _ordered(self) -> "Tremor":
        if self.band[0] > self.band[1]:
            rule = "the least frequency must come first"
            raise broken(("band",), rule, list(self.band), "Swap the two")
        return self

    def shift(self, times: FloatArray) -> FloatArray:
        """Displacement [m] at `times` [s], shape (n, 3)."""
        rng = np.random.default_rng(self.seed)
        rate = 2 * np.pi * rng.uniform(self.band[0], self.band[1], (TREMOR_WAVES, 3))
        phase = rng.uniform(0, 2 * np.pi, (TREMOR_WAVES, 3))
        waves = np.sin(times[:, None, None] * rate + phase).sum(axis=1)
        return np.asarray(self.amplitude * np.sqrt(2 / TREMOR_WAVES) * waves)


class JawMoment(Settings):
    """An opening of the jaws at a time."""

    time: float = _seconds("when the opening is reached", low=0)
    value: float = quantity("1", 0, 1, "opening of the jaws, 0 closed to 1 open")


class _Path(Settings):
    instrument: str = Field("", description="instrument that moves; without it the only one")
    tremor: Tremor | None = Field(None, description="noise on top of the path")
    jaw: tuple[JawMoment, ...] = Field(
        (), strict=False, description="course of the jaws, linear between its moments; without it they stay open"
    )

    @model_validator(mode="after")
    def _jaw_in_order(self) -> "_Path":
        _follow_in_time(self.jaw, "jaw", "the moments of the jaws")
        return self


class _Timed(Protocol):
    @property
    def time(self) -> float: ...


def _follow_in_time(moments: Sequence[_Timed], key: str, what: str) -> None:
    """Refuse moments of which one is not later than the one before."""
    for i, (before, moment) in enumerate(pairwise(moments), 1):
        if moment.time <= before.time:
            rule = f"{what} must follow in time; the one before is at {before.time:g} s"
            raise broken((key, i, "time"), rule, moment.time, "Order them, each later")


class Still(_Path):
    """No movement: the instrument stays where the scene puts it."""

    kind: Literal["still"]
    _start: tuple[tuple[float, ...], tuple[float, ...]] = PrivateAttr((ORIGIN, IDENTITY))

    def _path(self, times: FloatArray, folder: Path) -> Poses:
        position, orientation = self._start
        return Poses(np.tile(position, (len(times), 1)), np.tile(orientation, (len(times), 1)))


class _Turned(_Path):
    orientation: Quaternion = items("1", "orientation all the way, quaternion w, x, y, z", IDENTITY)

    def _held(self, position: FloatArray) -> Poses:
        return Poses(position, np.tile(self.orientation, (len(position), 1)))


class _Along(_Turned):
    point: Point = items("m", "where the movement meets the tissue")
    axis: Point = items("1", "direction of the movement into the tissue", (0.0, 0.0, -1.0))
    approach: float = quantity("m", 0, 1, "distance before the point at which the movement begins", 0.005)
    depth: float = quantity("m", 0, 1, "distance beyond the point at which it turns")
    begin: float = _seconds("when the movement begins", 0.0, low=0)

    @model_validator(mode="after")
    def _has_direction(self) -> "_Along":
        if np.linalg.norm(self.axis) < 1e-9:
            raise broken(("axis",), "an axis must have a direction", list(self.axis), "Give [0, 0, -1] for down")
        return self

    def _at(self, share: FloatArray) -> Poses:
        """Pose after a share of the way, 0 at the approach and 1 at the depth."""
        axis = np.array(self.axis) / np.linalg.norm(self.axis)
        along = -self.approach + (self.approach + self.depth) * share
        return self._held(np.array(self.point) + along[:, None] * axis)


class Press(_Along):
    """Approach along an axis, press to a depth, hold, leave."""

    kind: Literal["press"]
    press_time: float = _seconds("time from the approach to the depth")
    hold_time: float = _seconds("time at the depth", 0.0, low=0)
    leave: bool = Field(True, description="go back afterwards, as fast as it came")

    def _path(self, times: FloatArray, folder: Path) -> Poses:
        t = times - self.begin
        share = minimum_jerk(t / self.press_time)
        if self.leave:
            share -= minimum_jerk((t - self.press_time - self.hold_time) / self.press_time)
        return self._at(share)


class Poke(_Along):
    """Fast in and out, once or again and again."""

    kind: Literal["poke"]
    duration: float = _seconds("time of one poke, in and out")
    count: int = quantity("1", 1, 100_000, "number of pokes", 1)
    period: float | None = _seconds("time from one poke to the next; without it they follow at once", None)

    @model_validator(mode="after")
    def _apart(self) -> "Poke":
        if self.period is not None and self.period < self.duration:
            rule = "a poke must be over before the next begins"
            raise broken(("period",), rule, self.period, f"Give at least duration = {self.duration:g}")
        return self

    def _path(self, times: FloatArray, folder: Path) -> Poses:
        period = self.period or self.duration
        t = times - self.begin
        nth = np.clip(np.floor(t / period), 0, self.count - 1)
        u = (t - nth * period) / self.duration
        return self._at(minimum_jerk(2 * u) - minimum_jerk(2 * u - 1))


class Slide(_Turned):
    """From one point to another and, if wanted, to and fro."""

    kind: Literal["slide"]
    start: Point = items("m", "where it begins")
    end: Point = items("m", "where it turns or ends")
    stroke_time: float = _seconds("time of one stroke from start to end")
    strokes: int = quantity("1", 1, 100_000, "number of strokes, every second one going back", 1)
    begin: float = _seconds("when the movement begins", 0.0, low=0)

    def _path(self, times: FloatArray, folder: Path) -> Poses:
        t = times - self.begin
        nth = np.clip(np.floor(t / self.stroke_time), 0, self.strokes - 1)
        share = minimum_jerk(t / self.stroke_time - nth)
        share = np.where(nth % 2 == 1, 1 - share, share)
        start, end = np.array(self.start), np.array(self.end)
        return self._held(start + share[:, None] * (end - start))


class Circle(_Turned):
    """Round and round on a circle, from rest to rest."""

    kind: Literal["circle"]
    centre: Point = items("m", "centre of the circle")
    normal: Point = items("1", "axis of the circle; the turn is right-handed about it", (0.0, 0.0, 1.0))
    radius: float = quantity("m", 0, 1, "radius of the circle")
    period: float = _seconds("time of one turn")
    turns: float = quantity("1", 0.01, 1e6, "number of turns", 1.0)
    begin: float = _seconds("when the movement begins", 0.0, low=0)

    @model_validator(mode="after")
    def _has_direction(self) -> "Circle":
        if np.linalg.norm(self.normal) < 1e-9:
            rule = "an axis must have a direction"
            raise broken(("normal",), rule, list(self.normal), "Give [0, 0, 1] for a level circle")
        return self

    def _path(self, times: FloatArray, folder: Path) -> Poses:
        normal = np.array(self.normal) / np.linalg.norm(self.normal)
        least = np.eye(3)[np.argmin(np.abs(normal))]
        u = np.cross(normal, least)
        u /= np.linalg.norm(u)
        # Half a period each to get going and to stop, at constant speed between.
        end = self.turns * self.period
        ease = min(0.5 * self.period, end / 2)
        t = np.clip(times - self.begin, 0.0, end + ease)
        ramp = _eased(t, ease) - _eased(t - end, ease)
        angle = 2 * np.pi * ramp / self.period
        v = np.cross(normal, u)
        round_it = np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * v
        return self._held(np.array(self.centre) + self.radius * round_it)


def _eased(t: FloatArray, ease: float) -> FloatArray:
    """Time gone by for one who takes `ease` to reach full pace: the integral of `minimum_jerk(t / ease)`."""
    u = np.clip(t / ease, 0.0, 1.0)
    return np.asarray(ease * u**4 * (2.5 - 3 * u + u**2) + np.maximum(t - ease, 0.0))


class Waypoint(Settings):
    """A pose to be reached, at rest, at a time."""

    time: float = _seconds("when the pose is reached", low=0)
    position: Point = items("m", "place of the body frame's origin")
    orientation: Quaternion = items("1", "orientation, quaternion w, x, y, z", IDENTITY)


class Waypoints(_Path):
    """From pose to pose, from rest to rest, with minimum jerk."""

    kind: Literal["waypoints"]
    waypoint: Annotated[tuple[Waypoint, ...], Field(min_length=1)] = Field(
        strict=False, description="poses in the order of their times"
    )

    @model_validator(mode="after")
    def _in_order(self) -> "Waypoints":
        _follow_in_time(self.waypoint, "waypoint", "waypoints")
        return self

    def _path(self, times: FloatArray, folder: Path) -> Poses:
        stamp = np.array([w.time for w in self.waypoint])
        position = np.array([w.position for w in self.waypoint])
        orientation = np.array([w.orientation for w in self.waypoint])
        return _between(stamp, position, orientation, times, minimum_jerk)


# --- recording --------------------------------------------------------------------------------------------


class Recording(_Path):
    """A recorded path from a CSV file, linear between its moments (orientation by slerp), gaps included.

    A column `jaw` is the course of the jaws.
    """

    kind: Literal["recording"]
    file: str = Field(min_length=1, description="CSV file, relative to the scenario file")
    begin: float | None = quantity(
        "s", -1e12, 1e12, "moment of the recording to begin with; the first by default", None
    )

    def _path(self, times: FloatArray, folder: Path) -> Poses:
        recorded = read_recording(folder / self.file, self.instrument)
        stamp = recorded.time - (recorded.time[0] if self.begin is None else self.begin)
        poses = _between(stamp, recorded.position, recorded.orientation, times, lambda u: u)
        if recorded.jaw is None:
            return poses
        if self.jaw:
            rule, way_out = "the jaws must have one course only", "Remove jaw from the stimulus, or the column"
            raise InputError(str(folder / self.file), rule, "jaw in the stimulus and in the recording", way_out)
        return replace(poses, jaw=np.interp(times, stamp, recorded.jaw))


def _between(stamp: FloatArray, position: FloatArray, orientation: FloatArray, times: FloatArray, ease: Any) -> Poses:
    if len(stamp) == 1:
        n = len(times)
        return Poses(np.repeat(position, n, axis=0), np.repeat(orientation, n, axis=0))
    after = np.clip(np.searchsorted(stamp, times, side="right"), 1, len(stamp) - 1)
    before = after - 1
    share = ease(np.clip((times - stamp[before]) / (stamp[after] - stamp[before]), 0.0, 1.0))
    place = position[before] + share[:, None] * (position[after] - position[before])
    return Poses(place, slerp(orientation[before], orientation[after], share))


@dataclass(frozen=True, eq=False)
class Recorded:
    """Content of a recording.

    Parameters
    ----------
    time : float64 [s], shape (n,), ascending
    position : float64 [m], shape (n, 3)
    orientation : float64, unit quaternions w, x, y, z, shape (n, 4)
    jaw : float64, 0 closed to 1 open, shape (n,), None without that column
    gap, gap_time : float [s]
        The longest time without a pose, and when it begins, counted from the first pose.

    """

    time: FloatArray
    position: FloatArray
    orientation: FloatArray
    jaw: FloatArray | None
    gap: float
    gap_time: float


def read_recording(path: Path, instrument: str) -> Recorded:
    """Read a recorded path of `instrument`.

    The header names the columns, each with its unit in brackets or none for SI: `time [s]`,
    `NAME.position[1] [m]` to `[3]`, `NAME.orientation[1]` to `[4]`, `NAME.jaw`, or for short
    `time, x, y, z, qw, qx, qy, qz, jaw`. Without any orientation column the orientation is 1, 0, 0, 0; other
    columns are not read. Separators are commas, semicolons or tabs; empty lines and lines that begin with #
    are skipped.

    Raises
    ------
    InputError
        With file and line: a missing column, an unknown unit, a value that is no finite number, time that
        does not grow, a quaternion without a norm, jaws opened beyond 0 to 1.

    """
    check_recording(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(str(path), "a recording must be UTF-8 text", str(error), "Save it as CSV") from error
    lines = [(n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip() and line.lstrip()[0] != "#"]
    if len(lines) < 2:
        way_out = "Record at least one line under the header"
        raise InputError(str(path), "a recording must have a header and a pose", f"{len(lines)} lines", way_out)
    separator = max(",;\t", key=lines[0][1].count)
    rows = list(csv.reader((line for _, line in lines), delimiter=separator))
    names, columns, factors = _columns(f"{path}:{lines[0][0]}", rows[0], instrument)
    values = np.empty((len(rows) - 1, len(columns)))
    for i, row in enumerate(rows[1:]):
        place = f"{path}:{lines[i + 1][0]}"
        for j, column in enumerate(columns):
            word = row[column] if column < len(row) else "nothing"
            try:
                values[i, j] = float(word)
            except ValueError:
                values[i, j] = np.nan
            if not np.isfinite(values[i, j]):
                rule = f"column {rows[0][column].strip()} must hold a finite number"
                raise InputError(place, rule, word.strip() or "nothing", "Mend or remove the line")
    values *= factors
    time = values[:, 0]
    step = np.diff(time)
    for i in np.flatnonzero(step <= 0)[:1]:
        what = "must not repeat" if step[i] == 0 else "must not run backwards"
        found = f"{time[i + 1]:.9g} s after {time[i]:.9g} s"
        raise InputError(f"{path}:{lines[i + 2][0]}", f"time {what}", found, "Remove or sort the lines")
    orientation = np.tile(IDENTITY, (len(values), 1))
    if len(names) >= 8:
        norm = np.linalg.norm(values[:, 4:8], axis=1)
        for i in np.flatnonzero(norm < 1e-6)[:1]:
            place, rule = f"{path}:{lines[i + 1][0]}", "a quaternion w, x, y, z must have a norm above 1e-6"
            raise InputError(place, rule, values[i, 4:8].tolist(), "Mend or remove the line")
        orientation = values[:, 4:8] / norm[:, None]
    jaw = values[:, -1] if names[-1] in _jaw_names(instrument) else None
    for i in np.flatnonzero((jaw < 0) | (jaw > 1))[:1] if jaw is not None else ():
        place, rule = f"{path}:{lines[i + 1][0]}", f"column {names[-1]} must lie between 0, closed, and 1, open"
        raise InputError(place, rule, values[i, -1], "Mend or remove the line")
    widest = int(np.argmax(step)) if len(step) else 0
    gap, gap_time = (float(step[widest]), float(time[widest] - time[0])) if len(step) else (0.0, 0.0)
    return Recorded(time, values[:, 1:4], orientation, jaw, gap, gap_time)


def _jaw_names(instrument: str) -> tuple[str, str]:
    return f"{instrument}.jaw", "jaw"


def _columns(place: str, header: Sequence[str], instrument: str) -> tuple[list[str], list[int], FloatArray]:
    """Names of the columns of time, position, perhaps orientation and jaw; where they stand; their factors into SI."""
    found: dict[str, tuple[int, str]] = {}
    for i, title in enumerate(header):
        # A unit stands in brackets after a space or is no mere number: position[1] has no unit, x[mm] has.
        match = re.fullmatch(r"\s*(.*?)(?:\s+\[([^\]]*)\]|\[([a-zA-Z][^\]]*)\])?\s*", title)
        assert match is not None  # the pattern takes any title
        name = match[1].strip().strip('"')
        if name in found:
            raise InputError(place, "a column must appear once", f"{name} twice", "Rename or remove one of the two")
        found[name] = (i, match[2] or match[3] or "")
    long = [f"{instrument}.{part}[{k}]" for part, n in (("position", 3), ("orientation", 4)) for k in range(1, n + 1)]
    short = ["x", "y", "z", "qw", "qx", "qy", "qz"]
    wanted = long if any(name in found for name in long) or "x" not in found else short
    if not any(name in found for name in wanted[3:]):
        wanted = wanted[:3]
    names = ["time", *wanted, *[name for name in _jaw_names(instrument) if name in found][:1]]
    columns, factors = [], []
    for name in names:
        if name not in found:
            rule, way_out = f"a recording must have a column {name}", nearest(name, found, what="columns")
            raise InputError(place, rule, "none of that name", way_out.replace("right spelling", "column"))
        column, unit = found[name]
        units = SECONDS if name == "time" else METRES if name in wanted[:3] else PURE
        if unit and unit not in units:
            rule = f"the unit of column {name} must be one of {', '.join(units)}"
            raise InputError(place, rule, f"[{unit}]", "Convert the column")
        columns.append(column)
        factors.append(units[unit] if unit else 1.0)
    return names, columns, np.array(factors)


# --- all instruments --------------------------------------------------------------------------------------

Declared = Annotated[Still | Press | Slide | Poke | Circle | Waypoints | Recording, Field(discriminator="kind")]


def no_jaws(place: str, instrument: str, what: str) -> InputError:
    """The error for a course of jaws that the instrument does not have; `what` is to be removed."""
    way_out = f"Give the instrument a grasp in the scene, or remove {what}"
    return InputError(place, "only an instrument with a grasp has jaws to move", f"{instrument} without", way_out)


@dataclass(frozen=True)
class Stimulus:
    """The paths of all instruments that move.

    Parameters
    ----------
    paths : one of the declared kinds for each instrument, `instrument` filled in
    folder : where relative file names begin
    graspers : names of the instruments that have jaws

    """

    paths: tuple[Declared, ...]
    folder: Path
    graspers: frozenset[str] = frozenset()

    def poses(self, times: FloatArray) -> dict[str, Poses]:
        """Pose of every instrument that has a path at `times` [s], shape (n,)."""
        found = {}
        for path in self.paths:
            poses = path._path(times, self.folder)
            if isinstance(path, Recording) and poses.jaw is not None and path.instrument not in self.graspers:
                raise no_jaws(str(self.folder / path.file), path.instrument, "the column of the jaw")
            if path.tremor is not None:
                poses = replace(poses, position=poses.position + path.tremor.shift(times))
            if path.jaw:
                opening = np.interp(times, [m.time for m in path.jaw], [m.value for m in path.jaw])
                poses = replace(poses, jaw=opening)
            found[path.instrument] = poses
        return found

    def sample(self, times: FloatArray) -> dict[str, FloatArray]:
        """Value of every input variable at `times` [s], each of shape (n,).

        Raises
        ------
        InputError
            A recording that cannot be read, or that moves jaws which the instrument does not have.

        """
        found = {}
        for name, poses in self.poses(np.asarray(times, np.float64)).items():
            for k in range(3):
                found[f"{name}.position[{k + 1}]"] = poses.position[:, k].copy()
            for k in range(4):
                found[f"{name}.orientation[{k + 1}]"] = poses.orientation[:, k].copy()
            if poses.jaw is not None:
                found[f"{name}.jaw"] = poses.jaw
        return found

    def remarks(self) -> list[str]:
        """What the user should know of the recordings, one line each."""
        found = []
        for path in self.paths:
            if isinstance(path, Recording):
                r = read_recording(self.folder / path.file, path.instrument)
                span = r.time[-1] - r.time[0]
                text = f"{path.file}: {len(r.time)} poses over {span:.4g} s"
                found.append(f"{text}, longest gap {r.gap:.4g} s at {r.gap_time:.4g} s")
        return found
