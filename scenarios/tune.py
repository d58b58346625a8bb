"""A scene file with the configuration of a sweep that keeps a time or an error, measured once more."""

import math
import os
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from tissue_contact.edits import Edit, edited
from tissue_contact.errors import InputError, WorkError
from tissue_contact.files import publish
from tissue_contact.scenarios.scenario import Scenario
from tissue_contact.scenarios.trade import (
    Measured,
    Request,
    built,
    follow,
    job_of,
    measured,
    median_of,
    point_of,
    step_times,
)
from tissue_contact.scene import Scene, parse_scene
from tissue_contact.study.front import Point, percent, within_error, within_time
from tissue_contact.study.levers import Configuration, things


@dataclass(frozen=True)
class Wish:
    """What a configuration must keep: a time of a step in contact [µs], or an error; one of the two is given."""

    us: float = math.inf
    error: float = math.inf

    @classmethod
    def of(cls, us: float | None, error: str | None) -> "Wish":
        """From the words of the command line: an error is 1% or 0.01. Raises InputError."""
        if (us is None) == (error is None):
            found = "neither" if us is None else "both"
            raise InputError("--budget-us, --error", "exactly one of the two must be given", found, "Give one of them")
        if us is not None:
            return cls(us=us)
        assert error is not None
        try:
            share = float(error.removesuffix("%")) / (100.0 if error.endswith("%") else 1.0)
        except ValueError:
            share = math.nan
        if not 0.0 < share < math.inf:
            rule = "the error must be a positive share of the reference"
            raise InputError("--error", rule, error, "Write for instance 1% or 0.01")
        return cls(error=share)

    @property
    def text(self) -> str:
        """The wish in words."""
        return f"at most {self.us:g} µs" if self.us < math.inf else f"an error of at most {percent(self.error)}"

    def candidates(self, points: Sequence[Point], measure: str) -> list[Point]:
        """The points that keep it, the best first."""
        if self.us < math.inf:
            return within_time(points, measure, self.us)
        return within_error(points, measure, self.error)

    def keeps(self, point: Point, measure: str) -> bool:
        """Whether a point keeps it."""
        us, error = point.at(measure)
        return us <= self.us and error <= self.error


def tune(scenario: Scenario, data: Path, request: Request, wish: Wish, output: Path, overwrite: bool = False) -> Point:
    """Sweep as `trade` does, choose, measure the choice anew and write a scene file with it.

    Parameters
    ----------
    scenario : Scenario
    data : folder that keeps the runs of the sweep
    request : Request
    wish : what is to be kept
    output : scene file to write
    overwrite : whether that may be the scenario's own

    Raises
    ------
    InputError
        As `trade`; the output is the scenario's own scene.
    WorkError
        As `trade`; nothing that was tried keeps the wish.
    Interrupted
        As `trade`.
    """
    own = Path(scenario.scene.place)
    if output.exists() and output.samefile(own) and not overwrite:
        way_out = "Choose another name, or add --overwrite"
        raise InputError("--output", "the scene that is tuned must not be overwritten unasked", output, way_out)
    found, console = measured(scenario, data, request), Console()
    for remark in found.sweep.remarks:
        console.print(remark, highlight=False, markup=False)
    candidates = wish.candidates(found.sweep.points, request.measure)
    for point, again in _checked(scenario, found, request, candidates):
        told = _told(again, request.measure)
        if wish.keeps(again, request.measure):
            break
        console.print(f"Measured anew, {point.label} has {told}: trying the next best.", highlight=False, markup=False)
    else:
        raise WorkError(f"nothing that was tried keeps {wish.text}. {_best(found, request.measure, wish)}")
    comment = (
        f"Chosen by tissue-contact tune for {wish.text} in the scenario {scenario.name}: {again.label}.",
        f"Measured: {told}; the scene before had {_told(found.sweep.points[0], request.measure)}.",
    )
    publish(output, written(scenario.scene, again.configuration, output, comment))
    console.print(f"{again.label}: {told}", style="bold", highlight=False, markup=False)
    console.print(f"wrote {output}", highlight=False, markup=False, soft_wrap=True)
    return again


def _checked(
    scenario: Scenario, found: Measured, request: Request, candidates: Sequence[Point]
) -> Iterator[tuple[Point, Point]]:
    """Each point with what it comes to when it is run and timed anew."""
    for point in candidates:
        edits = [edit for option in point.configuration for edit in option.edits]
        job = job_of(scenario, edited(scenario.scene, edits))
        result = follow(job)
        us: float | str | None = None
        if not result["refusal"]:
            with tempfile.TemporaryDirectory() as name:
                fmu = built(job, Path(name))
                us = median_of([step_times(fmu, job) for _ in range(request.rounds)])
        yield point, point_of(point.configuration, result, found.true, found.sweep.convergence, job.steps, us)


def _told(point: Point, measure: str) -> str:
    us, error = point.at(measure)
    return f"{us:,.1f} µs a step in contact, error of the {measure} {percent(error)}" if us < math.inf else "a refusal"


def _best(found: Measured, measure: str, wish: Wish) -> str:
    """What comes nearest to a wish that nothing keeps."""
    points = [p for p in found.sweep.points if p.timed]
    if not points:
        return "Every run was refused"
    best = min(points, key=lambda p: p.at(measure) if wish.us < math.inf else p.at(measure)[::-1])
    kind = "fastest" if wish.us < math.inf else "most accurate"
    return f"The {kind} is {best.label}, with {_told(best, measure)}"


def written(scene: Scene, configuration: Configuration, output: Path, comment: Sequence[str]) -> bytes:
    """Scene file of a configuration, a comment before it, and mesh paths as they are seen from where it will lie."""
    edits = [edit for option in configuration for edit in option.edits]
    here = output.resolve().parent
    for kind, i, thing in things(scene):
        if thing.mesh is not None and not Path(thing.mesh).is_absolute():
            mesh = os.path.relpath((scene.folder / thing.mesh).resolve(), here)
            edits.append(Edit((kind, i, "mesh"), Path(mesh).as_posix()))
    text = "".join(f"# {line}\n" for line in comment).encode() + edited(scene, edits)
    parse_scene(text, here, str(output))  # what is written can be read
    return text
