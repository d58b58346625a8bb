"""`make growth`: how the work of a step grows with the mesh, with the preset `fast`, in instructions.

Times of large meshes, which leave the caches, tell more of what else the machine does. The motion and the sheets are
those of `bench`, as they are and with a reach.
"""

import json
import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from tissue_contact.assemble import assemble
from tissue_contact.commandline import Workers, guarded
from tissue_contact.errors import WorkError
from tissue_contact.files import publish
from tissue_contact.fmu.compile import shared_library
from tissue_contact.fmu.native import host_platform
from tissue_contact.pool import pool
from tissue_contact.scenarios import bench, instructions
from tissue_contact.scene import parse_scene
from tissue_contact.settings import check_file, check_word

Row = dict[str, Any]

PRESSED = 340  # steps of the motion until the capsule is deep
FREE = 40  # without contact: none differs from another
COUNTED = 20  # of them, the last
AWAY = np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.0])  # m, of the poses
WORK = ("no contact", "pressed", "detection", "response")
# Of the second sheet over the first: ever finer ones, and one as fine around the same contact.
COMPARED = (("1.5K", "6K"), ("6K", "24K"), ("24K", "96K"), ("6K supported", "96K supported"))


def counted(task: tuple[str, bool]) -> Row:
    """Thousands of instructions of a step on the sheet of a level, as it is or with a reach, and of its parts."""
    level, reaching = task
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        tissue = bench.tissue_text(level, folder) + (f"\n{bench.REACH}" if reaching else "")
        assembly = assemble(parse_scene(bench.scene_text(tissue, bench.PRESET.format("fast")).encode(), folder))
        fmu = bench.repeating(assembly, folder)
        poses = bench.poses()[1:]

        def thousands(path: Any, part: str = "") -> float:
            starts = {f"repeat.{part}": 1.0} if part else None
            count = instructions.of_steps(fmu, path, bench.STEP, COUNTED, starts)
            assert count is not None  # main has asked
            return count / 1e3

        row = {"no contact": thousands(poses[:FREE] + AWAY), "pressed": thousands(poses[:PRESSED])}
        for part in ("detection", "response"):
            row[part] = thousands(poses[:PRESSED], part) - row["pressed"]
    return {"level": level, "reach": reaching, "triangles": len(assembly.model.triangle_a)} | row


def n_log_n(small: str, large: str) -> float:
    """N log N of the triangles of one level over that of another."""
    m, n = (2 * bench.LEVELS[level][0] ** 2 for level in (small, large))
    return n * math.log(n) / (m * math.log(m))


def ratios(rows: list[Row]) -> list[Row]:
    """What sheets cost over others, and N log N of the triangles of the files."""
    found = []
    by_case = {(row["level"], row["reach"]): row for row in rows}
    for reach in (False, True):
        for small, large in COMPARED:
            if (small, reach) in by_case and (large, reach) in by_case:
                a, b = by_case[small, reach], by_case[large, reach]
                over = {work: b[work] / a[work] for work in WORK}
                found.append({"of": large, "over": small, "reach": reach, **over, "N log N": n_log_n(small, large)})
    return found


def tables(rows: list[Row]) -> list[Table]:
    """The figures as tables for the screen."""
    counts = Table("sheet", "triangles", *WORK, title="thousands of instructions")
    for row in rows:
        counts.add_row(case(row["level"], row["reach"]), f"{row['triangles']:,}", *(f"{row[w]:,.0f}" for w in WORK))
    growth = Table("sheet", "over", *WORK, "N log N", title="times as many")
    for row in ratios(rows):
        names = case(row["of"], row["reach"]), row["over"]
        growth.add_row(*names, *(f"{row[w]:.2f}" for w in WORK), f"{row['N log N']:.2f}")
    return [counts, growth] if growth.rows else [counts]


def case(level: str, reach: bool) -> str:
    """Name of a sheet as it is or with a reach."""
    return f"{level}, with a reach" if reach else level


def main(
    output: Path = Path("build/growth.json"),
    levels: str = ",".join(bench.LEVELS),
    workers: Workers = 1,
) -> None:
    """Count, print and keep the figures."""
    check_file("--output", output)
    console = Console()
    wanted = levels.split(",")
    for level in wanted:
        check_word("--levels", level, bench.LEVELS)
    with tempfile.TemporaryDirectory() as name:
        if instructions.counter(Path(name) / "log") is None:  # before anything is compiled
            raise WorkError("nothing counts instructions here: install valgrind, or perf on a machine with counters")
    # The largest first: they take longest.
    tasks = [(level, reach) for reach in (False, True) for level in sorted(wanted, key=lambda k: -bench.LEVELS[k][0])]
    shared_library(host_platform(), bench.MEASURED)  # workers side by side would compile side by side
    with pool(workers) as spread:
        rows = spread(counted, tasks, lambda n, _: console.print(f"counted: {case(*tasks[n])}", style="dim"))
    rows.sort(key=lambda row: (row["reach"], wanted.index(row["level"])))
    for table in tables(rows):
        console.print(table)
    publish(output, (json.dumps(rows, indent=1) + "\n").encode())
    console.print(f"kept in {output}")


if __name__ == "__main__":
    typer.run(guarded(main, "growth"))
