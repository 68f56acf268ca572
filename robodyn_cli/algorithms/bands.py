"""Matrices of mechanisms with many loops: each row holds few coordinates, so that rows and columns can be put in an
order in which all entries lie in a narrow band about the diagonal.

What is found there is what dense matrices give, but for rounding: singular values by reduction of the band to two
diagonals (Golub and Van Loan, Matrix Computations, 4th ed., section 8.6; LAPACK's dgbbrd and dbdsqr), solutions and
determinants by elimination with pivots inside the band (dgbtrf). Small matrices, and those without such an order, are
left to numpy.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.algorithms.constraints import parity
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

FEWEST = 64  # rows and columns from which on an order is looked for
NARROW = (
    12  # times the width of the band that rows and columns have to be, so that its reduction takes less time
)
SURE = 1e-5  # of the norm: smallest singular values above it are told from zero without finding them
AT_A_TIME = 1 << 21  # entries of matrices that are held at a time where samples are gone through in parts

Places = NDArray[np.intp]


@record
class Band:
    """An order in which entries lie from ``lower`` diagonals below the main one to ``upper`` above it.

    size : of the square that holds the band; where a matrix is none, zeros stretch its shorter side. rows, columns :
    places of entries that are not zero. along : the column of each in the band. across : the diagonal of each, the
    uppermost first. row_order, column_order : which row and column of the matrix comes k-th.
    """

    size: int
    rows: Places
    columns: Places
    along: Places
    across: Places
    row_order: Places
    column_order: Places
    lower: int
    upper: int

    @staticmethod
    def of(A: Array | Scattered) -> Band | None:
        """Return the band of matrices A (T, m, n); None where they are small, or no narrow one is found."""
        m, n = A.shape[1:]
        if min(m, n) < FEWEST or not isinstance(A, (np.ndarray, Scattered)) or not len(A):
            return None  # arrays that record are none of numpy's
        rows, columns = (
            (A.rows, A.columns) if isinstance(A, Scattered) else np.nonzero((A != 0.0).any(axis=0))
        )
        if NARROW * len(rows) > m * n:  # more entries than the widest band that pays has room for
            return None
        band = Band.in_order(rows, columns, np.arange(m), np.arange(n))
        # no band is narrower than the fullest row and column: where the given one is not much wider, none is looked for
        fullest = max(int(np.bincount(places).max(initial=0)) for places in (rows, columns))
        if band.width > 2 * fullest:
            band = Band.in_order(rows, columns, *_orders(m, n, rows, columns))
        return band if NARROW * band.width <= min(m, n) else None

    @staticmethod
    def in_order(rows: Places, columns: Places, row_order: Places, column_order: Places) -> Band:
        """Return the band of entries at rows and columns in an order."""
        m, n = len(row_order), len(column_order)
        size = max(m, n)
        i, j = np.argsort(row_order)[rows] * size // m, np.argsort(column_order)[columns] * size // n
        lower, upper = (int(x.max(initial=0)) for x in (i - j, j - i))
        return Band(size, rows, columns, j, upper + i - j, row_order, column_order, lower, upper)

    @property
    def width(self) -> int:
        """The number of diagonals."""
        return self.lower + self.upper + 1

    def stored(self, A: Array | Scattered, room: int = 0) -> Array:
        """Return matrices A (T, m, n) as LAPACK stores bands (T, n, diagonals), with room above the diagonals."""
        out = np.zeros((len(A), self.size, room + self.width))
        entries = A.entries if isinstance(A, Scattered) else A[:, self.rows, self.columns]
        out[:, self.along, room + self.across] = entries
        return out


def _orders(m: int, n: int, rows: Places, columns: Places) -> tuple[Places, Places]:
    """Return the order of rows and of columns in which entries come close to the diagonal (Cuthill and McKee)."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    ends = np.concatenate([rows, m + columns]), np.concatenate([m + columns, rows])
    graph = coo_matrix((np.ones(2 * len(rows)), ends), shape=(m + n, m + n)).tocsr()
    order = reverse_cuthill_mckee(graph, symmetric_mode=True)
    return order[order < m].astype(np.intp), (order[order >= m] - m).astype(np.intp)


@record
class Scattered:
    """Matrices (T, m, n) by those entries (T, k), at rows and columns (k,), that are not zero everywhere; a part of
    them is an array."""

    entries: Array
    rows: Places
    columns: Places
    sides: tuple[int, int]

    def __len__(self) -> int:
        return len(self.entries)

    @property
    def shape(self) -> tuple[int, int, int]:
        return len(self.entries), *self.sides

    def of_columns(self, columns: Sequence[int]) -> Scattered:
        """Return the matrices with some of their columns, in order."""
        place = np.full(self.sides[1], -1)
        place[list(columns)] = np.arange(len(columns))
        kept = place[self.columns] >= 0
        sides = self.sides[0], len(columns)
        return Scattered(self.entries[:, kept], self.rows[kept], place[self.columns[kept]], sides)

    def __getitem__(self, part: slice) -> Array:
        own = self.entries[part]
        out = np.zeros((len(own), *self.sides))
        out[:, self.rows, self.columns] = own
        return out


def parts(shape: tuple[int, ...]) -> Iterator[slice]:
    """Yield parts of samples whose matrices (T, m, n) are few enough to be held at a time; one of small matrices."""
    some = max(1, AT_A_TIME // max(1, shape[1] * shape[2]))
    for first in range(0, max(shape[0], 1), some):
        yield slice(first, min(first + some, shape[0]))


def _of_dense(function: Callable[[Array], Array], A: Array | Scattered) -> Array:
    """Return a function of matrices (T, m, n) as arrays, few of which are made at a time."""
    if isinstance(A, Scattered):
        return np.concatenate([function(A[part]) for part in parts(A.shape)])
    return function(A)


def singular_values(A: Array | Scattered) -> Array:
    """Return the singular values of a matrix (m, n), or of several (T, m, n), largest first.

    Raises
    ------
    LinAlgError : an entry is not finite.
    """
    if isinstance(A, np.ndarray) and A.ndim == 2:
        own: Array = singular_values(A[None])[0]
        return own
    band = Band.of(A)
    if band is None:
        return _of_dense(lambda dense: np.linalg.svd(dense, compute_uv=False), A)
    stored = band.stored(A)
    if not np.isfinite(stored).all():
        raise np.linalg.LinAlgError("an entry is not finite")
    return np.array([_of_band(x, band)[: min(A.shape[1:])] for x in stored])


def full_rank(A: Array, ratio: float) -> NDArray[np.bool_]:
    """Return where the smallest singular value of matrices A (T, m, n) is above ``ratio`` times the largest (T,).

    Raises
    ------
    LinAlgError : an entry is not finite.
    """
    band = Band.of(A)
    if band is None:
        return _above(singular_values(A), ratio)
    found = _surely_above(A, band, ratio)
    if not found.all():
        found[~found] = _above(singular_values(A[~found]), ratio)
    return found


def _above(values: Array, ratio: float) -> NDArray[np.bool_]:
    above: NDArray[np.bool_] = values[:, -1] > ratio * values[:, 0]
    return above


def _surely_above(A: Array, band: Band, ratio: float) -> NDArray[np.bool_]:
    """Return of which matrices in a band the smallest singular value is surely above ``ratio`` times the largest (T,).

    B^T B - s^2 has a Cholesky factor only if all singular values of B are above s. B is A with rows of one size, those
    of a long mechanism's loops are small beside others; the smallest singular value of A is no less than that of B
    times the smallest row. The norm of all entries is no less than the largest singular value; s is far above what
    rounding makes of B^T B.
    """
    from scipy.linalg.lapack import dpbtrf

    entries = A[:, band.rows, band.columns]
    largest = np.abs(entries).max(axis=1, initial=0.0)
    if not np.isfinite(largest).all():
        raise np.linalg.LinAlgError("an entry is not finite")
    entries = entries / np.where(largest > 0.0, largest, 1.0)[:, None]
    norm = np.sqrt((entries**2).sum(axis=1))
    _, first, row = np.unique(band.rows, return_index=True, return_inverse=True)  # they come in order
    rows = np.sqrt(np.add.reduceat(entries**2, first, axis=1))
    rows = np.where(rows > 0.0, rows, np.inf)  # what is zero stays so, and is no smallest one
    least = rows.min(axis=1)
    stored = band.stored(Scattered(entries / rows[:, row], band.rows, band.columns, A.shape[1:]))
    size, width = stored.shape[1:]
    square = np.zeros((len(stored), width, size))
    for k in range(min(width, size)):
        square[:, k, : size - k] = (stored[:, : size - k, k:] * stored[:, k:, : width - k]).sum(axis=2)
    square[:, 0] -= np.maximum(SURE**2 * len(first), (2.0 * ratio * norm / least) ** 2)[:, None]
    stretched = np.ones(size, dtype=bool)  # columns that only make the band square
    stretched[np.arange(len(band.column_order)) * size // len(band.column_order)] = False
    square[:, 0, stretched] = 1.0
    return np.array([dpbtrf(x, lower=1)[1] == 0 for x in square], dtype=bool)


def solved(A: Array, b: Array) -> Array:
    """Return x (T, n) with A x = b for matrices A (T, n, n).

    Raises
    ------
    LinAlgError : a matrix is singular.
    """
    band = Band.of(A)
    if band is None:
        dense: Array = np.linalg.solve(A, b[..., None])[..., 0]
        return dense
    from scipy.linalg.lapack import dgbtrs

    x = np.empty_like(b)
    for k, (factors, pivots) in enumerate(_eliminated(A, band)):
        if not factors[band.lower + band.upper].all():
            raise np.linalg.LinAlgError("singular matrix")
        x[k, band.column_order], _ = dgbtrs(factors, band.lower, band.upper, b[k, band.row_order], pivots)
    return x


def slogdet(A: Array) -> tuple[Array, Array]:
    """Return the signs (T,) of the determinants of matrices A (T, n, n), 0 of singular ones, and logarithms of their
    sizes."""
    band = Band.of(A)
    if band is None:
        dense: tuple[Array, Array] = np.linalg.slogdet(A)
        return dense
    return _of_triangles(A, band)


def _of_triangles(A: Array | Scattered, band: Band) -> tuple[Array, Array]:
    """Return the same by elimination in a band."""
    order = parity(band.row_order) * parity(band.column_order)
    swapped, found = np.arange(band.size), []
    for factors, pivots in _eliminated(A, band):
        diagonal = factors[band.lower + band.upper]
        sign = order * (-1.0) ** np.count_nonzero(pivots != swapped) * np.sign(diagonal).prod()
        found.append((sign, np.log(np.abs(diagonal)).sum() if sign else -np.inf))
    both = np.array(found)
    return both[:, 0], both[:, 1]


def determinants(A: Array | Scattered) -> Array:
    """Return the determinants (T,) of matrices A (T, n, n)."""
    band = Band.of(A)
    if band is None:
        return _of_dense(np.linalg.det, A)
    sign, log = _of_triangles(A, band)
    return sign * np.exp(log)


def _eliminated(A: Array | Scattered, band: Band) -> Iterator[tuple[Array, Places]]:
    """Yield the factors of each matrix (T, n, n), in a band, and which row was swapped with each."""
    from scipy.linalg.lapack import dgbtrf

    for stored in band.stored(A, room=band.lower):
        factors, pivots, _ = dgbtrf(stored.T, band.lower, band.upper, overwrite_ab=True)
        yield factors, pivots


def _of_band(stored: Array, band: Band) -> Array:
    """Return the singular values of one matrix in a band, which is overwritten."""
    n, width, none = band.size, stored.shape[1], np.zeros(1)
    values, beside, room = np.zeros(n), np.zeros(n), np.zeros(4 * n)
    _call("dgbbrd", b"N", n, n, 0, band.lower, band.upper, stored, width, values, beside,
          none, 1, none, 1, none, 1, room)  # fmt: skip
    if _call("dbdsqr", b"U", n, 0, 0, 0, values, beside, none, 1, none, 1, none, 1, room):
        raise np.linalg.LinAlgError("the singular values do not converge")
    return values


def _call(name: str, *arguments: bytes | int | Array) -> int:
    """Call a routine of LAPACK that scipy has without a function of its own; returns what it says of its end."""
    info = ctypes.c_int(0)
    given: list[Any] = []
    for x in arguments:
        if isinstance(x, bytes):
            given.append(ctypes.c_char_p(x))
        else:
            given.append(
                ctypes.byref(ctypes.c_int(x)) if isinstance(x, int) else ctypes.c_void_p(x.ctypes.data)
            )
    _routine(name)(*given, ctypes.byref(info))
    return info.value


def _routine(name: str) -> Callable[..., None]:
    from scipy.linalg import cython_lapack

    capsule, python = cython_lapack.__pyx_capi__[name], ctypes.pythonapi
    signature = ctypes.PYFUNCTYPE(ctypes.c_char_p, ctypes.py_object)(("PyCapsule_GetName", python))
    address = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.py_object, ctypes.c_char_p)(
        ("PyCapsule_GetPointer", python)
    )
    return ctypes.CFUNCTYPE(None)(address(capsule, signature(capsule)) or 0)
