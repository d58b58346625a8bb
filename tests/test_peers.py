"""The comparison with peers, as far as it needs none of them: the plain step, the pairs, the page and its tables."""

import importlib
import json
import math
import os
import re
import time
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scenes import assembled
from scipy.spatial.transform import Rotation

from tissue_contact.scenarios import bench, edge_loop, peer_detection, peers
from tissue_contact.scenarios.apart import LeftOut, apart
from tissue_contact.scenarios.peer_scene import record
from tissue_contact.simulate import Instance

ROOT = Path(__file__).parents[1]
SUBSTEPS = 4


# --- the plain step ---------------------------------------------------------------------------------------


@pytest.fixture
def falling(tmp_path) -> Instance:
    """A small sheet with an initial velocity, and an instrument that stays away."""
    (tmp_path / "sheet.obj").write_text(bench.sheet(8))
    text = bench.SCENE.format(solver=f"substeps = {SUBSTEPS}", tissue=bench.MESH.format(name="sheet.obj"), contact="")
    instance = Instance(assembled(text.replace('name = "bench"', ""), tmp_path))
    instance.inputs[:] = 0.0, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0
    instance.initialize()
    instance.state.vz[:] = instance.model.node_free * np.cos(50 * instance.state.x)
    return instance


def test_edge_loop_moves_a_sheet_as_the_kernels_do(falling):
    state = falling.state
    sheet = edge_loop.sheet_of(falling.model, state)
    sheet.vz[:] = state.vz
    material = edge_loop.Material(1.0, 20.0, 0.0, 0.0, 0.0025, 0.04)
    far, axis, still = (0.0, 0.0, 0.05), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)
    state.tuned[:] = np.nan  # the velocities were set from outside: its balance begins anew
    for _ in range(20):
        falling.step(1e-3)
        edge_loop.advance(sheet, material, far, axis, still, 1e-3, SUBSTEPS)
    assert np.ptp(state.z - falling.model.rest_z) > 1e-3
    for mine, ours in ((sheet.x, state.x), (sheet.y, state.y), (sheet.z, state.z), (sheet.vz, state.vz)):
        assert_allclose(mine, ours, rtol=1e-9, atol=1e-12)


# --- pairs ------------------------------------------------------------------------------------------------


def crossings(start: np.ndarray, end: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Which segment crosses which triangle, shape [segments, triangles]."""
    a, b, c = (corners[None, :, k] for k in range(3))

    def volume(*points: np.ndarray) -> np.ndarray:
        p, q, r, s = points
        return np.einsum("...k,...k", np.cross(q - p, r - p), s - p)

    p, q = start[:, None], end[:, None]
    sides = [volume(p, q, u, v) > 0 for u, v in ((a, b), (b, c), (c, a))]
    beyond = (volume(a, b, c, p) > 0) != (volume(a, b, c, q) > 0)
    return beyond & (sides[0] == sides[1]) & (sides[1] == sides[2])


def brute_force(tissue: np.ndarray, rod: np.ndarray) -> int:
    """Pairs of triangles of which an edge of one crosses the other, all against all."""
    hit = np.zeros((len(tissue), len(rod)), bool)
    for k in range(3):
        hit |= crossings(tissue[:, k], tissue[:, k - 1], rod)
        hit |= crossings(rod[:, k], rod[:, k - 1], tissue).T
    return int(hit.sum())


def test_pairs_are_as_many_as_by_brute_force(tmp_path):
    sheet = tmp_path / "sheet.obj"
    sheet.write_text(bench.sheet(12))
    scene = record(sheet, 50)
    _, pairs = peer_detection.measure(peers.OURS, scene)
    expected = []
    for moment, vertices in zip(scene.moments, scene.positions, strict=True):
        pose = bench.poses()[moment]
        placed = Rotation.from_quat(pose[3:], scalar_first=True).apply(scene.rod.vertices) + pose[:3]
        expected.append(brute_force(vertices[scene.tissue.triangles], placed[scene.rod.triangles]))
    assert pairs == expected
    assert max(pairs) > 20 and len(pairs) > 8


def test_edges_of_two_triangles_know_both():
    edges, faces = peer_detection._edges(np.array([[0, 1, 2], [2, 1, 3]]))
    assert faces[edges.tolist().index([1, 2])] == [1, 0]
    hit = np.full(len(edges), -1)
    hit[edges.tolist().index([1, 2])] = 7
    assert list(peer_detection._crossed(faces, hit)) == [(1, 7), (0, 7)]


# --- processes of their own -------------------------------------------------------------------------------


def test_work_apart_gives_what_it_gives():
    assert apart(math.sqrt, 4.0) == 2.0


@pytest.mark.parametrize(
    "work, reason",
    [
        ((importlib.import_module, "no_such_peer"), "not installed: No module named 'no_such_peer'"),
        ((math.sqrt, -1.0), "ValueError"),
        ((os.abort,), "ended by SIGABRT"),
        ((os._exit, 3), "ended with exit code 3"),
    ],
)
def test_work_apart_that_fails_is_left_out_with_the_reason(work, reason):
    with pytest.raises(LeftOut, match=re.escape(reason)):
        apart(*work)


def test_work_apart_that_hangs_is_left_out():
    with pytest.raises(LeftOut, match=re.escape("not done after 0.1 s")):
        apart(time.sleep, 60.0, limit=0.1)


def test_one_that_fails_leaves_the_others_alone():
    def work(name: str) -> str:
        if name == "broken":
            raise LeftOut("it is broken")
        return name

    left_out: dict[str, str] = {}
    found = peers.rounds_of(["sound", "broken"], work, 3, left_out, lambda _: None)
    assert found == {"sound": ["sound"] * 3}
    assert left_out == {"broken": "it is broken"}


# --- the page ---------------------------------------------------------------------------------------------


def page_module():
    """docs/peers.py."""
    return importlib.import_module("peers")


def test_the_page_says_what_was_measured():
    module = page_module()
    data = json.loads(module.DATA.read_text("utf-8"))
    page = module.PAGE.read_text("utf-8")
    assert module.page_of(page, data) == page, "run python docs/peers.py"


def test_rows_compare_with_ours():
    ours = {"median": 20.0, "p99": 30.0, **peers.pair_difference([10, 20], [10, 20])}
    peer = {"median": 90.0, "p99": 95.5, **peers.pair_difference([10, 18], [10, 20])}
    data = {"detection": {"6K": {"coal": peer, peers.OURS: ours}}, "versions": {"coal": "3.0", "tissue-contact": "1"}}
    _, rows = peers.detection_rows(data)
    assert rows == [
        ["6K", peers.TOLD[peers.OURS][0], "20.0", "30.0", "1", "15", "1"],
        ["6K", peers.TOLD["coal"][0], "90.0", "95.5", "4.5", "50 % of the moments as many, else −2 to +0", "3.0"],
    ]


def test_the_fastest_round_of_each_moment_counts():
    assert peers.fastest([np.array([3.0, 9.0, 4.0, 1.0]), np.array([5.0, 2.0, 3.0])]).tolist() == [3.0, 2.0, 3.0]
