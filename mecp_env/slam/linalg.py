"""Small dense linear algebra as plain loops: the same bits in every process and thread setting (no BLAS)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mecp_env.kernel import kernel

Array = NDArray[np.float64]


@kernel
def cholesky(S: Array) -> Array:
    """Lower L with L L^T = S (n,n); only the lower half of S is read. Raises ValueError when S is not positive."""
    n = S.shape[0]
    L = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            total = S[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i == j:
                if not total > 0.0:
                    raise ValueError("matrix is not positive definite")
                L[i, i] = math.sqrt(total)
            else:
                L[i, j] = total / L[j, j]
    return L


@kernel
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


@kernel
def mahalanobis(nu: Array, S: Array) -> float:
    """nu^T S^-1 nu: the normalised innovation squared (NIS) of nu (n,) under S (n,n)."""
    y = solve_lower(cholesky(S), nu)
    total = 0.0
    for i in range(y.shape[0]):
        total += y[i] * y[i]
    return total
