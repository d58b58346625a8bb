"""Ours and the peers of `make peers` that find intersecting triangles of a tissue that moves and a rigid rod.

All are used in one way: made of a scene; given positions by `form` in the layout that a library takes, which is not
timed; asked to take them over and to find, which is; and what was found is counted, which is not. Lengths are
millimetres for the peers: some have absolute tolerances.
"""

import time
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from tissue_contact.kernels.compiled import kernel
from tissue_contact.kernels.forces import detect_all
from tissue_contact.kernels.layout import Real
from tissue_contact.kernels.occupancy import ANYWHERE
from tissue_contact.scenarios import bench
from tissue_contact.scenarios.peer_scene import HULL, Mesh, PeerScene, assembly_of
from tissue_contact.simulate import Instance

MILLIMETRES = 1e3
ROOM = 1_000_000  # contacts that a peer may give


class Detection(Protocol):
    """A way to find pairs."""

    def form(self, vertices: Real, pose: Real) -> Any:
        """Positions [m] and pose in the form that `find` takes."""

    def find(self, formed: Any) -> Any:
        """Take positions and pose over and find the pairs."""

    def count(self, found: Any) -> int:
        """How many pairs were found."""


@kernel
def _detect(model, state, scratch):  # type: ignore[no-untyped-def]
    """The kernel for Python, which only kernels may call."""
    state.tissue_way[:] = ANYWHERE  # the positions come from elsewhere
    return detect_all(model, state, scratch, 0.0, 1.0)


class Ours:
    """Our own detection, called from Python."""

    contact = HULL

    def __init__(self, scene: PeerScene) -> None:
        self._instance = Instance(assembly_of(scene.sheet, contact=self.contact))
        self._blocks = self._instance._model, self._instance._state, self._instance._scratch

    def form(self, vertices: Real, pose: Real) -> Any:
        return *np.ascontiguousarray(vertices.T), pose

    def find(self, formed: Any) -> Any:
        state = self._instance.state
        state.x[:], state.y[:], state.z[:], state.pose[:] = formed
        return _detect(*self._blocks)

    def count(self, found: Any) -> int:
        """Pairs that the response rejects, as the rod came from behind, were found all the same."""
        state = self._instance.state
        return int(state.pairs[0] + state.rejected[0])


class OursNear(Ours):
    """What a step with the default response looks for: triangles near the rod's distance field, not pairs."""

    contact = bench.CONTACT

    def count(self, found: Any) -> int:
        return int(self._instance.state.pairs[0])


def _place(pose: Real) -> tuple[Real, Real]:
    """Rotation matrix and position [mm]."""
    return Rotation.from_quat(pose[3:], scalar_first=True).as_matrix(), MILLIMETRES * pose[:3]


class PythonFcl:
    """FCL through python-fcl, which has no refit: the tree is built anew in every step."""

    def __init__(self, scene: PeerScene) -> None:
        import fcl

        self._fcl, self._triangles = fcl, scene.tissue.triangles.astype(np.int64)
        self._rod = fcl.CollisionObject(self._model(MILLIMETRES * scene.rod.vertices, scene.rod.triangles))
        self._request = fcl.CollisionRequest(num_max_contacts=ROOM)

    def _model(self, vertices: Real, triangles: Any) -> Any:
        model = self._fcl.BVHModel()
        model.beginModel(len(triangles), len(vertices))
        model.addSubModel(vertices, triangles)
        model.endModel()
        return model

    def form(self, vertices: Real, pose: Real) -> Any:
        return MILLIMETRES * vertices, self._fcl.Transform(*_place(pose))

    def find(self, formed: Any) -> Any:
        vertices, place = formed
        self._rod.setTransform(place)
        result = self._fcl.CollisionResult()
        self._fcl.collide(
            self._fcl.CollisionObject(self._model(vertices, self._triangles)), self._rod, self._request, result
        )
        return result

    def count(self, found: Any) -> int:
        return len({(contact.b1, contact.b2) for contact in found.contacts})


class Coal:
    """coal with a tree of OBBRSS, refitted from the bottom up."""

    def __init__(self, scene: PeerScene) -> None:
        import coal

        self._coal = coal
        self._tissue, self._rod = self._model(scene.tissue), self._model(scene.rod)
        self._request = coal.CollisionRequest()
        self._request.num_max_contacts = ROOM

    def _points(self, vertices: Real) -> Any:
        points = self._coal.StdVec_Vec3s()
        points.extend(MILLIMETRES * row for row in vertices)
        return points

    def _model(self, mesh: Mesh) -> Any:
        triangles = self._coal.StdVec_Triangle()
        triangles.extend(self._coal.Triangle(*map(int, corners)) for corners in mesh.triangles)
        model = self._coal.BVHModelOBBRSS()
        model.beginModel(len(triangles), len(mesh.vertices))
        model.addSubModel(self._points(mesh.vertices), triangles)
        model.endModel()
        return model

    def form(self, vertices: Real, pose: Real) -> Any:
        return self._points(vertices), self._coal.Transform3s(*_place(pose))

    def find(self, formed: Any) -> Any:
        points, place = formed
        self._tissue.beginReplaceModel()
        self._tissue.replaceSubModel(points)
        self._tissue.endReplaceModel(True, True)
        result = self._coal.CollisionResult()
        self._coal.collide(self._tissue, self._coal.Transform3s(), self._rod, place, self._request, result)
        return result

    def count(self, found: Any) -> int:
        return len({(contact.b1, contact.b2) for contact in found.getContacts()})


class MeshLib:
    """MeshLib in single precision, its tree refitted."""

    def __init__(self, scene: PeerScene) -> None:
        from meshlib import mrmeshnumpy, mrmeshpy

        self._mm, self._mn, self._triangles = mrmeshpy, mrmeshnumpy, scene.tissue.triangles.astype(np.int32)
        self._tissue = self._mesh(scene.tissue.vertices, self._triangles)
        self._rod = self._mesh(scene.rod.vertices, scene.rod.triangles.astype(np.int32))
        self._all = self._tissue.topology.getValidVerts()

    def _mesh(self, vertices: Real, triangles: Any) -> Any:
        return self._mn.meshFromFacesVerts(triangles, np.float32(MILLIMETRES * vertices))

    def form(self, vertices: Real, pose: Real) -> Any:
        turn, position = _place(pose)
        vector = self._mm.Vector3f
        place = self._mm.AffineXf3f(self._mm.Matrix3f(*(vector(*row) for row in turn)), vector(*position))
        return self._mesh(vertices, self._triangles), place  # a whole mesh, as points alone are not made of an array

    def find(self, formed: Any) -> Any:
        moved, place = formed
        self._tissue.points = moved.points
        self._tissue.updateCaches(self._all)
        return self._mm.findCollidingTriangles(self._tissue, self._rod, place)

    def count(self, found: Any) -> int:
        return len(found)


class Embree:
    """Embree through embreex, which has rays and not Embree's own collision of two trees, and no refit.

    A pair intersects where an edge of one triangle crosses the other: edges of the tissue are cast against the rod, in
    the rod's frame, and edges of the rod against a tree of the tissue that is built anew. A ray gives its first hit
    only, so that pairs are missed.
    """

    def __init__(self, scene: PeerScene) -> None:
        from embreex import mesh_construction, rtcore_scene

        self._scene_of, self._mesh_of = rtcore_scene.EmbreeScene, mesh_construction.TriangleMesh
        self._triangles = scene.tissue.triangles.astype(np.int32)
        self._tissue_edges, self._tissue_faces = _edges(self._triangles)
        self._rod_edges, self._rod_faces = _edges(scene.rod.triangles.astype(np.int32))
        self._rod_vertices = np.float32(MILLIMETRES * scene.rod.vertices)
        self._rod = self._tree(self._rod_vertices, scene.rod.triangles.astype(np.int32))

    def _tree(self, vertices: Any, triangles: Any) -> Any:
        tree = self._scene_of()
        self._mesh_of(tree, vertices, triangles)
        return tree

    @staticmethod
    def _cast(tree: Any, vertices: Any, edges: Any) -> Any:
        """Triangle that each edge hits first within its length, -1 for none."""
        start = vertices[edges[:, 0]]
        way = vertices[edges[:, 1]] - start
        found = tree.run(start, way, np.ones(len(edges), np.float32), output=True)
        return np.where(found["tfar"] <= 1.0, found["primID"], -1)

    def form(self, vertices: Real, pose: Real) -> Any:
        turn, position = _place(pose)
        return np.float32((MILLIMETRES * vertices - position) @ turn)

    def find(self, formed: Any) -> Any:
        tissue = self._tree(formed, self._triangles)
        return (
            self._cast(self._rod, formed, self._tissue_edges),
            self._cast(tissue, self._rod_vertices, self._rod_edges),
        )

    def count(self, found: Any) -> int:
        on_rod, on_tissue = found
        pairs = {(t, u) for t, u in _crossed(self._tissue_faces, on_rod)}
        return len(pairs | {(t, u) for u, t in _crossed(self._rod_faces, on_tissue)})


def _edges(triangles: Any) -> tuple[Any, list[list[int]]]:
    """Edges of a mesh, shape [E, 2], and the triangles at each."""
    every = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    edges, which = np.unique(every, axis=0, return_inverse=True)
    faces: list[list[int]] = [[] for _ in edges]
    for n, edge in enumerate(which.ravel()):
        faces[edge].append(n % len(triangles))
    return edges, faces


def _crossed(faces: list[list[int]], hit: Any) -> Any:
    """Pairs of a triangle with an edge that hits, and the triangle that it hits."""
    return ((own, int(hit[edge])) for edge in np.flatnonzero(hit >= 0) for own in faces[edge])


WAYS: dict[str, Callable[[PeerScene], Detection]] = {
    "tissue-contact": Ours,
    "tissue-contact, near the field": OursNear,
    "embreex": Embree,
    "meshlib": MeshLib,
    "coal": Coal,
    "python-fcl": PythonFcl,
}


def measure(name: str, scene: PeerScene) -> tuple[Real, list[int]]:
    """Time [µs] and number of pairs at every moment of a scene."""
    way, poses = WAYS[name](scene), bench.poses()
    us, pairs = np.empty(len(scene.moments)), []
    for n, (moment, vertices) in enumerate(zip(scene.moments, scene.positions, strict=True)):
        formed = way.form(vertices, poses[moment])
        if n == 0:
            way.find(formed)  # what a first call compiles or allocates is not of a step
        start = time.perf_counter_ns()
        found = way.find(formed)
        us[n] = (time.perf_counter_ns() - start) / 1000
        pairs.append(way.count(found))
    return us, pairs
