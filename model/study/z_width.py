"""Z-width of a scene: the stiffest contact that a haptic device bears without a limit cycle, over virtual damping."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from tissue_contact.assembly import Assembly
from tissue_contact.kernels.collision import BODIES
from tissue_contact.kernels.laws import KELVIN_VOIGT
from tissue_contact.kernels.layout import Index, Real
from tissue_contact.kernels.slots import (
    CONTACT_DAMPING,
    CONTACT_PARAMETERS,
    CONTACT_STIFFNESS,
    TISSUE_PARAMETERS,
)
from tissue_contact.simulate import Instance, Refused
from tissue_contact.study.haptic import WINDOWS, Device, bisect, close_loop, dies_away
from tissue_contact.study.press import Press

RATIO = 1.05  # of the two values between which a limit is found
REST_STEPS = 400  # of the press that finds the force of the hand
DECAYS, PERIODS = 5.0, 1.5  # of a run: times that the free device takes to slow down; swings in each window of it


@dataclass(frozen=True, eq=False)
class Search:
    """The search for one limit: the work of one task.

    ``held`` is the scene with all vertices of its tissues fixed, a rigid wall with the same contact; ``rigid`` says
    whether that is what the device presses on, or the tissue. ``low`` and ``high`` [N/m] are the stiffnesses of the
    contact between which is looked; ``soft`` [N/m] is that of the tissue under it, infinite for a rigid wall.
    """

    assembly: Assembly
    held: Assembly
    press: Press
    rigid: bool
    device: Device
    virtual: float  # [N·s/m] damping of the contact
    delay: float  # [s]
    period: float  # [s]
    speed: float  # [m/s] at the touch
    soft: float
    low: float
    high: float


class Width(NamedTuple):
    """Stiffness of the contact [N/m], as on a rigid wall at the force of the hand, on either side of the limit."""

    borne: float  # 0 where the least tried was not borne
    not_borne: float  # infinite where the greatest tried was borne
    status: str  # of the step that ended the run which was not borne, "" for a limit cycle


def z_width(search: Search) -> Width:
    """Search the limit by bisection of the logarithm of the contact's stiffness, to within `RATIO`."""
    device, ended = search.device, {}
    mass = device.mass + device.hand_mass

    def bears(stiffness: float) -> bool:
        contact = stiff_contact(search.held, search.press, device.push, stiffness, search.virtual)
        instance = Instance(search.held if search.rigid else search.assembly)
        contact.set(instance)
        search.press.put(instance, search.assembly.inputs, 0.0)
        instance.initialize()

        def push_back(way: float) -> float:
            search.press.put(instance, search.assembly.inputs, way)
            instance.step(search.period)
            return search.press.force(instance)

        slowest = 2.0 * math.pi * math.sqrt(mass * (1.0 / stiffness + 1.0 / search.soft))
        time = max(DECAYS * 2.0 * mass / (device.damping + device.hand_damping), WINDOWS * PERIODS * slowest)
        steps = math.ceil(time / search.period)
        ended[stiffness] = ""
        try:
            places = close_loop(push_back, device, search.period, search.delay, steps, search.speed)
        except Refused as refused:
            ended[stiffness] = refused.status.name
            return False
        return dies_away(places, device.quantum)

    borne, not_borne = bisect(bears, search.low, search.high, RATIO)
    return Width(borne, not_borne, ended.get(not_borne, ""))


class Contact(NamedTuple):
    """Parameters of the contacts of an instrument."""

    slots: Index  # shape [contacts], where those of each begin
    stiffness: Real  # shape [contacts]
    damping: Real  # shape [contacts]

    def set(self, instance: Instance) -> None:
        """Give them to an instance."""
        instance.parameters[self.slots + CONTACT_STIFFNESS] = self.stiffness
        instance.parameters[self.slots + CONTACT_DAMPING] = self.damping


def stiff_contact(held: Assembly, press: Press, push: float, stiffness: float, virtual: float) -> Contact:
    """Parameters with which the contact has a stiffness [N/m] and a damping [N·s/m] at a force [N] on a rigid wall.

    All contacts of the instrument are scaled alike. The slope of the force over the way is matched, as a field is
    the stiffer the more of it is touched; per area k and c both act on the area K/k.
    """
    slots = contact_slots(held, press)
    scene = held.parameters[slots + CONTACT_STIFFNESS]
    least, greatest = np.log(factors(held, slots + CONTACT_STIFFNESS))
    factor = brentq(lambda s: wall_stiffness(held, press, push, math.exp(s)) - stiffness, least, greatest, xtol=1e-4)
    found = math.exp(factor) * scene
    model = held.model
    viscous = model.contact_law[(model.contact_body == press.instrument) & (model.contact_response != BODIES)]
    # F = k d^n (1 + lambda d') has the slope lambda F over the rate.
    damping = np.where(viscous == KELVIN_VOIGT, virtual * found / stiffness, virtual / push)
    return Contact(slots, found, damping)


def factors(held: Assembly, slots: Index) -> tuple[float, float]:
    """Least and greatest factor on the parameters in some slots that keeps all of them in their ranges."""
    own = [v for v in held.variables if v.block == "parameters" and v.slot in slots]
    # a little within, as products round
    return 1.001 * max(v.minimum / v.start for v in own), 0.999 * min(v.maximum / v.start for v in own)


def wall_stiffness(held: Assembly, press: Press, push: float, factor: float) -> float:
    """Slope [N/m] of the force over the way on a rigid wall, where an instrument at rest is pushed with a force [N].

    ``factor`` is that on the stiffness of the scene's contacts. A contact too soft to bear the force gives 0.
    """
    instance = Instance(held)
    slots = contact_slots(held, press) + CONTACT_STIFFNESS
    instance.parameters[slots] *= factor

    def force(way: float) -> float:
        press.put(instance, held.inputs, way)
        instance.initialize()
        return press.force(instance)

    if force(press.reach) <= push:
        return 0.0
    if force(0.0) >= push:  # stiffer than the place of the touch is known
        return math.inf
    way = brentq(lambda way: force(way) - push, 0.0, press.reach, xtol=1e-15, rtol=1e-6)
    step = 0.01 * way
    return (force(way + step) - force(way - step)) / (2.0 * step)


def contact_slots(assembly: Assembly, press: Press) -> Index:
    """Where the parameters of the instrument's contacts with tissues begin."""
    model = assembly.model
    own = np.flatnonzero((model.contact_body == press.instrument) & (model.contact_response != BODIES))
    return np.asarray(TISSUE_PARAMETERS * model.tissue_rate.size + CONTACT_PARAMETERS * own, np.uint32)


def stiffness_range(held: Assembly, press: Press, push: float) -> tuple[float, float]:
    """Least and greatest stiffness [N/m] on a rigid wall that the ranges of the contacts' parameters allow."""
    low, high = factors(held, contact_slots(held, press) + CONTACT_STIFFNESS)
    # What bears the force only beyond the reach is no contact to compare with.
    while wall_stiffness(held, press, push, low) == 0.0 and low < high:
        low *= 2.0
    # a little within, as the search for the factor must find both ends
    return 1.01 * wall_stiffness(held, press, push, low), 0.99 * wall_stiffness(held, press, push, high)


def resting_force(assembly: Assembly, press: Press, way: float, h: float) -> float:
    """Force [N] of the tissue on an instrument that has gone some way [m] beyond the touch and rests there."""
    instance = Instance(assembly)
    press.put(instance, assembly.inputs, 0.0)
    instance.initialize()
    for n in range(1, REST_STEPS + 1):
        press.put(instance, assembly.inputs, way * min(1.0, 2.0 * n / REST_STEPS))
        instance.step(h)
    return press.force(instance)
