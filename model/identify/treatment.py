"""Treatment of recordings between the file and the identification: nothing is done unless it is asked for."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from pydantic import Discriminator, Field, Tag, model_validator
from scipy.signal import butter, sosfiltfilt
from scipy.spatial.transform import Rotation

from tissue_contact.errors import InputError
from tissue_contact.identify.recording import Exclusion, Real, Recording
from tissue_contact.scene import Point
from tissue_contact.settings import Settings, broken, items, quantity, show

FEWEST = 3  # samples that a probe must have to be of use
STAYS = 3  # samples in a row that make a force stay above a threshold
PAUSE = 5.0  # a step of this many usual ones is a gap in the recording
UNEVEN = 0.05  # share by which a step of an even recording may differ from the mean
FILTERED = 10  # samples that the filter needs to run in from both ends
MOST = 10_000_000  # samples of a resampled recording

Flags = npt.NDArray[np.bool_]
FORCES = ("force", "force_vector")
COURSES = ("depth", "rate", "force", "force_vector", "pose")  # what a recording may have over time

Newtons = Annotated[float, Field(ge=-1e4, le=1e4)]
Vector = Annotated[tuple[Newtons, ...], Field(min_length=3, max_length=3, strict=False)]


def _form(value: object) -> str:
    return "word" if isinstance(value, str) else "list" if isinstance(value, list | tuple) else "number"


Bias = Annotated[
    Annotated[Literal["before_touch"], Tag("word")]
    | Annotated[Newtons, Tag("number")]
    | Annotated[Vector, Tag("list")],
    Discriminator(_form),
]


def _hertz(description: str) -> Any:
    return quantity("Hz", 1e-3, 1e6, description, None)


class Treatment(Settings):
    """What is done to the samples, in the order of the keys."""

    saturation: float | None = quantity(
        "N", 1e-6, 1e6, "force, as recorded, from which on a sample is left out, either sign", None
    )
    bias: Bias | None = Field(
        None,
        description="what to subtract from the recorded force: a number from the normal force, a list of three from "
        'the force vector, or "before_touch", the mean before the first touch (without first_touch, at depths of 0 '
        "or less)",
        json_schema_extra={"unit": "N"},
    )
    sign: Literal[1, -1] = Field(1, description="-1 where the file has forces on the tissue")
    frame: Literal["world", "instrument"] = Field(
        "world", description="frame of the force vector; instrument turns it by the orientation into the world"
    )
    normal: Point | None = items(
        "1", "direction out of the tissue, in the world; the normal force is the force vector along it", None
    )
    resample: float | None = _hertz(
        "linear interpolation at even stamps; nothing is done against aliasing, so take no less than was recorded"
    )
    low_pass: float | None = _hertz(
        "Butterworth filter, 2nd order, run both ways: no delay, half the amplitude at this frequency"
    )
    rate: Literal["given", "differentiated"] | None = Field(
        None, description="rate of the depth from its column or from depth over time; without, from what there is"
    )
    first_touch: float | None = quantity(
        "N", 1e-6, 1e4, f"depth counts from where the force stays at or above it, {STAYS} samples in a row", None
    )
    min_force: float | None = quantity("N", 0, 1e4, "a probe whose largest force is below it is left out", None)

    @model_validator(mode="after")
    def _has_direction(self) -> "Treatment":
        if self.normal is not None and np.linalg.norm(self.normal) < 1e-9:
            raise broken(("normal",), "a normal must have a direction", show(self.normal), "Give [0, 0, 1] for up")
        return self

    def supersedes(self) -> set[str]:
        """Quantities that are not to be read from a column, as they are made from others."""
        return {name for name, made in (("force", self.normal), ("rate", self.rate == "differentiated")) if made}

    def check(self, place: str, has: Callable[[str], bool]) -> None:
        """InputError for an option without the columns that it needs.

        `has` tells whether there is a quantity or a whole vector.
        """
        needs = (
            ("bias", isinstance(self.bias, float), "force"),
            ("bias", isinstance(self.bias, tuple), "force_vector"),
            ("bias", self.bias == "before_touch" and self.first_touch is None, "depth"),
            ("frame", self.frame == "instrument", "force_vector"),
            ("frame", self.frame == "instrument", "position"),
            ("frame", self.frame == "instrument", "orientation"),
            ("normal", self.normal is not None, "force_vector"),
            ("resample", self.resample is not None, "time"),
            ("low_pass", self.low_pass is not None, "time"),
            ("rate", self.rate == "given", "rate"),
            ("rate", self.rate == "differentiated", "depth"),
            ("rate", self.rate == "differentiated", "time"),
        )
        for option, asked, name in needs:
            if asked and (name in self.supersedes() or not has(name)):
                rule = f"{option} = {show(getattr(self, option))} needs a column of {name}"
                way_out = f"Remove {option} from the treatment, or add or map the column"
                raise InputError(place, rule, "normal in its stead" if has(name) else "none", way_out)


class Raw(NamedTuple):
    """A recording before its treatment."""

    recording: Recording
    gap: Flags  # shape [n], whether rows were left out between a sample and the next


class Treated(NamedTuple):
    """What a treatment came to; exclusions are of whole probes."""

    recordings: tuple[Recording, ...]
    exclusions: tuple[Exclusion, ...]
    notes: tuple[str, ...]


def treat(raw: Sequence[Raw], treatment: Treatment) -> Treated:
    """Apply every option but saturation, which is a matter of rows.

    A gap, where rows were left out or time steps over PAUSE usual steps, is bridged by a straight line for
    resampling and filter; the samples on the line are then left out.

    Raises
    ------
    InputError
        No sample before the touch; more than MOST samples; a filter over uneven stamps or not below half
        the sampling rate.

    """
    notes: list[str] = []
    exclusions: list[Exclusion] = []
    recordings = [r.recording for r in raw]
    if treatment.bias is not None:
        recordings = _unbiased(recordings, treatment, notes)
    if treatment.sign == -1:
        recordings = [_along(r, np.negative, FORCES) for r in recordings]
        notes.append("sign of the force turned")
    if treatment.frame == "instrument":
        recordings = [replace(r, force_vector=_turned(r)) for r in recordings]
        notes.append("force vector turned from the frame of the instrument into the world")
    if treatment.normal is not None:
        normal = np.array(treatment.normal) / np.linalg.norm(treatment.normal)
        recordings = [replace(r, force=_vector(r) @ normal) for r in recordings]
        notes.append(f"normal force taken from the force vector, along {show(treatment.normal)}")
    if treatment.resample is not None or treatment.low_pass is not None:
        recordings = _evenly(recordings, [r.gap for r in raw], treatment, notes, exclusions)
    recordings = _with_rate(recordings, notes)
    if treatment.first_touch is not None:
        recordings = _from_touch(recordings, treatment.first_touch, notes, exclusions)
    if treatment.min_force is not None:
        recordings = _strong(recordings, treatment.min_force, notes, exclusions)
    pulling = [r.name for r in recordings if r.force is not None and -r.force.min() > r.force.max()]
    if 2 * len(pulling) > len(recordings):  # single ones are noise
        text = f"the largest force is negative in {len(pulling)} of {len(recordings)} probes"
        notes.append(f"{text}: it must be positive where the tissue pushes back, see sign and bias")
    return Treated(tuple(recordings), tuple(exclusions), tuple(notes))


def left_out(name: str, place: str, line: int, reason: str) -> Exclusion:
    """Exclusion of a whole probe, at its first line."""
    return Exclusion(place, line, f"probe {name} as a whole: {reason}")


# --- one step each ----------------------------------------------------------------------------------------


def _unbiased(recordings: list[Recording], treatment: Treatment, notes: list[str]) -> list[Recording]:
    if treatment.bias != "before_touch":
        name = "force_vector" if isinstance(treatment.bias, tuple) else "force"
        notes.append(f"bias of {show(treatment.bias)} N subtracted from the {name.replace('_', ' ')}")
        return [_along(r, lambda force: force - np.array(treatment.bias), (name,)) for r in recordings]
    done, sizes = [], []
    for r in recordings:
        before = _before_touch(r, treatment)
        sizes.append(float(_size(_force(r)[before].mean(axis=0)[None])[0]))
        done.append(_less_mean(r, before))
    if sizes:
        notes.append(f"bias subtracted: the mean force before the touch, {_span(sizes)} N")
    return done


def _before_touch(r: Recording, treatment: Treatment) -> Flags:
    if treatment.first_touch is not None:
        # The bias is not known yet: the first sample stands for it.
        change = treatment.sign * (_force(r) - _force(r)[0])
        return np.arange(len(r)) < _touch(_size(change), treatment.first_touch)
    assert r.depth is not None  # `Treatment.check` saw to it, as to time, pose and vector below
    before = np.asarray(r.depth <= 0)
    if not before.any():
        rule = f'bias = "before_touch" needs a sample of probe {r.name} at a depth of 0 or less'
        way_out = "Give the bias as a number, or first_touch to find the touch by the force"
        raise InputError(f"{r.place}:{r.lines[0]}", rule, f"depths from {r.depth.min():.4g} m on", way_out)
    return before


def _less_mean(r: Recording, rows: Flags) -> Recording:
    return _along(r, lambda force: force - force[rows].mean(axis=0), FORCES)


def _turned(r: Recording) -> Real:
    assert r.pose is not None
    return np.asarray(Rotation.from_quat(r.pose[:, [4, 5, 6, 3]]).apply(_vector(r)))


def _evenly(
    recordings: list[Recording],
    gaps: list[Flags],
    treatment: Treatment,
    notes: list[str],
    exclusions: list[Exclusion],
) -> list[Recording]:
    """Resampled, low-passed, or both."""
    done, rates, bridges, on_bridges = [], [], 0, 0
    fewest = FEWEST if treatment.low_pass is None else FILTERED
    for r, gap in zip(recordings, gaps, strict=True):
        time = _time(r)
        rates.append((len(r) - 1) / float(time[-1] - time[0]))
        inside = np.zeros(len(r), bool)
        if treatment.resample is not None:
            step = np.diff(time)
            gap = gap | np.append(step > PAUSE * np.median(step), False)
            r, inside = _resampled(r, gap, treatment.resample)
            bridges, on_bridges = bridges + int(gap.sum()), on_bridges + int(inside.sum())
        if len(r) >= fewest and treatment.low_pass is not None:
            r = _low_passed(r, treatment.low_pass)
        if len(r) < fewest or len(r) - inside.sum() < FEWEST:
            text = f"{len(r)} samples to resample or filter, {inside.sum()} of them in gaps; {fewest} are needed"
            exclusions.append(left_out(r.name, r.place, int(r.lines[0]), text))
        else:
            done.append(_where(r, ~inside))
    if treatment.resample is not None and rates:
        notes.append(f"resampled from {_span(rates)} Hz to {treatment.resample:g} Hz by straight lines")
    if bridges:
        notes.append(f"{bridges} gaps bridged by straight lines, the {on_bridges} samples on them left out in the end")
    if treatment.low_pass is not None:
        notes.append(f"low-passed at {treatment.low_pass:g} Hz (Butterworth 2nd order, both ways)")
    return done


def _resampled(r: Recording, gap: Flags, rate: float) -> tuple[Recording, Flags]:
    """At even stamps, each with the line of the sample before it; and which stamps are inside a gap."""
    time = _time(r)
    steps = float(time[-1] - time[0]) * rate
    if steps > MOST:
        rule = f"resampling must not make more than {MOST} samples of probe {r.name}"
        found = f"resample = {rate:g} over {time[-1] - time[0]:.4g} s"
        raise InputError(f"{r.place}:{r.lines[0]}", rule, found, "Give a lower rate, or mend the time stamps")
    near = 1e-6 / rate  # rounding: a stamp this near to a sample is the sample's
    even = time[0] + np.arange(int(steps + 1e-6) + 1) / rate
    before = np.searchsorted(time, even + near, side="right") - 1

    def interpolated(values: Real) -> Real:
        columns = [np.interp(even, time, column) for column in np.atleast_2d(values.T)]
        return np.reshape(np.transpose(columns), (len(even), *values.shape[1:]))

    inside = gap[before] & (even > time[before] + near)
    return replace(_along(r, interpolated), lines=r.lines[before], time=even), inside


def _low_passed(r: Recording, frequency: float) -> Recording:
    step = np.diff(_time(r))
    mean, usual = float(step.mean()), float(np.median(step))
    worst = int(np.argmax(np.abs(step - usual)))
    if abs(step[worst] - usual) > UNEVEN * usual:
        rule = f"low_pass needs even time stamps, here of probe {r.name}"
        found = f"{step[worst]:.4g} s after the sample before, where {usual:.4g} s is usual"
        raise InputError(f"{r.place}:{r.lines[worst + 1]}", rule, found, f"Give resample = {1 / usual:.4g} as well")
    if frequency >= 0.5 / mean:
        rule = f"low_pass must be below half the {1 / mean:.4g} Hz at which probe {r.name} is sampled"
        raise InputError(f"{r.place}:{r.lines[0]}", rule, f"{frequency:g} Hz", f"Give less than {0.5 / mean:.4g}")
    sections = butter(2, 2 * frequency * mean, output="sos")
    return _along(r, lambda values: np.asarray(sosfiltfilt(sections, values, axis=0)))


def _with_rate(recordings: list[Recording], notes: list[str]) -> list[Recording]:
    done = [
        replace(r, rate=np.gradient(r.depth, r.time))
        if r.rate is None and r.depth is not None and r.time is not None
        else r
        for r in recordings
    ]
    if any(new is not old for new, old in zip(done, recordings, strict=True)):
        notes.append("rate of the depth differentiated from depth over time (central differences)")
    return done


def _from_touch(
    recordings: list[Recording], threshold: float, notes: list[str], exclusions: list[Exclusion]
) -> list[Recording]:
    done, before = [], 0
    for r in recordings:
        touch = _touch(_size(_force(r)), threshold)
        if touch == len(r):
            text = f"its force never stays at first_touch = {threshold:g} N or above"
            exclusions.append(left_out(r.name, r.place, int(r.lines[0]), text))
            continue
        before += touch
        r = _where(r, np.arange(len(r)) >= touch)
        done.append(r if r.depth is None else replace(r, depth=r.depth - r.depth[0]))
    text = f"depth counted from the first touch, where the force stays at {threshold:g} N or above"
    notes.append(f"{text}; {before} samples before it left out")
    return done


def _strong(
    recordings: list[Recording], least: float, notes: list[str], exclusions: list[Exclusion]
) -> list[Recording]:
    done = []
    for r in recordings:
        largest = _size(_force(r)).max()
        if largest >= least:
            done.append(r)
            continue
        text = f"its largest force is {largest:.4g} N, below min_force = {least:g} N"
        exclusions.append(left_out(r.name, r.place, int(r.lines[0]), text))
    weak = len(recordings) - len(done)
    notes.append(f"{weak} of {len(recordings)} probes left out as noise, their force staying below {least:g} N")
    return done


# --- parts of a recording ---------------------------------------------------------------------------------


def _along(r: Recording, act: Callable[[Real], Real], names: Sequence[str] = COURSES) -> Recording:
    """`r` with what it has of `names` put through `act`, which works along the first axis."""
    changed: dict[str, Any] = {name: act(_smooth(getattr(r, name))) for name in names if getattr(r, name) is not None}
    if "pose" in changed:
        changed["pose"][:, 3:] /= np.linalg.norm(changed["pose"][:, 3:], axis=1, keepdims=True)
    return replace(r, **changed)


def _smooth(values: Real) -> Real:
    """A pose with its quaternions in one half of their sphere, each next to the one before; others as they are."""
    if values.shape[1:] != (7,):
        return values
    turn = (values[1:, 3:] * values[:-1, 3:]).sum(axis=1) < 0
    sign = np.cumprod(np.append(1.0, np.where(turn, -1.0, 1.0)))
    return np.hstack([values[:, :3], values[:, 3:] * sign[:, None]])


def _where(r: Recording, rows: Flags) -> Recording:
    names = [name for name in ("lines", "time", *COURSES) if getattr(r, name) is not None]
    return replace(r, **{name: getattr(r, name)[rows] for name in names})


def _touch(force: Real, threshold: float) -> int:
    """First sample from which the force stays at or above a threshold; their number if there is none."""
    run = np.convolve(force >= threshold, np.ones(STAYS), mode="valid") == STAYS
    return int(np.argmax(run)) if run.any() else len(force)


def _force(r: Recording) -> Real:
    """The normal force or, without, the force vector."""
    return _vector(r) if r.force is None else r.force


def _size(force: Real) -> Real:
    return force if force.ndim == 1 else np.asarray(np.linalg.norm(force, axis=1))


def _vector(r: Recording) -> Real:
    assert r.force_vector is not None
    return r.force_vector


def _time(r: Recording) -> Real:
    assert r.time is not None
    return r.time


def _span(values: Sequence[float]) -> str:
    low, high = f"{min(values):.4g}", f"{max(values):.4g}"
    return low if low == high else f"{low} to {high}"
