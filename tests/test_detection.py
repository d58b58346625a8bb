"""OHC collision detection against brute force, its cell classes, its sides and its regions."""

import numpy as np
import pytest
from scenes import assembled, index, settled, write_mesh
from scipy.spatial.transform import Rotation

from tissue_contact import blocks
from tissue_contact.kernels.detection import EMPTY, POTENTIAL, SOLO
from tissue_contact.kernels.layout import State
from tissue_contact.kernels.side import FACING, REJECTED
from tissue_contact.kernels.step import initialize
from tissue_contact.kernels.tritri import INTERSECT, intersect
from tissue_contact.kernels.vectors import rotation
from tissue_contact.simulate import Instance
from tissue_contact.status import OK

ROOM = np.zeros(256)

SCENE = """
    [[tissue]]
    shape = {{ kind = "patch", size = [0.03, 0.03], triangles = {triangles}, curvature_radius = 0.05, seed = {seed} }}
    areal_density = 1.0
    stiffness = 100.0
    [[instrument]]
    shape = {instrument}
    [[contact]]
    response = "hull"
    stiffness = 100.0
"""
INSTRUMENTS = [
    '{ kind = "capsule", radius = 0.002, length = 0.02, triangles = 200 }',
    '{ kind = "box", size = [0.006, 0.004, 0.02], triangles = 300 }',
    '{ kind = "grasper", radius = 0.002, length = 0.03, jaw_length = 0.012, opening = 0.5, triangles = 300 }',
]

TWO = """
    [[tissue]]
    name = "left"
    shape = {{ kind = "patch", size = [0.02, 0.03], triangles = 300, curvature_radius = 0.05, seed = 1 }}
    position = [-0.008, 0.0, 0.0]
    areal_density = 1.0
    stiffness = 100.0
    [[tissue]]
    name = "right"
    shape = {{ kind = "patch", size = [0.02, 0.03], triangles = 500, curvature_radius = 0.05, seed = 2 }}
    position = [0.008, 0.0, 0.0]
    areal_density = 1.0
    stiffness = 100.0
    [[instrument]]
    shape = {instrument}
    [[contact]]
    between = ["left", "instrument"]
    {response}
    [[contact]]
    between = ["right", "instrument"]
    {response}
"""
RESPONSES = ['response = "hull"\n    stiffness = 100.0', "stiffness_per_area = 1e6"]


def random_pose(rng: np.random.Generator) -> np.ndarray:
    turn = Rotation.random(random_state=rng.integers(2**31)).as_quat(scalar_first=True)
    return np.concatenate([rng.uniform(-0.006, 0.006, 3), turn])


def deformed(instance: Instance, rng: np.random.Generator) -> None:
    """Move every vertex: a wave, a dent and noise."""
    state = instance.state
    wave = 0.002 * np.sin(rng.uniform(100, 400) * state.x + rng.uniform(0, 6))
    state.z[:] += wave - 0.004 * np.exp(-(state.x**2 + state.y**2) / 4e-5)
    for axis in (state.x, state.y, state.z):
        axis[:] += rng.normal(0, 3e-4, axis.size)


def detect(instance: Instance) -> set[tuple[int, int]]:
    """Detect at the pose of the inputs, without a pair rejected; the pairs."""
    # The instance's own initialize would begin with the start state again.
    assert initialize(*instance._arguments(), instance.outputs, instance._scratch) == OK
    n, scratch = int(instance.state.pairs[0]), instance.scratch
    pairs = list(zip(scratch.pair_triangle[:n].tolist(), scratch.pair_instrument[:n].tolist(), strict=True))
    assert pairs == sorted(pairs), "the order of the pairs must not depend on the hash"
    assert len(pairs) == len(set(pairs)), "each pair once"
    return set(pairs)


def brute_force(instance: Instance) -> set[tuple[int, int]]:
    """All pairs by testing every triangle against every other, with the same body coordinates as detection has."""
    model, state, pose = instance.model, instance.state, instance.inputs
    r = rotation(tuple(pose[3:7] / np.sqrt((pose[3:7] ** 2).sum())))
    dx, dy, dz = state.x - pose[0], state.y - pose[1], state.z - pose[2]
    x = r[0] * dx + r[3] * dy + r[6] * dz
    y = r[1] * dx + r[4] * dy + r[7] * dz
    z = r[2] * dx + r[5] * dy + r[8] * dz
    tissue = [
        tuple((x[v], y[v], z[v]) for v in corners)
        for corners in zip(model.triangle_a, model.triangle_b, model.triangle_c, strict=True)
    ]
    ix, iy, iz = model.body_x, model.body_y, model.body_z
    instrument = [
        tuple((ix[v], iy[v], iz[v]) for v in corners)
        for corners in zip(model.body_a, model.body_b, model.body_c, strict=True)
    ]
    return {
        (t, u) for t, a in enumerate(tissue) for u, b in enumerate(instrument) if intersect(*a, *b, ROOM) == INTERSECT
    }


@pytest.mark.parametrize("shape", INSTRUMENTS)
def test_same_pairs_as_brute_force_on_deforming_meshes(shape):
    seed = 21
    rng = np.random.default_rng(seed)
    assembly = assembled(SCENE.format(triangles=300, seed=seed, instrument=shape))
    found, classes, rejected = 0, np.zeros(3, bool), 0
    for trial in range(25):
        instance = Instance(assembly)
        deformed(instance, rng)
        instance.inputs[:] = random_pose(rng)
        kept = detect(instance)
        expected = brute_force(instance)
        sides = instance.state.side
        lost = {pair for pair in expected if sides[pair[0]] == REJECTED}
        assert kept == expected - lost, (seed, trial)
        assert instance.state.rejected[0] == len(lost), (seed, trial)
        assert {int(t) for t in np.flatnonzero(sides)} == {t for t, _ in expected}, (seed, trial)
        if expected:
            classes |= instance.scratch.cells > 0
        found += len(expected)
        rejected += len(lost)
    assert found > 200
    assert rejected > 0
    assert classes[EMPTY] and classes[SOLO] and classes[POTENTIAL]


@pytest.mark.parametrize("shape", INSTRUMENTS)
@pytest.mark.parametrize("response", RESPONSES, ids=["pairs", "field"])
def test_blocks_find_what_one_block_of_all_triangles_finds(monkeypatch, shape, response):
    """Through random motions of tissue and instrument, sides carried along; only what is listed as near has a side."""
    seed = 22
    rng = np.random.default_rng(seed)
    instances = []
    for size in (9, 10**9):
        monkeypatch.setattr(blocks, "BLOCK", size)
        instances.append(Instance(assembled(TWO.format(instrument=shape, response=response))))
    assert [len(i.model.block_triangle_start) - 1 for i in instances] == [108, 2]
    found = rejected = away = 0
    for trial in range(60):
        pose = random_pose(rng)
        pose[:3] += rng.choice([0.0, 0.0, 0.02], 3)
        left = []
        for instance in instances:
            state, model = instance.state, instance.model
            state.x[:], state.y[:], state.z[:] = model.rest_x, model.rest_y, model.rest_z
            deformed(instance, np.random.default_rng([seed, trial]))
            instance.inputs[:] = pose
            assert initialize(*instance._arguments(), instance.outputs, instance._scratch) == OK
            begin = model.contact_near_start[:-1]
            near = [state.near[b : b + n].tolist() for b, n in zip(begin, state.near_count, strict=True)]
            left.append([near, *(a.tolist() for a in (state.side, state.pairs, state.rejected, instance.outputs))])
            # Contact k looks at tissue k, so that the place of a side is the number of its triangle.
            assert np.flatnonzero(state.side).tolist() == [t for triangles in near for t in triangles], (seed, trial)
        assert left[0] == left[1], (seed, trial)
        found += sum(state.pairs)
        rejected += sum(state.rejected)
        away += sum(state.pairs == 0)
    assert found > 200
    assert rejected > 0
    assert 0 < away < 120


@pytest.mark.parametrize("integrator", ["projective_dynamics", "implicit_euler", "symplectic_euler", "runge_kutta_4"])
@pytest.mark.parametrize("response", RESPONSES, ids=["pairs", "field"])
def test_blocks_passed_over_hold_nothing(monkeypatch, integrator, response):
    """Steps are the same to the last bit when every block is looked at in each of them, while the tissues are kicked.

    Of the schemes whose vertices do not move by their last velocities every block is looked at anyway.
    """
    seed = 23
    rng = np.random.default_rng(seed)
    monkeypatch.setattr(blocks, "BLOCK", 9)
    shape = INSTRUMENTS[0]
    soft = TWO.replace("areal_density = 1.0\n    stiffness = 100.0", "areal_density = 1.0\n    stiffness = 1.0")
    text = f'[solver]\nintegrator = "{integrator}"\n{soft.format(instrument=shape, response=response)}'
    plain, careful = (Instance(assembled(text)) for _ in range(2))
    for instance in (plain, careful):
        instance.inputs[:] = [0.0, 0.0, 0.02, 1, 0, 0, 0]
        instance.initialize()
        instance.state.put_in[0] += 1.0  # [J], far more than the kicks are
    passed = found = 0
    place = np.zeros(3)
    for k in range(200):
        kick = rng.normal(0.0, 0.3, (3, plain.state.x.size)) * plain.model.node_free
        place = 0.98 * place + rng.normal(0.0, 5e-4, 3)
        for instance in (plain, careful):
            state = instance.state
            if k % 10 == 0:
                state.vx[:], state.vy[:], state.vz[:] = kick
            instance.inputs[:3] = place
        careful.state.block_reach[:] = np.inf
        for instance in (plain, careful):
            instance.step(1e-3)
        for name in State._fields:
            if not name.startswith("block_"):
                assert np.array_equal(getattr(plain.state, name), getattr(careful.state, name)), (seed, name)
        assert np.array_equal(plain.outputs, careful.outputs), seed
        passed += int((plain.state.block_reach > careful.state.block_reach).sum())
        found += int(plain.state.pairs.sum())
    assert found > 100
    assert (passed > 1000) == (integrator != "runge_kutta_4")


@pytest.mark.parametrize("integrator", ["projective_dynamics", "implicit_euler", "symplectic_euler", "runge_kutta_4"])
def test_a_field_is_looked_for_as_seldom_as_the_motion_allows(integrator):
    """Outputs are the same to the last bit as with a detection after every substep, and there are far fewer.

    Both sides count, so that it does not matter when a side is latched.
    """
    seed = 24
    rng = np.random.default_rng(seed)
    response = 'stiffness_per_area = 1e6\n    damping_per_area = 1e3\n    side = "both"'
    scene = TWO.format(instrument=INSTRUMENTS[0], response=response)
    assemblies = [
        assembled(f'[solver]\nintegrator = "{integrator}"\n{period}\n{scene}')
        for period in ("", "detection_period = 1e-6")
    ]
    seldom, often = (Instance(assembly) for assembly in assemblies)
    assert seldom.model.detection_period[0] == np.inf
    names = [v.name for v in assemblies[0].variables if v.block == "outputs"]
    told = np.array([not name.endswith(("pairs", "rejected")) for name in names])
    for instance in (seldom, often):
        instance.inputs[:] = [0.0, 0.0, 0.005, 1, 0, 0, 0]
        instance.initialize()
    pressed = kept = 0
    way, moved = np.zeros(3), 0.0
    for k in range(400):
        # from a creep to a thrust
        way = 0.9 * way + rng.normal(0.0, 10.0 ** rng.uniform(-6, -4), 3)
        way[2] -= 0.04 * (seldom.inputs[2] + 0.002 + 0.003 * np.sin(0.05 * k))
        for instance in (seldom, often):
            instance.inputs[:3] += way
            instance.step(1e-3)
        assert np.array_equal(seldom.outputs[told], often.outputs[told]), (seed, k)
        pressed += bool(seldom.outputs[names.index("instrument.force[3]")] != 0.0)
        kept += seldom.state.moved[0] > moved
        moved = seldom.state.moved[0]
    assert pressed > 200
    assert kept > 100


def test_sides_do_not_depend_on_how_seldom_a_field_is_looked_for():
    """A slow press of a bar, at whose edges triangles turn: the same bits as with a detection a millisecond."""
    text = """
        [[tissue]]
        shape = { kind = "patch", size = [0.02, 0.02], triangles = 400 }
        position = [-0.015, 0.0, 0.0]
        areal_density = 1.0
        stiffness = 100.0
        support_stiffness = 1e5
        support_damping = 1000.0
        [[instrument]]
        shape = { kind = "box", size = [0.06, 0.006, 0.01] }
        [[contact]]
        stiffness_per_area = 1e7
        damping_per_area = 3e3
        [solver]
    """
    runs = []
    for period in ("", "detection_period = 1e-3"):
        instance = Instance(assembled(text + period))
        instance.inputs[:] = [0.0, 0.0, 0.001, 1, 0, 0, 0]
        instance.initialize()
        outputs, turned, side = [], 0, instance.state.side.copy()
        for _ in range(200):
            instance.inputs[2] -= 1e-5
            instance.step(1e-3)
            outputs.append(instance.outputs.copy())
            turned += int(((side != instance.state.side) & (side != 0) & (instance.state.side != 0)).sum())
            side[:] = instance.state.side
        assert turned > 0
        runs.append(np.array(outputs))
    names = [v.name for v in assembled(text).variables if v.block == "outputs"]
    told = np.array([not name.endswith("airs") for name in names])
    assert np.array_equal(runs[0][:, told], runs[1][:, told])


def test_cell_classes_add_up_to_the_grid():
    instance = settled(
        assembled(SCENE.format(triangles=300, seed=1, instrument=INSTRUMENTS[0])), [0, 0, -0.001, 1, 0, 0, 0]
    )
    assert instance.scratch.cells.sum() == instance.model.grid_size.prod()
    assert instance.scratch.cells[POTENTIAL] <= instance.model.grid_occupied[0]


def test_detection_with_nothing_near_finds_nothing():
    assembly = assembled(SCENE.format(triangles=300, seed=1, instrument=INSTRUMENTS[0]))
    instance = settled(assembly, [0, 0, 0.05, 1, 0, 0, 0])
    assert instance.outputs[index(assembly, "solver.pairs")] == 0
    assert not instance.state.side.any()


def test_sides_are_forgotten_when_the_instrument_leaves():
    instance = settled(
        assembled(SCENE.format(triangles=300, seed=1, instrument=INSTRUMENTS[0])), [0, 0, -0.002, 1, 0, 0, 0]
    )
    assert (instance.state.side == FACING).any()
    instance.inputs[2] = 0.05
    for _ in range(2):  # the first step ends away from the tissue
        instance.step(1e-3)
    assert not instance.state.side.any()
    assert instance.outputs[index(instance._assembly, "solver.pairs")] == 0


def test_two_places_are_two_regions(tmp_path):
    """A fork with two prongs touches a flat sheet in two places."""
    prong = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 10)], float) * 1e-3
    sides = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    faces = np.array([corners for a, b, c, d in sides for corners in ([a, b, c], [a, c, d])])
    vertices = np.concatenate([prong - [0.006, 0, 0], prong + [0.005, 0, 0]])
    mesh = write_mesh(tmp_path / "fork.obj", vertices, np.concatenate([faces, faces + 8]))
    assembly = assembled(
        f"""
        [[tissue]]
        shape = {{ kind = "patch", size = [0.03, 0.03], triangles = 800 }}
        areal_density = 1.0
        stiffness = 100.0
        [[instrument]]
        mesh = "{mesh}"
        many_parts = true
        [[contact]]
        response = "hull"
        stiffness = 100.0
        """,
        tmp_path,
    )
    instance = settled(assembly, [0, 0, -0.001, 1, 0, 0, 0])
    assert instance.outputs[index(assembly, "instrument.contacts")] == 2
    # Each region has the whole stiffness of the contact: 2 x 100 N/m x 1 mm.
    assert instance.outputs[index(assembly, "instrument.force[3]")] == pytest.approx(0.2, rel=1e-9)


def test_capacity_exceeded_is_a_status_not_a_crash():
    from tissue_contact.errors import WorkError

    text = "[solver]\nmax_pairs = 16\n" + SCENE.format(triangles=2000, seed=1, instrument=INSTRUMENTS[0])
    with pytest.raises(WorkError, match=r"more than 16 intersecting triangle pairs.*max_pairs"):
        settled(assembled(text), [0, 0, -0.002, 1, 0, 0, 0])
