"""The recording of the scenario probing: the model itself with other constants than its scene has, and noise.

`python tests/probing.py` writes it anew.
"""

import io
from dataclasses import replace
from pathlib import Path

import numpy as np

from tissue_contact.assemble import assemble
from tissue_contact.files import publish
from tissue_contact.scene import read_scene
from tissue_contact.simulate import rollout

FOLDER = Path(__file__).parent.parent / "scenarios" / "probing"
TRUTH = {"tissue.stiffnessScale": 1.6, "tissue.supportStiffness": 6.5e4, "tissue.supportDamping": 3500.0}
NOISE = 0.005  # [N] standard deviation of each component
SEED = 1
STEPS, STEP = 1000, 1e-3


def poses() -> np.ndarray:
    """Time, position and quaternion: two slow presses and a fast one with a tremble, each at a place of its own."""
    t = STEP * np.arange(STEPS + 1)
    z = np.full(t.size, 2e-3)
    x = np.zeros(t.size)
    for begin, end, depth, place in ((0.0, 0.4, 8e-3, 0.0), (0.4, 0.8, 5e-3, 6e-3), (0.8, 1.0, 6e-3, -4e-3)):
        inside = (t >= begin) & (t <= end)
        course = np.clip(2.5 * np.sin(np.pi * (t[inside] - begin) / (end - begin)) ** 2, 0.0, 1.0)
        course = course * course * (3.0 - 2.0 * course)  # in and out without a jolt
        z[inside] -= (2e-3 + depth) * course
        x[inside] = place * np.sin(np.pi * (t[inside] - begin) / (end - begin)) ** 2
    z -= 5e-5 * np.sin(2 * np.pi * 25.0 * t) * (t > 0.8)
    zero = np.zeros_like(t)
    return np.stack([t, x, zero, z, zero + 1.0, zero, zero, zero], axis=1)


def recording() -> bytes:
    """The CSV file."""
    assembly = assemble(read_scene(FOLDER / "scene.toml"))
    parameters = assembly.parameters.copy()
    for v in assembly.variables:
        if v.name in TRUTH:
            parameters[v.slot] = TRUTH[v.name]
    driven = poses()
    # What is written is what is driven: the poses are rounded first.
    driven[:, 1:4] = np.round(driven[:, 1:4], 7)
    force = rollout(replace(assembly, parameters=parameters), driven[:, 1:], STEP).outputs[:, :3]
    noisy = force + NOISE * np.random.default_rng(SEED).standard_normal(force.shape)
    text = io.StringIO()
    text.write("time [s],x [mm],y [mm],z [mm],fx [N],fy [N],fz [N]\n")
    for row, f in zip(driven, noisy, strict=True):
        text.write(f"{row[0]:.3f},{1e3 * row[1]:.4f},{1e3 * row[2]:.4f},{1e3 * row[3]:.4f},")
        text.write(",".join(f"{part:.4f}" for part in f) + "\n")
    return text.getvalue().encode()


if __name__ == "__main__":
    publish(FOLDER / "measured.csv", recording())
