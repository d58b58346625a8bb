"""Figures of the report on an identification, each small enough for the width of a phone."""

import base64
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image
from scipy.stats import norm

from tissue_contact.identify.recording import Real
from tissue_contact.identify.result import Result
from tissue_contact.identify.statistics import root_mean_square
from tissue_contact.identify.wording import laws, number, scoped, unit

SIZE = (4.0, 2.9)  # [inch] at 10 points: as wide as a phone
DOTS_PER_INCH = 170
SHADES = 48
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")  # of the laws, told apart by the colour-blind too
SHOWN = 6  # probes
DOTS = 4000  # at most in a figure
BINS = 12  # of the running median
GROUPS = 8  # regions at most, each with a row of its own
SHORT = 14  # letters of a region's name


@dataclass(frozen=True, eq=False)
class Curve:
    """Measured force of one probe and that of the fits."""

    label: str
    region: str
    x: Real  # shape [n]
    x_name: str  # "depth" or "time"
    unit: str  # of x, "m" or "s"
    measured: Real  # [N], shape [n]
    fitted: Mapping[str, Real]  # by law: the fit to all probes [N], shape [n]
    own: Mapping[str, Real]  # by law: the fit to this probe [N], may be empty

    def missed(self, law: str) -> Real:
        """Residual of the fit to all probes [N]."""
        return self.fitted[law] - self.measured

    def rmse(self, law: str) -> float:
        """Error of the fit to all probes [N]."""
        return root_mean_square(self.missed(law))


class Picture(NamedTuple):
    source: str  # the image itself, as an address
    alternative: str  # what it shows, for who cannot see it
    caption: str


def colours(result: Result) -> dict[str, str]:
    """Of each law."""
    return {law: COLOURS[k % len(COLOURS)] for k, law in enumerate(laws(result))}


def chosen_curves(curves: Sequence[Curve], law: str) -> list[tuple[str, Curve]]:
    """The curves worth a look: the worst, those about the median and the best fitted, with that word."""
    order = sorted((c for c in curves if law in c.fitted and len(c.x)), key=lambda c: (-c.rmse(law), c.label))
    if len(order) <= SHOWN:
        return [("", c) for c in order]
    part, middle = SHOWN // 3, len(order) // 2
    first = middle - part // 2
    groups = (("worst", order[:part]), ("median", order[first : first + part]), ("best", order[-part:]))
    return [(word, c) for word, group in groups for c in group]


def probe_pictures(result: Result, curves: Sequence[Curve]) -> list[Picture]:
    """Measured force of a few probes and what the fits make of it."""
    pictures = []
    for word, curve in chosen_curves(curves, result.chosen):
        axes = _axes()
        scale = _axis(axes, curve)
        for law, colour in colours(result).items():
            for fits, style in ((curve.fitted, "-"), (curve.own, "--")):
                if law in fits:
                    axes.plot(scale * curve.x, fits[law], style, color=colour, lw=1.3)
        axes.plot(scale * curve.x, curve.measured, "o", color="black", ms=3 if len(curve.x) < 100 else 1)
        axes.set_ylabel("force [N]")
        place = f"{curve.label}, {curve.region}" if curve.region else curve.label
        caption = f"{word}: {place}" if word else place
        pictures.append(
            Picture(
                _address(axes),
                f"Force over {curve.x_name}, measured and fitted, of probe {place}",
                f"{caption} (RMSE {number(curve.rmse(result.chosen))} N)",
            )
        )
    return pictures


def residual_pictures(result: Result, curves: Sequence[Curve]) -> list[Picture]:
    """Residuals over depth or time for each law, to the same scale."""
    pictures = []
    parts = {law: [c for c in curves if law in c.fitted] for law in laws(result)}
    missed = {law: np.concatenate([c.missed(law) for c in own]) for law, own in parts.items() if own}
    reach = 1.05 * max((float(np.abs(r).max(initial=0.0)) for r in missed.values()), default=0.0) or 1.0
    for law, residual in missed.items():
        x = np.concatenate([c.x for c in parts[law]])
        axes = _axes()
        scale = _axis(axes, parts[law][0])
        thin = slice(None, None, -(-len(x) // DOTS) or 1)
        axes.axhline(0.0, color="black", lw=0.8)
        axes.plot(scale * x[thin], residual[thin], ".", color=colours(result)[law], ms=3, alpha=0.4, mew=0)
        axes.plot(*_running_median(scale * x, residual), color="black", lw=1.5)
        axes.set_ylim(-reach, reach)
        axes.set_ylabel("fitted − measured [N]")
        what = f"Residuals of {law} over {parts[law][0].x_name}"
        pictures.append(Picture(_address(axes), f"{what}, with their running median", law))
    return pictures


def noise_pictures(result: Result, curves: Sequence[Curve]) -> list[Picture]:
    """Whether the residuals of the chosen law are normal."""
    own = [c.missed(result.chosen) for c in curves if result.chosen in c.fitted]
    residual = np.sort(np.concatenate(own)) if own else np.empty(0)
    n = len(residual)
    if n < 3 or not residual.std() > 0.0:
        return []
    mean, deviation, colour = residual.mean(), residual.std(), colours(result)[result.chosen]
    axes = _axes()
    axes.hist(residual, bins=40, density=True, color=colour, alpha=0.5)
    x = np.linspace(residual[0], residual[-1], 200)
    axes.plot(x, norm.pdf(x, mean, deviation), color="black", lw=1.2)
    axes.set_xlabel("fitted − measured [N]")
    axes.set_ylabel("density [1/N]")
    histogram = _address(axes)
    axes = _axes()
    normal = norm.ppf((np.arange(n) + 0.5) / n)
    thin = np.unique(np.r_[0 : n : -(-n // DOTS), n - 1])
    axes.axline((0.0, mean), slope=deviation, color="black", lw=1.2)
    axes.plot(normal[thin], residual[thin], ".", color=colour, ms=3)
    axes.set_xlabel("quantile of the normal distribution")
    axes.set_ylabel("residual [N]")
    return [
        Picture(histogram, f"Histogram of the residuals of {result.chosen}", "Histogram, normal curve"),
        Picture(_address(axes), f"Residuals of {result.chosen} against normal quantiles", "Normal quantiles"),
    ]


def spread_pictures(result: Result, regions: Mapping[str, str]) -> list[Picture]:
    """Each constant of the chosen law over the probes, by region; `regions` are those of the probes."""
    fits, pictures = scoped(result, "probe", result.chosen), []
    for k, pooled in enumerate(result.pooled(result.chosen).estimates):
        by_region: dict[str, list[float]] = {}
        for fit in fits:
            value = fit.estimates[k].value
            if value is not None and fit.estimates[k].verdict != "given":
                by_region.setdefault(regions.get(fit.label, ""), []).append(value)
        if sum(map(len, by_region.values())) < 2:
            continue
        if len(by_region) > GROUPS:
            by_region = {"": [v for values in by_region.values() for v in values]}
        axes = _axes()
        _strips(axes, by_region, pooled.value)
        axes.set_xlabel(f"{pooled.name} [{unit(pooled.unit)}]" if unit(pooled.unit) else pooled.name)
        alternative = f"Spread of {pooled.name} over the probes" + (", by region" if len(by_region) > 1 else "")
        pictures.append(Picture(_address(axes), alternative, pooled.name))
    return pictures


def _strips(axes: Axes, by_region: Mapping[str, Sequence[float]], pooled: float | None) -> None:
    """A dot a probe, one row a region, a box over the quartiles, a line at the pooled value."""
    names = sorted(by_region, reverse=True)
    every = np.concatenate([by_region[n] for n in names])
    if every.min() > 0.0 and every.max() > 20.0 * every.min():
        axes.set_xscale("log")
    for y, name in enumerate(names):
        values = np.asarray(by_region[name])
        shift = 0.25 * np.sin(np.arange(len(values)) * 2.4)  # no chance: the same result is the same picture
        axes.plot(values, y + shift, ".", color=COLOURS[0], ms=4, alpha=0.45, mew=0)
        low, middle, high = np.quantile(values, (0.25, 0.5, 0.75))
        axes.plot([low, high], [y, y], color="black", lw=1.5)
        axes.plot(middle, y, "o", color="white", mec="black", ms=5)
    if pooled is not None:
        axes.axvline(pooled, color=COLOURS[1], lw=1.2, ls="--")
    axes.set_yticks(range(len(names)), [n if len(n) <= SHORT else n[: SHORT - 1] + "…" for n in names])
    for text in axes.get_yticklabels():
        text.set_parse_math(False)  # a dollar in a name is a dollar
    axes.set_ylim(-0.6, len(names) - 0.4)


def _running_median(x: Real, y: Real) -> tuple[Real, Real]:
    order = np.argsort(x, kind="stable")
    parts = np.array_split(order, min(BINS, len(order)))
    return np.array([np.median(x[p]) for p in parts]), np.array([np.median(y[p]) for p in parts])


def _axis(axes: Axes, curve: Curve) -> float:
    """Label the axis of x; factor from its unit to that of the axis."""
    milli = curve.unit == "m"
    axes.set_xlabel(f"{curve.x_name} [{'mm' if milli else curve.unit}]")
    return 1e3 if milli else 1.0


def _axes() -> Axes:
    axes = Figure(figsize=SIZE, dpi=DOTS_PER_INCH, layout="constrained").subplots()
    axes.grid(alpha=0.25)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    return axes


def _address(axes: Axes) -> str:
    """The drawing itself as an address."""
    canvas = FigureCanvasAgg(axes.get_figure(root=True))
    canvas.draw()
    file = io.BytesIO()
    # A palette makes a line drawing a quarter of the size.
    Image.fromarray(np.asarray(canvas.buffer_rgba())[:, :, :3]).quantize(SHADES).save(file, "png", optimize=True)
    return "data:image/png;base64," + base64.b64encode(file.getvalue()).decode()
