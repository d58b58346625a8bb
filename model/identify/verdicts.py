"""From a fit to what is told of it."""

from collections.abc import Sequence

import numpy as np

from tissue_contact.identify.least_squares import Fit
from tissue_contact.identify.recording import Real
from tissue_contact.identify.result import Estimate, Fitted, HeldOut
from tissue_contact.identify.statistics import (
    akaike,
    autocorrelation,
    determination,
    root_mean_square,
    uncertainty,
    verdict,
)


def estimates_of(
    fit: Fit, names: Sequence[str], units: Sequence[str], lower: Real, upper: Real
) -> tuple[list[Estimate], tuple[tuple[float, ...], ...]]:
    """Estimates with verdicts, and the correlations of those that have a number."""
    found = uncertainty(fit, lower > 0.0)
    estimates = []
    for k, (name, unit) in enumerate(zip(names, units, strict=True)):
        word, reason = verdict(k, fit, found, list(names), lower, upper)
        known = np.isfinite(found.error[k])
        estimates.append(
            Estimate(
                name=name,
                unit=unit,
                value=float(fit.values[k]) if word != "not identifiable" else None,
                standard_error=float(found.error[k]) if known else None,
                low=float(max(found.low[k], lower[k])) if known else None,
                high=float(min(found.high[k], upper[k])) if known else None,
                verdict=word,
                reason=reason,
            )
        )
    told = [k for k, e in enumerate(estimates) if e.value is not None]
    return estimates, tuple(tuple(float(c) for c in row) for row in found.correlation[np.ix_(told, told)])


def numbers(
    fit: Fit,
    measured: Real,
    scope: str,
    label: str,
    law: str,
    estimates: Sequence[Estimate],
    correlation: tuple[tuple[float, ...], ...],
) -> Fitted:
    """All that is told of one fit."""
    return Fitted(
        scope=scope,
        label=label,
        law=law,
        estimates=tuple(estimates),
        correlation=correlation,
        samples=len(measured),
        rmse=root_mean_square(fit.residual),
        r2=determination(fit.residual, measured),
        aic=akaike(fit.residual, len(fit.values)),
        autocorrelation=autocorrelation(fit.residual),
        evaluations=fit.evaluations,
        converged=fit.converged,
        message=fit.message,
    )


def tried(law: str, what: str, parts: Sequence[tuple[Real, Real]]) -> HeldOut:
    """Error on ``what`` was held out: residual and measured force of every fold."""
    missed, measured = (np.concatenate(part) for part in zip(*parts, strict=True))
    return HeldOut(
        law=law, what=what, folds=len(parts), rmse=root_mean_square(missed), r2=determination(missed, measured)
    )
