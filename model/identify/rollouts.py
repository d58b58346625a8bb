"""The force of a whole scene as a function of its tunable parameters: rollouts with their derivatives.

A rollout runs in Python (`SceneForce`) or in an FMU (a class of the same shape in the scenarios); `as_casadi` makes a
casadi function of either, with exact or differenced derivatives, for use inside larger problems.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import casadi as ca
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation, Slerp

from tissue_contact.assembly import Assembly, start_values
from tissue_contact.errors import InputError
from tissue_contact.identify.recording import Real, Recording
from tissue_contact.identify.sensitivity import sensitivities
from tissue_contact.identify.treatment import MOST
from tissue_contact.settings import nearest
from tissue_contact.simulate import rollout
from tissue_contact.variables import Variable

EVEN = 1e-6  # share of a step by which stamps may be uneven


@dataclass(frozen=True, eq=False)
class Drive:
    """What a rollout is driven with and compared to."""

    inputs: Real  # shape [n + 1, inputs], as `simulate.rollout` takes them
    step: float  # [s]
    measured: Real  # [N], shape [m · 3], force vectors
    at: npt.NDArray[np.int64] | slice = field(default_factory=lambda: slice(None))  # the m rows where it was measured


class ForceModel(Protocol):
    """The force vectors of all drives as a function of the wanted parameters."""

    @property
    def variables(self) -> Sequence[Variable]:
        """The wanted parameters."""

    def values(self, parameters: Real) -> Real:
        """Force [N], shape [m]."""

    def slopes(self, parameters: Real) -> Real:
        """Its derivatives by the parameters, shape [m, p]."""


def wanted_variables(variables: Sequence[Variable], names: Sequence[str]) -> list[Variable]:
    """The named tunable parameters; InputError for a name that there is not."""
    known = {v.name: v for v in variables if v.block == "parameters"}
    for name in names:
        if name not in known:
            way_out = nearest(name, known, what="parameters")
            raise InputError("--parameter", "the scene must have the tunable parameter", name, way_out)
    return [known[name] for name in names]


def instrument_of(variables: Sequence[Variable], name: str | None) -> str:
    """The instrument that is meant: the named one, or the only one; InputError otherwise."""
    ending = ".position[1]"
    known = [v.name.removesuffix(ending) for v in variables if v.block == "inputs" and v.name.endswith(ending)]
    if name is None and len(known) == 1:
        return known[0]
    if name in known:
        return name
    rule = "the instrument that was recorded must be named where there are several"
    found = f"{len(known)} instruments" if name is None else name
    raise InputError("--instrument", rule, found, nearest(name or "", known, what="instruments"))


def drive_of(recording: Recording, variables: Sequence[Variable], instrument: str) -> Drive:
    """The inputs of a rollout that follows a recording of poses and force vectors, one step a sample.

    Where samples are missing between even stamps, the instrument goes on evenly from one to the next.
    """
    place = f"{recording.place}, probe {recording.name}"
    if recording.pose is None or recording.force_vector is None or recording.time is None:
        have = [k for k in ("time", "pose", "force_vector") if getattr(recording, k) is not None]
        rule = "a fit of the whole model needs time, pose and force vector"
        raise InputError(place, rule, " and ".join(have) or "none of them", "Give columns for all three")
    steps = np.diff(recording.time)
    counts = np.fmax(1.0, np.rint(steps / np.median(steps)))
    at = np.append(0, counts.cumsum()).astype(np.int64)
    step = float(recording.time[-1] - recording.time[0]) / at[-1]
    if np.abs(steps - counts * step).max() > EVEN * step or at[-1] > MOST:
        found = f"steps from {steps.min():g} to {steps.max():g} s"
        raise InputError(place, "a rollout needs even time stamps", found, "Set resample in [treatment]")
    (first,) = [v.slot for v in variables if v.name == f"{instrument}.position[1]"]
    still = start_values(sum(v.block == "inputs" for v in variables), tuple(variables), "inputs")
    rows = np.arange(at[-1] + 1)
    inputs = np.tile(still, (len(rows), 1))
    pose = recording.pose
    inputs[:, first : first + 3] = np.transpose([np.interp(rows, at, x) for x in pose[:, :3].T])
    turns = Slerp(at, Rotation.from_quat(pose[:, 3:], scalar_first=True))(rows)
    inputs[:, first + 3 : first + 7] = turns.as_quat(scalar_first=True)
    return Drive(inputs, step, recording.force_vector.ravel(), at)


class SceneForce:
    """Force of an assembled scene by rollouts in Python; derivatives from `sensitivities`."""

    def __init__(self, assembly: Assembly, instrument: str, drives: Sequence[Drive], names: Sequence[str]) -> None:
        self.variables = wanted_variables(assembly.variables, names)
        self._assembly, self._drives = assembly, drives
        (first,) = [v.slot for v in assembly.variables if v.name == f"{instrument}.force[1]"]
        self._force = slice(first, first + 3)
        self._slots = [v.slot for v in self.variables]

    def _full(self, parameters: Real) -> Real:
        full = self._assembly.parameters.copy()
        full[self._slots] = parameters
        return full

    def values(self, parameters: Real) -> Real:
        full = self._full(parameters)
        runs = [rollout(self._assembly, d.inputs, d.step, full).outputs for d in self._drives]
        return np.concatenate([run[d.at, self._force].ravel() for d, run in zip(self._drives, runs, strict=True)])

    def slopes(self, parameters: Real) -> Real:
        full = self._full(parameters)
        runs = [sensitivities(self._assembly, d.inputs, d.step, full, self._slots)[1] for d in self._drives]
        parts = [by[d.at, self._force] for d, by in zip(self._drives, runs, strict=True)]
        return np.concatenate([part.reshape(-1, len(self._slots)) for part in parts])


@dataclass(frozen=True, eq=False)
class SceneMaker:
    """Makes the `SceneForce` of some drives."""

    assembly: Assembly
    instrument: str
    names: tuple[str, ...]

    def __call__(self, drives: Sequence[Drive]) -> SceneForce:
        return SceneForce(self.assembly, self.instrument, drives, self.names)


class _Callback(ca.Callback):
    """Common to force and Jacobian: one column of parameters in."""

    def __init__(self, model: ForceModel, size: int, name: str) -> None:
        ca.Callback.__init__(self)
        self.model, self.size = model, size
        self.construct(name, {})

    def get_n_in(self) -> int:
        return 1

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(len(self.model.variables), 1)

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self.size, 1)

    def eval(self, arguments: Sequence[ca.DM]) -> list[Real]:
        return [self.model.values(np.asarray(arguments[0]).ravel())]

    def has_jacobian(self) -> bool:
        return True

    def get_jacobian(
        self, name: str, inames: Sequence[str], onames: Sequence[str], options: Mapping[str, Any]
    ) -> ca.Function:
        self.jacobian_callback = _Jacobian(self.model, self.size, name, inames, onames)
        return self.jacobian_callback


class _Jacobian(ca.Callback):
    def __init__(self, model: ForceModel, size: int, name: str, inames: Sequence[str], onames: Sequence[str]) -> None:
        ca.Callback.__init__(self)
        self.model, self.size, self.names = model, size, (inames, onames)
        self.construct(name, {})

    def get_n_in(self) -> int:
        return 2  # the parameters, and the force that they gave

    def get_n_out(self) -> int:
        return 1

    def get_name_in(self, i: int) -> str:
        return self.names[0][i]

    def get_name_out(self, i: int) -> str:
        return self.names[1][i]

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        n = len(self.model.variables)
        return ca.Sparsity.dense(n, 1) if i == 0 else ca.Sparsity(self.size, 1)

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self.size, len(self.model.variables))

    def eval(self, arguments: Sequence[ca.DM]) -> list[Real]:
        return [self.model.slopes(np.asarray(arguments[0]).ravel())]


def as_casadi(model: ForceModel, size: int, name: str = "force") -> ca.Callback:
    """The force [N] of all samples as a casadi function of the parameters, shape [p, 1] to [size, 1].

    Its Jacobian is that of ``model``. Keep the function for as long as what was made of it is used.
    """
    return _Callback(model, size, name)
