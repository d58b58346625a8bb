"""The equations of a scene, for the documentation in its FMU: of what docs/model.md tells, what the scene has.

An effect, response, law or scheme is one paragraph of `CHAPTERS`.
"""

import html
from collections.abc import Callable, Sequence
from typing import NamedTuple

from tissue_contact.scene import Contact, Scene, Tissue

Names = Callable[[Scene], Sequence[str]]


class Paragraph(NamedTuple):
    """A text with an equation, and the names of what it holds for in a scene: without any it is left out."""

    names: Names
    text: str
    equation: str = ""


def _tissues(holds: Callable[[Tissue], object]) -> Names:
    return lambda scene: [t.name for t in scene.tissue if holds(t)]


def _contacts(holds: Callable[[Contact], object]) -> Names:
    return lambda scene: [c.name for c in scene.contact if holds(c)]


def _with_tissue(holds: Callable[[Contact], object], wanted: bool = True) -> Names:
    """Contacts of a tissue, or those of two bodies."""

    def names(scene: Scene) -> Sequence[str]:
        tissues = {t.name for t in scene.tissue}
        return [c.name for c in scene.contact if holds(c) and (c.between[0] in tissues) == wanted]

    return names


def _scheme(name: str) -> Names:
    return lambda scene: [name.replace("_", " ")] if scene.tissue and scene.solver.integrator == name else []


def _substeps(fixed: bool) -> Names:
    return lambda scene: ["substeps"] if scene.tissue and (scene.solver.substeps > 0) == fixed else []


def _limited(scene: Scene) -> Sequence[str]:
    return [] if scene.solver.substeps or not scene.solver.motion_limit else _scheme("projective_dynamics")(scene)


def _field(points: str) -> str:
    return f"Depth δ is read at points of {points} in the signed distance φ of the other body; p is a pressure."


def _support(response: str, x: str) -> Paragraph:
    text = f"Depth δ below a tissue triangle: x are {x}, P is the point of collision, n the triangle's inner normal."
    return Paragraph(_contacts(lambda c: c.response == response), text, "δ = max (x − P)·n")


_IN_FIELD = "δ = −φ,  F = A p(δ, dδ/dt) ∇φ"
_IMPLICIT = "M (v′ − v) = dt f(x + dt v′, v′),  x′ = x + dt v′"

CHAPTERS = {
    "Tissue": (
        Paragraph(
            _tissues(lambda t: True),
            "A surface of point masses. A vertex i that is not fixed, with the area Aᵢ, a third of that of its "
            "triangles at rest, and the mass mᵢ, area times areal density, is moved by the sum of all forces.",
            "mᵢ dvᵢ/dt = Σ f",
        ),
        Paragraph(
            _tissues(lambda t: True),
            "Springs of stiffness k_ij and rest length l_ij; û is the unit vector from i to j.",
            "f = Σⱼ k_ij (|xⱼ − xᵢ| − l_ij) û",
        ),
        Paragraph(_tissues(lambda t: t.bending_stiffness), "Springs also between the two vertices opposite an edge."),
        Paragraph(_tissues(lambda t: t.preload), "Rest lengths that are shorter than meshed."),
        Paragraph(
            _tissues(lambda t: t.nonlinearity),
            "Springs that stiffen with their strain e, so that for k_ij stands:",
            "k_ij (1 + β e²),  e = |xⱼ − xᵢ|/l_ij − 1",
        ),
        Paragraph(_tissues(lambda t: t.damping), "Dampers in the springs.", "f = Σⱼ d_ij ((vⱼ − vᵢ)·û) û"),
        Paragraph(
            _tissues(lambda t: t.area_stiffness),
            "Resistance of every triangle against a change of its area A.",
            "f = −∂/∂xᵢ ½ k_A Σ (A − A₀)²/A₀",
        ),
        Paragraph(
            _tissues(lambda t: t.volume_stiffness),
            "Resistance against a change of the volume V.",
            "f = −∂/∂xᵢ ½ k_V (V − V₀)²/|V₀|",
        ),
        Paragraph(_tissues(lambda t: t.support_stiffness), "Elastic foundation.", "f = −Aᵢ k_s (xᵢ − xᵢ⁰)"),
        Paragraph(_tissues(lambda t: t.support_damping), "Damping of the foundation.", "f = −Aᵢ c_s vᵢ"),
        Paragraph(_tissues(lambda t: t.drag), "Drag against the surroundings.", "f = −Aᵢ c_d vᵢ"),
        Paragraph(lambda scene: [t.name for t in scene.tissue if any(scene.solver.gravity)], "Weight.", "f = mᵢ g"),
    ),
    "Contact": (
        Paragraph(_with_tissue(lambda c: c.is_field), _field("the tissue, each for an area A at rest,"), _IN_FIELD),
        Paragraph(_with_tissue(lambda c: c.is_field, False), _field("one body, each for an area A,"), _IN_FIELD),
        _support("hull", "the vertices of the convex hull of a part of the body"),
        _support("kdop", "the vertices of the k-DOP of a part of the body"),
        _support("oobb", "the corners of the object-oriented bounding box of a part of the body"),
        _support("primitive", "the corners of the body's triangles that intersect it"),
        Paragraph(
            _contacts(lambda c: c.response == "oobb_literal"),
            "Depth δ along the direction of motion u, or the inner normal n of a tissue triangle where the instrument "
            "stands still; D reaches from the point of collision to the faces of the box of a part of the body.",
            "δ = |D·u|",
        ),
        Paragraph(
            _contacts(lambda c: not c.is_field and c.pair_weight == "length"),
            "p is the force of a whole region, all that a part of the body touches; tissue triangles share it by the "
            "length of the curve in which they meet that part, w of the whole.",
            "F = w p(δ, dδ/dt) n,  Σ w = 1",
        ),
        Paragraph(
            _contacts(lambda c: not c.is_field and c.pair_weight == "none"),
            "p is the force of every pair of triangles that intersect.",
            "F = p(δ, dδ/dt) n",
        ),
        Paragraph(
            _with_tissue(lambda c: c.side == "outer"),
            "Tissue triangles that the body comes to from within are rejected.",
        ),
        Paragraph(
            _contacts(lambda c: c.law == "kelvin_voigt"),
            "Law of Kelvin and Voigt, with stiffness k and damping c.",
            "p = max(0, k δ + c dδ/dt)",
        ),
        Paragraph(
            _contacts(lambda c: c.law == "hunt_crossley"),
            "Law of Hunt and Crossley, with stiffness k, exponent n and dissipation λ.",
            "p = max(0, k δ (δ/1 m)ⁿ⁻¹ (1 + λ dδ/dt))",
        ),
        Paragraph(
            _contacts(lambda c: c.friction),
            "Coulomb friction of the coefficient μ, by the tangential velocity v_t and the slip speed ε.",
            "F_t = μ |F| v_t/√(v_t² + ε²)",
        ),
        Paragraph(_contacts(lambda c: True), "The other body takes the opposite force at the same point."),
    ),
    "Grasp": (
        Paragraph(
            lambda scene: [i.name for i in scene.instrument if i.grasp is not None],
            "Closing jaws anchor the free vertices within their reach in the body frame, with shares s by area; e is "
            "the way from a vertex to its anchor, which slides after it beyond s times the slip force.",
            "f = s (k e + c de/dt)",
        ),
    ),
    "Time": (
        Paragraph(
            _scheme("symplectic_euler"),
            "Dampers and friction, D, act at the velocities that a substep ends with.",
            "v* = v + dt f(x)/m,  M v′ = M v* + dt D(v′),  x′ = x + dt v′",
        ),
        Paragraph(_scheme("explicit_euler"), "All forces are those before.", "v′ = v + dt f(x, v)/m,  x′ = x + dt v"),
        Paragraph(_scheme("runge_kutta_4"), "The classical scheme, with four evaluations of the forces."),
        Paragraph(_scheme("implicit_euler"), "Solved by Newton's method.", _IMPLICIT),
        Paragraph(
            _scheme("projective_dynamics"), "Implicit Euler by a few iterations with one constant matrix.", _IMPLICIT
        ),
        Paragraph(_limited, "The rest of a step in which a vertex moves fast is made by symplectic Euler."),
        Paragraph(_substeps(False), "As many in a step as stability and the motion ask for."),
        Paragraph(_substeps(True), "A fixed number in a step."),
    ),
}


def equations(scene: Scene) -> str:
    """The paragraphs that hold for a scene, as HTML."""
    parts = []
    for heading, paragraphs in CHAPTERS.items():
        held = [(names, p) for p in paragraphs if (names := p.names(scene))]
        parts += [f"<h3>{heading}</h3>\n"] if held else []
        for names, (_, text, equation) in held:
            parts.append(f"<p><b>{', '.join(names)}</b>: {html.escape(text)}</p>\n")
            parts += [f'<p class="equation">{html.escape(equation)}</p>\n'] if equation else []
    return "".join(parts)
