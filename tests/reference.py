"""The equations of one tissue under one round instrument, written a second time: plain numpy, continuous in time.

What the kernels are compared with. Nothing of theirs is used here, not even the lists of springs: a tissue is made of
vertices and triangles, sums run over sparse incidence matrices, and scipy integrates with a controlled error. Work of
the instrument and what the dampers take are states of the same system, so they are as exact as the motion.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.sparse import csr_matrix
from scipy.spatial.transform import Rotation

Array = np.ndarray
RTOL = 1e-10  # of the integration in time


class Term(NamedTuple):
    """What one effect gives at one moment."""

    energy: float  # stored [J]
    force: Array  # minus the gradient of the energy [N], shape [V, 3]
    drag: Array  # forces that store nothing: dampers, friction [N], shape [V, 3]
    loss: float  # what these take [W]


class Touch(NamedTuple):
    """What the contact gives at one moment."""

    term: Term
    force: Array  # on the instrument [N], shape [3]
    torque: Array  # about the origin of the body frame [N·m], shape [3]
    power: float  # of the instrument on the tissue [W]
    point: Array  # mean of the points inside, weighted by their normal forces [m], shape [3]
    inside: Array  # which points are inside, shape [I]
    depth: Array  # their depths [m], shape [I]
    gradient: Array  # of the field there, shape [I, 3]


NOTHING = Touch(
    Term(0.0, np.zeros((1, 3)), np.zeros((1, 3)), 0.0),
    force=np.zeros(3), torque=np.zeros(3), power=0.0, point=np.zeros(3),
    inside=np.empty(0, int), depth=np.empty(0), gradient=np.empty((0, 3)),
)  # fmt: skip


class Pose(NamedTuple):
    """An instrument at one moment."""

    rotation: Array  # body to world, shape [3, 3]
    origin: Array  # [m], shape [3]
    velocity: Array  # of the origin [m/s], shape [3]
    spin: Array  # [rad/s], world, shape [3]


# --- tissue -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Tissue:
    """A surface of springs; the constants have the names and units of the scene file."""

    rest: Array  # [m], shape [V, 3]
    triangles: Array  # shape [T, 3]
    free: Array  # bool, shape [V]
    node_area: Array  # [m²], shape [V]
    springs: Array  # shape [S, 2]
    spring_stiffness: Array  # [N/m], shape [S]
    spring_rest: Array  # [m], shape [S]
    areal_density: float
    damping: float = 0.0
    nonlinearity: float = 0.0
    area_stiffness: float = 0.0
    volume_stiffness: float = 0.0
    drag: float = 0.0
    support_stiffness: float = 0.0
    support_damping: float = 0.0
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def mass(self) -> Array:
        """Of every vertex [kg]."""
        return self.areal_density * self.node_area


def edges(triangles: Array) -> dict[tuple[int, int], list[int]]:
    """Every edge once, lower vertex first, with the vertices opposite to it."""
    found: dict[tuple[int, int], list[int]] = {}
    for corners in triangles.tolist():
        for k in range(3):
            a, b, opposite = corners[k], corners[k - 1], corners[k - 2]
            found.setdefault((min(a, b), max(a, b)), []).append(opposite)
    return found


def on_boundary(triangles: Array, vertices: int) -> Array:
    """Which vertices lie at an edge of one triangle only, bool, shape [V]."""
    out = np.zeros(vertices, bool)
    for edge, opposite in edges(triangles).items():
        if len(opposite) == 1:
            out[list(edge)] = True
    return out


def make_tissue(
    rest: Array, triangles: Array, fixed: Array, *, stiffness: float, bending_stiffness: float = 0.0,
    preload: float = 0.0, **constants: Any,
) -> Tissue:  # fmt: skip
    """Tissue of a mesh at rest; ``fixed`` says which vertices never move."""
    found = edges(triangles)
    springs = list(found)
    values = [stiffness] * len(springs)
    if bending_stiffness > 0.0:
        flaps = [opposite for opposite in found.values() if len(opposite) == 2]
        springs += [(a, b) for a, b in flaps]
        values += [bending_stiffness] * len(flaps)
    pairs = np.array(springs)
    meshed = np.linalg.norm(rest[pairs[:, 1]] - rest[pairs[:, 0]], axis=1)
    area = np.zeros(len(rest))
    for corners, own in zip(triangles, _areas(rest, triangles)[0], strict=True):
        area[corners] += own / 3
    return Tissue(rest, triangles, ~fixed, area, pairs, np.array(values), (1 - preload) * meshed, **constants)


def _cross(a: Array, b: Array) -> Array:
    """Vector product along the last axis; numpy's own takes longer than all the rest of a small system."""
    a, b = a[..., [1, 2, 0, 2, 0, 1]], b[..., [2, 0, 1, 1, 2, 0]]
    product = a * b
    return product[..., :3] - product[..., 3:]


def _areas(x: Array, triangles: Array) -> tuple[Array, Array]:
    """Area [m²] and unit normal of every triangle."""
    a, b, c = x[triangles[:, 0]], x[triangles[:, 1]], x[triangles[:, 2]]
    normal = _cross(b - a, c - a)
    length = np.sqrt((normal**2).sum(axis=1))
    return 0.5 * length, normal / length[:, None]


def _gathered(indices: Array, forces: Array, vertices: int) -> Array:
    """Sum at every vertex, shape [V, 3], of the forces on the vertices that ``indices`` names one by one."""
    return np.column_stack([np.bincount(indices, forces[:, k], vertices) for k in range(3)])


def spring_term(tissue: Tissue, x: Array, v: Array) -> Term:
    """Springs k (1 + b e²) with strain e = L/l - 1, and dampers along them."""
    i, j = tissue.springs.T
    span = x[j] - x[i]
    length = np.sqrt((span**2).sum(axis=1))
    unit = span / length[:, None]
    k, rest, b = tissue.spring_stiffness, tissue.spring_rest, tissue.nonlinearity
    e = length / rest - 1
    pull = k * (1 + b * e**2) * (length - rest)
    rate = ((v[j] - v[i]) * unit).sum(axis=1)
    ends = np.concatenate([i, j])
    on_i = np.array([pull, tissue.damping * rate])[:, :, None] * unit
    force, drag = (_gathered(ends, np.concatenate([f, -f]), len(x)) for f in on_i)
    energy = (k * rest**2 * (e**2 / 2 + b * e**4 / 4)).sum()
    return Term(energy, force, drag, (tissue.damping * rate**2).sum())


def area_term(tissue: Tissue, x: Array) -> Term:
    """E = k/2 sum (A - A0)²/A0. A side moves the area by half its length across: dA/da = n × (c - b) / 2."""
    t = tissue.triangles
    before, _ = _areas(tissue.rest, t)
    now, normal = _areas(x, t)
    strain = (now - before) / before
    a, b, c = x[t[:, 0]], x[t[:, 1]], x[t[:, 2]]
    pull = -tissue.area_stiffness / 2 * strain[:, None] * normal
    forces = np.concatenate([_cross(pull, side) for side in (c - b, a - c, b - a)])
    energy = tissue.area_stiffness / 2 * (strain**2 * before).sum()
    return Term(energy, _gathered(t.T.ravel(), forces, len(x)), np.zeros_like(x), 0.0)


def volume(x: Array, triangles: Array) -> float:
    """What a closed surface holds [m³]."""
    a, b, c = x[triangles[:, 0]], x[triangles[:, 1]], x[triangles[:, 2]]
    return float((a * _cross(b, c)).sum() / 6)


def volume_term(tissue: Tissue, x: Array) -> Term:
    """E = k/2 (V - V0)²/V0, dV/da = b × c / 6."""
    t = tissue.triangles
    before = volume(tissue.rest, t)
    strain = (volume(x, t) - before) / before
    a, b, c = x[t[:, 0]], x[t[:, 1]], x[t[:, 2]]
    slopes = np.concatenate([_cross(b, c), _cross(c, a), _cross(a, b)]) / 6
    force = -tissue.volume_stiffness * strain * _gathered(t.T.ravel(), slopes, len(x))
    energy = tissue.volume_stiffness / 2 * strain**2 * before
    return Term(energy, force, np.zeros_like(x), 0.0)


def ground_term(tissue: Tissue, x: Array, v: Array) -> Term:
    """Support, its damper, drag and weight: what a vertex feels without neighbours."""
    u, area = x - tissue.rest, tissue.node_area[:, None]
    weight = tissue.mass[:, None] * np.array(tissue.gravity)
    viscous = tissue.support_damping + tissue.drag
    force = weight - tissue.support_stiffness * area * u
    energy = (tissue.support_stiffness / 2 * area * u**2 - weight * u).sum()
    return Term(energy, force, -viscous * area * v, (viscous * area * v**2).sum())


def tissue_terms(tissue: Tissue, x: Array, v: Array) -> dict[str, Term]:
    """All that a tissue does by itself; area and volume only where they are asked for."""
    terms = {"springs": spring_term(tissue, x, v), "ground": ground_term(tissue, x, v)}
    if tissue.area_stiffness > 0.0:
        terms["area"] = area_term(tissue, x)
    if tissue.volume_stiffness > 0.0:
        terms["volume"] = volume_term(tissue, x)
    return terms


def total(terms: list[Term]) -> Term:
    """Their sum."""
    energy, force, drag, loss = zip(*terms, strict=True)
    return Term(sum(energy), sum(force), sum(drag), sum(loss))


# --- contact ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Contact:
    """Points of a tissue in the field of a capsule along z, its lowest point at the origin of the body frame."""

    spread: csr_matrix  # areal weights, shape [P, V]
    triangle: Array  # shape [P]
    area: Array  # at rest [m²], shape [P]
    radius: float
    length: float  # over all; 2 radius is a sphere
    law: str  # kelvin_voigt or hunt_crossley
    stiffness: float  # per area
    damping: float = 0.0  # per area, of kelvin_voigt
    exponent: float = 1.5  # of hunt_crossley, as is
    dissipation: float = 0.0
    friction: float = 0.0
    slip_speed: float = 1e-3


def make_contact(tissue: Tissue, spacing: float, **constants: Any) -> Contact:
    """Contact of a tissue at the centroids of n² equal parts of every triangle, which are about ``spacing`` apart."""
    columns, weights, triangle, area = [], [], [], []
    areas, _ = _areas(tissue.rest, tissue.triangles)
    for t, corners in enumerate(tissue.triangles.tolist()):
        a, b, c = tissue.rest[corners]
        longest = max(np.linalg.norm(b - a), np.linalg.norm(c - b), np.linalg.norm(a - c))
        n = int(np.clip(np.ceil(longest / spacing), 1, 8))
        upright = [(i + 1 / 3, j + 1 / 3) for i in range(n) for j in range(n - i)]
        hanging = [(i + 2 / 3, j + 2 / 3) for i in range(n - 1) for j in range(n - 1 - i)]
        for p, q in upright + hanging:
            columns += corners
            weights += [1 - (p + q) / n, p / n, q / n]
            triangle.append(t)
            area.append(areas[t] / n**2)
    rows = np.repeat(np.arange(len(area)), 3)
    spread = csr_matrix((weights, (rows, columns)), shape=(len(area), len(tissue.rest)))
    return Contact(spread, np.array(triangle), np.array(area), **constants)


def field(contact: Contact, p: Array) -> tuple[Array, Array]:
    """Signed distance of points of the body frame from the instrument [m] and its gradient."""
    nearest = np.zeros_like(p)
    nearest[:, 2] = np.clip(p[:, 2], contact.radius, contact.length - contact.radius)
    away = p - nearest
    distance = np.sqrt((away**2).sum(axis=1))
    return distance - contact.radius, away / distance[:, None]


def contact_term(contact: Contact, pose: Pose, x: Array, v: Array) -> Touch:
    """Normal force and friction at every point that lies inside the instrument."""
    arm = contact.spread @ x - pose.origin
    distance, gradient = field(contact, arm @ pose.rotation)
    inside = np.flatnonzero(distance < 0.0)
    arm, gradient, d = arm[inside], gradient[inside] @ pose.rotation.T, -distance[inside]
    spread, area = contact.spread[inside], contact.area[inside]
    own = pose.velocity + _cross(pose.spin, arm)
    relative = own - spread @ v
    rate = (gradient * relative).sum(axis=1)
    if contact.law == "kelvin_voigt":
        elastic = contact.stiffness * d
        stored = contact.stiffness * d**2 / 2
        pressure = np.maximum(0.0, elastic + contact.damping * rate)
    else:
        n = contact.exponent
        elastic = contact.stiffness * d**n
        stored = contact.stiffness * d ** (n + 1) / (n + 1)
        pressure = np.maximum(0.0, elastic * (1 + contact.dissipation * rate))
    slide = relative - rate[:, None] * gradient
    hold = contact.friction * pressure / np.sqrt((slide**2).sum(axis=1) + contact.slip_speed**2)
    load = area * pressure
    spring = (area * elastic)[:, None] * gradient
    other = (area * (pressure - elastic))[:, None] * gradient + (area * hold)[:, None] * slide
    force = spring + other
    term = Term(float(area @ stored), spread.T @ spring, spread.T @ other, float((other * relative).sum()))
    return Touch(
        term,
        force=-force.sum(axis=0),
        torque=-_cross(arm, force).sum(axis=0),
        power=float((force * own).sum()),
        point=pose.origin + load @ arm / load.sum() if load.any() else np.zeros(3),
        inside=inside,
        depth=d,
        gradient=gradient,
    )


# --- time -------------------------------------------------------------------------------------------------


def still(pose: Array) -> Pose:
    """An instrument at rest; the pose is x, y, z and a quaternion w, x, y, z."""
    return Pose(_turn(pose).as_matrix(), np.array(pose[:3]), np.zeros(3), np.zeros(3))


def _turn(pose: Array) -> Rotation:
    return Rotation.from_quat(np.roll(pose[3:], -1))


def even_motion(start: Array, end: Array, h: float) -> Callable[[float], Pose]:
    """Motion from one pose to the next within h [s]: along a line, about one axis, at constant speed."""
    velocity = (np.array(end[:3]) - start[:3]) / h
    spin = (_turn(end) * _turn(start).inv()).as_rotvec() / h

    def at(t: float) -> Pose:
        turn = Rotation.from_rotvec(spin * t) * _turn(start)
        return Pose(turn.as_matrix(), start[:3] + velocity * t, velocity, spin)

    return at


class Trace(NamedTuple):
    """A solution at the communication points, n + 1 rows each."""

    x: Array  # [m], shape [n + 1, V, 3]
    v: Array  # [m/s], shape [n + 1, V, 3]
    force: Array  # on the instrument [N], shape [n + 1, 3]
    torque: Array  # [N·m], shape [n + 1, 3]
    mean_force: Array  # over the step before, the force itself at the start [N], shape [n + 1, 3]
    point: Array  # mean of the points inside, weighted by their normal forces [m], 0 without, shape [n + 1, 3]
    depth: Array  # of the deepest point [m], shape [n + 1], as are the energies [J]
    kinetic: Array
    elastic: Array
    contact: Array
    work: Array  # of the instrument on the tissue so far
    dissipated: Array
    overhang: Array  # most that the field's gradient at a point inside looks along the outer normal, -1 to 1


def solve(
    tissue: Tissue, contact: Contact | None, poses: Array, h: float, x: Array | None = None, v: Array | None = None,
    rtol: float = RTOL,
) -> Trace:  # fmt: skip
    """Solution from rest, or from ``x`` and ``v``, over the communication steps between the rows of ``poses``.

    Every step is integrated by itself, as the instrument's velocity jumps between them.
    """
    size = tissue.rest.size
    free = tissue.free[:, None]
    start_v = np.zeros_like(tissue.rest) if v is None else free * v
    state = np.concatenate([(tissue.rest if x is None else x).ravel(), start_v.ravel(), np.zeros(5)])
    # of a millimetre, of a speed of 0.1 m/s, of an impulse of 1 mN·s, of an energy of 1 mJ
    atol = rtol * np.repeat([1e-3, 1e-1, 1e-3, 1e-3], [size, size, 3, 2])

    def split(y: Array) -> tuple[Array, Array]:
        return y[:size].reshape(-1, 3), y[size : 2 * size].reshape(-1, 3)

    def look(y: Array, pose: Pose) -> tuple[Term, Touch]:
        own = total(list(tissue_terms(tissue, *split(y)).values()))
        return own, NOTHING if contact is None else contact_term(contact, pose, *split(y))

    def rate(t: float, y: Array, motion: Callable[[float], Pose]) -> Array:
        own, touch = look(y, motion(t))
        forces = own.force + own.drag + touch.term.force + touch.term.drag
        return np.concatenate(
            [
                y[size : 2 * size],
                (free * forces / tissue.mass[:, None]).ravel(),
                touch.force,
                [touch.power, own.loss + touch.term.loss],
            ]
        )

    def row(pose: Pose) -> dict[str, Array | float]:
        own, touch = look(state, pose)
        x, v = split(state)
        kinetic = 0.5 * float((tissue.mass[:, None] * v**2).sum())
        return {
            "x": x, "v": v, "force": touch.force, "torque": touch.torque, "mean_force": touch.force,
            "point": touch.point, "depth": touch.depth.max(initial=0.0), "kinetic": kinetic, "elastic": own.energy,
            "contact": touch.term.energy, "work": state[-2], "dissipated": state[-1],
            "overhang": -1.0 if contact is None else _overhang(tissue, contact, touch, x),
        }  # fmt: skip

    rows = [row(still(poses[0]))]
    for start, end in pairwise(poses):
        motion = even_motion(start, end, h)
        found = solve_ivp(rate, (0, h), state, "DOP853", t_eval=[h], rtol=rtol, atol=atol, args=(motion,))
        assert found.success, found.message
        impulse = found.y[-5:-2, -1] - state[-5:-2]
        state = found.y[:, -1]
        rows.append({**row(motion(h)), "mean_force": impulse / h})
    return Trace(**{name: np.array([r[name] for r in rows]) for name in Trace._fields})


def _overhang(tissue: Tissue, contact: Contact, touch: Touch, x: Array) -> float:
    """Most that the field's gradient at a point inside looks along the outer normal of its triangle."""
    normal = _areas(x, tissue.triangles)[1][contact.triangle[touch.inside]]
    return float((normal * touch.gradient).sum(axis=1).max(initial=-1.0))
