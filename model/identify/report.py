"""The report on an identification: a page that is complete in itself, and a summary for the terminal."""

import importlib.resources
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jinja2 import Environment, StrictUndefined
from rich.box import SIMPLE_HEAD
from rich.console import Group, RenderableType
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from tissue_contact.files import publish
from tissue_contact.identify import figures, wording
from tissue_contact.identify.figures import Curve
from tissue_contact.identify.result import Fitted, Result
from tissue_contact.identify.wording import laws, number, scoped

__all__ = ["Curve", "summary", "write_report"]

QUARTILES = (0.0, 0.25, 0.5, 0.75, 1.0)
FILTERS = (number, wording.amount, wording.interval, wording.judged, wording.measure, wording.unit)


class _Spread(NamedTuple):
    """How a number differs between probes."""

    name: str
    unit: str
    probes: int  # that have it
    quartiles: tuple[float, ...]
    verdicts: str


def write_report(result: Result, curves: Sequence[Curve], path: Path) -> None:
    """Write the page, whole or not at all.

    Parameters
    ----------
    result
    curves
        Of all probes: a few are drawn, and the residuals of all.
    path
    """
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters.update({f.__name__: f for f in FILTERS})
    text = importlib.resources.files("tissue_contact.identify").joinpath("report.html").read_text("utf-8")
    regions = {c.label: c.region for c in curves}
    page = environment.from_string(text).render(
        result=result,
        pooled=result.pooled(result.chosen),
        others=[result.pooled(law) for law in laws(result)[1:]],
        cautions=wording.cautions(result),
        comparison=wording.comparison(result),
        exponent_note=wording.exponent_note(result),
        laws=laws(result),
        measures=_measures(result) + _course(result),
        correlated=_correlated(result.pooled(result.chosen)),
        by_region={law: scoped(result, "region", law) for law in laws(result)},
        by_probe={law: scoped(result, "probe", law) for law in laws(result)},
        spreads={law: _spreads(scoped(result, "probe", law)) for law in laws(result)},
        regions=regions,
        colours=figures.colours(result),
        probe_pictures=figures.probe_pictures(result, curves),
        residual_pictures=figures.residual_pictures(result, curves),
        noise_pictures=figures.noise_pictures(result, curves),
        spread_pictures=figures.spread_pictures(result, regions),
    )
    publish(path, page.encode())


def _measures(result: Result) -> list[tuple[str, list[str]]]:
    """How well the laws fit: what is measured, and its value for each law."""
    pooled, unseen = [result.pooled(law) for law in laws(result)], {h.law: h for h in result.held_out}
    held = [unseen.get(law) for law in laws(result)]
    least = min(f.aic for f in pooled)
    rows = [
        ("R², fitted data", [_share(f.r2) for f in pooled]),
        ("RMSE, fitted data [N]", [number(f.rmse) for f in pooled]),
        ("R², held-out data", [_share(h.r2) if h else "–" for h in held]),
        ("RMSE, held-out data [N]", [number(h.rmse) if h else "–" for h in held]),
        ("AIC", [f"{f.aic:,.1f}".replace("-", "−") for f in pooled]),
        ("AIC above the least", [f"{f.aic - least:,.1f}" for f in pooled]),
    ]
    return [row for row in rows if result.held_out or "held-out" not in row[0]]


def _course(result: Result) -> list[tuple[str, list[str]]]:
    """How the fits went."""
    pooled = [result.pooled(law) for law in laws(result)]
    return [
        ("Correlation of neighbouring residuals", [f"{f.autocorrelation:.2f}".replace("-", "−") for f in pooled]),
        ("Evaluations", [f"{f.evaluations:,}" for f in pooled]),
        ("Converged", ["yes" if f.converged else "no" for f in pooled]),
    ]


def _correlated(fit: Fitted) -> list[str]:
    """Names of the rows of the correlation matrix."""
    return [e.name for e in fit.estimates if e.value is not None and e.verdict != "given"]


def _share(r2: float | None) -> str:
    return "–" if r2 is None else f"{r2:.3f}".replace("-", "−")


def _spreads(fits: Sequence[Fitted]) -> list[_Spread]:
    """Of each constant and of the error, over probes."""
    if not fits:
        return []
    spreads = []
    for same in zip(*(f.estimates for f in fits), strict=True):
        spreads.append(
            _spread(same[0].name, wording.unit(same[0].unit), [e.value for e in same], wording.verdicts(same))
        )
    spreads.append(_spread("RMSE", "N", [f.rmse for f in fits]))
    spreads.append(_spread("R²", "", [f.r2 for f in fits]))
    return spreads


def _spread(name: str, unit: str, values: Sequence[float | None], verdicts: str = "") -> _Spread:
    known = [v for v in values if v is not None]
    quartiles = tuple(float(q) for q in np.quantile(known, QUARTILES)) if known else ()
    return _Spread(name, unit, len(known), quartiles, verdicts)


def summary(result: Result) -> RenderableType:
    """The chosen constants and the comparison of the laws, for a terminal."""
    constants = _table(f"{result.chosen}: constants", ["", "value ± error", "95 % interval", "verdict"])
    for e in result.pooled(result.chosen).estimates:
        value = f"{wording.measure(e)} {wording.unit(e.unit) if e.value is not None else ''}"
        constants.add_row(*map(Text, (e.name, value, wording.interval(e), wording.judged(e))))
    fits = _table("fits to all probes together", ["", *laws(result)])
    for name, cells in _measures(result):
        fits.add_row(name, *cells)
    cautions = [Text(f"Warning: {c}", "yellow") for c in wording.cautions(result)]
    return Group(constants, *cautions, fits, *map(Text, wording.comparison(result)))


def _table(title: str, heads: Sequence[str]) -> Table:
    return Table(
        *map(escape, heads),
        title=Text(title, "bold"),
        title_justify="left",
        box=SIMPLE_HEAD,
        show_edge=False,
        pad_edge=False,
    )
