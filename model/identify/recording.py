"""Recordings: what an experiment measured, in SI units, with the line that each sample came from."""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Real = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Recording:
    """The samples of one probe, in the order of the file. What was not measured is None."""

    name: str  # of the probe
    region: str  # what the probe belongs to, "" without
    place: str  # the file, for messages
    lines: npt.NDArray[np.int64]  # shape [n], line of the file; of the sample before, where resampled
    time: Real | None = None  # [s], shape [n], increasing
    depth: Real | None = None  # [m], shape [n], positive inside
    rate: Real | None = None  # [m/s], shape [n], of depth
    force: Real | None = None  # [N], shape [n], normal force, positive where the tissue pushes back
    force_vector: Real | None = None  # [N], shape [n, 3], on the instrument, world frame
    pose: Real | None = None  # shape [n, 7], position [m], unit quaternion w, x, y, z, body to world

    def __len__(self) -> int:
        return len(self.lines)


@dataclass(frozen=True)
class Exclusion:
    """A row that was left out, and why."""

    place: str
    line: int
    reason: str


@dataclass(frozen=True, eq=False)
class Reading:
    """What a file, or several, came to."""

    recordings: tuple[Recording, ...]
    exclusions: tuple[Exclusion, ...] = ()
    notes: tuple[str, ...] = field(default=())  # what was done to the data, a sentence each
