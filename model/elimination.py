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

    F rows, one for each free vertex, in X panels: up to `WIDTH` columns, one after the other, each the first that is
    changed by the one before. Y rows of panels: `WIDTH` for its own columns, used or not, then those below them that
    its last column reaches, which the others reach as well or hold zeros for. Each has room for `WIDTH` entries.
    """

    vertex: IntArray  # shape [F], vertex of each row
    place: IntArray  # shape [V], row of each vertex, F where it is fixed
    panel: IntArray  # shape [F], panel of each row
    column: IntArray  # shape [X + 1], first column of each panel, and F
    start: IntArray  # shape [X + 1], where the rows of a panel begin
    row: IntArray  # shape [Y], four times the row, ascending within a panel; 4 F + 4 where a panel has no such column
    spring: IntArray  # shape [S], entry of each spring, 4 Y where an end is fixed


def elimination(springs: IntArray, free: FloatArray) -> Elimination:
    """Order by least degree, and fill, of springs [S, 2] between vertices that are free (1) or fixed (0)."""
    vertices = np.flatnonzero(free > 0.0)
    count = len(vertices)
    place = np.full(len(free), count, np.int64)
    if count == 0:
        none, one = np.zeros(0, np.int64), np.zeros(1, np.int64)
        return Elimination(none, place, none, one, one, none, np.zeros(len(springs), np.int64))
    place[vertices] = np.arange(count)
    ends = place[springs[(place[springs] < count).all(axis=1)]]
    # Any matrix of this pattern that is positive definite fills in alike.
    degree = np.bincount(ends.ravel(), minlength=count) + 1.0
    pattern = coo_matrix((-np.ones(2 * len(ends)), (ends.ravel(), ends[:, ::-1].ravel())), (count, count))
    matrix = csc_matrix(pattern + coo_matrix((degree, (range(count), range(count))), (count, count)))
    found = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    lower = tril(found.L, -1, format="csc")
    lower.sort_indices()
    position = _postorder(lower)
    place[vertices] = position[found.perm_c]
    column = np.repeat(np.arange(count), np.diff(lower.indptr))
    ordered = csc_matrix((lower.data, (position[lower.indices], position[column])), (count, count))
    ordered.sort_indices()
    first = _panels(ordered)
    panel = np.repeat(np.arange(len(first) - 1), np.diff(first))
    rows = []
    for begin, end in pairwise(first):
        below = ordered.indices[ordered.indptr[end - 1] : ordered.indptr[end]]
        rows += [np.arange(begin, end), np.full(WIDTH - (end - begin), count + 1), below]
    start = np.concatenate([[0], np.cumsum(WIDTH + np.diff(ordered.indptr)[first[1:] - 1])])
    row = np.concatenate(rows)
    down, across = place[springs].max(axis=1), place[springs].min(axis=1)
    spring = np.full(len(springs), WIDTH * len(row))
    within = down < count
    own = panel[across[within]]
    # Rows ascend within a panel but for those that it does not have, so a place is found by bisection without them.
    key = np.repeat(np.arange(len(first) - 1), np.diff(start)) * (count + 2) + row
    used = np.flatnonzero(row < count)
    at = used[np.searchsorted(key[used], own * (count + 2) + down[within])]
    spring[within] = WIDTH * at + across[within] - first[own]
    return Elimination(vertices[np.argsort(place[vertices])], place, panel, first, start, 4 * row, spring)


def _parents(lower: csc_matrix) -> IntArray:
    """The elimination tree: the first row that each column of a factor reaches, as many as there are if none."""
    count = lower.shape[0]
    reached = np.append(lower.indices, count)
    return np.where(np.diff(lower.indptr) > 0, reached[lower.indptr[:-1]], count)


def _postorder(lower: csc_matrix) -> IntArray:
    """Place of each column in an order that fills in alike, right after all that change it."""
    count, parent = lower.shape[0], _parents(lower)
    size = np.ones(count + 1, np.int64)
    for column in range(count):
        size[parent[column]] += size[column]
    position, last = np.empty(count, np.int64), np.full(count + 1, count - 1)
    for column in reversed(range(count)):
        position[column] = last[parent[column]]
        last[parent[column]] -= size[column]
        last[column] = position[column] - 1
    return position


def _panels(lower: csc_matrix) -> IntArray:
    """First column of each panel of a factor in postorder, and the number of columns."""
    count = lower.shape[0]
    breaks = np.append(np.flatnonzero(_parents(lower)[:-1] != np.arange(1, count)) + 1, count)
    # Columns get shorter towards the end of a chain, so the panel that is not full is the first.
    chains = zip(np.concatenate([[0], breaks[:-1]]), breaks, strict=True)
    return np.concatenate([[0], *(np.arange(end, begin, -WIDTH)[::-1] for begin, end in chains)])
