"""Small dense linear algebra as plain loops: the same bits in every process and thread setting (no BLAS)."""

from __future__ import annotations

import math

import numpy as np

from mecp_env.core.carriers import Array, Ints
from mecp_env.core.jit import compiled

TILE = 32
WIDE = 8  # doubles in the widest registers


@compiled
def solve_lower(L: Array, b: Array) -> Array:
    """y (n,) of L y = b for a lower triangular L (n,n)."""
    n = L.shape[0]
    y = np.empty(n)
    for i in range(n):
        total = b[i]
        for k in range(i):
            total -= L[i, k] * y[k]
        y[i] = total / L[i, i]
    return y


@compiled
def quadratic(M: Array, a: Array, b: Array) -> float:
    """a^T M b"""
    total = 0.0
    for i in range(a.shape[0]):
        part = 0.0
        for j in range(b.shape[0]):
            part += M[i, j] * b[j]
        total += a[i] * part
    return total


@compiled
def factor_lower(S: Array) -> bool:
    """Replace the lower half of S (n,n) by L with L L^T = S; False (S is then spoilt) when S is not positive."""
    for j in range(S.shape[0]):
        for k in range(j):
            S[j, j] -= S[j, k] * S[j, k]
        if not 0.0 < S[j, j] < np.inf:
            return False
        S[j, j] = math.sqrt(S[j, j])
        for i in range(j + 1, S.shape[0]):
            total = S[i, j]
            for k in range(j):
                total -= S[i, k] * S[j, k]
            S[i, j] = total / S[j, j]
    return True


@compiled
def forward_rows(L: Array, B: Array) -> None:
    """Replace B (m,n) by X of L X = B for a lower triangular L (m,m); whole rows, so that the inner loop is wide."""
    for i in range(B.shape[0]):
        row = B[i]
        for k in range(i):
            factor, above = L[i, k], B[k]
            for j in range(row.shape[0]):
                row[j] -= factor * above[j]
        inverse = 1.0 / L[i, i]
        for j in range(row.shape[0]):
            row[j] *= inverse


@compiled
def downdate(P: Array, n: int, W: Array) -> None:
    """P -= W^T W on the leading n x n block of a symmetric P: lower half first, then mirrored.

    W (m,w) has at least n columns, those behind the n-th are 0: rows that end at whole WIDEs leave no rest to the
    compiler's wide loop. What that writes beyond the diagonal is mirrored over.
    """
    paired = W.shape[0] - W.shape[0] % 4
    if n % 2 == 1:
        for k in range(W.shape[0]):
            P[0, 0] -= W[k, 0] * W[k, 0]
    for i in range(n % 2, n, 2):  # two rows of P, four rows of W a pass, which the compiler makes wide
        end = min(wide(i + 2), W.shape[1], P.shape[1])
        upper, lower = P[i, :end], P[i + 1, :end]
        for k in range(0, paired, 4):
            a0, a1, a2, a3 = W[k, i], W[k + 1, i], W[k + 2, i], W[k + 3, i]
            b0, b1, b2, b3 = W[k, i + 1], W[k + 1, i + 1], W[k + 2, i + 1], W[k + 3, i + 1]
            w0, w1, w2, w3 = W[k], W[k + 1], W[k + 2], W[k + 3]
            for j in range(upper.shape[0]):
                upper[j] -= (a0 * w0[j] + a1 * w1[j]) + (a2 * w2[j] + a3 * w3[j])
                lower[j] -= (b0 * w0[j] + b1 * w1[j]) + (b2 * w2[j] + b3 * w3[j])
        for k in range(paired, W.shape[0]):
            a0, b0, w0 = W[k, i], W[k, i + 1], W[k]
            for j in range(upper.shape[0]):
                upper[j] -= a0 * w0[j]
                lower[j] -= b0 * w0[j]
    mirror_lower(P, n)


@compiled
def add_product(C: Array, A: Array, B: Array, first: int, lower: bool, pairs: Ints) -> None:
    """Add A B, A (m,k), B (k,n), to C from its row and column `first` on; `lower`: above the diagonal C is spoilt.

    Only to the rows i and i + 1 (if there is one) for each i of `pairs`, which are even. Two rows of C and four of B a
    pass, so that the compiler's wide loop loads less than it computes.
    """
    (m, depth), spare = A.shape, np.zeros(B.shape[1])
    paired = depth - depth % 4
    for i in pairs:
        end, other = min(i + 2, B.shape[1]) if lower else B.shape[1], min(i + 1, m - 1)
        upper = C[first + i, first : first + end]
        under = C[first + other, first : first + end] if other > i else spare[:end]
        for k in range(0, paired, 4):
            a0, a1, a2, a3 = A[i, k], A[i, k + 1], A[i, k + 2], A[i, k + 3]
            c0, c1, c2, c3 = A[other, k], A[other, k + 1], A[other, k + 2], A[other, k + 3]
            b0, b1, b2, b3 = B[k], B[k + 1], B[k + 2], B[k + 3]
            for j in range(upper.shape[0]):
                upper[j] += (a0 * b0[j] + a1 * b1[j]) + (a2 * b2[j] + a3 * b3[j])
                under[j] += (c0 * b0[j] + c1 * b1[j]) + (c2 * b2[j] + c3 * b3[j])
        for k in range(paired, depth):
            a0, c0, b0 = A[i, k], A[other, k], B[k]
            for j in range(upper.shape[0]):
                upper[j] += a0 * b0[j]
                under[j] += c0 * b0[j]


def product(A: Array, B: Array) -> Array:
    """A B for A (m,k), B (k,n)."""
    whole: Array = product_of(A, B, np.arange(0, A.shape[0], 2))
    return whole


@compiled
def product_of(A: Array, B: Array, pairs: Ints) -> Array:
    """The rows i and i + 1 of A B for each i of `pairs`, as in `add_product`; the others are 0."""
    C = np.zeros((A.shape[0], B.shape[1]))
    add_product(C, A, B, 0, False, pairs)
    return C


@compiled
def low_rank(A: Array, rounding: float) -> tuple[Array, Array]:
    """Q (n,r) and R (r,n) with Q R = A (n,n), but for `rounding` times the norm of A's largest column in each column.

    Gram-Schmidt, the largest of the columns that are left comes next. A is overwritten.
    """
    n = A.shape[0]
    Q, R, square, first, rank = np.empty((n, n)), np.zeros((n, n)), np.zeros(n), 0.0, 0
    for i in range(n):
        for j in range(n):
            square[j] += A[i, j] * A[i, j]
    while rank < n:
        pivot = np.argmax(square)
        norm, column, row = math.sqrt(square[pivot]), Q[rank], R[rank]
        first = max(first, norm)
        if not norm > rounding * first:
            break
        for i in range(n):
            column[i] = A[i, pivot] / norm
        for i in range(n):
            for j in range(n):
                row[j] += column[i] * A[i, j]
        for j in range(n):
            square[j] = 0.0
        for i in range(n):
            left = A[i]
            for j in range(n):
                left[j] -= column[i] * row[j]
                square[j] += left[j] * left[j]
        rank += 1
    return np.ascontiguousarray(Q[:rank].T), R[:rank]


@compiled
def block_of(P: Array, rows: Ints, columns: Ints) -> Array:
    """P[np.ix_(rows, columns)], in a fraction of its time."""
    block = np.empty((rows.shape[0], columns.shape[0]))
    for i in range(rows.shape[0]):
        row, to = P[rows[i]], block[i]
        for j in range(columns.shape[0]):
            to[j] = row[columns[j]]
    return block


@compiled
def changed_part(P: Array, numbers: Ints, A: Array, B: Array, C: Array, first: int, pairs: Ints) -> None:
    """Write P[np.ix_(numbers, numbers)] + A B of a symmetric P to C, from its row and column `first` on.

    For a symmetric A B, of which only the rows i and i + 1 for each i of `pairs` are added; those of C that belong to
    no pair are spoilt, and so is what lies left of and above the part. The lower half is written and then copied, a few
    rows after the other, while they are in the cache. Numbers that follow each other are copied together.
    """
    start, runs, p = np.empty(numbers.shape[0] + 1, np.int64), 0, 0
    for j in range(numbers.shape[0]):
        if j == 0 or numbers[j] != numbers[j - 1] + 1:
            start[runs] = j
            runs += 1
    start[runs] = numbers.shape[0]
    for begin in range(0, numbers.shape[0], TILE):
        end, q = min(begin + TILE, numbers.shape[0]), p
        for i in range(begin, end):
            row, to = P[numbers[i]], C[first + i]
            for r in range(runs):
                j, stop = start[r], min(start[r + 1], i + 1)
                some, there = row[numbers[j] :], to[first + j : first + max(j, stop)]
                for k in range(there.shape[0]):
                    there[k] = some[k]
        while q < pairs.shape[0] and pairs[q] < end:
            q += 1
        add_product(C, A, B, first, True, pairs[p:q])
        mirror_rows(C, first + begin, first + end)
        p = q


@compiled
def own_blocks(P: Array, numbers: Ints, A: Array, B: Array, C: Array, first: int) -> None:
    """As `changed_part` of A and B^T, but of the blocks (2,2) on the diagonal alone, which are the same to the bit."""
    depth = A.shape[1]
    for i in range(numbers.shape[0]):
        for j in range(i - i % 2, i + 1):
            total = P[numbers[i], numbers[j]]
            for k in range(0, depth - depth % 4, 4):
                total += (A[i, k] * B[j, k] + A[i, k + 1] * B[j, k + 1]) + (
                    A[i, k + 2] * B[j, k + 2] + A[i, k + 3] * B[j, k + 3]
                )
            for k in range(depth - depth % 4, depth):
                total += A[i, k] * B[j, k]
            C[first + i, first + j] = C[first + j, first + i] = total


@compiled
def wide(n: int) -> int:
    """n, rounded up to a multiple of WIDE."""
    return (n + WIDE - 1) // WIDE * WIDE


@compiled
def mirror_lower(P: Array, n: int) -> None:
    """Copy the lower half of the leading n x n block of P to the upper half, in tiles that stay in the cache."""
    for begin in range(0, n, TILE):
        mirror_rows(P, begin, min(begin + TILE, n))


@compiled
def mirror_rows(P: Array, begin: int, end: int) -> None:
    """Copy what is left of the diagonal in some rows of P to the columns above it."""
    for first in range(0, end, TILE):
        for i in range(max(begin, first), end):
            for j in range(first, min(first + TILE, i)):
                P[j, i] = P[i, j]


@compiled
def solve3(A: Array, g: Array) -> None:
    """Replaces g (3,) by d of (A + a little) d = g for a symmetric positive A (3,3), which is overwritten."""
    for k in range(3):
        A[k, k] *= 1.0 + 1e-6
    for k in range(3):
        for i in range(k + 1, 3):
            share = A[i, k] / A[k, k]
            g[i] -= share * g[k]
            for j in range(k, 3):
                A[i, j] -= share * A[k, j]
    for k in range(2, -1, -1):
        for j in range(k + 1, 3):
            g[k] -= A[k, j] * g[j]
        g[k] /= A[k, k]


@compiled
def sandwich(J: Array, P: Array) -> Array:
    """J P J^T for J (m,n) and a symmetric P (n,n)."""
    m, n = J.shape
    half, whole = np.zeros((m, n)), np.zeros((m, m))
    for i in range(m):
        for k in range(n):
            for j in range(n):
                half[i, j] += J[i, k] * P[k, j]
    for i in range(m):
        for j in range(m):
            for k in range(n):
                whole[i, j] += half[i, k] * J[j, k]
    return whole


@compiled
def inverse3(S: Array) -> Array:
    """The inverse of a symmetric S (3,3), by its cofactors: the same bits with every kernel of a BLAS."""
    inverse, determinant = np.empty((3, 3)), 0.0
    for i in range(3):
        a, b = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            c, d = (j + 1) % 3, (j + 2) % 3
            inverse[j, i] = S[a, c] * S[b, d] - S[a, d] * S[b, c]
        determinant += S[0, i] * (S[1, a] * S[2, b] - S[1, b] * S[2, a])
    return inverse / determinant
