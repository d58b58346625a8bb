"""What a run leaves: its rows, the figures drawn from them, and whether they keep the expectations."""

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_contact.errors import InputError
from tissue_contact.files import publish
from tissue_contact.scenarios.scenario import Expectation
from tissue_contact.settings import nearest

FloatArray = NDArray[np.float64]


@dataclass(eq=False)
class Trace:
    """Rows of a run, one for each communication point; filled one after the other, so that it may end early.

    Parameters
    ----------
    time : float64 [s], shape (n,)
    names, units : of the columns
    values : float64, shape (n, columns)
    step_time : float64 [s]
        Time that the FMU took for the step that led to a row, shape (n,); 0 for the first row.
    done : int
        Rows that are filled.

    """

    time: FloatArray
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: FloatArray
    step_time: FloatArray
    done: int = 0

    def column(self, name: str) -> FloatArray:
        """The filled rows of one column, shape (done,). KeyError when there is none of that name."""
        if name not in self.names:
            raise KeyError(name)
        return self.values[: self.done, self.names.index(name)]

    def vector(self, name: str) -> FloatArray:
        """The filled rows of `name[1]` to `name[3]`, shape (done, 3)."""
        return np.column_stack([self.column(f"{name}[{k}]") for k in (1, 2, 3)])

    def unit(self, name: str) -> str:
        """Unit of one column."""
        return self.units[self.names.index(name)]


def write_csv(trace: Trace, path: Path) -> None:
    """Write the filled rows, all of the file or nothing; every number reads back as the same."""
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    titles = [f"{name} [{unit}]" for name, unit in zip(trace.names, trace.units, strict=True)]
    writer.writerow(["time [s]", *titles])
    rows = np.column_stack([trace.time[: trace.done], trace.values[: trace.done]])
    writer.writerows(rows.tolist())
    publish(path, text.getvalue().encode())


# --- expectations -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Verdict:
    """One expectation, what came out, and whether it holds.

    Parameters
    ----------
    expectation : Expectation
    value : float
        The statistic, in `unit`.
    unit : str
    whole : float
        What the bounds are shares of, in `unit`; 1 where they are no shares.

    """

    expectation: Expectation
    value: float
    unit: str
    whole: float = 1.0

    @property
    def holds(self) -> bool:
        """Whether the value lies within the bounds; NaN never does. Nothing is within any share of nothing."""
        low, high = self.expectation.at_least, self.expectation.at_most
        return (low is None or self.value >= low * self.whole) and (high is None or self.value <= high * self.whole)

    @property
    def bounds(self) -> str:
        """The bounds in words."""
        low, high = self.expectation.at_least, self.expectation.at_most
        if low == high:
            return f"exactly {low:g}{self._measure}"
        if low is None:
            return f"at most {high:g}{self._measure}"
        return f"at least {low:g}{self._measure}" if high is None else f"{low:g} to {high:g}{self._measure}"

    @property
    def found(self) -> str:
        """The value in words, measured like the bounds."""
        if not self.expectation.of or self.whole == 0:
            return f"{self.value:.6g}{_unit(self.unit)}"
        return f"{self.value / self.whole:.3g}{self._measure}"

    @property
    def told(self) -> str:
        """What was found beside what was wanted."""
        e = self.expectation
        return f"{e.statistic} of {e.output} is {self.found}; wanted {self.bounds}"

    @property
    def _measure(self) -> str:
        return f" of {self.expectation.of}" if self.expectation.of else _unit(self.unit)


def _unit(unit: str) -> str:
    return "" if unit == "1" else f" {unit}"


def check_names(expectations: Sequence[Expectation], names: Sequence[str], place: str) -> None:
    """Refuse expectations on outputs that are not there, with InputError; `place` is the scenario file."""
    for i, expectation in enumerate(expectations):
        for key in ("output", "of"):
            name = getattr(expectation, key)
            if name and name not in names:
                here, rule = f"{place}, expect[{i}].{key}", "the FMU must have the output"
                raise InputError(here, rule, f'"{name}"', nearest(name, names, what="outputs"))


def judge(expectations: Sequence[Expectation], trace: Trace) -> list[Verdict]:
    """Hold the filled rows against the expectations, whose outputs must exist."""
    statistics: dict[str, Callable[[FloatArray], Any]] = {
        "max": np.max,
        "min": np.min,
        "mean": np.mean,
        "final": lambda values: values[-1],
        "peak": lambda values: np.max(np.abs(values)),
    }
    return [
        Verdict(
            e,
            float(statistics[e.statistic](trace.column(e.output))),
            trace.unit(e.output),
            float(statistics["peak"](trace.column(e.of))) if e.of else 1.0,
        )
        for e in expectations
    ]


# --- figures in the summary -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Summary:
    """What a run comes to: forces [N], depths [m], times [s], energies [J]; None where the scene has none.

    Parameters
    ----------
    peak_force, peak_time, deepest, contact_time : of each instrument and each rigid body, by name
    leader : the instrument that met the greatest force, None when nothing was touched
    held : most tissue vertices that each grasper held, by name
    balance, work : energy that is unaccounted for, at its worst; greatest magnitude of the instruments' work
    step_median, step_tail, step_max : time that the FMU took for a step; the tail is the 99.9th percentile
    real_time_factor : simulated time over the time that its steps took

    """

    peak_force: dict[str, float]
    peak_time: dict[str, float]
    deepest: dict[str, float]
    contact_time: dict[str, float]
    leader: str | None
    held: dict[str, int]
    balance: float | None
    work: float | None
    step_median: float
    step_tail: float
    step_max: float
    real_time_factor: float


def summarise(trace: Trace) -> Summary:
    """Summary of the filled rows; at least one step must have been done."""
    names = [n.removesuffix(".depth") for n in trace.names if n.endswith(".depth")]
    peak_force, peak_time, deepest, contact_time = {}, {}, {}, {}
    step = np.diff(trace.time[: trace.done])
    for name in names:
        force = np.linalg.norm(trace.vector(f"{name}.force"), axis=1)
        depth = trace.column(f"{name}.depth")
        peak_force[name] = float(force.max())
        peak_time[name] = float(trace.time[force.argmax()])
        deepest[name] = float(depth.max())
        contact_time[name] = float(step[(depth > 0)[1:]].sum())
    instruments = {name: peak_force[name] for name in names if f"{name}.position[1]" in trace.names}
    leader = max(instruments, key=lambda name: instruments[name], default=None)
    graspers = [n.removesuffix(".grasped") for n in trace.names if n.endswith(".grasped")]
    energy = "energy.balance" in trace.names and "energy.work" in trace.names
    taken = trace.step_time[1 : trace.done]
    return Summary(
        peak_force=peak_force,
        peak_time=peak_time,
        deepest=deepest,
        contact_time=contact_time,
        leader=leader if leader is not None and peak_force[leader] > 0 else None,
        held={name: int(trace.column(f"{name}.grasped").max()) for name in graspers},
        balance=float(max(trace.column("energy.balance"), key=abs)) if energy else None,
        work=float(np.abs(trace.column("energy.work")).max()) if energy else None,
        step_median=float(np.median(taken)),
        step_tail=float(np.percentile(taken, 99.9)),
        step_max=float(taken.max()),
        real_time_factor=float(step.sum() / taken.sum()),
    )
