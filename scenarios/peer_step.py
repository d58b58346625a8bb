"""The peers of `make peers` that step a deforming sheet under a moving rod, each 1 ms with what it needs of substeps.

All have the masses, the mesh and the fixed rim of the bench's scene. Their elasticity and their contact are their own,
with constants that make the sheet about as stiff.
"""

import time
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from tissue_contact.kernels.layout import Real
from tissue_contact.scenarios import bench, edge_loop
from tissue_contact.scenarios.peer_scene import PRESSED, PeerScene, assembly_of

DENSITY, STIFFNESS, DRAG = 1.0, 200.0, 20.0  # kg/m², N/m, N·s/m³: the bench's scene
CONTACT = 1e8, 2e4  # N/m³, N·s/m³
RADIUS, LENGTH = 0.0025, 0.04  # m, of the rod
# A sheet of equal springs in squares with one diagonal is about as stiff as a membrane of this modulus and thickness.
YOUNG, THICKNESS, POISSON = 2.3e5, 1e-3, 1 / 3
PATIENCE = 60.0  # s, after which a slow one has shown enough


class Stepping(Protocol):
    """A way to step."""

    whole: bool  # whether it is fast enough for all of the motion; else the press alone, as far as it gets

    def step(self, before: Real, after: Real) -> None:
        """1 ms in which the rod goes from one pose to another."""

    def heights(self) -> Real:
        """Of all vertices [m]."""


def _area(scene: PeerScene) -> float:
    a, b, c = (scene.tissue.vertices[scene.tissue.triangles[:, k]] for k in range(3))
    return float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def _rim(scene: PeerScene) -> Any:
    """Vertices on the border of the sheet, which are fixed."""
    return np.flatnonzero(np.abs(scene.tissue.vertices[:, :2]).max(axis=1) > 0.03 - 1e-9)


def _middle(pose: Real) -> Real:
    """Middle of the rod [m], whose tip is at the pose."""
    return pose[:3] + Rotation.from_quat(pose[3:], scalar_first=True).apply([0.0, 0.0, 0.5 * LENGTH])


class EdgeLoop:
    """`edge_loop`, with as many substeps as the FMU takes."""

    whole = True
    substeps = 22

    def __init__(self, scene: PeerScene) -> None:
        assembly = assembly_of(scene.sheet)
        self._sheet = edge_loop.sheet_of(assembly.model, assembly.state)
        self._material = edge_loop.Material(DENSITY, DRAG, *CONTACT, RADIUS, LENGTH)
        self._advance(bench.poses()[0], bench.poses()[0], 0)

    def _advance(self, before: Real, after: Real, substeps: int) -> None:
        axis = Rotation.from_quat(before[3:], scalar_first=True).apply([0.0, 0.0, 1.0])
        velocity = tuple((after[:3] - before[:3]) / bench.STEP)
        place = tuple(before[:3]), tuple(axis), velocity
        edge_loop.advance(self._sheet, self._material, *place, bench.STEP, substeps)

    def step(self, before: Real, after: Real) -> None:
        self._advance(before, after, self.substeps)

    def heights(self) -> Real:
        return self._sheet.z


class PyPbd:
    """pyPBD: XPBD distance constraints, 10 iterations a step, no contact; gravity stays, the binding cannot set it."""

    whole = True

    def __init__(self, scene: PeerScene) -> None:
        import pypbd

        pypbd.Logger.addConsoleSink(pypbd.LogLevel.ERR)
        simulation = pypbd.Simulation.getCurrent()
        simulation.initDefault()
        self._model, self._stepper = simulation.getModel(), simulation.getTimeStep()
        sheet = self._model.addTriangleModel(list(scene.tissue.vertices), scene.tissue.triangles.ravel().tolist())
        distances = 4  # XPBD
        self._model.addClothConstraints(sheet, distances, STIFFNESS, 0.0, 0.0, 0.0, 0.0, 0.0, False, False)
        self._particles = self._model.getParticles()
        self._count = len(scene.tissue.vertices)
        for v in range(self._count):
            self._particles.setMass(v, DENSITY * _area(scene) / self._count)
        for v in _rim(scene):
            self._particles.setMass(int(v), 0.0)
        self._model.initConstraintGroups()
        self._stepper.setValueUInt(self._stepper.NUM_SUB_STEPS, 1)
        self._stepper.setValueUInt(self._stepper.MAX_ITERATIONS, 10)
        pypbd.TimeManager.getCurrent().setTimeStepSize(bench.STEP)

    def step(self, before: Real, after: Real) -> None:
        self._stepper.step(self._model)

    def heights(self) -> Real:
        return np.array([self._particles.getPosition(v)[2] for v in range(self._count)])


class Mujoco:
    """MuJoCo flex: membrane elements, integrator discrete, solver CG.

    Its default contact is so soft beside this sheet that the rod goes through.
    """

    whole = False
    FILE = """
<mujoco>
  <option timestep="{step}" gravity="0 0 0" integrator="discrete" solver="CG"/>
  <size memory="1G"/>
  <worldbody>
    <body name="rod" mocap="true"><geom type="capsule" size="{radius} {half}"/></body>
    <flexcomp name="sheet" type="direct" dim="2" mass="{mass}" radius="5e-4" point="{points}" element="{triangles}">
      <elasticity young="{young}" poisson="{poisson}" thickness="{thickness}" elastic2d="stretch"/>
      <contact selfcollide="none" condim="1" solref="-1e7 -2e3" solimp="0.9999 0.9999 1e-4"/>
      <pin id="{rim}"/>
    </flexcomp>
  </worldbody>
</mujoco>
"""

    def __init__(self, scene: PeerScene) -> None:
        import mujoco

        self._mujoco = mujoco
        text = self.FILE.format(
            step=bench.STEP,
            radius=RADIUS,
            half=0.5 * LENGTH - RADIUS,
            mass=DENSITY * _area(scene),
            points=" ".join(map(str, scene.tissue.vertices.ravel().tolist())),
            triangles=" ".join(map(str, scene.tissue.triangles.ravel().tolist())),
            young=YOUNG,
            poisson=POISSON,
            thickness=THICKNESS,
            rim=" ".join(map(str, _rim(scene).tolist())),
        )
        self._model = mujoco.MjModel.from_xml_string(text)
        self._model.dof_damping[:] = DRAG * _area(scene) / len(scene.tissue.vertices)
        self._data = mujoco.MjData(self._model)

    def step(self, before: Real, after: Real) -> None:
        self._data.mocap_pos[0], self._data.mocap_quat[0] = _middle(after), after[3:]
        self._mujoco.mj_step(self._model, self._data)

    def heights(self) -> Real:
        return self._data.flexvert_xpos[:, 2]


class PyBullet:
    """pybullet's deformable world: springs, 20 substeps a step."""

    whole = False

    def __init__(self, scene: PeerScene) -> None:
        import pybullet

        self._bullet = pybullet
        pybullet.connect(pybullet.DIRECT)
        pybullet.resetSimulation(pybullet.RESET_USE_DEFORMABLE_WORLD)
        pybullet.setGravity(0, 0, 0)
        pybullet.setTimeStep(bench.STEP)
        pybullet.setPhysicsEngineParameter(numSubSteps=20)
        shape = pybullet.createCollisionShape(pybullet.GEOM_CAPSULE, radius=RADIUS, height=LENGTH - 2 * RADIUS)
        self._rod = pybullet.createMultiBody(0, shape)
        self._place(bench.poses()[0])
        self._sheet = pybullet.loadSoftBody(
            str(scene.sheet),
            mass=DENSITY * _area(scene),
            useMassSpring=1,
            springElasticStiffness=STIFFNESS,
            springDampingStiffness=0.0,
            useNeoHookean=0,
            useBendingSprings=0,
            useSelfCollision=0,
            useFaceContact=1,
            collisionMargin=1e-4,
        )
        for v in _rim(scene):
            pybullet.createSoftBodyAnchor(self._sheet, int(v), -1, -1)

    def _place(self, pose: Real) -> None:
        self._bullet.resetBasePositionAndOrientation(self._rod, _middle(pose).tolist(), np.roll(pose[3:], -1).tolist())

    def step(self, before: Real, after: Real) -> None:
        self._place(after)
        self._bullet.stepSimulation()

    def heights(self) -> Real:
        return np.array(self._bullet.getMeshData(self._sheet, flags=self._bullet.MESH_DATA_SIMULATION_MESH)[1])[:, 2]


WAYS: dict[str, Callable[[PeerScene], Stepping]] = {
    "edge loop": EdgeLoop,
    "pypbd": PyPbd,
    "mujoco": Mujoco,
    "pybullet": PyBullet,
}


def measure(name: str, scene: PeerScene) -> tuple[Real, int, float]:
    """Time [µs] of every step in contact; the height [m] of the lowest vertex late in the press, and when [ms]."""
    way, poses = WAYS[name](scene), bench.poses()
    touching = int(scene.moments[0]), int(scene.moments[-1])
    first, last = (0, len(poses) - 1) if way.whole else (touching[0] - 1, PRESSED)
    us, looked, lowest, begin = [], 0, np.nan, time.monotonic()
    for k in range(first + 1, last + 1):
        start = time.perf_counter_ns()
        way.step(poses[k - 1], poses[k])
        taken = (time.perf_counter_ns() - start) / 1000
        if touching[0] <= k <= touching[1]:
            us.append(taken)
        out_of_time = time.monotonic() - begin > PATIENCE
        if k == PRESSED or out_of_time:
            looked, lowest = k, float(way.heights().min())
        if out_of_time:
            break
    return np.array(us), looked, lowest
