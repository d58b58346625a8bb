"""A haptic device in a loop with a sampled contact: how stiff the contact may be, by simulation and by theory.

Along one axis a device of mass m and damping b follows

    m dv/dt = F_hand - F - b v

with the force F of the contact held from one sample to the next and given a delay later. The contact sees the place x
of the device, as its encoder gives it, at every sample; a spring K with a damper B gives F = K x + B (x - x')/T, with
x' the place a period T before. Z-width is the range of K and B that such a loop bears (Colgate and Brown 1994).
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tissue_contact.kernels.layout import Real

WINDOWS = 8  # of a run, whose swings must fall from each to the next but for the first two, in which it bounces
FALL = 0.998  # from window to window: what falls less ends in a limit cycle, what bounces at random rises at times
LEAST_SWING = 1e-7  # [m] below it is none that a hand feels or an encoder sees
QUANTA = 4.0  # swing in steps of the encoder that is no limit cycle: one step each way, and the damper's answer
SCANNED = np.geomspace(1e-3, 1e2, 50)  # times `linear_stiffness`: where the limit of a linear loop is looked for


class Device(NamedTuple):
    """A haptic device along one axis, with the hand that holds it.

    ``quantum`` [m] is the step of the encoder, 0 for none; ``push`` [N] is the steady force of the hand.
    """

    mass: float  # [kg]
    damping: float  # [N·s/m]
    quantum: float = 0.0
    push: float = 1.0
    hand_mass: float = 0.0  # [kg]
    hand_damping: float = 0.0  # [N·s/m]

    def advance(self, x: float, v: float, force: float, t: float) -> tuple[float, float]:
        """Place [m] and speed [m/s] a time t [s] later under a constant force [N], exactly.

        v' = v + p t a,  x' = x + t v + q t² a,  with a the acceleration at first, s = b t/m, p = (1 - exp(-s))/s and
        q = (1 - p)/s.
        """
        mass, damping = self.mass + self.hand_mass, self.damping + self.hand_damping
        s, a = damping * t / mass, (force - damping * v) / mass
        p = -math.expm1(-s) / s if s > 0.0 else 1.0
        q = (1.0 - p) / s if s > 1e-6 else 0.5  # of which 1 - p would leave less than the error, s/6
        return x + t * v + q * t * t * a, v + p * t * a

    def read(self, x: float) -> float:
        """Place [m] as the encoder gives it."""
        return round(x / self.quantum) * self.quantum if self.quantum > 0.0 else x


def lag(delay: float, period: float) -> tuple[int, float]:
    """Whole periods in a delay, and what is left of it [s]."""
    whole = math.floor(delay / period + 1e-9)  # a delay of whole periods has nothing left
    return whole, max(0.0, delay - whole * period)


def close_loop(
    contact: Callable[[float], float], device: Device, period: float, delay: float, steps: int, speed: float
) -> Real:
    """Places [m] of a device at the samples of a run, from a touch with a speed [m/s], shape [steps].

    ``contact`` gives the force [N] that pushes back at a place [m], once for every sample.
    """
    whole, rest = lag(delay, period)
    forces = [0.0] * (whole + 2)  # the last one first
    x, v, places = 0.0, speed, np.empty(steps)
    for n in range(steps):
        places[n] = x
        forces = [contact(device.read(x)), *forces[:-1]]
        x, v = device.advance(x, v, device.push - forces[whole + 1], rest)
        x, v = device.advance(x, v, device.push - forces[whole], period - rest)
    return places


def dies_away(places: Real, quantum: float) -> bool:
    """Whether a run ends without a limit cycle: its swing falls all the time, or is that of the encoder's steps."""
    size = len(places) // WINDOWS
    swings = np.ptp(places[len(places) - WINDOWS * size :].reshape(WINDOWS, size), axis=1)
    least = max(QUANTA * quantum, LEAST_SWING)
    return bool(swings[-1] <= least or (swings[3:] < FALL * swings[2:-1]).all())


def bisect(bears: Callable[[float], bool], low: float, high: float, ratio: float) -> tuple[float, float]:
    """Greatest value that is borne and least that is not, at most a ratio apart, by bisection of the logarithm.

    The first is 0 where ``low`` is not borne, the second infinite where ``high`` is.
    """
    if not bears(low):
        return 0.0, low
    if bears(high):
        return high, math.inf
    while high > ratio * low:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if bears(middle) else (low, middle)
    return low, high


# --- theory -----------------------------------------------------------------------------------------------


def passive_stiffness(damping: float, virtual: float, period: float, delay: float) -> float:
    """Stiffness [N/m] up to which the loop is passive, so that it is stable whatever passive hand holds the device.

    b > K (T/2 + t_d) + |B|. Without delay this is Colgate and Schenkel (1997) for K + B (z - 1)/(T z), for which it is
    also necessary. Their condition for any H,

        b > T/2 · Re[(1 - e^-jwT) H(e^jwT)] / (1 - cos wT)    for all w up to π/T,

    gives K T/2 · sin((2d + 1) wT/2)/sin(wT/2) - B cos((d + 1) wT) for a delay of d periods. The first is
    K (T/2 + d T) at most, the second |B|. With a delay the two need not fall together: then the bound is sufficient.
    """
    return max(0.0, (damping - abs(virtual)) / (0.5 * period + delay))


def linear_stiffness(device: Device, virtual: float, period: float, delay: float) -> float:
    """Stiffness [N/m] up to which this one loop is stable, about: K < (b + B)/(T/2 + t_d).

    Of Gil, Sánchez, Hulin, Preusche and Hirzinger (2009), for dampings that are small against the mass over the delay.
    """
    return (device.damping + device.hand_damping + virtual) / (0.5 * period + delay)


def loop_matrix(device: Device, stiffness: float, virtual: float, period: float, delay: float) -> Real:
    """Matrix that takes (x, v, the places of the last samples) one period on, without hand force and encoder."""
    whole, rest = lag(delay, period)
    size = 2 + whole + 2  # places back to that which the oldest force was damped with

    def following(state: Real) -> Real:
        past = [state[0], *state[2:]]

        def force(n: int) -> float:
            return float(stiffness * past[n] + virtual * (past[n] - past[n + 1]) / period)

        x, v = device.advance(state[0], state[1], -force(whole + 1), rest)
        x, v = device.advance(x, v, -force(whole), period - rest)
        return np.array([x, v, *past[: size - 2]])

    return np.column_stack([following(unit) for unit in np.eye(size)])


def exact_stiffness(device: Device, virtual: float, period: float, delay: float) -> float:
    """Least stiffness [N/m] at which the linear loop of this device is unstable, by its eigenvalues; 0 if always."""

    def bears(stiffness: float) -> bool:
        return bool(abs(np.linalg.eigvals(loop_matrix(device, stiffness, virtual, period, delay))).max() <= 1.0)

    values = linear_stiffness(device, virtual, period, delay) * SCANNED
    first = next((n for n, k in enumerate(values) if not bears(k)), None)
    if first is None:
        return math.inf
    return 0.0 if first == 0 else bisect(bears, values[first - 1], values[first], 1 + 1e-6)[0]
