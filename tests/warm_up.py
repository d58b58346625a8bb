"""Compile what the tests share, for Python and for the FMU side by side, and leave it in the cache."""

import sys
from concurrent.futures import ThreadPoolExecutor
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


def main() -> None:
    """Numba compiles for the FMU in a process of its own, so that a thread is enough to wait for it."""
    with ThreadPoolExecutor(1) as pool:
        native = pool.submit(shared_library, host_platform(), progress=lambda text: print(text, file=sys.stderr))
        assembly = assemble(parse_scene(SCENE, Path()))
        for instance in (Instance(assembly), DualInstance(assembly, assembly.parameters, 0)):
            instance.initialize()
            instance.step(1e-3)
        native.result()


if __name__ == "__main__":
    main()
