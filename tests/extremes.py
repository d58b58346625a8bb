"""Random scenes at the extremes of every constant, with random calls: what is done is finite and bounded, or refused.

One integer seed makes a scene and its calls. `run` does them and returns what came out; it raises `Broken` where the
model breaks a promise. As a program it runs many seeds side by side, and survives a crash and a hang of one:

    python tests/extremes.py --count 20000 --first 0 --workers 2
    python tests/extremes.py --first 1234 --count 1 --show
"""

import argparse
import collections
import json
import math
import multiprocessing
import re
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from itertools import pairwise
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import numpy as np
import warm_up

from tissue_contact import fields
from tissue_contact.assemble import assemble
from tissue_contact.assembly import Assembly
from tissue_contact.errors import InputError, WorkError
from tissue_contact.kernels import slots
from tissue_contact.kernels.collision import BODIES, FIELD
from tissue_contact.kernels.laws import KELVIN_VOIGT
from tissue_contact.kernels.step import SWING, UNEXPLAINED
from tissue_contact.scene import Scene, parse_scene
from tissue_contact.simulate import Instance
from tissue_contact.status import STATUSES

NODES_MAX = 3000  # coarse fields of odd shapes: what is tested here does not depend on their accuracy
LIMIT = 30.0  # [s] for one seed, far above what the budgets of its scene allow
FMU_SHARE = 0.1  # of the seeds, whose calls are made to an FMU as well
STARTING = 120.0  # [s] that a worker may take to load the kernels, or to compile them
RESPONSES = ("distance_field", "hull", "kdop", "oobb", "oobb_literal", "primitive")
FAULTS = {"nonfinite_input", "zero_quaternion", "parameter_range", "step_size"}
PATTERNS = {s.name: re.compile(re.escape(s.message).replace("%g", ".+")) for s in STATUSES[1:]}


class Broken(Exception):
    """A promise of the model does not hold."""


class Case(NamedTuple):
    """A scene of the generator."""

    text: str  # the scene file
    flat: bool  # a flat patch of which no vertex moves, pushed along its normal without friction by an upright body


# --- scenes -------------------------------------------------------------------------------------------------


def toml(value: object) -> str:
    """A value of TOML."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{k} = {toml(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(value) if isinstance(value, str | bool) else repr(value)


def scene_text(tables: dict[str, Any]) -> str:
    """A scene file: dictionaries become tables, lists of dictionaries arrays of tables."""
    lines = ['name = "extreme"']
    for name, table in tables.items():
        for one in table if isinstance(table, list) else [table]:
            lines.append(f"[[{name}]]" if isinstance(table, list) else f"[{name}]")
            lines += [f"{key} = {toml(value)}" for key, value in one.items()]
    return "\n".join(lines) + "\n"


class Draw:
    """Random numbers of one seed."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.wild = self.log(0.02, 1.0)  # share of the constants that go to their extremes

    def log(self, low: float, high: float) -> float:
        """Log-uniform, and sometimes one of the ends."""
        if self.chance(0.1):
            return low if self.chance(0.5) else high
        return float(np.clip(np.exp(self.rng.uniform(np.log(low), np.log(high))), low, high))

    def chance(self, share: float) -> bool:
        return bool(self.rng.random() < share)

    def pick(self, *choices: Any) -> Any:
        return choices[self.rng.integers(len(choices))]

    def constant(self, usual: tuple[float, float], extreme: tuple[float, float]) -> float:
        """A constant within its usual range, or in a wild scene within all that is allowed."""
        return self.log(*(extreme if self.chance(self.wild) else usual))

    def uniform(self, low: float, high: float) -> float:
        return float(self.rng.uniform(low, high))

    def integer(self, low: int, high: int) -> int:
        return round(self.log(low, high))

    def point(self, size: float) -> list[float]:
        return self.rng.uniform(-size, size, 3).tolist()

    def turn(self) -> list[float]:
        q = self.rng.normal(size=4)
        return (q / np.linalg.norm(q)).tolist()


def case_of(seed: int, folder: Path) -> Case:
    """The scene of a seed; its mesh files go to a folder."""
    draw = Draw(seed)
    flat = draw.chance(0.2)
    tissues = 1 if flat else draw.pick(1, 1, 1, 1, 1, 2, 2, 0)
    instruments = 1 if flat else draw.pick(1, 1, 1, 1, 2, 2, 0)
    rigids = 0 if flat else draw.pick(0, 0, 0, 0, 1)
    if tissues + instruments == 0:
        tissues = 1
    field = draw.chance(0.5)
    tables: dict[str, Any] = {"solver": _solver(draw)}
    tables["tissue"] = [_tissue(draw, i, flat, folder) for i in range(tissues)]
    tables["instrument"] = [_instrument(draw, i, flat, folder) for i in range(instruments)]
    tables["rigid"] = [
        {"name": f"rigid{i}", "shape": _body(draw, False), "position": draw.point(0.02), "rotation": draw.turn()}
        for i in range(rigids)
    ]
    contacts = []
    for k in range(instruments):
        for t in range(tissues):
            if flat or draw.chance(0.9):
                response = "distance_field" if field and not flat else draw.pick(*RESPONSES)
                contacts.append(_contact(draw, f"tissue{t}", f"instrument{k}", response, flat))
        for r in range(rigids):
            if draw.chance(0.5):
                contacts.append(_contact(draw, f"instrument{k}", f"rigid{r}", "distance_field", False))
    for t in range(tissues):
        for r in range(rigids):
            if draw.chance(0.5):
                contacts.append(_contact(draw, f"tissue{t}", f"rigid{r}", "distance_field", False))
    if instruments == 2 and draw.chance(0.5):
        contacts.append(_contact(draw, "instrument0", "instrument1", "distance_field", False))
    if contacts:
        tables["contact"] = contacts
    touched = {name for c in contacts if c["between"][0].startswith("tissue") for name in c["between"]}
    for instrument in tables["instrument"]:
        if instrument["name"] in touched and not flat and draw.chance(0.25):
            instrument["grasp"] = _grasp(draw)
    if draw.chance(0.2) and not any(t.get(effect) for t in tables["tissue"] for effect in NOT_PROJECTIVE):
        # last of all, so that every seed keeps the rest of its scene
        few = min(tables["solver"]["max_substeps"], 10)
        tables["solver"] |= {"integrator": "projective_dynamics", "iterations": draw.integer(1, 8)}
        if draw.chance(0.5):
            few = min(tables["solver"]["max_substeps"], 40)
            tables["solver"]["motion_limit"] = draw.constant((1e-5, 1e-3), (1e-7, 1.0))
        tables["solver"] |= {"max_substeps": few, "substeps": min(tables["solver"]["substeps"], few)}
    return Case(scene_text({k: v for k, v in tables.items() if v}), flat)


NOT_PROJECTIVE = ("nonlinearity", "area_stiffness", "volume_stiffness")  # which projective_dynamics refuses


def _solver(draw: Draw) -> dict[str, Any]:
    integrator = draw.pick(
        "symplectic_euler", "symplectic_euler", "symplectic_euler", "explicit_euler", "implicit_euler", "runge_kutta_4"
    )
    most = draw.integer(1, 10 if integrator == "implicit_euler" else 300)
    step = draw.constant((1e-4, 1e-2), (1e-6, 1.0))
    return {
        "step": step,
        "stop_time": 1e6,
        "gravity": [0.0, 0.0, 0.0] if draw.chance(0.6) else draw.point(20.0),
        "safety": draw.uniform(0.5, 1.0) if draw.chance(0.8) else draw.log(0.01, 1.0),
        "substeps": draw.integer(1, most) if draw.chance(0.25) else 0,
        "max_substeps": most,
        "detection_period": draw.constant((1e-4, 1e-2), (1e-6, 1.0)),
        "detection": draw.pick("continuous", "continuous", "discrete"),
        "max_pairs": draw.integer(16, 4096),
        "integrator": integrator,
        "energy_gain": draw.pick(1.0, 1.0, 1.0, 0.0, draw.log(1e-3, 1e6)),
    }


def _mesh(draw: Draw, folder: Path, name: str, size: float) -> dict[str, Any]:
    """A mesh file of a few triangles, some of them flat or twice there."""
    count = draw.integer(1, 8)
    points = draw.rng.uniform(-size, size, (count + 2, 3)) * [1.0, 1.0, draw.pick(0.0, 0.0, 0.3)]
    triangles = [[k, k + 1, k + 2] for k in range(count)]  # a strip
    if draw.chance(0.3):
        triangles.append(triangles[0])
    if draw.chance(0.3):
        triangles.append([0, 0, 1])
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in triangles]
    (folder / f"{name}.obj").write_text("\n".join(lines) + "\n")
    return {"mesh": f"{name}.obj", "open_surface": True, "many_parts": True}


def _tissue(draw: Draw, i: int, flat: bool, folder: Path) -> dict[str, Any]:
    size = draw.constant((0.01, 0.05), (2e-3, 0.5))
    out: dict[str, Any] = {"name": f"tissue{i}"}
    kind = "patch" if flat else draw.pick("patch", "patch", "patch", "ellipsoid", "ellipsoid", "mesh")
    closed = kind == "ellipsoid"
    irregular = draw.chance(0.5)
    if kind == "patch":
        out["shape"] = {
            "kind": "patch", "size": [size, size * draw.log(0.2, 1.0)], "triangles": draw.integer(2, 200),
            "seed": int(draw.rng.integers(1000)), "irregular": irregular,
        }  # fmt: skip
        if not flat and draw.chance(0.3):
            out["shape"]["curvature_radius"] = size * draw.log(1.0, 100.0) * draw.pick(1.0, -1.0)
    elif closed:
        radii = [0.5 * size * draw.log(0.2, 1.0) for _ in range(3)]
        out["shape"] = {"kind": "ellipsoid", "radii": radii, "triangles": draw.integer(20, 200)}
    else:
        out |= _mesh(draw, folder, f"tissue{i}", size)
    if "shape" in out and not flat and (closed or irregular) and draw.chance(0.3):
        side = radii[0] if closed else 0.5 * size
        corners = [[-1.0, -1.0, -1.0], [side * draw.uniform(-0.5, 1.0), 1.0, 1.0]]  # some vertex is on that side
        out["shape"] |= {"reach": corners, "growth": draw.log(0.01, 0.5)}
    if not flat and draw.chance(0.3):
        out |= {"position": draw.point(0.01), "rotation": draw.turn()}
    out["areal_density"] = draw.constant((0.3, 10.0), (1e-3, 1e3))
    if draw.chance(0.2):
        out |= {"youngs_modulus": draw.constant((1e3, 1e5), (1.0, 1e9)), "thickness": draw.log(1e-4, 1e-2)}
    else:
        out["stiffness"] = draw.constant((10.0, 1e3), (1.0, 1e7))
    for key, share, usual, extreme in (
        ("bending_stiffness", 0.2, (1.0, 100.0), (1e-2, 1e7)),
        ("nonlinearity", 0.2, (0.1, 10.0), (1e-2, 1e4)),
        ("preload", 0.2, (0.01, 0.3), (1e-3, 0.9)),
        ("damping", 0.4, (1e-3, 1.0), (1e-3, 1e4)),
        ("area_stiffness", 0.2, (0.1, 100.0), (1e-2, 1e7)),
        ("volume_stiffness", 0.4 * closed, (10.0, 1e4), (1.0, 1e9)),
        ("drag", 0.4, (1.0, 1e3), (1e-2, 1e7)),
        ("support_stiffness", 0.6, (1e4, 1e6), (1.0, 1e10)),
        ("support_damping", 0.5, (10.0, 1e4), (1e-2, 1e7)),
    ):
        if draw.chance(share):
            out[key] = draw.constant(usual, extreme)
    if flat:
        out["fixed"] = {"box": [[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]}
    elif draw.chance(0.5):
        out["fixed"] = draw.pick("none", [0], {"box": [[-1.0, -1.0, -1.0], [1.0, 1.0, 0.0]]})
    elif closed and "support_stiffness" not in out:
        out["fixed"] = "none"
    if draw.chance(0.2):
        out["probes"] = [draw.point(size)]
    return out


def _body(draw: Draw, upright: bool) -> dict[str, Any]:
    kinds = ("sphere", "capsule", "box", "cylinder")
    kind = draw.pick(*kinds) if upright or draw.chance(0.9) else draw.pick("grasper", "hook")
    size = draw.constant((1e-3, 6e-3), (1e-3, 0.1))
    long = min(1.0, size * draw.log(2.5, 30.0))
    if kind == "box":
        return {"kind": kind, "size": [size, size * draw.log(0.1, 1.0) if draw.chance(0.3) else size, long]}
    out = {"kind": kind, "radius": 0.5 * size, "triangles": draw.integer(24, 200)}
    if kind != "sphere":
        out["length"] = long
    if kind == "grasper":
        out |= {"jaw_length": 0.5 * long, "opening": draw.uniform(0.0, 0.5), "triangles": 150}
    if kind == "hook":
        out |= {"hook_length": size, "triangles": 150}
    return out


def _instrument(draw: Draw, i: int, flat: bool, folder: Path) -> dict[str, Any]:
    out: dict[str, Any] = {"name": f"instrument{i}"}
    if not flat and draw.chance(0.05):
        out |= _mesh(draw, folder, f"instrument{i}", draw.log(2e-3, 0.02))
    else:
        out["shape"] = _body(draw, flat)
    if not flat and draw.chance(0.2):
        out |= {"offset": draw.point(0.01), "rotation": draw.turn()}
    depth = draw.log(1e-5, 0.1) * draw.pick(-1.0, 1.0, 1.0)  # below 0 it starts inside
    out["start_position"] = [*draw.rng.uniform(-0.005, 0.005, 2).tolist(), depth]
    if not flat and draw.chance(0.5):
        out["start_orientation"] = draw.turn()
    return out


def _contact(draw: Draw, first: str, second: str, response: str, flat: bool) -> dict[str, Any]:
    out: dict[str, Any] = {"between": [first, second], "response": response, "name": f"{first}_{second}"}
    field, hunt = response == "distance_field", draw.chance(0.4)
    if field:
        out["stiffness_per_area"] = draw.constant((1e5, 1e7), (1e2, 1e12))
        if draw.chance(0.5):
            out["quadrature_spacing"] = draw.log(2e-3, 2e-2)
    else:
        out["stiffness"] = draw.constant((10.0, 1e3), (1.0, 1e7))
        out["pair_weight"] = draw.pick("length", "length", "none")
        if response == "kdop":
            out["kdop"] = draw.pick(6, 14, 26)
    if hunt:
        out |= {"law": "hunt_crossley", "exponent": draw.pick(1.0, 1.5, 2.0, 3.0, draw.uniform(1.0, 3.0))}
        if draw.chance(0.7):
            out["dissipation"] = draw.constant((0.1, 10.0), (1e-3, 1e3))
    elif draw.chance(0.7):
        if field:
            out["damping_per_area"] = draw.constant((1.0, 1e4), (1e-3, 1e9))
        else:
            out["damping"] = draw.constant((1e-3, 1.0), (1e-3, 1e4))
    if not flat and draw.chance(0.4):
        out |= {"friction": draw.constant((0.05, 1.0), (1e-3, 10.0)), "slip_speed": draw.log(1e-6, 1.0)}
    if field and not flat and first.startswith("tissue") and draw.chance(0.2):
        out["side"] = draw.pick("outer", "both")
    return out


def _grasp(draw: Draw) -> dict[str, Any]:
    return {
        "radius": draw.log(1e-3, 0.1),  # often beyond all the tissue, and often too small for any vertex
        "stiffness": draw.constant((10.0, 1e3), (1.0, 1e7)),
        "damping": draw.constant((1e-3, 1.0), (1e-3, 1e4)) if draw.chance(0.6) else 0.0,
        "slip_force": draw.constant((0.1, 10.0), (1e-3, 1e4)),
    }


# --- bounds -------------------------------------------------------------------------------------------------


class Watch:
    """What must hold after every step that was done, whatever the constants."""

    def __init__(self, assembly: Assembly, case: Case) -> None:
        self.assembly, self.case, self.model = assembly, case, assembly.model
        m = self.model
        self.bodies = len(m.body_radius)
        self.common = slots.BODY_OUTPUTS * self.bodies
        starts = m.tissue_triangle_start
        corners = np.array([m.rest_x, m.rest_y, m.rest_z]).T
        triangles = np.array([m.triangle_a, m.triangle_b, m.triangle_c]).T.astype(int)
        p = corners[triangles] if len(triangles) else np.zeros((0, 3, 3))
        areas = 0.5 * np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
        self.area = [areas[a:b].sum() for a, b in pairwise(starts)]
        boxes = np.array(m.body_high) - np.array(m.body_low)
        self.size = np.linalg.norm(boxes.reshape(-1, 3), axis=1)  # diameter of each body

    def share(self, instance: Instance, k: int) -> float:
        """Sum of the shares or the area of a contact at most."""
        m = self.model
        if m.contact_response[k] == FIELD:
            return float(self.area[m.contact_tissue[k]])
        if m.contact_response[k] == BODIES:
            o = int(m.contact_other[k])
            return float(m.sample_area[m.body_sample_start[o] : m.body_sample_start[o + 1]].sum())
        first = int(m.contact_touch_start[k])
        return float(instance.state.touch_share[first : first + int(instance.state.touches[k])].sum())

    def law(self, parameters: np.ndarray, k: int, depth: float, speed: float) -> float:
        """Largest force of a contact for a share or an area of 1, friction included, and a field's gradient up to 2."""
        own = slots.TISSUE_PARAMETERS * len(self.area) + slots.CONTACT_PARAMETERS * k
        stiffness, damping, n, friction = parameters[own : own + 4]
        if self.model.contact_law[k] == KELVIN_VOIGT:
            size = stiffness * depth + 2.0 * damping * speed
        else:
            size = stiffness * depth**n * (1.0 + 2.0 * damping * speed)
        return float(2.0 * (1.0 + friction) * size)

    def check(self, instance: Instance, before: np.ndarray, moved: bool, tuned: bool = False) -> None:
        """Bounds of the outputs after a call that was done; ``before`` are those of the last one.

        ``tuned``: a parameter was changed between the two, which changes what is stored.
        """
        out, state = instance.outputs, instance.state
        if not (np.isfinite(out).all() and np.isfinite(instance.copy_state()[1]).all()):
            raise Broken("something is not finite after a call that was done")
        speeds = self._speeds(instance) if moved else np.zeros(self.bodies)
        swift = np.sqrt(state.vx**2 + state.vy**2 + state.vz**2).max(initial=0.0)
        for i in range(self.bodies):
            own = slots.BODY_OUTPUTS * i
            self._force(instance, i, out[own : own + slots.BODY_OUTPUTS], speeds, swift, moved)
        energies = out[self.common : self.common + slots.COMMON_OUTPUTS]
        past = before[self.common : self.common + slots.COMMON_OUTPUTS]
        scale = abs(energies).max() + abs(past).max() + 1.0
        if min(energies[slots.ENERGY_KINETIC], energies[slots.ENERGY_CONTACT]) < -1e-9 * scale:
            raise Broken(f"an energy is negative: {energies.tolist()}")
        if not tuned:
            self._energy(instance, energies, past)

    def _speeds(self, instance: Instance) -> np.ndarray:
        motion = instance.scratch.motion.reshape(-1, 6)
        # A touched point is no farther from the body than the body is long.
        turning = np.linalg.norm(motion[:, 3:], axis=1) * (np.array(self.model.body_radius) + self.size)
        return np.linalg.norm(motion[:, :3], axis=1) + turning

    def _force(
        self, instance: Instance, i: int, own: np.ndarray, speeds: np.ndarray, swift: float, moved: bool
    ) -> None:
        m, parameters = self.model, instance.parameters
        depth, force = own[slots.DEPTH], np.linalg.norm(own[slots.FORCE : slots.FORCE + 3])
        bound = 0.0
        for k in range(len(m.contact_body)):
            body, other = int(m.contact_body[k]), int(m.contact_other[k])
            between = m.contact_response[k] == BODIES
            if i != body and not (between and i == other):
                continue
            speed = speeds[body] + (speeds[other] if between else swift)
            bound += self.share(instance, k) * self.law(parameters, k, depth, speed)
        grasps = slots.TISSUE_PARAMETERS * len(self.area) + slots.CONTACT_PARAMETERS * len(m.contact_body)
        for g in range(len(m.grasp_body)):
            if m.grasp_body[g] == i and instance.state.held[g] > 0:
                _, damping, slip = parameters[grasps + slots.GRASP_PARAMETERS * int(m.grasp_grasper[g]) :][:3]
                motion = instance.scratch.motion[6 * i : 6 * i + 6] * moved
                arm = np.linalg.norm(m.grasp_centre[3 * g : 3 * g + 3]) + m.grasp_radius[g]
                speed = np.linalg.norm(motion[:3]) + arm * np.linalg.norm(motion[3:]) + swift
                bound += 1.0001 * slip + damping * speed
        if not force <= bound * 1.000001 + 1e-9:
            raise Broken(f"body {i} feels {force:g} N at a depth of {depth:g} m, {bound:g} N can be explained")
        # Nearly upside down, a body's sides lean by as much.
        w, x, y, z = instance.state.pose[7 * i + 3 : 7 * i + 7]
        lean = 2 * math.hypot(x * z + w * y, y * z - w * x)
        if self.case.flat and own[slots.FORCE + 2] < -(1e-9 + lean) * force and self._shallow(instance, i):
            raise Broken(f"body {i} is attracted with {own[slots.FORCE + 2]:g} N of {force:g} N")

    def _shallow(self, instance: Instance, i: int) -> bool:
        """Whether an upright body is less deep in a flat patch than its thinnest part is thick."""
        return bool(-instance.state.pose[7 * i + 2] <= self.model.contact_reach[0])

    def _energy(self, instance: Instance, energies: np.ndarray, past: np.ndarray) -> None:
        """What a step gained from nowhere is within what it may find, which a body's own size bounds."""
        m = self.model
        found = 0.0
        for k in range(len(m.contact_body)):
            depth, share = float(self.size[m.contact_body[k]]), self.share(instance, k)
            share = max(share, 2.0 * depth**2 if m.contact_response[k] >= FIELD else 1.0)
            found += share * self.law(instance.parameters, k, depth, 0.0) * depth
        given = energies[slots.ENERGY_WORK] - past[slots.ENERGY_WORK]
        stored = sum(abs(past[k]) for k in (slots.ENERGY_KINETIC, slots.ENERGY_ELASTIC, slots.ENERGY_CONTACT))
        gained = past[slots.ENERGY_BALANCE] - energies[slots.ENERGY_BALANCE]
        gained += max(0.0, past[slots.ENERGY_DISSIPATED] - energies[slots.ENERGY_DISSIPATED])
        allowed = max(SWING, float(m.energy_gain[0])) * (stored + abs(given)) + found
        rounding = 1e-9 * (1.0 + abs(energies).max() + abs(past).max())
        if not gained <= allowed + rounding:
            raise Broken(f"{gained:g} J came from nowhere, {allowed:g} J can be explained")
        state = instance.state
        now = sum(abs(energies[k]) for k in (slots.ENERGY_KINETIC, slots.ENERGY_ELASTIC, slots.ENERGY_CONTACT))
        allowed = float(m.energy_gain[0]) * state.put_in[0] + found + float(m.safety[0]) * now
        if gained > rounding and not state.gained[0] <= allowed + rounding:
            raise Broken(f"{state.gained[0]:g} J came from nowhere since the start, {allowed:g} J can be explained")
        allowed = (max(1.0, float(m.energy_gain[0])) + UNEXPLAINED) * state.put_in[0] + found
        if given < 0.0 and not state.returned[0] <= allowed + rounding:
            raise Broken(f"the bodies got back {state.returned[0]:g} J, {allowed:g} J can be explained")


# --- calls --------------------------------------------------------------------------------------------------


class Call(NamedTuple):
    """One call and what came of it, to be made to an FMU again."""

    what: str  # step, initialize, save, restore
    h: float
    inputs: np.ndarray
    parameters: np.ndarray
    outcome: str
    outputs: np.ndarray


def status_of(error: WorkError) -> str:
    """Name of the status that a message tells of."""
    (name,) = [name for name, pattern in PATTERNS.items() if pattern.fullmatch(str(error))]
    return name


class Player:
    """Makes random calls to an instance and holds it to its promises."""

    def __init__(self, seed: int, scene: Scene, assembly: Assembly, case: Case) -> None:
        self.draw = Draw(seed + 2**32)
        self.scene, self.assembly = scene, assembly
        self.instance, self.watch = Instance(assembly), Watch(assembly, case)
        self.case, self.calls, self.kept = case, [], []
        self.given = {v.slot: v for v in assembly.variables if v.block == "parameters"}
        self.flat_way = -1.0

    def play(self) -> collections.Counter:
        """Make the calls; what came of them."""
        draw = self.draw
        outcomes = collections.Counter([self.call("initialize", 0.0)])
        for _ in range(draw.integer(3, 16)):
            what = "step"
            if draw.chance(0.05):
                what = draw.pick("initialize", "save", "restore", "restore")
            self.move()
            self.turn_knobs()
            outcomes[self.call(what, self.length())] += 1
            self.mend()
        self.last()
        return outcomes

    def length(self) -> float:
        """Of a step [s]."""
        draw = self.draw
        if draw.chance(0.05):
            return draw.pick(0.0, -0.0, -1e-3, math.nan, math.inf, -math.inf, 1e300, 5e-324)
        return draw.log(1e-6, 1.0) if draw.chance(0.2) else self.assembly.step_size

    def move(self) -> None:
        """Choose the poses that the next step goes to."""
        draw, inputs = self.draw, self.instance.inputs
        h = self.assembly.step_size
        for i in range(len(self.scene.instrument)):
            p = inputs[7 * i : 7 * i + 7]
            way = draw.pick("rest", "slow", "slow", "slow", "fast", "jump", "centre", "odd")
            if self.case.flat:
                p[2] += self.flat_way * draw.log(1e-6, 3e-3)
                if draw.chance(0.1):
                    self.flat_way *= -1.0
            elif way == "slow":
                p[:3] += draw.rng.normal(0.0, 1.0, 3) * draw.log(1e-6, 2e-3)
            elif way == "fast":
                p[:3] += np.array(draw.turn()[:3]) * h * draw.log(1.0, 100.0)
            elif way == "jump":
                p[:3] += np.array(draw.turn()[:3])
            elif way == "centre":
                p[:3] = draw.point(draw.log(1e-6, 0.05))
            if not self.case.flat and draw.chance(0.3):
                turn = p[3:] + draw.rng.normal(0.0, draw.log(1e-4, 1.0), 4)
                p[3:] = turn / np.linalg.norm(turn) * (draw.log(1e-5, 1e5) if draw.chance(0.2) else 1.0)
            if way == "odd" and draw.chance(0.3):
                value = draw.pick(math.nan, math.inf, -math.inf, 1e300, -1e300, 1.7e308, 2e6, -1e6, 5e-324)
                p[draw.rng.integers(7)] = value
            if draw.chance(0.02):
                p[3:] = draw.pick(0.0, 1e-8, 1e-170, 1e170)
        for j in range(7 * len(self.scene.instrument), inputs.size):
            if draw.chance(0.4):
                inputs[j] = draw.pick(0.0, 0.0, 1.0, draw.uniform(0.0, 1.0), -5.0, 7.0)
            if draw.chance(0.01):
                inputs[j] = math.nan

    def turn_knobs(self) -> None:
        """Change a parameter, within its range or beyond."""
        draw = self.draw
        if not self.given or not draw.chance(0.2):
            return
        variable = self.given[draw.pick(*self.given)]
        low, high = max(variable.minimum, 1e-3 * max(variable.start, 1e-9)), variable.maximum
        value = min(high, max(low, variable.start * draw.log(0.1, 10.0)))
        if draw.chance(0.2):
            value = draw.pick(variable.minimum, variable.maximum, draw.log(low, high))
        if draw.chance(0.1):
            value = draw.pick(math.nan, math.inf, -math.inf, -1.0, -5e-324, 1e300, 1.001 * variable.maximum)
        self.instance.parameters[variable.slot] = value

    def faults(self, what: str, h: float) -> set[str]:
        """Every fault that the next call has."""
        instance, found = self.instance, set()
        if not all(v.minimum <= instance.parameters[slot] <= v.maximum for slot, v in self.given.items()):
            found.add("parameter_range")
        if not (abs(instance.inputs) <= 1e6).all():
            found.add("nonfinite_input")
        with np.errstate(all="ignore"):
            for i in range(len(self.scene.instrument)):
                if not np.linalg.norm(instance.inputs[7 * i + 3 : 7 * i + 7]) >= 1e-6:
                    found.add("zero_quaternion")
        if what == "step" and not (h == 0.0 or 1e-100 <= h <= 1e6):
            found.add("step_size")
        return found

    def call(self, what: str, h: float) -> str:
        """Make one call; its outcome."""
        instance = self.instance
        if what == "save":
            self.kept.append((instance.copy_state(), instance.outputs.copy()))
            self.note(what, h, "saved")
            return "saved"
        if what == "restore":
            if not self.kept:
                return "nothing to restore"
            state, instance.outputs[:] = self.kept[-1]
            instance.restore_state(state)
            self.note(what, h, "restored")
            return "restored"
        faults, saved, outputs = self.faults(what, h), instance.copy_state(), instance.outputs.copy()
        inputs, parameters, tuned = instance.inputs.copy(), instance.parameters.copy(), instance.state.tuned.copy()
        try:
            instance.initialize() if what == "initialize" else instance.step(h)
            outcome = "done"
        except WorkError as error:
            outcome = status_of(error)
        self.note(what, h, outcome)
        if inputs.tobytes() != instance.inputs.tobytes() or parameters.tobytes() != instance.parameters.tobytes():
            raise Broken("a call changed its inputs or parameters")
        if outcome == "done" and faults:
            raise Broken(f"{what} of {h} s was done with {sorted(faults)}")
        if (outcome in FAULTS) != bool(faults) or (faults and outcome not in faults):
            raise Broken(f"{what} of {h} s was refused with {outcome}, its faults are {sorted(faults)}")
        if outcome != "done":
            now = instance.copy_state()
            if saved[0].tobytes() != now[0].tobytes() or saved[1].tobytes() != now[1].tobytes():
                raise Broken(f"the state changed though {what} was refused with {outcome}")
            if outputs.tobytes() != instance.outputs.tobytes():
                raise Broken(f"the outputs changed though {what} was refused with {outcome}")
        elif what == "initialize":
            self.watch.check(instance, instance.outputs, False)
        elif h > 0.0:
            self.watch.check(instance, outputs, True, tuned.tobytes() != parameters.tobytes())
        return outcome

    def note(self, what: str, h: float, outcome: str) -> None:
        i = self.instance
        self.calls.append(Call(what, h, i.inputs.copy(), i.parameters.copy(), outcome, i.outputs.copy()))

    def mend(self) -> None:
        """Take back what is out of its range, and a pose that was refused."""
        instance = self.instance
        for slot, v in self.given.items():
            if not v.minimum <= instance.parameters[slot] <= v.maximum:
                instance.parameters[slot] = v.start
        n = 7 * len(self.scene.instrument)
        if self.calls[-1].outcome not in ("done", "saved", "restored", "nothing to restore") or self.draw.chance(0.05):
            instance.inputs[:n] = instance.state.pose[:n]
        instance.inputs[n:] = np.where(np.isfinite(instance.inputs[n:]), instance.inputs[n:], 1.0)

    def last(self) -> None:
        """Whatever was before, a step that is short enough and goes nowhere is done."""
        instance = self.instance
        n = 7 * len(self.scene.instrument)
        instance.inputs[:n], instance.inputs[n:] = instance.state.pose[:n], 1.0
        for slot, v in self.given.items():
            instance.parameters[slot] = v.start
        for h in (1e-4, 1e-6, 1e-9, 1e-12, 1e-15, 1e-18):
            if self.call("step", h) == "done":
                return
        if self.calls[-1].outcome in ("too_many_pairs", "too_many_points", "energy_sum", "energy_returned"):
            # The scene has no room for where the instruments are, or chatters there: only elsewhere it goes on.
            for i in range(len(self.scene.instrument)):
                instance.inputs[7 * i] += 10.0 * (i + 1)
            # A rigid body that does not move may ask for more room than there is by itself.
            if self.call("initialize", 0.0) == "done" and self.call("step", 1e-9) in ("done", "too_many_points"):
                return
        raise Broken(f"no step is done any more, the last was refused with {self.calls[-1].outcome}")


def replay(player: Player) -> None:
    """Make the calls to an FMU: the same outcomes, the same bits."""
    from extremes_fmu import Fmu

    with tempfile.TemporaryDirectory() as folder:
        fmu = Fmu(player.assembly, Path(folder))
        try:
            for k, call in enumerate(player.calls):
                found, outputs = fmu.call(call)
                if found != fmu.expected(call):
                    raise Broken(f"call {k}, {call.what}: {call.outcome} in Python, {found} in the FMU: {fmu.text}")
                if call.outcome == "done" and outputs.tobytes() != call.outputs.tobytes():
                    raise Broken(f"call {k}, {call.what}: the outputs of the FMU differ")
                if call.what == "initialize" and call.outcome != "done":
                    return  # an FMU then stays in Initialization Mode, an instance in Python in the state before
        finally:
            fmu.free()


def run(seed: int, with_fmu: bool | None = None) -> collections.Counter:
    """Everything of one seed; what came of its calls. Raises Broken."""
    with tempfile.TemporaryDirectory() as folder:
        case = case_of(seed, Path(folder))
        try:
            scene = parse_scene(case.text.encode(), Path(folder))
            with mock.patch.object(fields, "NODES_MAX", NODES_MAX):
                assembly = assemble(scene)
        except InputError:
            return collections.Counter(["invalid scene"])
    player = Player(seed, scene, assembly, case)
    with np.errstate(all="ignore"):
        outcomes = player.play()
    if with_fmu or (with_fmu is None and seed % round(1 / FMU_SHARE) == 0):
        replay(player)
        outcomes["calls of an FMU"] += len(player.calls)
    return outcomes


Job = Callable[[int], collections.Counter]

# --- many of them -------------------------------------------------------------------------------------------


def _work(pipe: Connection, job: Job) -> None:
    """Do the seeds that come through a pipe, each with (outcomes, failure) for an answer."""
    while (seed := pipe.recv()) is not None:
        try:
            pipe.send((job(seed), None))
        except Exception as error:
            where = "" if isinstance(error, Broken) else traceback.format_exc()
            pipe.send((collections.Counter(), f"{type(error).__name__}: {error}\n{where}".strip()))


class Worker:
    """A process that does one seed after another."""

    def __init__(self, job: Job, limit: float) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, other = context.Pipe()
        self.process = context.Process(target=_work, args=(other, job), daemon=True)
        self.process.start()
        other.close()
        self.seed: int | None = None
        self.limit, self.deadline, self.fresh = limit, 0.0, True

    def give(self, seed: int) -> None:
        self.seed, self.begun = seed, time.monotonic()
        self.deadline = time.monotonic() + self.limit + self.fresh * STARTING
        self.fresh = False
        self.pipe.send(seed)

    def stop(self) -> None:
        self.process.kill()
        self.process.join()
        self.pipe.close()


def run_many(
    seeds: range, workers: int, progress: bool = False, job: Job = run, limit: float = LIMIT
) -> tuple[collections.Counter, dict[int, str], collections.Counter]:
    """Run seeds side by side: outcomes of the calls, failures by seed, and how many scenes had each outcome."""
    outcomes, scenes, failures = collections.Counter(), collections.Counter(), {}
    todo = iter(seeds)
    crew = [Worker(job, limit) for _ in range(min(workers, len(seeds)))]
    begun, shown, done = time.monotonic(), 0.0, 0
    for worker in crew:
        worker.give(next(todo))
    while crew:
        wait([w.pipe for w in crew], timeout=1.0)
        for at, worker in enumerate(crew):
            failure = None
            if worker.pipe.poll():
                try:
                    found, failure = worker.pipe.recv()
                    outcomes += found
                    scenes.update(found.keys())
                except (EOFError, OSError):
                    worker.process.join()
                    failure = f"the process died with exit code {worker.process.exitcode}"
            elif time.monotonic() > worker.deadline:
                failure = f"not done after {worker.deadline - worker.begun:g} s"
            else:
                continue
            done += 1
            if failure is not None:
                failures[worker.seed] = failure
                if progress:
                    print(f"\nseed {worker.seed}: {failure}", flush=True)
            if failure is not None and failure.startswith(("the process died", "not done")):
                worker.stop()
                crew[at] = worker = Worker(job, limit)
            seed = next(todo, None)
            if seed is None:
                worker.stop()
            else:
                worker.give(seed)
        crew = [w for w in crew if not w.pipe.closed]
        if progress and time.monotonic() - shown > 2.0:
            shown = time.monotonic()
            rate = done / (shown - begun)
            print(f"\r{done} of {len(seeds)} scenes, {rate:.1f} a second, {len(failures)} failed", end="", flush=True)
    return outcomes, failures, scenes


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=20000, help="how many seeds")
    parser.add_argument("--first", type=int, default=0, help="the first one; to go on, the count of the last run")
    parser.add_argument("--workers", type=int, default=multiprocessing.cpu_count(), help="processes side by side")
    parser.add_argument("--show", action="store_true", help="run one seed in this process, and show its scene")
    given = parser.parse_args()
    warm_up.main()  # a worker that compiled would run out of its time, and leave its compiler behind
    if given.show:
        with tempfile.TemporaryDirectory() as folder:
            print(case_of(given.first, Path(folder)).text)
        for outcome, n in run(given.first, with_fmu=True).most_common():
            print(f"{n:6d}  {outcome}")
        return 0
    outcomes, failures, scenes = run_many(range(given.first, given.first + given.count), given.workers, True)
    print(f"\n{given.count} scenes, seeds {given.first} to {given.first + given.count - 1}")
    print(f"{'calls':>10}{'scenes':>10}")
    for outcome, n in outcomes.most_common():
        print(f"{n:10d}{scenes[outcome]:10d}  {outcome}")
    for seed, failure in sorted(failures.items()):
        print(f"FAILED seed {seed}: {failure.splitlines()[0]}")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parent))
    sys.exit(main())
