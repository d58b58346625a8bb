"""The figures of a run: forces and depths over time, the deformed tissue at the peak force; a scene at rest."""

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from numpy.typing import NDArray

from tissue_contact.assembly import Assembly
from tissue_contact.files import publish
from tissue_contact.geometry import area_normals, unit
from tissue_contact.scenarios.outcome import FloatArray, Trace
from tissue_contact.scene import Rigid, Scene
from tissue_contact.simulate import rollout
from tissue_contact.surfaces import rotation_matrix, surface_of

if TYPE_CHECKING:
    from tissue_contact.scenarios.run import Outcome

DOTS_PER_INCH = 160
CANVAS = 1680  # [pixel] across, of which the picture is cut out
ELEVATION, AZIMUTH = 32.0, -58.0  # [degree] of the camera above and round the tissue at the contact
LIGHT = np.array([-0.45, -0.35, 0.82])  # towards the light, in the camera's upright frame
AMBIENT = 0.42  # light that reaches every side
STEEL = np.array([0.44, 0.52, 0.60])
STEEL_OPACITY = 0.45
BONE = np.array([0.93, 0.90, 0.80])
# From pale tissue to deep red, dark enough at the far end for the shading to stay visible everywhere.
DISPLACEMENT_COLOURS = LinearSegmentedColormap.from_list(
    "displacement", ["#f6ddcf", "#f2b49b", "#e27b6a", "#bf4551", "#8a2346", "#4f1237"]
)
PALE = np.array(DISPLACEMENT_COLOURS(0.2)[:3])  # tissue at rest
STILL_SIZE = 5.0  # [inch] of the longer side of the picture of a scene at rest
POSE = (("position", 3), ("orientation", 4))  # inputs of an instrument
COMPONENT_COLOURS = {"x": "#4477aa", "y": "#66a61e", "z": "#d95f02"}


class Mesh(NamedTuple):
    """Vertices [m], shape (n, 3), and triangles, shape (m, 3)."""

    vertices: FloatArray
    triangles: NDArray[Any]


def draw(outcome: "Outcome", assembly: Assembly, output: Path) -> list[Path]:
    """Draw the figures of a run into folder `output`; `assembly` starts with the parameters of the run.

    Returns
    -------
    The files written.

    """
    name, trace, summary = outcome.scenario.name, outcome.trace, outcome.summary
    files = []
    if summary.peak_force:
        files.append(output / f"{name}.png")
        publish(files[-1], history(trace, list(summary.peak_force), name))
    files.append(output / f"{name}-peak.png")
    publish(files[-1], peak(trace, summary.leader, outcome.scenario.scene, assembly, name))
    return files


# --- over time --------------------------------------------------------------------------------------------


def history(trace: Trace, bodies: Sequence[str], title: str) -> bytes:
    """Force and depth of the named instruments and rigid bodies over time, as PNG; grey while jaws hold tissue.

    A grasper that holds tissue and touches none shows how many vertices it holds instead of its depth.
    """
    figure = Figure(figsize=(8, 2 + 3.2 * len(bodies)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2 * len(bodies), 1, sharex=True, height_ratios=[3, 2] * len(bodies))
    time = trace.time[: trace.done]
    for name, force_axes, lower in zip(bodies, axes[::2], axes[1::2], strict=True):
        force = trace.vector(f"{name}.force")
        depth = trace.column(f"{name}.depth")
        size = np.linalg.norm(force, axis=1)
        force_axes.plot(time, size, color="0.75", lw=4.0, label="magnitude")
        for k, (part, colour) in enumerate(COMPONENT_COLOURS.items()):
            force_axes.plot(time, force[:, k], color=colour, lw=1.0, label=part)
        top = int(size.argmax())
        if size[top] > 0:
            right = time[top] < 0.7 * time[-1]
            force_axes.plot(time[top], size[top], "o", color="black", ms=4)
            force_axes.annotate(
                f"{size[top]:.3g} N at {time[top]:.3f} s",
                (time[top], size[top]),
                xytext=(8 if right else -8, 4),
                textcoords="offset points",
                ha="left" if right else "right",
            )
        below, meaning = 1e3 * depth, "depth [mm]"
        if f"{name}.grasped" in trace.names:
            held = trace.column(f"{name}.grasped")
            for a in (force_axes, lower):
                reach = a.get_xaxis_transform()
                a.fill_between(time, 0, 1, where=held > 0, transform=reach, color="0.9", lw=0, label="holds tissue")
            if held.max() > 0 and not depth.max() > 0:
                below, meaning = held, "vertices held"
        force_axes.set_ylabel(f"force on {name} [N]")
        force_axes.margins(y=0.22)
        lower.fill_between(time, below, color="#bf4551", alpha=0.25, lw=0)
        lower.plot(time, below, color="#bf4551", lw=1.2)
        lower.set_ylabel(meaning)
        lower.set_ylim(bottom=0)
        for a in (force_axes, lower):
            a.grid(alpha=0.25)
            a.spines[["top", "right"]].set_visible(False)
    axes[0].set_title(title)
    labelled = {text: line for a in axes[::2] for line, text in zip(*a.get_legend_handles_labels(), strict=True)}
    figure.legend(labelled.values(), labelled.keys(), loc="outside lower center", frameon=False, ncols=len(labelled))
    axes[-1].set_xlabel("time [s]")
    axes[-1].set_xlim(time[0], time[-1])
    return png(figure)


def png(figure: Figure) -> bytes:
    """A figure as the bytes of a PNG file."""
    file = io.BytesIO()
    # Without matplotlib's version in it the same picture is the same file.
    figure.savefig(file, format="png", dpi=DOTS_PER_INCH, facecolor="white", metadata={"Software": None})
    return file.getvalue()


# --- at the peak ------------------------------------------------------------------------------------------


def peak(trace: Trace, leader: str | None, scene: Scene, assembly: Assembly, title: str) -> bytes:
    """All there is at the greatest force on instrument `leader`, at the end when there is none, as PNG.

    The FMU does not tell the shape of the tissue: the same steps are done again by the model in Python, which
    gives the same bits.
    """
    row, when = trace.done - 1, "no contact"
    if leader is not None:
        force = np.linalg.norm(trace.vector(f"{leader}.force"), axis=1)
        row = int(force.argmax())
        when = f"peak force {force[row]:.3g} N on {leader}"
    inputs = np.tile(assembly.inputs, (row + 1, 1))
    for variable in assembly.variables:
        if variable.block == "inputs":
            inputs[:, variable.slot] = trace.column(variable.name)[: row + 1]
    state = rollout(assembly, inputs, trace.time[1] - trace.time[0]).state
    rest = _at_rest(assembly)
    tissue = Mesh(np.column_stack([state.x, state.y, state.z]), rest.triangles)
    poses = {
        i.name: [trace.column(f"{i.name}.{part}[{k}]")[row] for part, n in POSE for k in range(1, n + 1)]
        for i in scene.instrument
    }
    bodies, rigid, up = _bodies(scene, poses)
    return picture(tissue, rest.vertices, bodies, up, f"{title}: {when}, t = {trace.time[row]:.3f} s", rigid)


def still(scene: Scene, assembly: Assembly) -> bytes:
    """The scene at its start: tissue and bodies, as PNG."""
    poses = {i.name: [*i.start_position, *i.start_orientation] for i in scene.instrument}
    tissue = _at_rest(assembly)
    bodies, rigid, up = _bodies(scene, poses)
    image = _scene(tissue, np.tile(PALE, (len(tissue.triangles), 1)), bodies, up, rigid)
    height, width = image.shape[:2]
    figure = Figure(figsize=(STILL_SIZE * width / max(width, height), STILL_SIZE * height / max(width, height)))
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.02, 0.02, 0.96, 0.96))
    axes.imshow(image, interpolation="antialiased")
    axes.set_axis_off()
    return png(figure)


def _at_rest(assembly: Assembly) -> Mesh:
    """All tissue."""
    model = assembly.model
    return Mesh(
        np.column_stack([model.rest_x, model.rest_y, model.rest_z]),
        np.column_stack([model.triangle_a, model.triangle_b, model.triangle_c]),
    )


def _bodies(scene: Scene, poses: Mapping[str, Sequence[float]]) -> tuple[list[Mesh], list[Mesh], FloatArray]:
    """Instruments at their poses, rigid bodies, and which way the handles go: up, where they go no way together."""
    placed, handles = [], np.zeros(3)
    for body in scene.bodies:
        surface = surface_of(body, scene.folder, scene.place)
        pose = np.array([*body.position, *body.rotation] if isinstance(body, Rigid) else poses[body.name])
        turn = rotation_matrix(tuple(pose[3:] / np.linalg.norm(pose[3:])))
        placed.append(Mesh(surface.vertices @ turn.T + pose[:3], surface.triangles))
        middle = turn @ surface.vertices.mean(axis=0)  # the origin is the tip
        if not isinstance(body, Rigid):
            handles += middle / max(float(np.linalg.norm(middle)), 1e-6)
    up = handles if np.linalg.norm(handles) > 0.1 else np.array([0.0, 0.0, 1.0])
    return placed[: len(scene.instrument)], placed[len(scene.instrument) :], up


def picture(
    tissue: Mesh, rest: FloatArray, bodies: Sequence[Mesh], up: FloatArray, title: str, rigid: Sequence[Mesh] = ()
) -> bytes:
    """Shaded picture of tissue, coloured by its displacement, of half-transparent instruments and of bones, as PNG.

    Parameters
    ----------
    tissue : Mesh
        As it is deformed, in the world.
    rest : float64 [m], shape (n, 3)
        Where its vertices were.
    bodies : sequence of Mesh
        The instruments, in the world.
    up : float64, shape (3,)
        Direction that points up in the picture: from the contact towards the handle shows the dent.
    title : str
        Over the picture.
    rigid : sequence of Mesh
        The bodies that do not move, in the world.

    """
    moved = 1e3 * np.linalg.norm(tissue.vertices - rest, axis=1)
    span = Normalize(0.0, max(float(moved.max(initial=0.0)), 1e-3))
    colours = DISPLACEMENT_COLOURS(span(moved[tissue.triangles].mean(axis=1)))[:, :3]
    image = _scene(tissue, colours, bodies, up, rigid)

    height = 5.6  # [inch] of the picture itself
    width = float(np.clip(height * image.shape[1] / image.shape[0], 4.0, 10.0))
    figure = Figure(figsize=(width + 1.3, height + 0.7))
    FigureCanvasAgg(figure)
    total = figure.get_size_inches()
    axes = figure.add_axes((0.1 / total[0], 0.1 / total[1], width / total[0], height / total[1]))
    axes.imshow(image, interpolation="antialiased")
    axes.set_axis_off()
    if len(tissue.vertices):
        legend = figure.add_axes(((width + 0.25) / total[0], 0.25, 0.2 / total[0], 0.5))
        figure.colorbar(ScalarMappable(span, DISPLACEMENT_COLOURS), cax=legend, label="displacement of the tissue [mm]")
    figure.suptitle(title, y=1 - 0.18 / total[1], fontsize=12, va="top")
    return png(figure)


def _scene(
    tissue: Mesh, colours: FloatArray, bodies: Sequence[Mesh], up: FloatArray, rigid: Sequence[Mesh] = ()
) -> NDArray[np.uint8]:
    """Shaded tissue, its triangles in `colours`, half-transparent instruments, bones; shape (rows, columns, 4)."""
    upright, camera = _upright(up), _camera()
    corners = [(tissue.vertices @ upright.T)[tissue.triangles]]
    base, opacity = [colours], [np.ones(len(tissue.triangles))]
    for body, colour, alpha in [(b, STEEL, STEEL_OPACITY) for b in bodies] + [(b, BONE, 1.0) for b in rigid]:
        body_corners = (body.vertices @ upright.T)[body.triangles]
        body_corners = body_corners[_normals(body_corners) @ camera > 0]  # the far side would show through
        corners.append(body_corners)
        base.append(np.tile(colour, (len(body_corners), 1)))
        opacity.append(np.full(len(body_corners), alpha))
    faces, opaque = 1e3 * np.concatenate(corners), np.concatenate(opacity)
    return _rendered(faces, np.column_stack([_lit(faces, np.concatenate(base), camera), opaque]), opaque == 1.0)


def _rendered(faces: FloatArray, colours: FloatArray, solid: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Picture of faces [mm] with a scale bar, cropped to what is drawn; shape (rows, columns, 4)."""
    figure = Figure(figsize=(CANVAS / 120, CANVAS / 120), dpi=120)
    canvas = FigureCanvasAgg(figure)
    axes: Axes3D = figure.add_axes((0, 0, 1, 1), projection="3d")
    # Edges in the colour of their face close the hairlines between neighbours; on glass they would show.
    edges = np.where(solid[:, None], colours, 0.0)
    axes.add_collection3d(
        Poly3DCollection(faces, facecolors=colours, edgecolors=edges, linewidths=0.4, zsort="average")
    )
    low, high = faces.min(axis=(0, 1)), faces.max(axis=(0, 1))
    size = np.maximum(high - low, 0.01 * (high - low).max())
    axes.set(xlim=(low[0], low[0] + size[0]), ylim=(low[1], low[1] + size[1]), zlim=(low[2], low[2] + size[2]))
    axes.set_proj_type("persp", focal_length=1.6)
    axes.set_box_aspect(tuple(size), zoom=0.85)  # it scales an array in place
    axes.view_init(ELEVATION, AZIMUTH)
    axes.set_axis_off()
    decade = 10.0 ** np.floor(np.log10(0.5 * size[0]))
    bar = decade * max(digit for digit in (1, 2, 5) if digit * decade <= 0.5 * size[0])
    end = np.array([high[0], low[1] - 0.03 * size[1], faces[:, :, 2].min()])
    axes.add_collection3d(Line3DCollection([[end - [bar, 0, 0], end]], colors="black", linewidths=3))
    axes.text(*(end - [0.5 * bar, 0.02 * size[1], 0]), f"{bar:g} mm", ha="right", va="top", fontsize=22)
    canvas.draw()
    image = np.asarray(canvas.buffer_rgba())
    drawn = np.any(image[:, :, :3] < 255, axis=2)
    rows, columns = np.flatnonzero(drawn.any(axis=1)), np.flatnonzero(drawn.any(axis=0))
    return image[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1].copy()


def _upright(up: FloatArray) -> FloatArray:
    """Rotation into a frame whose z is `up`, as near to the world's axes as possible, shape (3, 3)."""
    z = up / np.linalg.norm(up)
    x = np.array([1.0, 0.0, 0.0]) if abs(z[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    x = x - z * (x @ z)
    x /= np.linalg.norm(x)
    return np.array([x, np.cross(z, x), z])


def _camera() -> FloatArray:
    """Unit vector towards the camera."""
    e, a = np.deg2rad([ELEVATION, AZIMUTH])
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def _normals(corners: FloatArray) -> FloatArray:
    return unit(area_normals(corners))


def _lit(corners: FloatArray, colour: FloatArray, camera: FloatArray) -> FloatArray:
    """Colours after Lambert with a little gloss; a triangle seen from behind is lit on that side."""
    normal = _normals(corners)
    normal *= np.where(normal @ camera < 0, -1.0, 1.0)[:, None]
    light = LIGHT / np.linalg.norm(LIGHT)
    diffuse = np.clip(normal @ light, 0, None)[:, None]
    half = light + camera
    gloss = 0.18 * np.clip(normal @ (half / np.linalg.norm(half)), 0, None)[:, None] ** 40
    return np.clip(colour * (AMBIENT + (1 - AMBIENT) * diffuse) + gloss, 0, 1)
