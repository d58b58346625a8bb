"""Bounded nonlinear least squares with exact derivatives: one solver for laws and for whole models."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.optimize import least_squares

from tissue_contact.identify.recording import Real

LOSSES = ("linear", "huber", "soft_l1", "cauchy")


class Model(Protocol):
    """What is fitted, a function of the constants, shape [p]."""

    def values(self, constants: Real) -> Real:
        """What is compared with the measured, shape [m]."""

    def slopes(self, constants: Real) -> Real:
        """Its Jacobian, shape [m, p]."""


@dataclass(frozen=True, eq=False)
class Fit:
    """What a least squares fit came to."""

    values: Real  # shape [p]
    residual: Real  # model less measured, shape [m]
    jacobian: Real  # of the residual by the values, shape [m, p]
    weight: Real  # of each residual by the loss, 1 for plain least squares, shape [m]
    noise: float  # residual above which the loss weighs down; 1 for plain least squares
    cost: float  # half of the sum of squares, or of the loss
    evaluations: int  # of the model
    converged: bool
    message: str


def fit(
    model: Model,
    measured: Real,
    starts: Sequence[Real],
    lower: Real,
    upper: Real,
    loss: str = "linear",
    noise: float | None = None,
    tolerance: float = 1e-12,
) -> Fit:
    """Best of the fits from several starts: Gauss–Newton within a trust region and bounds (Branch and others 1999).

    Parameters
    ----------
    model
        Its Jacobian is asked for only where a step was good.
    measured : shape [m]
    starts : each of shape [p], within the bounds
    lower, upper : shape [p]
    loss
        One of `LOSSES`; all but "linear" weigh down what is far off.
    noise
        Residual above which it does [unit of measured]; without it 1.5 times the robust spread of a linear fit.
    tolerance
        Relative change of the cost at which the search ends, or a hundred times that of the constants.
    """
    if loss != "linear" and noise is None:
        plain = fit(model, measured, starts, lower, upper, tolerance=tolerance)
        spread = 1.4826 * float(np.median(np.abs(plain.residual - np.median(plain.residual))))
        noise = 1.5 * spread or 1.0
    best: Fit | None = None
    # What cannot be 0 is sought as a logarithm: a stiffness and the exponent over it then hardly bend the model.
    log = lower > 0.0
    scale = np.where(log, 1.0, np.fmax(np.abs(starts[0]), 1e-12 * upper))
    evaluations = 0

    def natural(u: Real) -> Real:
        return np.clip(np.where(log, np.exp(np.where(log, u, 0.0)), u * scale), lower, upper)

    def sought(values: Real) -> Real:
        return np.where(log, np.log(np.where(log, values, 1.0)), values / scale)

    last: tuple[Real, Real] | None = None

    def slopes(values: Real) -> Real:
        """The Jacobian, once where the search ends: the model's takes longer than all else."""
        nonlocal last
        if last is None or not np.array_equal(last[0], values):
            last = values, model.slopes(values)
        return last[1]

    low, high = sought(lower), sought(upper)
    margin = 1e-9 * (high - low)  # the solver wants to begin inside
    for start in starts:
        found = least_squares(
            lambda u: model.values(natural(u)) - measured,
            np.clip(sought(start), low + margin, high - margin),
            jac=lambda u: slopes(natural(u)) * np.where(log, natural(u), scale),
            bounds=(low, high),
            x_scale="jac",
            loss=loss,
            f_scale=noise or 1.0,
            ftol=tolerance,
            xtol=0.01 * tolerance,
            gtol=1e-15,
            max_nfev=500,
        )
        evaluations += found.nfev
        if best is None or found.cost < best.cost:
            values = natural(found.x)
            residual, jacobian = model.values(values) - measured, slopes(values)
            size = noise or 1.0
            weight = weights(residual / size, loss)
            cost, ended = float(found.cost), bool(found.status > 0)
            best = Fit(values, residual, jacobian, weight, size, cost, 0, ended, found.message)
    assert best is not None
    return Fit(**{**best.__dict__, "evaluations": evaluations})


def weights(z: Real, loss: str) -> Real:
    """Weight of residuals in units of the noise: the derivative of the loss by z²."""
    if loss == "huber":
        return 1.0 / np.fmax(1.0, np.abs(z))
    if loss == "soft_l1":
        return 1.0 / np.sqrt(1.0 + z * z)
    if loss == "cauchy":
        return 1.0 / (1.0 + z * z)
    return np.ones_like(z)
