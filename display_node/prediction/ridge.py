"""Solution of a positive definite system by Cholesky's factors, for the kernels."""

import math

from display_node.prediction.expert import Floats
from display_node.prediction.kernels import TABLE, kernel


@kernel(f"boolean({TABLE}, {TABLE})")
def solve_ridge(squares: Floats, products: Floats) -> bool:
    """Replace each column of `products` by its solution; return False where there is none.

    squares: shape (n, n), of which the lower triangle counts; it is replaced by its factor.
    products: shape (n, columns).
    """
    size, columns = products.shape
    for row in range(size):
        for column in range(row + 1):
            total = squares[row, column]
            for inner in range(column):
                total -= squares[row, inner] * squares[column, inner]
            if row > column:
                squares[row, column] = total / squares[column, column]
            elif total > 0.0 and total < math.inf:
                squares[row, row] = math.sqrt(total)
            else:
                return False
    for row in range(size):
        solved = products[row]
        for inner in range(row):
            factor, earlier = squares[row, inner], products[inner]
            for column in range(columns):
                solved[column] -= factor * earlier[column]
        for column in range(columns):
            solved[column] /= squares[row, row]
    for row in range(size - 1, -1, -1):
        solved = products[row]
        for inner in range(row + 1, size):
            factor, later = squares[inner, row], products[inner]
            for column in range(columns):
                solved[column] -= factor * later[column]
        for column in range(columns):
            solved[column] /= squares[row, row]
    return True
