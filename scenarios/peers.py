"""`make peers`: detection and step beside libraries of the package index, on one scene, in one run, on one core.

Each is measured in a process of its own, so that one that is missing, fails or hangs leaves the others alone: it is
named with the reason. The rounds go through all of them one after the other. Each does the same in every round, so of
each moment its fastest round counts: what other work on the machine adds is left out, for all of them alike.
"""

import importlib.metadata
import json
import os
import platform
import tempfile
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from tissue_contact.commandline import guarded
from tissue_contact.files import publish
from tissue_contact.fmu.build import build
from tissue_contact.fmu.native import drive, host_platform
from tissue_contact.kernels.layout import Real
from tissue_contact.presets import PRESETS
from tissue_contact.scenarios import bench, peer_detection, peer_step
from tissue_contact.scenarios.apart import LeftOut, apart
from tissue_contact.scenarios.peer_scene import (
    PRESSED,
    PeerScene,
    assembly_of,
    graded_assembly,
    lowest_of,
    moved_alike,
    record,
)
from tissue_contact.settings import check_file, check_word

STEPPED = "6K"  # the sheet that is run, and on which steps are compared
EVERY = 4  # of its milliseconds in contact, how many are one moment to find pairs at
THINNED = {"1.5K": 1, "6K": 1, "24K": 2, "96K": 5}  # of these moments, how many are one on a sheet
ROUNDS = {"detection": 3, "step": 10}
OURS = "tissue-contact"
# As fine as the sheet where the rod gets to, coarser beyond; and with points as far apart as the bench's sparse ones
GRADED, SPARSE = "graded", "graded, sparse"
# What a name stands for in the tables, and the package whose version is told
TOLD: dict[str, tuple[str, str]] = {
    OURS: ("tissue-contact, exact pairs", "tissue-contact"),
    "tissue-contact, near the field": ("tissue-contact, triangles near the field", "tissue-contact"),
    "embreex": ("Embree, rays of edges, rebuilt", "embreex"),
    "meshlib": ("MeshLib, refitted", "meshlib"),
    "coal": ("coal, OBBRSS refitted", "coal"),
    "python-fcl": ("FCL, rebuilt", "python-fcl"),
    **{preset: (f"tissue-contact, FMU, preset {preset}", "tissue-contact") for preset in PRESETS},
    GRADED: ("tissue-contact, FMU, preset fast, sheet graded", "tissue-contact"),
    SPARSE: ("tissue-contact, FMU, preset fast, sheet graded, points 1 mm apart", "tissue-contact"),
    "edge loop": ("plain loop over the springs, 22 substeps", "numba"),
    "pypbd": ("pyPBD, XPBD, 10 iterations, no contact", "pypbd"),
    "mujoco": ("MuJoCo flex, discrete, CG", "mujoco"),
    "pybullet": ("pybullet deformable, 20 substeps", "pybullet"),
}
SLOW = "mujoco", "pybullet"  # one round is enough of these

Say = Callable[[str], None]


# --- measuring --------------------------------------------------------------------------------------------


def pair_difference(pairs: Real, ours: Real) -> dict[str, float]:
    """How the numbers of pairs differ from ours: the share of moments that agree, the least and the most."""
    difference = np.asarray(pairs) - np.asarray(ours)
    return {
        "pairs, median": float(np.median(pairs)),
        "equal": float(np.mean(difference == 0)),
        "least difference": int(difference.min()),
        "most difference": int(difference.max()),
    }


def fastest(rounds: list[Real]) -> Real:
    """The least of every moment that all the rounds got to, in which they did the same."""
    moments = min(len(us) for us in rounds)
    return np.min([us[:moments] for us in rounds], axis=0)


def rounds_of(
    names: list[str],
    work: Callable[[str], Any],
    rounds: int,
    left_out: dict[str, str],
    say: Say,
    once: Collection[str] = (),
) -> dict[str, list[Any]]:
    """Results of every round of all names, of some only of the first; one that fails is left out from then on."""
    found: dict[str, list[Any]] = {name: [] for name in names}
    for n in range(rounds):
        for name in [name for name in found if n == 0 or name not in once]:
            say(f"round {n + 1} of {rounds}: {name}")
            try:
                found[name].append(work(name))
            except LeftOut as error:
                left_out[name] = str(error)
                say(f"left out: {name}: {error}")
                del found[name]
    return found


def detection(scene: PeerScene, left_out: dict[str, str], say: Say) -> dict[str, Any]:
    """Figures of all detections on one sheet."""
    names = [name for name in peer_detection.WAYS if name not in left_out]
    found = rounds_of(
        names, lambda name: apart(peer_detection.measure, name, scene), ROUNDS["detection"], left_out, say
    )
    ours = found[OURS][0][1]
    return {
        name: {
            **bench.figures(fastest([us for us, _ in rounds])),
            "moments": len(scene.moments),
            **pair_difference(rounds[0][1], ours),
        }
        for name, rounds in found.items()
    }


def stepping(scene: PeerScene, left_out: dict[str, str], say: Say) -> dict[str, Any]:
    """Figures of all steps on one sheet."""
    fmus: dict[str, Path] = {}
    for preset in PRESETS:
        say(f"building: {preset}")
        assembly = assembly_of(scene.sheet, bench.PRESET.format(preset))
        fmus[preset] = build(assembly, scene.sheet.with_name(f"{preset}.fmu"), [host_platform()])
    lowest = dict.fromkeys(PRESETS, scene.lowest[PRESSED])
    for name, contact in ((GRADED, bench.CONTACT), (SPARSE, bench.SPARSE)):
        say(f"building: {name}")
        graded = graded_assembly(scene.sheet.parent, contact)
        fmus[name] = build(graded, scene.sheet.with_name(f"{name}.fmu"), [host_platform()])
        lowest[name] = lowest_of(graded)[PRESSED]
    touching = slice(int(scene.moments[0]) - 1, int(scene.moments[-1]))

    def work(name: str) -> tuple[Real, int, float]:
        if name in fmus:
            _, ns = drive(fmus[name], bench.poses()[1:], bench.STEP)
            return ns[touching] / 1000, PRESSED, float(lowest[name])
        result: tuple[Real, int, float] = apart(peer_step.measure, name, scene)
        return result

    results: dict[str, Any] = {}
    for name, rounds in rounds_of([*fmus, *peer_step.WAYS], work, ROUNDS["step"], left_out, say, SLOW).items():
        us = fastest([us for us, *_ in rounds])
        _, looked, lowest = rounds[0]
        results[name] = {
            **bench.figures(us),
            "moments": len(us),
            "real-time factor": round(1e6 * bench.STEP / float(np.median(us)), 4),
            "looked at": looked,
            "lowest": lowest,
            "lowest of ours": float(scene.lowest[looked]),
        }
    return results


def _processor() -> str:
    """Name of the processor's model."""
    about = Path("/proc/cpuinfo")
    lines = about.read_text().splitlines() if about.exists() else []
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def measure(say: Say, levels: list[str]) -> dict[str, Any]:
    """All the figures of `make peers`."""
    left_out: dict[str, str] = {}
    results: dict[str, Any] = {"processor": _processor(), "rounds": ROUNDS, "detection": {}, "step": {}}
    with tempfile.TemporaryDirectory() as folder:
        say("recording the motion")
        sheets = {level: bench.write_sheet(level, Path(folder)) for level in {STEPPED, *levels}}
        recorded = record(sheets[STEPPED], EVERY)
        results["step"] = stepping(recorded, left_out, say)
        for level in levels:
            say(f"{level} triangles")
            scene = recorded if level == STEPPED else moved_alike(recorded, sheets[level], THINNED[level])
            results["detection"][level] = detection(scene, left_out, say)
    packages = {package for name, (_, package) in TOLD.items() if name not in left_out}
    results["versions"] = {package: importlib.metadata.version(package) for package in sorted(packages)}
    results["left out"] = left_out
    return results


# --- telling ----------------------------------------------------------------------------------------------


def ratio(us: float, ours: float) -> str:
    """How many times ours."""
    return f"{us / ours:.2g}" if us < 100 * ours else f"{us / ours:,.0f}"


def _microseconds(us: float) -> str:
    return f"{us:,.1f}" if us < 100 else f"{us:,.0f}"


def _version(results: Mapping[str, Any], name: str) -> str:
    return str(results["versions"][TOLD[name][1]])


def _pairs(name: str, figures: Mapping[str, Any]) -> str:
    """What the number of pairs says of a detection."""
    if name == "tissue-contact, near the field":
        return f"{figures['pairs, median']:.0f} triangles, no pairs"
    least, most = figures["least difference"], figures["most difference"]
    if least == most == 0:
        return f"{figures['pairs, median']:.0f}" if name == OURS else "as many as ours"
    return f"{100 * figures['equal']:.0f} % of the moments as many, else {least:+d} to {most:+d}".replace("-", "−")


def detection_rows(results: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Headings and rows of the table of detections."""
    rows = []
    for level, found in results["detection"].items():
        for name, f in sorted(found.items(), key=lambda item: float(item[1]["median"])):
            shown = _microseconds(f["median"]), _microseconds(f["p99"]), ratio(f["median"], found[OURS]["median"])
            rows.append([level, TOLD[name][0], *shown, _pairs(name, f), _version(results, name)])
    return ["Sheet", "Detection", "Median [µs]", "p99 [µs]", "Ratio", "Pairs", "Version"], rows


def step_rows(results: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Headings and rows of the table of steps."""
    rows, ours = [], results["step"]["accurate"]["median"]
    for name, f in sorted(results["step"].items(), key=lambda item: float(item[1]["median"])):
        times = [_microseconds(f[key]) for key in ("median", "p99", "p99.9", "max")]
        lowest = f"{1e3 * f['lowest']:.2f} mm at {f['looked at']} ms, ours {1e3 * f['lowest of ours']:.2f}"
        lowest = lowest.replace("-", "−")
        factors = f"{f['real-time factor']:.2g}", ratio(f["median"], ours)
        rows.append([TOLD[name][0], *times, *factors, lowest, f"{f['moments']}", _version(results, name)])
    headings = ["Step", "Median [µs]", "p99", "p99.9", "Maximum", "Real-time factor", "Ratio", "Lowest vertex", "Steps"]
    return [*headings, "Version"], rows


def left_out_lines(results: Mapping[str, Any]) -> list[str]:
    """What could not be measured, and why."""
    return [f"left out: {name}: {reason}" for name, reason in results["left out"].items()]


def main(output: Path = Path("build/peers.json"), levels: str = ",".join(THINNED)) -> None:
    """Measure, print and keep the figures."""
    check_file("--output", output)
    for level in levels.split(","):
        check_word("--levels", level, THINNED)
    if hasattr(os, "sched_setaffinity"):  # libraries that use all the cores would not be compared with one
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    console = Console()
    results = measure(lambda text: console.print(text, style="dim"), levels.split(","))
    for title, (headings, rows) in (("Detection", detection_rows(results)), ("Step", step_rows(results))):
        table = Table(*headings, title=title)
        for row in rows:
            table.add_row(*row)
        console.print(table)
    for line in left_out_lines(results):
        console.print(line, style="bold")
    publish(output, (json.dumps(results, indent=1) + "\n").encode())
    console.print(f"kept in {output}; python docs/peers.py puts it into docs/peers.md")


if __name__ == "__main__":
    typer.run(guarded(main, "peers"))
