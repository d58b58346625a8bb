"""Instructions of steps in the FMU, counted by perf, or by valgrind where the machine hides its counters.

Unlike a time, a count is the same whatever else runs on the machine.
"""

import re
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path

from tissue_contact.fmu.native import drive
from tissue_contact.kernels.layout import Real


def counter(log: Path) -> list[str] | None:
    """Command that counts the instructions of a program into a file; None if there is none that works here."""
    ways = (
        ["perf", "stat", "-x", ",", "-e", "instructions:u", "-o", str(log), "--"],
        ["valgrind", "--tool=callgrind", "--callgrind-out-file=/dev/null", f"--log-file={log}"],
    )
    for way in ways:
        if shutil.which(way[0]):
            subprocess.run([*way, "true"], capture_output=True)
            if log.exists() and count_of(log.read_text("utf-8")) is not None:
                return way
    return None


def count_of(text: str) -> int | None:
    """Instructions that perf or callgrind counted."""
    found = re.search(r"^(\d+),,instructions|Collected : (\d+)", text, re.MULTILINE)
    return int(found[1] or found[2]) if found else None


def of_steps(fmu: Path, inputs: Real, h: float, last: int, starts: Mapping[str, float] | None = None) -> float | None:
    """Instructions of a step, the mean of the ``last`` of a run: what they add to it; None if none can be counted.

    ``inputs``, ``h`` [s] and ``starts`` are as for `drive`.
    """
    with tempfile.TemporaryDirectory() as name:
        log = Path(name) / "log"
        way = counter(log)
        if way is None:
            return None
        taken = []
        for path in (inputs[:-last], inputs):
            drive(fmu, path, h, starts=starts, prefix=way)
            counted = count_of(log.read_text("utf-8"))
            assert counted is not None  # the way was tried
            taken.append(counted)
    return (taken[1] - taken[0]) / last
