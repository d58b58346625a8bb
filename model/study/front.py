"""What is worth choosing of configurations that differ in time and in error."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissue_contact.study.levers import Configuration, label_of

Keys = frozenset[tuple[str, Any]]

WORTH = 1.02  # an error that is less by a smaller factor is not worth a longer step
NOISE = 1.05  # times that differ by a smaller factor may be equal
RESOLVED = 3.0  # an error counts as known where it is so many times the difference of the two finest references


@dataclass(frozen=True)
class Point:
    """A configuration and what its run came to.

    Parameters
    ----------
    configuration : Configuration
    error : share of the reference, by measure; none of a refused run
    us : median time of a step in contact [µs], None of a refused run
    timed : whether that was taken natively and alone, or in Python while other runs went on
    substeps : most in one step
    balance : worst energy balance, as a share of the greatest work
    refusal : why the run ended early, empty where it did not
    """

    configuration: Configuration
    error: Mapping[str, float | None]
    us: float | None
    timed: bool = False
    substeps: int = 0
    balance: float = 0.0
    refusal: str = ""

    @property
    def label(self) -> str:
        """The configuration in words."""
        return label_of(self.configuration)

    def at(self, measure: str) -> tuple[float, float]:
        """Time [µs] and error, both infinite where the run was refused or has no such error."""
        error = self.error.get(measure)
        if self.us is None or error is None:
            return math.inf, math.inf
        return self.us, error


@dataclass(frozen=True, eq=False)
class Sweep:
    """Runs of one scenario in many configurations.

    Parameters
    ----------
    scenario : its name
    step : communication step [s]
    points : the first is the scene as it is
    convergence : errors of the reference's forerunner against the reference, by measure
    references : number of triangles of both against the scene's
    remarks : what the user should know, one line each
    """

    scenario: str
    step: float
    points: Sequence[Point]
    convergence: Mapping[str, float | None]
    references: tuple[float, float]
    remarks: Sequence[str]


def front(points: Sequence[Point], measure: str, slack: float = 1.0) -> list[Point]:
    """The points that no faster one beats in error, from the fastest to the most accurate.

    Errors count as equal within the factor `WORTH`, times within `NOISE`: of equal points the one with fewer changes
    stays. With `slack` also points that are beaten only by those that are less than so many times as fast.
    """
    found: list[Point] = []
    least: list[tuple[float, float]] = []  # time and error of what is worth more than all before it
    for point in sorted(points, key=lambda p: p.at(measure)):
        us, error = point.at(measure)
        if error == math.inf:
            continue
        if found and _replaces(point, found[-1], measure):
            found[-1] = point
        elif all(error * WORTH < e for u, e in least if u * slack <= us):
            found.append(point)
        # what is not worth its time must not hide what is, in small steps
        if not least or error * WORTH < least[-1][1]:
            least.append((us, error))
    return found


def _replaces(point: Point, other: Point, measure: str) -> bool:
    """Whether a point is as good as one that is a little faster, and has fewer changes."""
    (us, error), (before, off) = point.at(measure), other.at(measure)
    simpler = len(point.configuration) < len(other.configuration)
    return simpler and us <= NOISE * before and error <= WORTH * off


def promising(configurations: Iterable[Configuration], points: Sequence[Point], measure: str) -> list[Configuration]:
    """Configurations with the most promising first: by time times error, as if what every change alone made multiplied.

    Parameters
    ----------
    configurations : none of them tried
    points : of the scene as it is, the first, and of every change alone among others
    measure : str
    """
    cost = {p.configuration: math.prod(p.at(measure)) for p in points}
    whole = cost[()] if 0.0 < cost[()] < math.inf else 1.0  # a scene that is refused says nothing
    return sorted(configurations, key=lambda made: math.prod(cost[(option,)] / whole for option in made))


def unresolved(points: Sequence[Point], measure: str, convergence: Mapping[str, float | None]) -> list[Point]:
    """The points whose error the reference is not converged enough to tell."""
    limit = RESOLVED * (convergence[measure] or 0.0)  # None is of a measure that no point has an error of
    return [p for p in points if p.at(measure)[1] < limit]


def within_time(points: Sequence[Point], measure: str, us: float) -> list[Point]:
    """The front of the timed points that keep a time [µs], the most accurate first."""
    return front([p for p in points if p.timed and p.at(measure)[0] <= us], measure)[::-1]


def within_error(points: Sequence[Point], measure: str, error: float) -> list[Point]:
    """The timed points that keep an error, the fastest first."""
    return sorted((p for p in points if p.timed and p.at(measure)[1] <= error), key=lambda p: p.at(measure))


def advice(points: Sequence[Point], measure: str) -> str:
    """One sentence on what to choose: of what takes no longer and errs no more, the least time times error.

    The first of the points is the scene as it is.
    """
    own, best = points[0], front([p for p in points if p.timed], measure)
    us, error = own.at(measure)
    if not math.isfinite(us):
        if not best:
            return "Nothing that was tried ran to its end: change the scene."
        us, error = best[-1].at(measure)
        return (
            f"The scene as it is is refused: take {best[-1].label}, {us:,.0f} µs a step at {percent(error)} error of "
            f"the {measure}."
        )
    no_worse = [p for p in [own, *best] if p.at(measure)[0] <= us and p.at(measure)[1] <= WORTH * error]
    chosen = min(no_worse, key=lambda p: math.prod(p.at(measure)))
    as_it_is = f"{us:,.0f} µs a step at {percent(error)} error of the {measure}"
    if chosen is own:
        return f"Leave the scene as it is, {as_it_is}: nothing that was tried is as accurate and faster."
    found, off = chosen.at(measure)
    return (
        f"Take {chosen.label}: {found:,.0f} µs a step at {percent(off)} error of the {measure}; the scene as it is "
        f"takes {as_it_is}."
    )


def solver_settings(sweeps: Sequence[Sequence[Point]], measure: str, error: float) -> dict[str, Any] | None:
    """The solver's keys that were fastest in several scenarios and kept an error in every one of them.

    Parameters
    ----------
    sweeps : points of each scenario, that of the scene as it is first
    measure : str
    error : float
        Greatest error in the worst of the scenarios.

    Returns
    -------
    Keys and values of the scene's table `solver`, by the product of their times against the scene as it is; None
    where no settings were timed in all of the scenarios and kept the error.

    """
    shares: list[dict[Keys, float]] = []
    for points in sweeps:
        own = points[0].at(measure)[0]
        found = {}
        for point in within_error(points, measure, error):
            edits = [edit for option in point.configuration for edit in option.edits]
            if all(edit.key[0] == "solver" for edit in edits):
                found[frozenset((str(edit.key[1]), edit.value) for edit in edits)] = point.at(measure)[0] / own
        shares.append(found)

    def mean(keys: Keys) -> float:
        return float(np.prod([s[keys] for s in shares]))

    common: list[Keys] = [keys for keys in shares[0] if all(keys in s for s in shares)] if shares else []
    if not common:
        return None
    best = min(common, key=mean)
    return dict(sorted(best))


def percent(share: float) -> str:
    """A share in percent, to two digits."""
    return f"{100 * share:,.{0 if share >= 0.0995 else 1 if share >= 0.00995 else 2}f} %"
