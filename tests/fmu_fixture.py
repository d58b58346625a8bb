"""A tiny assembly for the kernels of fmu_kernels/step.py, and an FMU of it."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest
from fmu_importer import Instance, Unpacked

from tissue_contact.assembly import Assembly, start_values
from tissue_contact.fmu.build import build
from tissue_contact.kernels.layout import Model, Scratch, State, blocks, pack
from tissue_contact.variables import Variable

KERNELS = Path(__file__).parent / "fmu_kernels" / "step.py"
PLATFORM = {"linux": "linux64", "win32": "win64", "darwin": "darwin64"}[sys.platform]

# A scene for the documentation; the arrays are not made of it.
SOURCE = b"""\
name = "tiny"
[[instrument]]
name = "tool"
shape = { kind = "sphere", radius = 0.01, triangles = 100 }
"""

# Value references: the place in this table.
PULL, WISH, POSITION, FORCE, STEPS, GAIN, SPARE = range(7)
VARIABLES = (
    Variable("tool.pull", "inputs", 0, "m", 0.25, -math.inf, math.inf, "Pull on the vertex, <&> quoted"),
    Variable("tool.wish", "inputs", 1, "1", 0.0, -100.0, 100.0, "Status to return"),
    Variable("tissue.position[1]", "outputs", 0, "m", 0.5, -math.inf, math.inf, "Place of the vertex"),
    Variable("tool.force[1]", "outputs", 1, "N", 0.0, -math.inf, math.inf, "Force"),
    Variable("solver.steps", "outputs", 2, "1", 0.0, 0.0, math.inf, "Steps done"),
    Variable("contact.stiffness", "parameters", 0, "N/m", 2.0, 1.0, 1e7, "Gain"),
    Variable("contact.damping", "parameters", 1, "N.s/m3", 0.125, 0.0, math.inf, "Not used"),
)


def bundle_of(kind, **given):
    """A bundle with the given fields and every other one a single zero."""
    return pack(kind(**{name: given.get(name, np.zeros(1, scalar)) for name, scalar in blocks(kind).items()}))


def tiny_assembly(name="tiny", vertices=3, variables=VARIABLES, **changes):
    """Assembly of one moving vertex and a few that only fade."""
    y = np.linspace(0.1, 1.0, vertices)
    model, model_index, model_real = bundle_of(Model, rest_x=np.array([0.5]), rest_y=y)
    state, state_index, state_real = bundle_of(State, vx=np.array([1.0]), y=y)
    scratch, scratch_index, scratch_real = bundle_of(Scratch, detail=np.zeros(2))
    settings = {
        "name": name,
        "description": "Tiny scene for tests",
        "model": model,
        "model_index": model_index,
        "model_real": model_real,
        "state": state,
        "state_index": state_index,
        "state_real": state_real,
        "scratch": scratch,
        "scratch_index": scratch_index,
        "scratch_real": scratch_real,
        "parameters": start_values(2, VARIABLES, "parameters"),
        "inputs": start_values(2, VARIABLES, "inputs"),
        "outputs": start_values(3, VARIABLES, "outputs"),
        "variables": variables,
        "start_time": 0.0,
        "stop_time": 1.0,
        "step_size": 0.001,
        "source": SOURCE,
    }
    return Assembly(**settings | changes)


def tiny_fmu(directory, platforms=(PLATFORM,), **changes):
    """Path of an .fmu of the tiny assembly."""
    assembly = tiny_assembly(**changes)
    return build(assembly, Path(directory) / f"{assembly.name}.fmu", platforms, kernels=KERNELS)


@pytest.fixture(scope="session")
def fmu_path(tmp_path_factory):
    """An .fmu of the tiny assembly for the platform of the tests."""
    return tiny_fmu(tmp_path_factory.mktemp("fmu"))


@pytest.fixture(scope="session")
def fmu(fmu_path, tmp_path_factory):
    """The tiny FMU unpacked, its library loaded."""
    return Unpacked(fmu_path, tmp_path_factory.mktemp("unpacked"))


@pytest.fixture
def instance(fmu):
    """A fresh instance of the tiny FMU."""
    made = Instance(fmu)
    assert made.c, made.text
    yield made
    made.free()
