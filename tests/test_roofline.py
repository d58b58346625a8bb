"""Bounds of a step: what is counted, and what the counts are held against."""

import math

import numpy as np
import pytest
from fmu_fixture import PLATFORM
from scenes import assembled

from tissue_contact.scenarios.counts import Part, parts
from tissue_contact.scenarios.roofline import Level, Machine, bound, measure_machine, remains

MACHINE = Machine(3e9, 48e9, 96e9, 1e9, (Level("L1", 1e4, 100e9), Level("memory", math.inf, 10e9)))
SCENE = """
    [solver]
    integrator = "{integrator}"
    [[tissue]]
    shape = {{ kind = "patch", size = [0.03, 0.03], triangles = 200 }}
    areal_density = 1.0
    stiffness = 100.0
    [[instrument]]
    shape = {{ kind = "sphere", radius = 0.003, triangles = 200 }}
    [[contact]]
    stiffness_per_area = 1e7
"""


@pytest.mark.parametrize(
    ("flops", "roots", "amount", "limit", "us"),
    [
        (48e3, 0, 1e3, "flops", 1.0),
        (48e3, 4e3, 1e3, "roots", 4.0),
        (0, 0, 1e4, "L1", 0.1),
        (0, 0, 2e4, "memory", 2.0),  # does not fit into the cache
    ],
)
def test_the_bound_is_the_longest_of_three(flops, roots, amount, limit, us):
    assert bound(Part("part", 3, flops, roots, amount), MACHINE) == (pytest.approx(3 * us), limit)


def test_counts_follow_the_sizes_of_the_arrays():
    explicit, implicit = (
        assembled(SCENE.format(integrator=f"{name}")) for name in ("symplectic_euler", "projective_dynamics")
    )
    found = {part.name: part for part in parts(explicit, explicit.state, explicit.scratch, 7)}
    springs, vertices = explicit.model.spring_i.size, explicit.model.rest_x.size
    assert found["springs"] == Part("springs", 7, 20 * springs, springs, 24 * springs + 72 * vertices)
    assert found["contact"].passes == 8
    assert found["contact"].flops == 0  # nothing is near at the start
    implicit = assembled(SCENE.format(integrator="projective_dynamics"))
    found = {part.name: part for part in parts(implicit, implicit.state, implicit.scratch, 1)}
    m = implicit.model
    below, rows = np.diff(m.factor_start.astype(int)) - 4, m.factor_vertex.size
    # of a panel's columns each reaches those after it in the panel, and all rows below
    n = sum(int(w * b + w * (w - 1) / 2) for w, b in zip(np.diff(m.factor_column.astype(int)), below, strict=True))
    assert n > rows > 0
    size = 16 * n + 8 * m.factor_row.size + 136 * rows
    assert found["substitutions"] == Part("substitutions", 3, 12 * n + 3 * rows, 0, size)
    assert found["pressed rows"].flops == 0
    assert found["contact"].passes == 4, "one for every iteration, and one for the outputs"


def test_what_remains_names_most_and_farthest():
    rows = [
        {"part": "springs", "measured": 50.0, "bound": 10.0},
        {"part": "energies", "measured": 9.0, "bound": 1.0},
        {"part": "backup", "measured": None, "bound": 1.0},
    ]
    text = remains({"parts": rows, "step": 61.0, "bound": 12.0, "rest": 2.0, "rest bound": 1.0})
    assert "5.1 times its bound" in text
    assert "springs: 40 of 49 µs" in text
    assert "farthest from its bound is energies, by 9 times" in text


@pytest.mark.skipif(PLATFORM != "linux64", reason="reads the sizes of caches as Linux tells them")
def test_the_machine_is_measured(tmp_path):
    machine = measure_machine(tmp_path)
    assert [level.name for level in machine.levels] == ["L1", "L2", "L3", "memory"]
    assert machine.levels[-1].size == math.inf
    assert all(rate > 0 and math.isfinite(rate) for rate in (*machine[:4], *(level.rate for level in machine.levels)))
