"""How far fitted constants can be trusted: standard errors, intervals, correlations, verdicts.

All of it is the linear theory at the optimum: covariance s² (J^T W J)^-1 with s² the weighted sum of squares over the
degrees of freedom (Seber and Wild 1989, Nonlinear Regression, section 5.1).
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.stats import t as student

from tissue_contact.identify.least_squares import Fit
from tissue_contact.identify.recording import Real

CONFIDENCE = 0.95
WEAK = 0.5  # relative standard error above which a constant is told as weak
ALIKE = 0.99  # correlation above which two constants are told as a pair that cannot be told apart
RANK = 1e-7  # share of the largest singular value, of unit columns, below which a direction leaves the data unchanged
AT_BOUND = 1e-6  # share of the value or the range


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Of the constants of one fit, each of shape [p]; infinite where the data say nothing."""

    error: Real  # standard error, unit of the constant
    low: Real  # of the confidence interval
    high: Real
    correlation: Real  # shape [p, p]


def uncertainty(fit: Fit, positive: npt.NDArray[np.bool_]) -> Uncertainty:
    """Standard errors, intervals of `CONFIDENCE` and correlations.

    The intervals of what is ``positive`` are even in its logarithm, in which the fit is nearly linear.
    """
    m, p = fit.jacobian.shape
    root = np.sqrt(fit.weight)
    jacobian = fit.jacobian * root[:, None]
    free = m - p
    error, correlation = np.full(p, np.inf), np.eye(p)
    norm = np.linalg.norm(jacobian, axis=0)
    felt = np.flatnonzero(norm > 0.0)
    if free > 0 and felt.size:
        _, size, right = np.linalg.svd(jacobian[:, felt] / norm[felt], full_matrices=False)
        known = size > RANK * size[0]
        # A direction that leaves the data unchanged makes every constant in it as uncertain as can be.
        lost = (np.abs(right[~known]) > 1e-3).any(axis=0)
        turned = right[known] / size[known, None]
        covariance = turned.T @ turned
        own = np.sqrt(np.diag(covariance))
        spread = np.sqrt(float((fit.weight * fit.residual**2).sum()) / free)
        error[felt] = np.where(lost, np.inf, spread * own / norm[felt])
        correlation[np.ix_(felt, felt)] = covariance / np.outer(own, own)
        if (~known).any():
            pair = right[~known][0]
            correlation[np.ix_(felt, felt)] = np.where(
                np.outer(lost, lost), -np.sign(np.outer(pair, pair)), correlation[np.ix_(felt, felt)]
            )
            np.fill_diagonal(correlation, 1.0)
    reach = student.ppf(0.5 + 0.5 * CONFIDENCE, max(free, 1)) * error
    factor = np.exp(np.fmin(reach / np.where(positive, fit.values, 1.0), 300.0))  # no value times it overflows
    low = np.where(positive, fit.values / factor, fit.values - reach)
    high = np.where(positive, fit.values * factor, fit.values + reach)
    return Uncertainty(error, low, high, correlation)


def verdict(k: int, fit: Fit, found: Uncertainty, names: list[str], lower: Real, upper: Real) -> tuple[str, str]:
    """Verdict on constant k and its reason: identified, weak, at bound or not identifiable."""
    value, error = fit.values[k], found.error[k]
    if not np.any(fit.jacobian[:, k]):
        return "not identifiable", "the force does not depend on it in these data"
    alike = [
        (names[j], found.correlation[k, j])
        for j in range(len(names))
        if j != k and abs(found.correlation[k, j]) > ALIKE
    ]
    if not np.isfinite(error):
        with_whom = f", only together with {alike[0][0]}" if alike else ""
        few = len(fit.residual) <= len(fit.values)
        return "not identifiable", "no more samples than constants" if few else f"the data do not fix it{with_whom}"
    room = AT_BOUND * max(abs(value), 1e-3 * (upper[k] - lower[k]))
    for bound, word in ((lower[k], "least"), (upper[k], "greatest")):
        if abs(value - bound) <= room or (bound == 0.0 and abs(value) < 0.01 * error):
            return "at bound", f"the best value is the {word} that is allowed, {bound:g}"
    if alike and error > 0.05 * abs(value):
        return "weak", f"correlation {alike[0][1]:.3f} with {alike[0][0]}"
    if error > WEAK * abs(value):
        return "weak", f"the standard error is {error / abs(value):.0%} of the value"
    return "identified", ""


def root_mean_square(residual: Real) -> float:
    return float(np.sqrt(np.mean(residual**2)))


def determination(residual: Real, measured: Real) -> float | None:
    """R², 1 less the sum of squares over that about the mean; None for data without spread."""
    spread = float(((measured - measured.mean()) ** 2).sum())
    return 1.0 - float((residual**2).sum()) / spread if spread > 0.0 else None


def folds(count: int, most: int, seed: int) -> list[tuple[list[int], list[int]]]:
    """Cross-validation: a shuffled count cut into parts, ``most`` at most, each with the rest that it is tried on."""
    order = np.random.default_rng(seed).permutation(count)
    parts = [sorted(int(k) for k in part) for part in np.array_split(order, min(most, count))]
    return [(sorted(set(range(count)) - set(part)), part) for part in parts]


def akaike(residual: Real, constants: int) -> float:
    """AIC of normal noise of unknown size: m ln(SSR/m) + 2 (p + 1); lower is better."""
    m = len(residual)
    return m * float(np.log(max(float((residual**2).sum()) / m, 1e-300))) + 2.0 * (constants + 1)


def autocorrelation(residual: Real) -> float:
    """Correlation of each residual with the next: near 0 for noise; towards 1 the intervals are too narrow."""
    square = float((residual**2).sum())
    return float((residual[1:] * residual[:-1]).sum()) / square if square > 0.0 else 0.0
