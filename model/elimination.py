"""In which order the vertices of the tissues are eliminated from a matrix of their springs, and what fills in."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csc_matrix, tril
from scipy.sparse.linalg import splu

from tissue_contact.geometry import FloatArray

IntArray = NDArray[np.signedinteger[Any]]


class Elimination(NamedTuple):
    """Places of the entries of a factor L; fields as those of the `Model` that begin with ``factor_``.

    F rows, one for each free vertex, N entries below the diagonal. F, and N, stand for what is not there.
    """

    vertex: IntArray  # shape [F], vertex of each row
    place: IntArray  # shape [V], row of each vertex
    start: IntArray  # shape [F + 1], where the entries of a column begin
    row: IntArray  # shape [N], four times the row, ascending within a column
    across_start: IntArray  # shape [F + 1], where the entries of a row begin
    across_column: IntArray  # shape [N], four times the column, ascending within a row
    across_entry: IntArray  # shape [N], the entry's number by columns
    spring: IntArray  # shape [S], entry of each spring


def elimination(springs: IntArray, free: FloatArray) -> Elimination:
    """Order by least degree, and fill, of springs [S, 2] between vertices that are free (1) or fixed (0)."""
    vertices = np.flatnonzero(free > 0.0)
    count = len(vertices)
    place = np.full(len(free), count, np.int64)
    if count == 0:
        none, one = np.zeros(0, np.int64), np.zeros(1, np.int64)
        return Elimination(none, place, one, none, one, none, none, np.zeros(len(springs), np.int64))
    place[vertices] = np.arange(count)
    ends = place[springs[(place[springs] < count).all(axis=1)]]
    # Any matrix of this pattern that is positive definite fills in alike.
    degree = np.bincount(ends.ravel(), minlength=count) + 1.0
    pattern = coo_matrix((-np.ones(2 * len(ends)), (ends.ravel(), ends[:, ::-1].ravel())), (count, count))
    matrix = csc_matrix(pattern + coo_matrix((degree, (range(count), range(count))), (count, count)))
    found = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    order = np.argsort(found.perm_c)
    lower = tril(found.L, -1, format="csc")
    lower.sort_indices()
    column = np.repeat(np.arange(count), np.diff(lower.indptr))
    by_row = np.lexsort((column, lower.indices))
    place[vertices[order]] = np.arange(count)
    rows, columns = place[springs].max(axis=1), place[springs].min(axis=1)
    spring = np.full(len(springs), lower.nnz)
    within = rows < count
    # Entries by columns ascend in column and row, so that a place is found by bisection.
    spring[within] = np.searchsorted(column * count + lower.indices, columns[within] * count + rows[within])
    return Elimination(
        vertices[order],
        place,
        lower.indptr,
        4 * lower.indices,
        np.concatenate([[0], np.cumsum(np.bincount(lower.indices, minlength=count))]),
        4 * column[by_row],
        by_row,
        spring,
    )
