"""`make soak`: ten minutes of simulated time without a pause, and what held up the steps that took longer than 1 ms.

The motion of `bench`, there and back again, on its sheet of 6,000 triangles. It is the same work in every repeat: what
a place of the motion takes at its median over the repeats is the step's own, what one step takes beyond that is not.
"""

import json
import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from tissue_contact.errors import InputError
from tissue_contact.files import publish
from tissue_contact.fmu.native import Soak, soak
from tissue_contact.kernels.layout import Real
from tissue_contact.scenarios import bench

LIMIT = 1e6  # ns, real time at a step of 1 ms
PERCENTILES = {"median": 50, "p99": 99, "p99.9": 99.9, "p99.99": 99.99, "maximum": 100}
STEAL = 7  # place in a row of /proc/stat, in ticks


def there_and_back() -> Real:
    """Poses of a press, a slide and a way out, and of the same backwards, so that it can go on; shape [2000, 7]."""
    path = bench.poses()
    return np.concatenate([path[1:], path[-2::-1]])


def stolen(core: int) -> float:
    """Time [s] for which the core was wanted here and given to another virtual machine, since the start."""
    rows = (line.split() for line in Path("/proc/stat").read_text("utf-8").splitlines())
    ticks = next(int(row[1 + STEAL]) for row in rows if row[0] == f"cpu{core}")
    return ticks / os.sysconf("SC_CLK_TCK")


def figures(ran: Soak, places: int) -> dict[str, Any]:
    """What a long run tells; times in µs.

    ``places`` is the number of steps of the motion that was repeated.
    """
    late = ran.step_ns > LIMIT
    preempted, waited, faulted = (late & (count > 0) for count in (ran.preemptions, ran.waits, ran.faults))
    own = np.median(ran.step_ns.reshape(-1, places), axis=0)

    def spread(ns: Real) -> dict[str, float]:
        values = np.percentile(ns / 1000, list(PERCENTILES.values()))
        return {name: round(float(value), 3) for name, value in zip(PERCENTILES, values, strict=True)}

    return {
        "steps": len(ran.step_ns),
        "memory locked": ran.locked,
        "step": spread(ran.step_ns),
        "processor time of a step": spread(ran.processor_ns),
        "steps over 1 ms of processor time": int((ran.processor_ns > LIMIT).sum()),
        "slowest place of the motion, median over the repeats": round(float(own.max()) / 1000, 3),
        "steps over 1 ms": int(late.sum()),
        "of them preempted": int(preempted.sum()),
        "of them waiting": int(waited.sum()),
        "of them with a page fault": int(faulted.sum()),
        "of them none of these": int((late & ~preempted & ~waited & ~faulted).sum()),
        "of them at places that take over 1 ms at their median": int(late.reshape(-1, places)[:, own > LIMIT].sum()),
        "steps preempted": int((ran.preemptions > 0).sum()),
        "steps with a page fault": int((ran.faults > 0).sum()),
    }


def measure(preset: str, level: str, repeats: int, core: int) -> dict[str, Any]:
    """The figures of `make soak`."""
    path = there_and_back()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _, fmu = bench.built(bench.on_sheet(bench.write_sheet(level, folder), bench.PRESET.format(preset)), folder)
        before = stolen(core)
        ran = soak(fmu, path, bench.STEP, repeats, core)
        lost = stolen(core) - before
    scene = {"preset": preset, "level": level, "core": core}
    taken = {"seconds": round(float(ran.step_ns.sum()) / 1e9, 1), "seconds stolen": round(lost, 2)}
    return scene | figures(ran, len(path)) | taken


def table(results: dict[str, Any]) -> Table:
    """The figures as a table for the screen."""
    shown = Table("what", "", title="steps on one core; µs")
    for name, value in results.items():
        rows = {f"{name}, {key}": part for key, part in value.items()} if isinstance(value, dict) else {name: value}
        for what, figure in rows.items():
            shown.add_row(what, f"{figure}" if isinstance(figure, bool | str) else f"{figure:,}")
    return shown


def main(
    output: Path = Path("build/soak.json"),
    preset: str = "balanced",
    level: str = bench.COMPARED,
    seconds: float = 600.0,
    core: int | None = None,
) -> None:
    """Run, print and keep the figures. Without a core: the last one that this process may use."""
    allowed = sorted(os.sched_getaffinity(0))
    if core is not None and core not in allowed:
        raise InputError("core", "must be one that this process may use", core, f"Choose from {allowed}")
    repeats = max(1, round(seconds / (len(there_and_back()) * bench.STEP)))
    results = measure(preset, level, repeats, allowed[-1] if core is None else core)
    console = Console()
    console.print(table(results))
    publish(output, (json.dumps(results, indent=1) + "\n").encode())
    console.print(f"kept in {output}")


if __name__ == "__main__":
    typer.run(main)
