"""What is how deep at which sample of a recording: the geometry that a fit of the contact law alone is made on."""

import numpy as np

from tissue_contact.assemble import assemble
from tissue_contact.errors import InputError
from tissue_contact.identify.laws import Touches
from tissue_contact.identify.recording import Real, Recording
from tissue_contact.kernels.bundle import Bundle
from tissue_contact.kernels.compiled import kernel
from tissue_contact.kernels.field import body_distance, fields_of
from tissue_contact.kernels.vectors import cross, dot, rotation, to_body, to_world, turn_between
from tissue_contact.scene import Contact, Scene

RINGS = 16  # Gauss points over the part of a round tip that touches: exact for a law that is a polynomial of depth


def of_depth(recording: Recording) -> Touches:
    """One touch a sample, at its depth: for the stiffness of a whole contact. Without rates they are 0."""
    n = len(recording)
    assert recording.depth is not None
    rate = np.zeros(n) if recording.rate is None else recording.rate
    return Touches(np.arange(n), recording.depth, rate, np.ones((n, 1)), n)


def of_tip(recording: Recording, radius: float | None, area: float | None) -> Touches:
    """Touches of a round tip of a radius [m], or of a flat one of an area [m²], in a flat surface that does not bulge.

    For constants per area, such as the stiffness of an elastic foundation: a ball of radius R that is d deep feels
    k pi d² (R - d/3) of a stiffness per area k (Winkler). Deeper than R a ball goes on as a cylinder.
    """
    whole = of_depth(recording)
    if area is not None:
        return Touches(whole.sample, whole.depth, whole.rate, area * whole.weight, whole.samples)
    assert radius is not None
    node, share = np.polynomial.legendre.leggauss(RINGS)
    deep = np.clip(whole.depth, 0.0, radius)[:, None]
    gap = deep * 0.5 * (1.0 + node)  # of a ring above the lowest point; its area is 2 pi (R - gap) times its height
    n = whole.samples
    return Touches(
        np.repeat(np.arange(n), RINGS),
        (whole.depth[:, None] - gap).ravel(),
        np.repeat(whole.rate, RINGS),
        (2.0 * np.pi * (radius - gap) * deep * 0.5 * share).reshape(-1, 1),
        n,
    )


def contact_of(scene: Scene, name: str | None) -> tuple[int, Contact]:
    """Number and settings of the contact that is meant: the named one, or the only one of tissue and instrument."""
    tissues, instruments = {t.name for t in scene.tissue}, {i.name for i in scene.instrument}
    able = [
        (k, c) for k, c in enumerate(scene.contact) if c.between[0] in tissues and c.between[1] in instruments
        if name is None or c.name == name
    ]  # fmt: skip
    if len(able) != 1:
        known = ", ".join(c.name for c in scene.contact) or "none"
        rule = "the contact of a tissue and an instrument that is to be fitted must be named where there are several"
        raise InputError(
            f"{scene.place}, --contact", rule, name or f"{len(able)}", f"Contacts of the scene: {known}"
        )  # fmt: skip
    return able[0]


def of_pose(recording: Recording, scene: Scene, contact: int) -> Touches:
    """Touches of the instrument's distance field with the tissue at rest, which keeps its shape, at the poses recorded.

    As the response `distance_field` of the model reads depth and direction, but that no side is rejected. The weight
    turns a pressure into the force on the instrument, world frame.
    """
    chosen = scene.contact[contact]
    if not chosen.is_field:
        raise InputError(
            f"{scene.place}, contact[{chosen.name}].response",
            "a fit of the law alone to poses needs the response distance_field",
            chosen.response,
            "Change it, record depths instead of poses, or fit the whole model with --parameter",
        )
    if recording.pose is None or recording.force_vector is None:
        raise InputError(
            recording.place,
            "a fit to a scene needs the pose and the force vector",
            "neither" if recording.pose is None and recording.force_vector is None else "one of the two",
            "Give columns for both, or leave --scene out to fit depths",
        )
    model = Bundle(assemble(scene).model)
    poses, motions = recording.pose, motions_of(recording)
    count = _deep(model, contact, poses, motions, np.empty(0, np.int64), np.empty((0, 5)))
    sample, found = np.empty(count, np.int64), np.empty((count, 5))
    _deep(model, contact, poses, motions, sample, found)
    return Touches(sample, found[:, 0], found[:, 1], found[:, 2:], len(recording))


def motions_of(recording: Recording) -> Real:
    """Velocity [m/s] and spin [rad/s] with which each pose was reached from the one before, shape [n, 6]."""
    motions = np.zeros((len(recording), 6))
    if recording.time is not None and recording.pose is not None:
        p = recording.pose
        for n, h in enumerate(np.diff(recording.time), start=1):
            motions[n, :3] = (p[n, :3] - p[n - 1, :3]) / h
            motions[n, 3:] = np.array(turn_between(tuple(p[n - 1, 3:]), tuple(p[n, 3:]))) / h
    return motions


@kernel
def _deep(model, contact, poses, motions, sample, found):
    """Count the touches; where there is room, note sample, depth, rate and area times direction of each."""
    tissue, body = model.contact_tissue[contact], model.contact_body[contact]
    fields = fields_of(model)
    first, last = model.body_part_start[body], model.body_part_start[body + 1]
    x, y, z = model.rest_x, model.rest_y, model.rest_z
    count = 0
    for n in range(len(poses)):
        p = (poses[n, 0], poses[n, 1], poses[n, 2])
        r = rotation((poses[n, 3], poses[n, 4], poses[n, 5], poses[n, 6]))
        velocity, spin = (motions[n, 0], motions[n, 1], motions[n, 2]), (motions[n, 3], motions[n, 4], motions[n, 5])
        for t in range(model.tissue_triangle_start[tissue], model.tissue_triangle_start[tissue + 1]):
            a, b, c = model.triangle_a[t], model.triangle_b[t], model.triangle_c[t]
            for q in range(model.triangle_point_start[t], model.triangle_point_start[t + 1]):
                wa, wb, wc = model.point_a[q], model.point_b[q], model.point_c[q]
                arm = (
                    wa * x[a] + wb * x[b] + wc * x[c] - p[0],
                    wa * y[a] + wb * y[b] + wc * y[c] - p[1],
                    wa * z[a] + wb * z[b] + wc * z[c] - p[2],
                )
                distance, gx, gy, gz = body_distance(fields, first, last, to_body(r, arm))
                if not distance < 0.0:
                    continue
                if count < len(sample):
                    g, turn, area = to_world(r, (gx, gy, gz)), cross(spin, arm), model.point_area[q]
                    sample[count] = n
                    found[count, 0] = -distance
                    found[count, 1] = dot(g, velocity) + dot(g, turn)
                    for k in range(3):
                        found[count, 2 + k] = -area * g[k]
                count += 1
    return count
