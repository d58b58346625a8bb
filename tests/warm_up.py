"""Compile what the tests share, for Python, for derivatives and for the FMU side by side, and leave it in the cache."""

import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from tissue_contact.assemble import assemble
from tissue_contact.fmu.compile import shared_library
from tissue_contact.fmu.native import host_platform
from tissue_contact.identify.sensitivity import DualInstance
from tissue_contact.scene import parse_scene
from tissue_contact.simulate import Instance

SCENE = b"""
name = "warm_up"
[[tissue]]
shape = { kind = "patch", size = [0.02, 0.02], triangles = 64 }
areal_density = 1.0
stiffness = 100.0
[[instrument]]
shape = { kind = "sphere", radius = 0.003, triangles = 128 }
[[contact]]
stiffness_per_area = 1e6
"""


def _native() -> None:
    shared_library(host_platform(), progress=lambda text: print(text, file=sys.stderr))


def _step(derivatives: bool) -> None:
    assembly = assemble(parse_scene(SCENE, Path()))
    instance = DualInstance(assembly, assembly.parameters, 0) if derivatives else Instance(assembly)
    instance.initialize()
    instance.step(1e-3)


def main() -> None:
    """The kernels of derivatives are others than those of plain numbers: no process waits for what another compiles."""
    with ProcessPoolExecutor(3, mp_context=get_context("spawn")) as pool:
        for job in [pool.submit(_step, True), pool.submit(_native), pool.submit(_step, False)]:
            job.result()


if __name__ == "__main__":
    main()
