"""Put what `make peers` measured into docs/peers.md, and draw it: `python docs/peers.py`.

The tables stand in the page between two comments that name them; the figures are kept beside it, in
docs/data/peers.json; tests/test_peers.py fails when the page does not say the same.
"""

import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from pages import filled, table

from tissue_contact.scenarios import peers

DOCS = Path(__file__).parent
PAGE, DATA, FIGURE = DOCS / "peers.md", DOCS / "data" / "peers.json", DOCS / "images" / "peers.png"
MEASURED = DOCS.parent / "build" / "peers.json"
OWN, OTHER = "#1b9e77", "#4477aa"

Found = Mapping[str, Any]


def run_text(data: Found) -> str:
    """On what it was measured, and what was left out."""
    left_out = data["left out"]
    reasons = "".join(f"- {name}: {reason}\n" for name, reason in left_out.items())
    rounds = data["rounds"]
    head = (
        f"Measured by `make peers` on one core of {data['processor']}, each moment the fastest of "
        f"{rounds['detection']} rounds of detection and {rounds['step']} of steps."
    )
    return f"{head} {'Left out:' if left_out else 'Nothing was left out.'}\n{reasons and chr(10) + reasons}"


def page_of(page: str, data: Found) -> str:
    """The page with what was measured."""
    texts = {
        "run": run_text(data),
        "detection": table(*peers.detection_rows(data)),
        "step": table(*peers.step_rows(data)),
    }
    return filled(page, texts)


def bars(axes: Axes, found: Mapping[str, Found], reference: str, title: str) -> None:
    """Median of each, the fastest on top, with the ratio to the one of ours that is referred to."""
    names = sorted(found, key=lambda name: -float(found[name]["median"]))
    us = [found[name]["median"] for name in names]
    told = [peers.TOLD[name] for name in names]
    colours = [OWN if package == peers.OURS else OTHER for _, package in told]
    drawn = axes.barh([text for text, _ in told], us, color=colours)
    ratios = [peers.ratio(value, found[reference]["median"]) for value in us]
    axes.bar_label(drawn, [f"{ratio} ×" for ratio in ratios], padding=3, fontsize=8)
    axes.set(xscale="log", title=title, xlim=(0.5 * min(us), 6 * max(us)))
    axes.tick_params(labelsize=8)
    axes.grid(axis="x", alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)


def figure(data: Found) -> bytes:
    """Detection by the size of the mesh, and the step, as PNG."""
    levels = data["detection"]
    panels = [(found, peers.OURS, f"detection, {level} triangles") for level, found in levels.items()]
    panels.append((data["step"], "accurate", f"step of 1 ms, {peers.STEPPED} triangles"))
    heights = [len(found) + 1.5 for found, _, _ in panels]
    drawn = Figure(figsize=(8.5, 0.3 * sum(heights)), layout="constrained")
    FigureCanvasAgg(drawn)
    every = drawn.subplots(len(panels), 1, height_ratios=heights, squeeze=False)[:, 0]
    for axes, panel in zip(every, panels, strict=True):
        bars(axes, *panel)
    every[-1].set_xlabel("median of the steps in contact [µs]")
    file = io.BytesIO()
    drawn.savefig(file, format="png", dpi=130, facecolor="white", metadata={"Software": None})
    return file.getvalue()


def main() -> None:
    """Data, tables and figure from what was measured."""
    data = json.loads(MEASURED.read_text("utf-8"))
    DATA.write_text(json.dumps(data, indent=1) + "\n", "utf-8")
    PAGE.write_text(page_of(PAGE.read_text("utf-8"), data), "utf-8")
    FIGURE.write_bytes(figure(data))


if __name__ == "__main__":
    main()
