"""The figures of a run: force and depth over time, the deformed tissue at the peak force; a scene at rest."""

import io
from collections.abc import Sequence
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
from tissue_contact.kernels.layout import State
from tissue_contact.kernels.slots import POSE
from tissue_contact.scenarios.outcome import FloatArray, Trace
from tissue_contact.simulate import rollout
from tissue_contact.surfaces import rotation_matrix

if TYPE_CHECKING:
    from tissue_contact.scenarios.run import Outcome

DOTS_PER_INCH = 160
CANVAS = 1680  # [pixel] across, of which the picture is cut out
ELEVATION, AZIMUTH = 24.0, -58.0  # [degree] of the camera above and round the tissue at the contact
LIGHT = np.array([-0.45, -0.35, 0.82])  # towards the light, in the camera's upright frame
AMBIENT = 0.42  # light that reaches every side
STEEL = np.array([0.44, 0.52, 0.60])
STEEL_OPACITY = 0.45
# From pale tissue to deep red, dark enough at the far end for the shading to stay visible everywhere.
DISPLACEMENT_COLOURS = LinearSegmentedColormap.from_list(
    "displacement", ["#f6ddcf", "#f2b49b", "#e27b6a", "#bf4551", "#8a2346", "#4f1237"]
)
PALE = np.array(DISPLACEMENT_COLOURS(0.2)[:3])  # tissue at rest
STILL_SIZE = 5.0  # [inch] of the longer side of the picture of a scene at rest
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
    name, trace = outcome.scenario.name, outcome.trace
    files = []
    if outcome.summary.peak_force:
        files.append(output / f"{name}.png")
        publish(files[-1], history(trace, list(outcome.summary.peak_force), name))
    files.append(output / f"{name}-peak.png")
    publish(files[-1], peak(trace, list(outcome.summary.peak_force), assembly, name))
    return files


# --- over time --------------------------------------------------------------------------------------------


def history(trace: Trace, instruments: Sequence[str], title: str) -> bytes:
    """Force and depth of the named instruments over time, as PNG."""
    figure = Figure(figsize=(8, 2 + 3.2 * len(instruments)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2 * len(instruments), 1, sharex=True, height_ratios=[3, 2] * len(instruments))
    time = trace.time[: trace.done]
    for name, force_axes, depth_axes in zip(instruments, axes[::2], axes[1::2], strict=True):
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
        force_axes.set_ylabel("force on the instrument [N]")
        force_axes.set_title(f"{title}: {name}" if len(instruments) > 1 else title)
        force_axes.legend(loc="upper left", frameon=False, ncols=4)
        force_axes.margins(y=0.22)
        depth_axes.fill_between(time, 1e3 * depth, color="#bf4551", alpha=0.25, lw=0)
        depth_axes.plot(time, 1e3 * depth, color="#bf4551", lw=1.2)
        depth_axes.set_ylabel("depth [mm]")
        depth_axes.set_ylim(bottom=0)
        for a in (force_axes, depth_axes):
            a.grid(alpha=0.25)
            a.spines[["top", "right"]].set_visible(False)
    axes[-1].set_xlabel("time [s]")
    axes[-1].set_xlim(time[0], time[-1])
    return _png(figure)


def _png(figure: Figure) -> bytes:
    file = io.BytesIO()
    # Without matplotlib's version in it the same picture is the same file.
    figure.savefig(file, format="png", dpi=DOTS_PER_INCH, facecolor="white", metadata={"Software": None})
    return file.getvalue()


# --- at the peak ------------------------------------------------------------------------------------------


def peak(trace: Trace, instruments: Sequence[str], assembly: Assembly, title: str) -> bytes:
    """The tissue and all instruments at the greatest force, or at the end without any contact, as PNG.

    The FMU does not tell the shape of the tissue: the same steps are done again by the model in Python, which
    gives the same bits.
    """
    forces = {name: np.linalg.norm(trace.vector(f"{name}.force"), axis=1) for name in instruments}
    leader = max(forces, key=lambda name: forces[name].max(), default=None)
    touched = leader is not None and forces[leader].max() > 0
    row = int(forces[leader].argmax()) if leader is not None and touched else trace.done - 1
    inputs = np.tile(assembly.inputs, (row + 1, 1))
    for variable in assembly.variables:
        if variable.block == "inputs":
            inputs[:, variable.slot] = trace.column(variable.name)[: row + 1]
    state = rollout(assembly, inputs, trace.time[1] - trace.time[0]).state
    names = [v.name.removesuffix(".orientation[1]") for v in assembly.variables if ".orientation[1]" in v.name]
    leading = names.index(leader) if leader in names else None
    rest, tissue, bodies, up = _placed(assembly, state, inputs[row], leading)
    when = f"peak force {forces[leader][row]:.3g} N" if leader is not None and touched else "no contact"
    return picture(tissue, rest, bodies, up, f"{title}: {when}, t = {trace.time[row]:.3f} s")


def still(assembly: Assembly) -> bytes:
    """The scene at its start: tissue and instruments, as PNG."""
    leading = 0 if len(assembly.model.instrument_part_start) > 1 else None
    _, tissue, bodies, up = _placed(assembly, assembly.state, assembly.inputs, leading)
    image = _scene(tissue, np.tile(PALE, (len(tissue.triangles), 1)), bodies, up)
    height, width = image.shape[:2]
    figure = Figure(figsize=(STILL_SIZE * width / max(width, height), STILL_SIZE * height / max(width, height)))
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.02, 0.02, 0.96, 0.96))
    axes.imshow(image, interpolation="antialiased")
    axes.set_axis_off()
    return _png(figure)


def _placed(
    assembly: Assembly, state: State, inputs: FloatArray, leading: int | None
) -> tuple[FloatArray, Mesh, list[Mesh], FloatArray]:
    """Rest places of the vertices, the tissue, the bodies at the poses of `inputs`, where instrument `leading` ends."""
    model = assembly.model
    rest = np.column_stack([model.rest_x, model.rest_y, model.rest_z])
    tissue = Mesh(
        np.column_stack([state.x, state.y, state.z]),
        np.column_stack([model.triangle_a, model.triangle_b, model.triangle_c]),
    )
    bodies, up = [], np.array([0.0, 0.0, 1.0])
    body_points = np.column_stack([model.instrument_x, model.instrument_y, model.instrument_z])
    body_triangles = np.column_stack([model.instrument_a, model.instrument_b, model.instrument_c])
    for i in range(len(model.instrument_triangle_start) - 1):
        pose = inputs[POSE * i : POSE * (i + 1)]
        turn = rotation_matrix(tuple(pose[3:] / np.linalg.norm(pose[3:])))
        begin, end = model.instrument_triangle_start[i : i + 2]
        bodies.append(Mesh(body_points @ turn.T + pose[:3], body_triangles[begin:end]))
        if i == leading:
            shaft = model.part_axis[6 * model.instrument_part_start[i] :][:6].reshape(2, 3)
            up = turn @ (shaft[1] - shaft[0])
    return rest, tissue, bodies, up


def picture(tissue: Mesh, rest: FloatArray, bodies: Sequence[Mesh], up: FloatArray, title: str) -> bytes:
    """Shaded picture of tissue, coloured by its displacement, and of half-transparent bodies, as PNG.

    Parameters
    ----------
    tissue : Mesh
        As it is deformed, in the world.
    rest : float64 [m], shape (n, 3)
        Where its vertices were.
    bodies : sequence of Mesh
        In the world.
    up : float64, shape (3,)
        Direction that points up in the picture: from the contact towards the handle shows the dent.
    title : str
        Over the picture.

    """
    moved = 1e3 * np.linalg.norm(tissue.vertices - rest, axis=1)
    span = Normalize(0.0, max(float(moved.max()), 1e-3))
    colours = DISPLACEMENT_COLOURS(span(moved[tissue.triangles].mean(axis=1)))[:, :3]
    image = _scene(tissue, colours, bodies, up)

    height = 5.6  # [inch] of the picture itself
    width = float(np.clip(height * image.shape[1] / image.shape[0], 4.0, 10.0))
    figure = Figure(figsize=(width + 1.3, height + 0.7))
    FigureCanvasAgg(figure)
    total = figure.get_size_inches()
    axes = figure.add_axes((0.1 / total[0], 0.1 / total[1], width / total[0], height / total[1]))
    axes.imshow(image, interpolation="antialiased")
    axes.set_axis_off()
    legend = figure.add_axes(((width + 0.25) / total[0], 0.25, 0.2 / total[0], 0.5))
    figure.colorbar(ScalarMappable(span, DISPLACEMENT_COLOURS), cax=legend, label="displacement of the tissue [mm]")
    figure.suptitle(title, y=1 - 0.18 / total[1], fontsize=12, va="top")
    return _png(figure)


def _scene(tissue: Mesh, colours: FloatArray, bodies: Sequence[Mesh], up: FloatArray) -> NDArray[np.uint8]:
    """Shaded tissue, its triangles in `colours`, and half-transparent bodies; shape (rows, columns, 4)."""
    upright, camera = _upright(up), _camera()
    corners = [(tissue.vertices @ upright.T)[tissue.triangles]]
    base, opacity = [colours], [np.ones(len(tissue.triangles))]
    for body in bodies:
        body_corners = (body.vertices @ upright.T)[body.triangles]
        body_corners = body_corners[_normals(body_corners) @ camera > 0]  # the far side would show through
        corners.append(body_corners)
        base.append(np.tile(STEEL, (len(body_corners), 1)))
        opacity.append(np.full(len(body_corners), STEEL_OPACITY))
    faces, colour, alpha = 1e3 * np.concatenate(corners), np.concatenate(base), np.concatenate(opacity)
    return _rendered(faces, np.column_stack([_lit(faces, colour, camera), alpha]), alpha == 1.0)


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
    bar = 10.0 ** np.floor(np.log10(0.5 * size[0]))
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
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return np.asarray(np.divide(normal, length, out=np.zeros_like(normal), where=length > 0))


def _lit(corners: FloatArray, colour: FloatArray, camera: FloatArray) -> FloatArray:
    """Colours after Lambert with a little gloss; a triangle seen from behind is lit on that side."""
    normal = _normals(corners)
    normal *= np.where(normal @ camera < 0, -1.0, 1.0)[:, None]
    light = LIGHT / np.linalg.norm(LIGHT)
    diffuse = np.clip(normal @ light, 0, None)[:, None]
    half = light + camera
    gloss = 0.18 * np.clip(normal @ (half / np.linalg.norm(half)), 0, None)[:, None] ** 40
    return np.clip(colour * (AMBIENT + (1 - AMBIENT) * diffuse) + gloss, 0, 1)
