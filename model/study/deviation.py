"""How far the rows of a run are from those of a reference."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

# Columns of the rows of a run, shape (communication points, bodies, 10).
FORCE, TORQUE, MEAN_FORCE, DEPTH = slice(0, 3), slice(3, 6), slice(6, 9), 9
WIDTH = 10
MEASURES = ("force", "peak", "impulse", "depth", "torque")
KNOWN = 0.25  # greatest difference of the two finest references in a measure that errors are told of


def errors(rows: FloatArray, true: FloatArray, steps: FloatArray) -> dict[str, float | None]:
    """Relative errors of a run against a reference, over all bodies together.

    Parameters
    ----------
    rows, true : shape (n + 1, bodies, 10)
        Force [N], torque [N·m], mean force over the step [N], depth [m] of the run and of the reference.
    steps : [s], shape (n,)

    Returns
    -------
    force, depth, torque
        L2 norm of the difference over all communication points, over that of the reference.
    peak
        Norm over the bodies of the difference of their greatest forces, over that of the reference.
    impulse
        Norm of the difference of the impulses, over the reference's integral of the force's magnitude.

    None where the reference is zero.

    Raises
    ------
    ValueError
        The shapes differ.

    """
    if rows.shape != true.shape or len(steps) != len(rows) - 1:
        raise ValueError(f"rows {rows.shape}, reference {true.shape} and {len(steps)} steps must belong together")

    def over_run(column: slice | int) -> float | None:
        return _share(rows[..., column] - true[..., column], true[..., column])

    peak, true_peak = (np.linalg.norm(r[..., FORCE], axis=2).max(axis=0) for r in (rows, true))
    weight = steps[:, None, None]
    off = ((rows - true)[1:, :, MEAN_FORCE] * weight).sum(axis=0)
    size = (np.linalg.norm(true[1:, :, MEAN_FORCE], axis=2) * steps[:, None]).sum(axis=0)
    return {
        "force": over_run(FORCE),
        "peak": _share(peak - true_peak, true_peak),
        "impulse": _share(off, size),
        "depth": over_run(DEPTH),
        "torque": over_run(TORQUE),
    }


def known(convergence: Mapping[str, float | None]) -> list[str]:
    """Measures in which the two finest references agree: not in a torque that is hardly there, for instance."""
    return [m for m, apart in convergence.items() if apart is not None and apart < KNOWN]


def _share(off: FloatArray, whole: FloatArray) -> float | None:
    size = float(np.linalg.norm(whole))
    return float(np.linalg.norm(off)) / size if size > 0.0 else None
