"""Small scenes for the tests of the model: texts, meshes and hand-made arrays turned into assemblies."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from tissue_contact.assemble import assemble
from tissue_contact.assembly import Assembly
from tissue_contact.kernels.layout import pack
from tissue_contact.scene import parse_scene
from tissue_contact.simulate import Instance


def assembled(text: str, folder: Path = Path()) -> Assembly:
    """Assembly of a scene given as TOML without its name; of symplectic Euler unless it says how it is integrated."""
    if "integrator" not in text and "preset" not in text:
        table, accurate = "[solver]\n", 'preset = "accurate"\n'
        text = text.replace(table, table + accurate, 1) if table in text else table + accurate + text
    return assemble(parse_scene(f'name = "test"\n{text}'.encode(), folder))


def write_mesh(path: Path, vertices: np.ndarray, triangles: np.ndarray) -> str:
    """Write an OBJ file with every digit of its vertices; its name."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in triangles.tolist()]
    path.write_text("\n".join(lines) + "\n")
    return path.name


def index(assembly: Assembly, name: str, block: str = "outputs") -> int:
    """Slot of a variable."""
    (slot,) = [v.slot for v in assembly.variables if v.name == name and v.block == block]
    return slot


def vector(assembly: Assembly, name: str) -> slice:
    """Slots of an output of three."""
    first = index(assembly, f"{name}[1]")
    return slice(first, first + 3)


def settled(assembly: Assembly, pose: np.ndarray) -> Instance:
    """Instance with its instrument put at a pose, outputs ready."""
    instance = Instance(assembly)
    instance.inputs[:] = pose
    instance.initialize()
    return instance


def disturbed(instance: Instance) -> Instance:
    """The instance, told that its state was changed from outside: what is stored now is where its balance goes on."""
    instance.state.tuned[:] = np.nan  # no parameter equals it, so that the next step looks at the energies anew
    return instance


def chain(
    masses: int, stiffness: float, mass: float, spacing: float, damping: float = 0.0, **solver: float | str
) -> Assembly:
    """A straight chain along x between two fixed ends, made of the arrays of a scene with its triangles taken away.

    Parameters
    ----------
    masses : int
        Number of free masses; the chain has one spring more.
    stiffness, mass, spacing, damping : float
        Of every spring [N/m], of every mass [kg], rest length [m], of every spring [N·s/m].
    """
    settings = "\n".join(f"{key} = {json.dumps(value)}" for key, value in solver.items())
    base = assembled(f"""
        [solver]
        {settings}
        [[tissue]]
        shape = {{ kind = "patch", size = [0.01, 0.01], triangles = 50 }}
        areal_density = {mass}
        stiffness = {stiffness}
        damping = {damping}
    """)
    n = masses + 2
    ends = np.ones(n)
    ends[[0, -1]] = 0.0
    places = {"x": spacing * np.arange(n), "y": np.zeros(n), "z": np.zeros(n)}
    springs = np.arange(n - 1)
    rate = 4.0 * stiffness  # the Laplacian of a chain has its eigenvalues below 4 k
    model = base.model._replace(
        tissue_vertex_start=[0, n], tissue_spring_start=[0, n - 1], tissue_triangle_start=[0, 0],
        triangle_a=[], triangle_b=[], triangle_c=[],
        spring_i=springs, spring_j=springs + 1, spring_rest=np.full(n - 1, spacing),
        spring_stiffness=np.full(n - 1, stiffness), spring_damping=np.full(n - 1, damping),
        rest_x=places["x"], rest_y=places["y"], rest_z=places["z"],
        node_area=np.ones(n), node_free=ends, node_mobility=ends, tissue_rate=[rate],
        tissue_damping_rate=[4.0 * damping], tissue_node_area_min=[1.0],
    )  # fmt: skip
    zeros = np.zeros(n)
    state = base.state._replace(**places, vx=zeros, vy=zeros, vz=zeros)
    # Room for a vertex or a spring of the mesh becomes room for one of the chain, where there is any.
    sizes = {len(base.model.rest_x): n, len(base.model.spring_i): n - 1}
    scratch = base.scratch._replace(
        **{
            name: np.zeros(times * sizes[size])
            for name in base.scratch._fields
            for size in sizes
            for times in (1, 3, 6, 12)
            if getattr(base.scratch, name).size == times * size
        }
    )
    packed_model, packed_state, packed_scratch = pack(model), pack(state), pack(scratch)
    return replace(
        base,
        model=packed_model[0], model_index=packed_model[1], model_real=packed_model[2],
        state=packed_state[0], state_index=packed_state[1], state_real=packed_state[2],
        scratch=packed_scratch[0], scratch_index=packed_scratch[1], scratch_real=packed_scratch[2],
    )  # fmt: skip
