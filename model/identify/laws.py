"""The force laws as casadi sees them: the very functions that the kernels run, with exact derivatives."""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from tissue_contact.identify.recording import Real
from tissue_contact.kernels.laws import hunt_crossley, kelvin_voigt
from tissue_contact.scene import Contact
from tissue_contact.settings import setting

# What each law takes after depth and rate, in the scene's words for a whole contact.
LAWS: dict[str, tuple[Any, tuple[str, ...]]] = {
    "kelvin_voigt": (kelvin_voigt, ("stiffness", "damping")),
    "hunt_crossley": (hunt_crossley, ("stiffness", "dissipation", "exponent")),
}
VISCOUS = {"damping", "dissipation", "damping_per_area"}  # felt in motion only
DEPTH_MIN = 1e-300  # [m] instead of 0, where the derivative of a power by its exponent is 0 times infinity


@dataclass(frozen=True)
class Constant:
    """A constant to identify: its name in the scene, unit and range."""

    name: str
    unit: str
    minimum: float
    maximum: float


def constants_of(law: str, per_area: bool) -> tuple[Constant, ...]:
    """Constants of a law in the order in which it takes them; per area those of a distance field."""
    names = LAWS[law][1]
    if per_area:
        names = tuple(f"{n}_per_area" if n in ("stiffness", "damping") else n for n in names)
    own = [setting(Contact, name) for name in names]
    return tuple(Constant(n, s.unit, s.minimum, s.maximum) for n, s in zip(names, own, strict=True))


@dataclass(frozen=True, eq=False)
class Touches:
    """What is deep at which sample: the geometry of a fit, free of constants.

    A recording of depths has one touch a sample, with weight 1. Where depth differs over the tip, a touch stands for an
    area, or for a vector area: the force of sample s is the sum of weight times the law over its touches.
    """

    sample: np.ndarray  # shape [m], which sample
    depth: Real  # [m], shape [m]
    rate: Real  # [m/s], shape [m]
    weight: Real  # 1, or [m²] for laws per area, shape [m, d]; d = 3 for force vectors
    samples: int

    def at(self, chosen: np.ndarray) -> "Touches":
        """The touches of some samples, which are numbered anew."""
        place = np.full(self.samples, -1)
        place[chosen] = np.arange(len(chosen))
        kept = place[self.sample] >= 0
        return Touches(
            place[self.sample[kept]], self.depth[kept], self.rate[kept], self.weight[kept], len(chosen)
        )  # fmt: skip


def traced(law: str) -> ca.Function:
    """A law of (depth, rate, constants) with its gradient by the constants, from the kernel's own source."""
    function, names = LAWS[law]
    ca.GlobalOptions.setNumpyMode(1)  # numpy's functions on symbols give symbols
    depth, rate, constants = ca.SX.sym("depth"), ca.SX.sym("rate"), ca.SX.sym("constants", len(names))
    force = function.py_func(depth, rate, *ca.vertsplit(constants))
    return ca.Function(law, [depth, rate, constants], [force, ca.gradient(force, constants)])


class Force:
    """The force at all samples as a function of the constants [their units], with its exact Jacobian."""

    def __init__(self, law: str, touches: Touches) -> None:
        # What does not touch has no force, whatever the law says of its rate.
        self._deep = np.flatnonzero(touches.depth > 0.0)
        self._law = traced(law).map(max(1, self._deep.size))
        self._count = len(LAWS[law][1])
        self._touches = touches
        self.size = touches.samples * touches.weight.shape[1]
        self._last: tuple[bytes, tuple[Real, Real]] = (b"", (np.empty(0), np.empty(0)))

    def values(self, constants: Real) -> Real:
        """Force [N], shape [samples · d]."""
        return self(constants)[0]

    def slopes(self, constants: Real) -> Real:
        """Derivatives of the force by the constants, shape [samples · d, constants]."""
        return self(constants)[1]

    def __call__(self, constants: Real) -> tuple[Real, Real]:
        """Force [N], shape [samples · d], and its derivatives by the constants, shape [samples · d, constants]."""
        if self._last[0] == constants.tobytes():  # a solver asks for the force and then for its derivatives
            return self._last[1]
        t, deep, n = self._touches, self._deep, self._count
        force, slope = np.zeros((t.samples, t.weight.shape[1])), np.zeros((t.samples, t.weight.shape[1], n))
        if deep.size:
            depth = np.fmax(t.depth[deep], DEPTH_MIN)
            size, gradient = self._law(depth[None], t.rate[deep][None], np.tile(constants[:, None], deep.size))
            weight = t.weight[deep]
            np.add.at(force, t.sample[deep], np.asarray(size).T * weight)
            np.add.at(slope, t.sample[deep], weight[:, :, None] * np.asarray(gradient).T[:, None, :])
        self._last = constants.tobytes(), (force.ravel(), slope.reshape(self.size, n))
        return self._last[1]
