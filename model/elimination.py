"""In which order the vertices of the tissues are eliminated from a matrix of their springs, and what fills in."""

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csc_matrix, tril
from scipy.sparse.linalg import splu

from tissue_contact.geometry import FloatArray

IntArray = NDArray[np.signedinteger[Any]]

WIDTH = 4  # columns of a panel: as many as the registers of a processor hold sums of, of right sides of four numbers


class Elimination(NamedTuple):
    """Places of the entries of a factor L; fields as those of the `Model` that begin with ``factor_``.

    F rows, one for each free vertex, in X panels of up to `WIDTH` columns. Y rows of panels: `WIDTH` for its own
    columns, used or not, then those below them that any of its columns reaches; the others hold zeros there. Each has
    room for `WIDTH` entries.
    """

    vertex: IntArray  # shape [F], vertex of each row
    place: IntArray  # shape [V], row of each vertex, F where it is fixed
    panel: IntArray  # shape [F], panel of each row
    column: IntArray  # shape [X + 1], first column of each panel, and F
    start: IntArray  # shape [X + 1], where the rows of a panel begin
    depth: IntArray  # shape [X], columns of a panel and of all panels that its elimination reaches
    row: IntArray  # shape [Y], four times the row, ascending within a panel; 4 F + 4 where a panel has no such column
    spring: IntArray  # shape [S], entry of each spring, 4 Y where an end is fixed


class _Panel:
    """Columns that lie together, the rows below them that any of them reaches, and the panels that reach it first."""

    def __init__(self, columns: list[int], below: set[int]) -> None:
        self.columns, self.below = columns, below
        self.children: list[_Panel] = []

    def fits(self, other: "_Panel") -> bool:
        """Whether there is room for the columns of another panel."""
        return len(self.columns) + len(other.columns) <= WIDTH

    def take(self, other: "_Panel") -> None:
        """Take in another panel; its columns come first."""
        self.columns = other.columns + self.columns
        self.below = (self.below | other.below).difference(self.columns)
        self.children += other.children

    def take_children(self) -> None:
        """Take in those that fit, the longest first: what they reach is reached already."""
        while fitting := [child for child in self.children if self.fits(child)]:
            longest = max(fitting, key=lambda child: len(child.below))
            self.children.remove(longest)
            self.take(longest)

    def join_children(self) -> None:
        """Join those that fit into one panel, which saves its rows and those that both reach, the longest first."""
        joined: list[_Panel] = []
        with_room: list[_Panel] = []
        for child in sorted(self.children, key=lambda child: -len(child.below)):
            fitting = [other for other in with_room if other.fits(child)]
            if fitting:
                wider = max(fitting, key=lambda other: len(other.below & child.below))
                wider.take(child)
            else:
                wider = child
                joined.append(child)
                with_room.append(child)
            if len(wider.columns) == WIDTH:
                with_room.remove(wider)
        self.children = joined


def elimination(springs: IntArray, free: FloatArray) -> Elimination:
    """Order by least degree, and fill, of springs [S, 2] between vertices that are free (1) or fixed (0)."""
    vertices = np.flatnonzero(free > 0.0)
    count = len(vertices)
    place = np.full(len(free), count, np.int64)
    if count == 0:
        none, one = np.zeros(0, np.int64), np.zeros(1, np.int64)
        return Elimination(none, place, none, one, one, none, none, np.zeros(len(springs), np.int64))
    place[vertices] = np.arange(count)
    ends = place[springs[(place[springs] < count).all(axis=1)]]
    # Any matrix of this pattern that is positive definite fills in alike.
    degree = np.bincount(ends.ravel(), minlength=count) + 1.0
    pattern = coo_matrix((-np.ones(2 * len(ends)), (ends.ravel(), ends[:, ::-1].ravel())), (count, count))
    matrix = csc_matrix(pattern + coo_matrix((degree, (range(count), range(count))), (count, count)))
    found = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    lower = tril(found.L, -1, format="csc")
    panels = _panels(lower)
    position = np.empty(count, np.int64)
    position[[column for panel in panels for column in panel.columns]] = np.arange(count)
    place[vertices] = position[found.perm_c]
    first = np.cumsum([0, *(len(panel.columns) for panel in panels)])
    panel = np.repeat(np.arange(len(panels)), np.diff(first))
    rows = []
    for (begin, end), each in zip(pairwise(first), panels, strict=True):
        below = np.sort(position[list(each.below)])
        rows += [np.arange(begin, end), np.full(WIDTH - (end - begin), count + 1), below]
    start = np.concatenate([[0], np.cumsum([WIDTH + len(each.below) for each in panels])])
    row = np.concatenate(rows)
    depth = np.diff(first)
    for k in range(len(panels) - 1, -1, -1):
        if start[k] + WIDTH < start[k + 1]:
            depth[k] += depth[panel[row[start[k] + WIDTH]]]
    down, across = place[springs].max(axis=1), place[springs].min(axis=1)
    spring = np.full(len(springs), WIDTH * len(row))
    within = down < count
    own = panel[across[within]]
    # Rows ascend within a panel but for those that it does not have, so a place is found by bisection without them.
    key = np.repeat(np.arange(len(first) - 1), np.diff(start)) * (count + 2) + row
    used = np.flatnonzero(row < count)
    at = used[np.searchsorted(key[used], own * (count + 2) + down[within])]
    spring[within] = WIDTH * at + across[within] - first[own]
    return Elimination(vertices[np.argsort(place[vertices])], place, panel, first, start, depth, 4 * row, spring)


def _panels(lower: csc_matrix) -> list[_Panel]:
    """Panels of a factor, each after all that reach it."""
    columns = [_Panel([k], set(lower.indices[a:b].tolist())) for k, (a, b) in enumerate(pairwise(lower.indptr))]
    all_columns = _Panel([], set())
    for column in columns:
        # the elimination tree: the parent of a column is the first row that it reaches
        parent = columns[min(column.below)] if column.below else all_columns
        parent.children.append(column)
    ordered: list[_Panel] = []
    waiting = [all_columns]
    while waiting:
        panel = waiting.pop()
        for child in panel.children:
            child.take_children()
        panel.join_children()
        ordered.append(panel)
        waiting += panel.children
    return ordered[:0:-1]
