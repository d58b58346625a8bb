"""The force of an FMU as a function of its tunable parameters, for an identification that has nothing but the FMU."""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import fmpy
import numpy as np
from fmpy.model_description import ModelDescription

from tissue_contact.identify.recording import Real
from tissue_contact.identify.rollouts import Drive, wanted_variables
from tissue_contact.scenarios.run import bound, drive, empty_trace, instance_of
from tissue_contact.variables import Block, Variable

# Half width of central differences, of a parameter or of its range where it is 0. So wide because a point of contact
# comes with a jump of its damper's force: over 1e-5 of a parameter one jump can be most of a difference.
DIFFERENCE = 1e-2


def variables_of(description: ModelDescription) -> list[Variable]:
    """Inputs and tunable parameters of an FMU; slots count each block on its own."""
    found, count = [], {"inputs": 0, "parameters": 0}
    blocks: dict[str, Block] = {"input": "inputs", "parameter": "parameters"}
    for v in description.modelVariables:
        if v.causality in blocks and v.type == "Real":
            block = blocks[v.causality]
            low, high = bound(v.min, -np.inf), bound(v.max, np.inf)
            start, unit = float(v.start or 0.0), v.unit or "1"
            found.append(Variable(v.name, block, count[block], unit, start, low, high, v.description or ""))
            count[block] += 1
    return found


class FmuForce:
    """Force on an instrument by rollouts of an FMU, with `fmi2Reset` before each; derivatives by differences."""

    def __init__(self, path: Path, instrument: str, drives: Sequence[Drive], names: Sequence[str]) -> None:
        self._path, self._drives = path, drives
        self._description = fmpy.read_model_description(str(path))
        table = variables_of(self._description)
        self.variables = wanted_variables(table, names)
        self._inputs = [v.name for v in table if v.block == "inputs"]
        self._force = [f"{instrument}.force[{k}]" for k in (1, 2, 3)]

    def _run(self, wanted: Sequence[Real]) -> list[Real]:
        """Forces for some sets of parameters."""
        log: list[tuple[int, str]] = []
        found = []
        with instance_of(self._path, self._description, log) as slave:
            for n, parameters in enumerate(wanted):
                forces = []
                for m, d in enumerate(self._drives):
                    if n + m > 0:
                        slave.reset()
                    steps = np.full(len(d.inputs) - 1, d.step)
                    trace = empty_trace(self._description, d.step * np.arange(len(d.inputs), dtype=np.float64))
                    inputs = dict(zip(self._inputs, d.inputs.T, strict=True))
                    values = {v.name: float(p) for v, p in zip(self.variables, parameters, strict=True)}
                    drive(slave, self._description, steps, inputs, values, trace)
                    columns = [trace.names.index(name) for name in self._force]
                    forces.append(trace.values[d.at][:, columns].ravel())
                found.append(np.concatenate(forces))
        return found

    def values(self, parameters: Real) -> Real:
        return self._run([parameters])[0]

    def slopes(self, parameters: Real) -> Real:
        sets, widths = [], []
        for k, v in enumerate(self.variables):
            high = v.maximum if np.isfinite(v.maximum) else 1.0
            reach = DIFFERENCE * (abs(parameters[k]) or high)
            around = np.clip(parameters[k] + np.array([-reach, reach]), v.minimum, v.maximum)
            for value in around:
                sets.append(parameters.copy())
                sets[-1][k] = value
            widths.append(around[1] - around[0])
        runs = self._run(sets)
        return np.stack([(b - a) / w for a, b, w in zip(runs[::2], runs[1::2], widths, strict=True)], axis=1)


@dataclass(frozen=True)
class FmuMaker:
    """Makes the `FmuForce` of some drives. It carries the FMU itself, for machines that do not have the file."""

    fmu: bytes
    instrument: str
    names: tuple[str, ...]

    def __call__(self, drives: Sequence[Drive]) -> FmuForce:
        if self.fmu not in _copies:
            _copies[self.fmu] = tempfile.TemporaryDirectory(prefix="tissue-contact-")
            Path(_copies[self.fmu].name, "model.fmu").write_bytes(self.fmu)
        return FmuForce(Path(_copies[self.fmu].name, "model.fmu"), self.instrument, drives, self.names)


_copies: dict[bytes, tempfile.TemporaryDirectory[str]] = {}  # one for each process, removed at its end
