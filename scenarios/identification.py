"""How well and how fast constants are identified: coverage of intervals, and a scene against plain scipy.

`make identification` writes `build/identification.json`; docs/identification.md tells of it.
"""

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from tissue_contact.assemble import assemble
from tissue_contact.files import publish
from tissue_contact.identify.contact_fit import Options, Probe, fit_laws
from tissue_contact.identify.laws import Force, Touches, constants_of
from tissue_contact.identify.least_squares import fit
from tissue_contact.identify.reading import read
from tissue_contact.identify.recording import Real
from tissue_contact.identify.rollouts import SceneForce, SceneMaker, drive_of, wanted_variables
from tissue_contact.identify.scene_fit import SceneOptions, fit_scene
from tissue_contact.identify.statistics import uncertainty
from tissue_contact.pool import Kept
from tissue_contact.scene import read_scene

PROBING = Path(__file__).parent / "probing"
WANTED = ("tissue.stiffnessScale", "tissue.supportStiffness", "tissue.supportDamping")
TRUTH = {"kelvin_voigt": np.array([300.0, 0.8]), "hunt_crossley": np.array([2e4, 1.5, 1.8])}
NOISES = (0.0, 0.01, 0.05, 0.2)  # of the peak force
DRAWS = 200
SEED = 1
PROBES = 200  # of the timed fit


def touches(samples: int = 400) -> Touches:
    """Depth that goes in and out some times, at two speeds."""
    t = 2e-3 * np.arange(samples)
    depth = 3e-3 * np.sin(5 * np.pi * t) ** 2 * (1 + 0.3 * np.sin(30 * t))
    return Touches(np.arange(samples), depth, np.gradient(depth, t), np.ones((samples, 1)), samples)


def coverage() -> list[dict[str, Any]]:
    """Largest error of the constants over the draws' mean, and how often their intervals cover the truth."""
    rows = []
    for law, truth in TRUTH.items():
        force = Force(law, touches())
        clean = force(truth)[0]
        lower, upper = np.array([[c.minimum, c.maximum] for c in constants_of(law, False)]).T
        for noise in NOISES:
            rng = np.random.default_rng(SEED)
            found = []
            for _ in range(DRAWS if noise else 1):
                noisy = clean + noise * clean.max() * rng.standard_normal(clean.size)
                done = fit(force, noisy, [truth * 1.5], lower, upper)
                trust = uncertainty(done, lower > 0.0)
                found.append((done.values / truth - 1.0, (trust.low <= truth) & (truth <= trust.high)))
            off = np.array([f[0] for f in found])
            rows.append(
                {
                    "law": law,
                    "noise": noise,
                    "error": np.sqrt((off**2).mean(axis=0)).tolist(),
                    "covered": np.array([f[1] for f in found]).mean(axis=0).tolist() if noise else None,
                }
            )
    return rows


def many_probes() -> dict[str, float]:
    """Seconds for both laws to all of many probes, each alone, and held out, on one core."""
    rng = np.random.default_rng(SEED)
    own = touches(50)
    clean = Force("hunt_crossley", own)(TRUTH["hunt_crossley"])[0]
    probes = [Probe(str(n), "", own, clean * (1 + 0.02 * rng.standard_normal(clean.size))) for n in range(PROBES)]
    begin = time.perf_counter()
    fits, _, _ = fit_laws(probes, Options(), True, "")
    return {"probes": PROBES, "fits": len(fits), "seconds": time.perf_counter() - begin}


class _Counted:
    """A function that counts its calls."""

    def __init__(self, function: Callable[[Real], Real]) -> None:
        self.function, self.calls = function, 0

    def __call__(self, values: Real) -> Real:
        self.calls += 1
        return self.function(values)


def whole_model(folder: Path) -> dict[str, Any]:
    """The scenario probing fitted by this package and by scipy with differences of two sizes, on one core."""
    assembly = assemble(read_scene(PROBING / "scene.toml"))
    (recording,) = read([PROBING / "measured.csv"]).recordings
    drive = drive_of(recording, assembly.variables, "probe")
    wanted = wanted_variables(assembly.variables, WANTED)
    start = np.array([v.start for v in wanted])
    force = SceneForce(assembly, "probe", [drive], WANTED)
    force.slopes(start)  # compiles
    rows: dict[str, Any] = {}
    begin = time.perf_counter()
    own = fit_scene(SceneMaker(assembly, "probe", WANTED), [drive], wanted, start, SceneOptions(),
                    Kept(folder / "identification-starts.json", repr(begin)))  # fmt: skip
    rows["tissue-contact fit"] = {
        "evaluations": own.fitted.evaluations,
        "seconds": time.perf_counter() - begin,
        "cost": own.starts[0]["cost"],
        "values": own.values.tolist(),
    }
    for step in (None, 1e-2):
        counted = _Counted(lambda u: force.values(u * start) - drive.measured)
        begin = time.perf_counter()
        done = least_squares(counted, np.ones(3), bounds=(1e-3, 1e3), diff_step=step)
        rows[f"scipy, differences of {'1.5e-8' if step is None else f'{step:g}'}"] = {
            "evaluations": counted.calls,
            "seconds": time.perf_counter() - begin,
            "cost": float(done.cost),
            "values": (done.x * start).tolist(),
        }
    return rows


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, required=True, help="file to write")
    output: Path = parser.parse_args().output
    found = {"coverage": coverage(), "many_probes": many_probes(), "whole_model": whole_model(output.parent)}
    publish(output, (json.dumps(found, indent=1) + "\n").encode())
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
