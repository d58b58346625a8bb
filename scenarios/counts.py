"""What the method asks of a processor in one step: operations and bytes of each part, from the sizes of an assembly.

Counted is the method in float64 with today's arrays, not what the kernels do: each number is read once for every pass
over it and written once, however often a loop comes back to it. An addition, a subtraction and a product are one
operation each, a root and the division that comes with it one root. What is not counted makes a bound lower, never
higher.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissue_contact.assembly import Assembly
from tissue_contact.elimination import WIDTH
from tissue_contact.kernels.layout import Model, Scratch, State
from tissue_contact.kernels.stability import PROJECTIVE_DYNAMICS

REAL, INDEX = 8, 4  # bytes
VECTOR = 3 * REAL  # of a vertex: x, y and z lie apart


class Part(NamedTuple):
    """One part of a step; operations and bytes are those of one pass."""

    name: str
    passes: int  # in a step
    flops: float
    roots: float
    bytes: float


def _springs(m: Model, passes: int) -> Part:
    """k (1 - l/|d|) d onto both ends: difference 3, square 5, force 6, sums 6; root. Ends, l, k; x, and f both ways."""
    s, v = m.spring_i.size, m.rest_x.size
    return Part("springs", passes, 20 * s, s, s * (2 * INDEX + 2 * REAL) + v * 3 * VECTOR)


def _motion(m: Model, passes: int) -> Part:
    """Symplectic Euler: kick, support, gravity, drag and drift 10 an axis, loss 10; x and v both ways, f, x at rest."""
    v = m.rest_x.size
    return Part("motion", passes, 40 * v, 0, v * (6 * VECTOR + 5 * REAL))


def _near(m: Model, state: State) -> NDArray[np.intp]:
    """Triangles near a field."""
    found = zip(m.contact_near_start, state.near_count, strict=False)
    return np.concatenate([state.near[start : start + n] for start, n in found]).astype(np.intp)


def _contact(m: Model, state: State, pressed: int, passes: int) -> Part:
    """A field at points: point 15, distance to a capsule 20; of a pressed one point 15, motion 27, force 75.

    Of a triangle corners 9, into the body 45.
    """
    triangles = _near(m, state)
    points = int((m.triangle_point_start[triangles + 1] - m.triangle_point_start[triangles]).sum())
    triangle = 4 * INDEX + 3 * VECTOR
    amount = len(triangles) * triangle + points * 3 * REAL + pressed * (REAL + 9 * VECTOR)
    return Part("contact", passes, 54 * len(triangles) + 35 * points + 117 * pressed, points, amount)


def _entries(m: Model) -> NDArray[np.intp]:
    """Entries below the diagonal in each panel of the factor."""
    width = np.diff(m.factor_column.astype(int))
    return width * (np.diff(m.factor_start.astype(int)) - WIDTH) + width * (width - 1) // 2


def _substitutions(m: Model, passes: int) -> Part:
    """Both, of three right sides: an entry 6, a row 3; values, places of rows, and the right sides, each way."""
    n, rows, named = int(_entries(m).sum()), m.factor_vertex.size, m.factor_row.size
    amount = 2 * (n * REAL + named * INDEX) + rows * (4 * 4 * REAL + REAL)
    return Part("substitutions", passes, 12 * n + 3 * rows, 0, amount)


def _residual(m: Model, passes: int) -> Part:
    """x + h v 6, residual 12 an axis, v added to 3; x both ways, v both ways, those of the start, f, x at rest, r."""
    v = m.rest_x.size
    return Part("residual and motion", passes, 45 * v, 0, v * (8 * VECTOR + 4 * REAL + REAL + INDEX))


def _pressed_rows(m: Model, scratch: Scratch, passes: int) -> Part:
    """A dense Cholesky factor of the pressed directions, and two passes over the path of their rows in the factor."""
    size = int(scratch.touched_count[0])  # at least one direction each
    panels, start = m.factor_start.size - 1, m.factor_start.astype(int)
    path = set()
    for row in scratch.touched[:size].astype(int):
        panel = int(m.factor_panel[row])
        while panel < panels and panel not in path:
            path.add(panel)
            below = start[panel] + WIDTH
            panel = int(m.factor_panel[m.factor_row[below] // 4]) if below < start[panel + 1] else panels
    entries = int(_entries(m)[list(path)].sum())
    dense = size**3 / 3 + 2 * size**2 + 6 * size**2 / 2
    return Part("pressed rows", passes, dense + 12 * entries, size, 2 * entries * REAL + size**2 / 2 * REAL)


def _energies(m: Model) -> Part:
    """Of a spring 3 and 5, what it is longer and its energy 4; of a vertex 18; every array once."""
    s, v = m.spring_i.size, m.rest_x.size
    return Part("energies", 1, 12 * s + 18 * v, s, s * (2 * INDEX + 2 * REAL) + v * (3 * VECTOR + REAL))


def _backup(assembly: Assembly) -> Part:
    """The FMU copies all that persists before a step, to return to it."""
    return Part("backup", 1, 0, 0, 2.0 * (assembly.state_real.nbytes + assembly.state_index.nbytes))


def parts(assembly: Assembly, state: State, scratch: Scratch, substeps: int) -> list[Part]:
    """Parts of a step of symplectic Euler or projective dynamics at a state, as it was left by a step; no detection."""
    m, pressed = assembly.model, int(scratch.active[0])
    common = [_energies(m), _backup(assembly)]
    if m.integrator[0] == PROJECTIVE_DYNAMICS:
        n = substeps * int(m.iterations[0])
        solved = [_substitutions(m, n), _residual(m, n), _pressed_rows(m, scratch, n)]
        # once more at the end of a substep, for what the bodies feel, of the last for the outputs as well
        return [_springs(m, n), _contact(m, state, pressed, n + substeps), *solved, *common]
    return [_springs(m, substeps), _motion(m, substeps), _contact(m, state, pressed, substeps + 1), *common]
