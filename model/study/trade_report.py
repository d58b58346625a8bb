"""A sweep as a table, a CSV, a figure and raw data."""

import csv
import io
import json
from textwrap import shorten
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator
from rich.box import SIMPLE
from rich.table import Table

from tissue_contact.study.deviation import MEASURES
from tissue_contact.study.front import Point, Sweep, advice, front, percent
from tissue_contact.study.levers import LEVERS

DOTS_PER_INCH = 130


def ordered(sweep: Sweep, measure: str) -> list[Point]:
    """The points from the fastest to the slowest, those that were refused last."""
    return sorted(sweep.points, key=lambda p: p.at(measure))


def table(sweep: Sweep, measure: str) -> Table:
    """For the screen: the front, the scene as it is, what was refused; numbers are those of the figure and the CSV."""
    best = front([p for p in sweep.points if p.timed], measure)
    shown = Table(
        *("", "configuration", "µs", *MEASURES, "balance"),
        title=f"{sweep.scenario}: error against the reference, µs a step of {1e3 * sweep.step:g} ms",
        box=SIMPLE,
        padding=(0, 1, 0, 0),
    )
    for n, point in enumerate(ordered(sweep, measure), 1):
        if point.refusal:
            shown.add_row(
                f"{n}", f"{point.label}: refused, {shorten(point.refusal, 60, placeholder=' …')}", style="dim"
            )
        elif point in best or not point.configuration:
            errors = [_cell(point.error.get(m)) for m in MEASURES]
            assert point.us is not None
            shown.add_row(f"{n}", point.label, f"{point.us:,.0f}", *errors, percent(point.balance))
    shown.add_section()
    low, high = sweep.references
    differences = [_cell(sweep.convergence[m]) for m in MEASURES]
    shown.add_row("", f"reference, {low:g} against {high:g} times the triangles", "", *differences, style="dim")
    beaten = sum(not p.refusal and p not in best for p in sweep.points)
    shown.caption = f"The front, the scene as it is, what was refused. {beaten} are beaten."
    return shown


def _cell(error: float | None) -> str:
    return "–" if error is None else percent(error)


def csv_text(sweep: Sweep, measure: str) -> str:
    """The points as CSV, one column for each lever and each error."""
    best = front([p for p in sweep.points if p.timed], measure)
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    columns = [f"error of {m} [1]" for m in MEASURES]
    writer.writerow(
        ["number", "front", *LEVERS, "time [us]", "timed alone", *columns, "substeps", "balance [1]", "refusal"]
    )
    for n, p in enumerate(ordered(sweep, measure), 1):
        levers = {o.lever: o.label for o in p.configuration}
        writer.writerow([
            n, int(p in best), *(levers.get(lever, "") for lever in LEVERS), p.us, int(p.timed),
            *(p.error.get(m) for m in MEASURES), p.substeps, p.balance, p.refusal,
        ])  # fmt: skip
    return text.getvalue()


def raw(sweep: Sweep, measure: str) -> bytes:
    """Everything as JSON; errors and balance are shares, times in µs."""
    best = front([p for p in sweep.points if p.timed], measure)
    points = [
        {
            "number": n,
            "label": p.label,
            "front": p in best,
            "levers": {o.lever: o.label for o in p.configuration},
            "edits": [[list(e.key), e.value] for o in p.configuration for e in o.edits],
            "us": _short(p.us),
            "timed": p.timed,
            "error": {m: _short(e) for m, e in p.error.items()},
            "substeps": p.substeps,
            "balance": _short(p.balance),
            "refusal": p.refusal,
        }
        for n, p in enumerate(ordered(sweep, measure), 1)
    ]
    whole: dict[str, Any] = {
        "scenario": sweep.scenario,
        "step": sweep.step,
        "measure": measure,
        "references": sweep.references,
        "convergence": {m: _short(e) for m, e in sweep.convergence.items()},
        "remarks": list(sweep.remarks),
        "advice": advice(sweep.points, measure),
        "points": points,
    }
    return (json.dumps(whole, indent=1, ensure_ascii=False) + "\n").encode()


def _short(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.5g}")


def figure(sweep: Sweep, measure: str) -> bytes:
    """Time of a step against error, the front marked and named, as PNG."""
    rows = {n: p for n, p in enumerate(ordered(sweep, measure), 1) if not p.refusal and p.at(measure)[1] > 0.0}
    best = front([p for p in sweep.points if p.timed], measure)
    drawn = Figure(figsize=(11, 6), layout="constrained")
    FigureCanvasAgg(drawn)
    axes = drawn.subplots()
    names = []
    for n, p in rows.items():
        us, error = p.at(measure)
        on, own = p in best, not p.configuration
        colour = "#d95f02" if on else "0.6"
        full = colour if p.timed else "none"
        axes.plot(us, 100 * error, "D" if own else "o", mec="black" if own else colour, mfc=full,
                  ms=7 if on or own else 4, zorder=3 if on else 2)  # fmt: skip
        axes.annotate(str(n), (us, 100 * error), xytext=(5, 4), textcoords="offset points",
                      fontsize=9 if on else 6, color="black" if on else "0.5", zorder=4)  # fmt: skip
        if on or own:
            names.append(f"{n}  {p.label}")
    line = [(us, 100 * error) for us, error in (p.at(measure) for p in best) if error > 0.0]
    if line:
        axes.step(*zip(*line, strict=True), where="post", color="#d95f02", lw=1.0, zorder=1, label="front")
    converged = 100 * (sweep.convergence[measure] or 0.0)
    axes.axhline(converged, color="#4477aa", lw=1.0, ls="--", label="difference of the two finest references")
    axes.plot([], [], "D", color="none", mec="black", label="the scene as it is")
    axes.plot([], [], "o", color="0.6", mfc="none", ms=4, label="timed among others, too slow for the front")
    axes.set(xscale="log", yscale="log", xlabel=f"step of {1e3 * sweep.step:g} ms in contact, median [µs]",
             ylabel=f"error of the {measure} [%]", title=sweep.scenario)  # fmt: skip
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=20))
        axis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:,.10g}"))
        axis.set_minor_locator(LogLocator(subs="all", numticks=20))
        axis.set_minor_formatter("")
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(loc="best", frameon=False, fontsize=8)
    drawn.text(1.0, 0.5, "\n".join(names), ha="left", va="center", fontsize=8)
    file = io.BytesIO()
    drawn.savefig(file, format="png", dpi=DOTS_PER_INCH, facecolor="white", bbox_inches="tight",
                  metadata={"Software": None})  # fmt: skip
    return file.getvalue()
