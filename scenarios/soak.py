"""`make soak`: ten minutes of simulated time without a pause, and what held up the steps that took longer than 1 ms.

The motion of `bench`, there and back again, on its sheet of 6,000 triangles, in several rounds from the same state: a
step is the same work to the last bit in each. Its own time is at most what it takes in its fastest round; what it takes
in another beyond that is the machine's.
"""

import json
import os
import tempfile
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from tissue_contact.commandline import guarded
from tissue_contact.errors import InputError, WorkError
from tissue_contact.files import publish
from tissue_contact.fmu.native import Soak, soak
from tissue_contact.kernels.layout import Real
from tissue_contact.scenarios import bench
from tissue_contact.scenarios.run import bar_of
from tissue_contact.settings import check_file, check_word

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


def figures(rounds: list[Soak]) -> dict[str, Any]:
    """What a long run tells that was made in several rounds; times in µs, spreads and counts over all of them.

    Raises
    ------
    WorkError
        The outputs of two rounds differ, so that their steps are not the same work.
    """
    first = rounds[0]
    if any(not np.array_equal(ran.outputs, first.outputs) for ran in rounds):
        raise WorkError("two rounds of the same steps differ in their outputs: their times say nothing of each other")
    wall, preemptions, waits, faults, processor = np.array([ran[:5] for ran in rounds]).swapaxes(0, 1)
    late = wall > LIMIT
    preempted, waited, faulted = (late & (count > 0) for count in (preemptions, waits, faults))
    own = wall.min(axis=0)

    def spread(ns: Real) -> dict[str, float]:
        values = np.percentile(ns / 1000, list(PERCENTILES.values()))
        return {name: round(float(value), 3) for name, value in zip(PERCENTILES, values, strict=True)}

    return {
        "rounds": len(rounds),
        "steps a round": len(first.step_ns),
        "memory locked": all(ran.locked for ran in rounds),
        "step": spread(wall),
        "processor time of a step": spread(processor),
        "step in its fastest round": spread(own),
        "steps over 1 ms in every round": int((own > LIMIT).sum()),
        "steps over 1 ms": int(late.sum()),
        "of them preempted": int(preempted.sum()),
        "of them waiting": int(waited.sum()),
        "of them with a page fault": int(faulted.sum()),
        "of them none of these": int((late & ~preempted & ~waited & ~faulted).sum()),
        "steps over 1 ms of processor time": int((processor > LIMIT).sum()),
        "steps preempted": int((preemptions > 0).sum()),
        "steps with a page fault": int((faults > 0).sum()),
    }


def measure(preset: str, level: str, repeats: int, rounds: int, core: int) -> dict[str, Any]:
    """The figures of `make soak`."""
    path = there_and_back()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        text = bench.scene_text(bench.tissue_text(level, folder), bench.PRESET.format(preset))
        _, fmu = bench.built(text, folder)
        before = stolen(core)
        with bar_of(Console(stderr=True), wanted=True) as bar:
            ran = [soak(fmu, path, bench.STEP, repeats, core) for _ in bar.track(range(rounds), description="rounds")]
        lost = stolen(core) - before
    scene = {"preset": preset, "level": level, "core": core}
    seconds = sum(float(one.step_ns.sum()) for one in ran) / 1e9
    return scene | figures(ran) | {"seconds": round(seconds, 1), "seconds stolen": round(lost, 2)}


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
    rounds: Annotated[int, typer.Option(min=1)] = 3,
    core: int | None = None,
) -> None:
    """Run, print and keep the figures. Without a core: the last one that this process may use."""
    check_file("--output", output)
    check_word("--level", level, bench.LEVELS)
    allowed = sorted(os.sched_getaffinity(0))
    if core is not None and core not in allowed:
        raise InputError("--core", "must be one that this process may use", core, f"Choose from {allowed}")
    repeats = max(1, round(seconds / (len(there_and_back()) * bench.STEP)))
    results = measure(preset, level, repeats, rounds, allowed[-1] if core is None else core)
    console = Console()
    console.print(table(results))
    publish(output, (json.dumps(results, indent=1) + "\n").encode())
    console.print(f"kept in {output}")


if __name__ == "__main__":
    typer.run(guarded(main, "soak"))
