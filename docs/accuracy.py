"""Write the tables and the figure of docs/accuracy.md from build/accuracy.json: `python docs/accuracy.py`.

What the tables hold is kept beside the page, in docs/data/accuracy.json; tests/test_accuracy.py fails when the page
does not say the same.
"""

import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from pages import filled, table

from tissue_contact.scenarios import accuracy

DOCS = Path(__file__).parent
PAGE, DATA, FIGURE = DOCS / "accuracy.md", DOCS / "data" / "accuracy.json", DOCS / "images" / "accuracy.png"
MEASURED = DOCS.parent / "build" / "accuracy.json"

CASES = [name for name in accuracy.CASES if name != "late"]
ROWS = {name: f"`{name}`" for name in accuracy.RESPONSES} | {
    "hull, raw pairs": '`hull`, `pair_weight = "none"`',
    "distance_field, coarse": "`distance_field`, 1,500 triangles",
    "hull, coarse": "`hull`, 1,500 triangles",
}
RESTLESS = 0.1  # of the work, an energy balance above which a run is said to chatter
SHOWN = {"oobb": ("#f4c7a1", 0.7), "hull": ("#4477aa", 1.4), "distance_field": ("#1b9e77", 1.4)}  # from the lowest up
COLOURS = dict(
    zip(
        accuracy.RESPONSES,
        ("#1b9e77", "#4477aa", "#984ea3", "#c77cff", "#e7298a", "#d95f02", "#a6761d", "#444444"),
        strict=True,
    )
)

Found = Mapping[str, Any]


# --- cells ------------------------------------------------------------------------------------------------


def percent(share: float, sign: bool = False) -> str:
    """Two digits, as a percentage."""
    value = 100 * share
    if abs(value) >= 1000:
        return f"{value / 100:{'+' if sign else ''}.0f} ×".replace("-", "−")
    digits = 0 if abs(value) >= 10 else 1 if abs(value) >= 1 else 2
    return f"{value:{'+' if sign else ''}.{digits}f} %".replace("-", "−")


def error(run: Found | None) -> str:
    """Error over the run and of the peak; what was refused, and what chatters, is said."""
    if run is None:
        return ""
    if "refused at" in run:
        return f"refused at {1e3 * run['refused at']:.0f} ms"
    cell = f"{percent(run['error'])}, {percent(run['peak error'], sign=True)}"
    return f"*{cell}*" if run["balance"] > RESTLESS else cell


# --- tables -----------------------------------------------------------------------------------------------


def errors_table(data: Found) -> str:
    """Every response in every motion."""
    rows = [[text, *(error(data["runs"].get(f"{case}, {name}")) for case in CASES)] for name, text in ROWS.items()]
    return table(["Response", *CASES], rows)


def cost_table(data: Found) -> str:
    """What a step costs, and how well energy is kept."""
    rows, field = [], data["us"]["distance_field"]
    for name, text in ROWS.items():
        found = [data["runs"].get(f"{case}, {name}") for case in CASES]
        us = data["us"].get(name)
        cost = ["", ""] if us is None else [f"{us:,.0f}", f"{us - field:+,.0f}".replace("-", "−")]
        balance = [percent(run["balance"]) if run else "" for run in found]
        rows.append([text, *cost, f"{found[0]['substeps']:.0f}" if found[0] else "", *balance])
    return table(["Response", "µs a step", "more than the field", "Substeps", *CASES], rows)


def late_table(data: Found) -> str:
    """Continuous detection, and what becomes of a fast press with discrete detection, at the worst moment."""
    rows = []
    for name in accuracy.RESPONSES:
        cells = [error(data["runs"].get(f"late, {name}, continuous"))]
        for rate in accuracy.DISCRETE:
            found = [data["runs"].get(f"late, {name}, {rate}, {delay}") for delay in accuracy.DELAYS]
            there = [run for run in found if run is not None]
            refused = [run for run in there if "refused at" in run]
            cells.append(error(refused[0] if refused else max(there, key=lambda run: run["error"], default=None)))
        rows.append([ROWS[name], *cells])
    return table(["Response", "continuous", *accuracy.DISCRETE], rows)


def reference_table(data: Found) -> str:
    """How far coarser meshes are from the reference."""
    cases, rows = list(accuracy.CASES), []
    for n in accuracy.MESHES[:-1]:
        runs = [data["runs"].get(f"{case}, reference, {n}") for case in cases]
        rows.append([f"{n:,}", *("" if run is None else percent(run["error"]) for run in runs)])
    return table(["Triangles", *cases], rows)


def step_table(data: Found) -> str:
    """The reference's error by its number of substeps, on the sheet of 24,000 triangles."""
    rows = []
    for name in ("press", "poke"):
        runs = [data["runs"].get(f"{name}, reference, 24000, {n} substeps") for n in (40, 80, 320)]
        runs.insert(2, data["runs"].get(f"{name}, reference, 24000"))
        rows.append([name, *(f"{run['peak']:.4f} N" if run else "" for run in runs)])
    return table(["Peak force", "40 substeps a step", "80", "160", "320"], rows)


def stiffness_table(data: Found) -> str:
    """Presses with other stiffness and detection."""
    rows = []
    for name, text in (
        ("reference, 24000", "field, 2e8 N/m³, 24,000 triangles"),
        ("distance_field, 8e8", "field, 8e8 N/m³, 24,000 triangles"),
        ("hull", "`hull`, 400 N/m"),
        ("hull, 4 times as stiff", "`hull`, 1,600 N/m"),
        ("kdop 14", "`kdop 14`, 400 N/m"),
        ("kdop 14, a quarter as stiff", "`kdop 14`, 100 N/m"),
        ("kdop 14, every substep", "`kdop 14`, 400 N/m, detection in every substep"),
        ("oobb", "`oobb`, 400 N/m"),
        ("oobb, a quarter as stiff", "`oobb`, 100 N/m"),
        ("oobb, every substep", "`oobb`, 400 N/m, detection in every substep"),
    ):
        run = data["runs"].get(f"press, {name}")
        if run is not None:
            figures = [f"{run['end']:.4f} N", f"{1e3 * run['depth']:.2f} mm", percent(run["balance"])]
            rows.append([text, error(run), *figures])
    return table(["Press", "Error, of the peak", "Held force", "Depth", "Energy balance"], rows)


def meshes_table(data: Found) -> str:
    """Settled force on a coarse and a fine mesh of one organ."""
    rows = []
    for name, entry in data["meshes"].items():
        organ, study = name.split(", ", 1)
        meshes = {mesh: np.array(force) for mesh, force in entry["forces"].items()}
        coarse, *between, fine = meshes.values()
        steps = [coarse / fine, coarse / between[0], between[0] / fine] if between else [coarse / fine]
        change = [np.abs(step - 1.0) for step in steps]
        cells = [f"{percent(float(np.median(c)))}, {percent(c.max())}" for c in change]
        told = entry["study"]
        rows.append(
            [
                f"{organ}, {study}",
                f"{1e3 * told['radius']:.0f} mm",
                f"{1e3 * told['depth']:.0f} mm",
                percent(told["preload"]) if told["preload"] else "none",
                f"{told['support']:.0e} N/m³".replace("e+0", "e"),
                f"{fine.min():.2f} to {fine.max():.2f} N",
                *cells,
                *[""] * (3 - len(cells)),
            ]
        )
    headings = ["Organ", "Tip radius", "Depth", "Stretch", "Support", "Force on the fine mesh", "Coarse to fine",
                "coarse to cut", "cut to fine"]  # fmt: skip
    return table(headings, rows)


TABLES = {
    "errors": errors_table,
    "cost": cost_table,
    "late": late_table,
    "reference": reference_table,
    "step": step_table,
    "stiffness": stiffness_table,
    "meshes": meshes_table,
}


def page_of(page: str, data: Found) -> str:
    """The page with its tables made anew."""
    return filled(page, {name: made(data) for name, made in TABLES.items()})


# --- figure -----------------------------------------------------------------------------------------------


def figure(kept: Found, data: Found) -> bytes:
    """Force over time in two motions, and error against cost, as PNG."""
    drawn = Figure(figsize=(9.5, 8.5), layout="constrained")
    FigureCanvasAgg(drawn)
    above, below = drawn.subfigures(2, 1, height_ratios=[3, 4])
    over_time(above, kept)
    against_cost(below, data)
    for axes in drawn.axes:
        axes.grid(alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
    file = io.BytesIO()
    drawn.savefig(file, format="png", dpi=130, facecolor="white", metadata={"Software": None})
    return file.getvalue()


def over_time(part: Any, kept: Found) -> None:
    """Force of the reference and of three responses."""
    reference = f"reference, {accuracy.CONVERGED}"
    for axes, case in zip(part.subplots(1, 2), ("press", "slide"), strict=True):
        for layer, (name, (colour, width)) in enumerate(SHOWN.items()):
            force = np.linalg.norm(np.array(kept["runs"][f"{case}, {name}"]["force"]), axis=1)
            time = 1e3 * accuracy.STEP * np.arange(len(force))
            axes.plot(time, force, color=colour, lw=width, zorder=layer, label=name)
        force = np.linalg.norm(np.array(kept["runs"][f"{case}, {reference}"]["force"]), axis=1)
        axes.plot(time, force, color="black", lw=1.2, ls=(0, (4, 3)), zorder=len(SHOWN), label="reference")
        axes.set_ylim(0.0, 2.0 * force.max())
        axes.set(title=f"{case}, capsule", xlabel="time [ms]", ylabel="force [N]", xlim=(time[0], time[-1]))
    part.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)


def against_cost(part: Any, data: Found) -> None:
    """Error over the run of every response in every motion, over the time of a step, by sheet."""
    panels = part.subplots(1, 2, sharey=True, width_ratios=[1, 3])
    marks = dict(zip(CASES, "osd^vX", strict=True))
    for panel, coarse in zip(panels, (True, False), strict=True):
        for name, us in data["us"].items():
            response, colour = name.removesuffix(", coarse"), COLOURS[name.removesuffix(", coarse")]
            runs = {case: data["runs"][f"{case}, {name}"] for case in CASES if (response != name) == coarse}
            for case, run in runs.items():
                full = colour if run["balance"] <= RESTLESS else "none"
                panel.plot(us, 100 * run["error"], marks[case], color=colour, mfc=full, ms=7)
        triangles = accuracy.COARSE if coarse else accuracy.COMPARED
        panel.set(yscale="log", xlabel="step of 1 ms [µs]", title=f"{triangles:,} triangles")
        panel.margins(x=0.25 if coarse else 0.08)
    panels[0].set_ylabel("error of the force over the run [%]")
    panels[0].yaxis.set_major_formatter("{x:g}")
    for case, mark in marks.items():
        panels[1].plot([], [], mark, color="black", ls="none", label=case)
    panels[1].plot([], [], "o", color="black", mfc="none", ls="none", label="hollow: energy not kept")
    for name, colour in COLOURS.items():
        panels[1].plot([], [], "s", color=colour, ls="none", ms=8, label=name)
    part.legend(*panels[1].get_legend_handles_labels(), loc="outside right center", frameon=False)


def main() -> None:
    """Data, tables and figure from what was measured."""
    kept = json.loads(MEASURED.read_text("utf-8"))
    data = accuracy.summary(kept)
    DATA.parent.mkdir(exist_ok=True)
    DATA.write_text(json.dumps(data, indent=1) + "\n", "utf-8")
    PAGE.write_text(page_of(PAGE.read_text("utf-8"), data), "utf-8")
    FIGURE.write_bytes(figure(kept, data))


if __name__ == "__main__":
    main()
