"""Sums over vertices, each in four parts: none of them waits for the one before, as a single sum would."""

from tissue_contact.kernels.compiled import inner, pointwise


@pointwise
def square(x, y, z, v):
    """x² + y² + z² of a vertex."""
    return x[v] * x[v] + y[v] * y[v] + z[v] * z[v]


@inner
def sum_of(values):
    """Sum of the values."""
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    fours = values.size // 4
    for k in range(fours):
        a, b = a + values[4 * k], b + values[4 * k + 1]
        c, d = c + values[4 * k + 2], d + values[4 * k + 3]
    for v in range(4 * fours, values.size):
        a += values[v]
    return (a + b) + (c + d)


@inner
def sum_of_squares(weight, x, y, z):
    """Sum of the weights times x² + y² + z²."""
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    fours = weight.size // 4
    for k in range(fours):
        a, b = a + weight[4 * k] * square(x, y, z, 4 * k), b + weight[4 * k + 1] * square(x, y, z, 4 * k + 1)
        c, d = c + weight[4 * k + 2] * square(x, y, z, 4 * k + 2), d + weight[4 * k + 3] * square(x, y, z, 4 * k + 3)
    for v in range(4 * fours, weight.size):
        a += weight[v] * square(x, y, z, v)
    return (a + b) + (c + d)
