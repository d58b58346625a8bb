"""Write the tables and the figure of docs/presets.md from build/presets.json: `python docs/presets.py`.

What they hold is kept beside the page, in docs/data/presets.json; tests/test_presets.py fails when the page does not
say the same.
"""

import io
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator
from pages import filled, table

from tissue_contact.presets import PRESETS
from tissue_contact.scenarios.presets import CANDIDATES, SHEETS
from tissue_contact.study.front import percent

DOCS = Path(__file__).parent
PAGE, DATA, FIGURE = DOCS / "presets.md", DOCS / "data" / "presets.json", DOCS / "images" / "presets.png"
MEASURED = DOCS.parent / "build" / "presets.json"
SHOWN = ("force", "peak", "impulse", "depth")
MARKS = dict(zip((c.words for c in CANDIDATES), "vD^<>s", strict=True))

Found = Mapping[str, Any]


def cell(share: float | None) -> str:
    """A share in percent, a dash where it is not known."""
    return "–" if share is None else percent(share)


def shown(name: str) -> str:
    """A scenario with a link to what it is."""
    return f"[{SHEETS[name]}](speed.md)" if name in SHEETS else f"[{name}](../scenarios/{name}/README.md)"


def of_presets(about: Found) -> Iterator[tuple[str, Found]]:
    """Names of presets with the run that each comes to in a scenario; those that come to one run are one."""
    names: dict[str, list[str]] = {}
    for name, preset in PRESETS.items():
        words = preset.words if preset.words in about["runs"] else CANDIDATES[-1].words
        names.setdefault(words, []).append(name)
    for words, same in names.items():
        yield "all" if len(same) == len(PRESETS) else ", ".join(same), about["runs"][words]


# --- tables -----------------------------------------------------------------------------------------------


def settings_table(data: Found) -> str:
    """What each preset is, and its worst error and its time over all scenarios that can have any candidate."""
    whole = {name: s["runs"] for name, s in data["scenarios"].items() if len(s["runs"]) == len(CANDIDATES)}
    rows = []
    for name, preset in PRESETS.items():
        runs = {where: found[preset.words] for where, found in whole.items()}
        done = {where: run["error"]["force"] for where, run in runs.items() if not run["refusal"]}
        refused = ", ".join(where for where in runs if where not in done)
        worst = max(done, key=lambda where: done[where])
        ratios = [whole[where][CANDIDATES[-1].words]["us"] / runs[where]["us"] for where in done]
        faster = f"{min(ratios):.1f} to {max(ratios):.1f}" if preset != CANDIDATES[-1] else ""
        error = f"{cell(done[worst])} ({worst})" + f", refused in {refused}" * bool(refused)
        rows.append([f"`{name}`", preset.words, error, faster])
    return table(["Preset", "Settings", "Worst error of the force", f"Times as fast as {CANDIDATES[-1].words}"], rows)


def errors_table(data: Found) -> str:
    """Every scenario with every preset."""
    rows = []
    for name, about in data["scenarios"].items():
        for preset, run in of_presets(about):
            if run["refusal"]:
                rows.append([shown(name), preset, "refused", *[""] * (len(SHOWN) + 2)])
                continue
            errors = [cell(run["error"].get(measure)) for measure in SHOWN]
            rows.append([shown(name), preset, f"{run['us']:,.0f}", *errors, percent(run["balance"]),
                         str(len(run["failed"]) or "")])  # fmt: skip
    return table(["Scenario", "Preset", "µs a step", *map(str.capitalize, SHOWN), "Energy balance", "Fails"], rows)


def failed_table(data: Found) -> str:
    """Expectations that fail, and what refused a run."""
    rows = []
    for name, about in data["scenarios"].items():
        for preset, run in of_presets(about):
            rows += [[shown(name), preset, told] for told in (*run["failed"], run["refusal"]) if told]
    return table(["Scenario", "Preset", "What fails"], rows)


def candidates_table(data: Found) -> str:
    """Error of the force and time with every candidate."""
    rows = []
    for name, about in data["scenarios"].items():
        cells = []
        for candidate in CANDIDATES:
            run = about["runs"].get(candidate.words)
            done = run is not None and not run["refusal"]
            cells.append(f"{cell(run['error'].get('force'))}, {run['us']:,.0f}" if done else "refused" if run else "")
        rows.append([shown(name), *cells])
    return table(["Scenario", *(c.words for c in CANDIDATES)], rows)


def references_table(data: Found) -> str:
    """How far the references are known, and what the mesh errs by."""
    rows = []
    for name, about in data["scenarios"].items():
        near = [cell(about["convergence"].get(measure)) for measure in ("force", "depth")]
        mesh = [cell(about["mesh"].get(measure)) for measure in ("force", "depth")]
        rows.append([shown(name), f"{about['triangles']:,}", *near, *mesh])
    return table(["Scenario", "Triangles", "Reference: force", "depth", "Mesh: force", "depth"], rows)


TABLES = {
    "settings": settings_table,
    "errors": errors_table,
    "failed": failed_table,
    "candidates": candidates_table,
    "references": references_table,
}


def page_of(page: str, data: Found) -> str:
    """The page with its tables made anew."""
    return filled(page, {name: made(data) for name, made in TABLES.items()})


# --- figure -----------------------------------------------------------------------------------------------


def figure(data: Found) -> bytes:
    """Time of a step against error of the force, one line for each scenario, as PNG."""
    drawn = Figure(figsize=(9.5, 5.5), layout="constrained")
    FigureCanvasAgg(drawn)
    axes = drawn.subplots()
    for name, about in data["scenarios"].items():
        runs = {words: about["runs"][words] for words in MARKS if words in about["runs"]}
        done = {words: run for words, run in runs.items() if not run["refusal"] and run["error"].get("force")}
        line = [(run["us"], 100 * run["error"]["force"]) for run in done.values()]
        if len(line) < 2:
            continue  # every preset is the same there
        (drawn_line,) = axes.plot(*zip(*line, strict=True), lw=0.8, label=name)
        for words, (us, error) in zip(done, line, strict=True):
            axes.plot(us, error, MARKS[words], color=drawn_line.get_color(), ms=6)
    for words, mark in MARKS.items():
        named = [f"preset {name}" for name, preset in PRESETS.items() if preset.words == words]
        axes.plot([], [], mark, color="black", ls="none", label=(named or [words])[0])
    axes.set(xscale="log", yscale="log", xlabel="step in contact, median [µs]", ylabel="error of the force [%]")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=20))
        axis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:,.10g}"))
        axis.set_minor_formatter("")
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    drawn.legend(loc="outside right center", frameon=False, fontsize=8)
    file = io.BytesIO()
    drawn.savefig(file, format="png", dpi=130, facecolor="white", metadata={"Software": None})
    return file.getvalue()


def main() -> None:
    """Data, tables and figure from what was measured."""
    text = MEASURED.read_text("utf-8")
    data = json.loads(text)
    DATA.write_text(text, "utf-8")
    PAGE.write_text(page_of(PAGE.read_text("utf-8"), data), "utf-8")
    FIGURE.write_bytes(figure(data))


if __name__ == "__main__":
    main()
