"""The calls of `extremes` made to an FMU: one library for all the scenes, as an importer would load it."""

import functools
import math
import tempfile
from ctypes import c_double
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from fmu_fixture import PLATFORM
from fmu_importer import DISCARD, ERROR, OK, Instance, Unpacked

from tissue_contact.assembly import Assembly
from tissue_contact.fmu import description, model_bin
from tissue_contact.fmu.build import build, guid_of
from tissue_contact.status import STATUSES

DISCARDED = {s.name for s in STATUSES if s.discard}
_held = tempfile.TemporaryDirectory()  # until the process ends


@functools.cache
def _library(name: str, assembly: Assembly):
    folder = Path(_held.name)
    return Unpacked(build(assembly, folder / f"{name}.fmu", [PLATFORM]), folder / name).native


_first: list[Assembly] = []  # the library is the same for every scene


class Fmu:
    """An instance of the FMU of an assembly, without the .fmu around it: library and resources are enough."""

    def __init__(self, assembly: Assembly, folder: Path) -> None:
        _first.append(assembly) if not _first else None
        guid = guid_of(description.write(assembly, ""), model_bin.write(assembly, ""))
        (folder / "model.bin").write_bytes(model_bin.write(assembly, guid))
        fmu = SimpleNamespace(native=_library("extreme", _first[0]), guid=guid, location=folder.as_uri())
        self.instance = Instance(fmu, logging_on=True)
        assert self.instance.c, self.instance.text
        variables = list(enumerate(assembly.variables))
        self.inputs = [(k, v.slot) for k, v in variables if v.block == "inputs"]
        self.parameters = [(k, v.slot) for k, v in variables if v.block == "parameters"]
        self.outputs = [(k, v.slot) for k, v in variables if v.block == "outputs"]
        self.size = assembly.outputs.size
        self.kept = []

    @property
    def text(self) -> str:
        return self.instance.messages[-1][5].decode() if self.instance.messages else "nothing was logged"

    def expected(self, call) -> int:
        """FMI status of an outcome in Python."""
        if call.outcome in ("done", "saved", "restored"):
            return OK
        return DISCARD if call.outcome in DISCARDED else ERROR

    def call(self, call) -> tuple[int, np.ndarray]:
        """Status of a call, and the outputs after it."""
        i = self.instance
        if call.what == "save":
            self.kept.append(i.save())
            return OK, self._outputs()
        if call.what == "restore":
            return i.restore(self.kept[-1]), self._outputs()
        if call.what == "initialize":
            assert i.call("fmi2Reset") == OK, self.text
        values = {k: float(call.inputs[slot]) for k, slot in self.inputs}
        values |= {k: float(call.parameters[slot]) for k, slot in self.parameters}
        before = self._bytes()
        status = i.set(values) if values else OK
        if status == OK and call.what == "initialize":
            assert (i.setup(), i.enter()) == (OK, OK), self.text
            status = i.exit()
        elif status == OK:
            before = self._bytes()
            now = c_double(0.0) if math.isnan(call.h) else c_double(i.time())
            status = i.call("fmi2DoStep", now, c_double(call.h), 1)
        if status != OK and call.what != "initialize":
            assert self._bytes() == before, f"the state changed though the call was refused: {self.text}"
        return status, self._outputs()

    def _bytes(self) -> bytes:
        state = self.instance.save()
        content = self.instance.serialize(state)
        self.instance.drop(state)
        return content[96:136] + content[152:]  # the clock and what persists; without mode, last status and checksum

    def _outputs(self) -> np.ndarray:
        out = np.zeros(self.size)
        _, values = self.instance.get(*[k for k, _ in self.outputs])
        out[[slot for _, slot in self.outputs]] = values
        return out

    def free(self) -> None:
        for state in self.kept:
            self.instance.drop(state)
        self.instance.free()
