"""Run an assembled scene in Python: the same step as in the FMU, compiled just in time."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

# numba must know duals before it reads what is cached of them: learning of them in between confuses it
import tissue_contact.kernels.dual  # noqa: F401
from tissue_contact.assembly import Assembly
from tissue_contact.errors import WorkError
from tissue_contact.kernels import stability
from tissue_contact.kernels.bundle import Bundle
from tissue_contact.kernels.compiled import kernel
from tissue_contact.kernels.layout import Index, Model, Real, Scratch, State
from tissue_contact.kernels.step import initialize, step
from tissue_contact.status import OK, PARAMETER_RANGE, STATUSES, Status


class Refused(WorkError):
    """A step that could not be done; ``status`` says why."""

    def __init__(self, status: Status, detail: Real) -> None:
        super().__init__(status.message % tuple(detail))
        self.status, self._detail = status, detail.copy()

    def __reduce__(self) -> tuple[type["Refused"], tuple[Status, Real]]:
        """To another process as it was made: by default an error goes there as its message."""
        return Refused, (self.status, self._detail)


@kernel
def _stable_substep(model, parameters, state, scratch, h):  # type: ignore[no-untyped-def]
    """The kernel for Python, which only kernels may call."""
    return stability.stable_substep(model, parameters, state, scratch, model.integrator[0], h)


class Rollout(NamedTuple):
    """What a rollout gives."""

    outputs: Real  # shape [n + 1, outputs], row 0 at the start, row k at the end of step k
    state: State  # at the end


class Instance:
    """One running copy of an assembled scene.

    ``parameters``, ``inputs`` and ``outputs`` may be read and set at any time; `step` reads and fills them.
    """

    _bundle, _initialize, _step = Bundle, staticmethod(initialize), staticmethod(step)

    def __init__(self, assembly: Assembly) -> None:
        self._assembly = assembly
        self._model, self._state = Bundle(assembly.model), self._bundle(assembly.state)
        self._scratch = self._bundle(assembly.scratch)
        self.model: Model = assembly.model
        self.state: State = self._state.fields
        self.scratch: Scratch = self._scratch.fields
        self.parameters = assembly.parameters.copy()
        self.inputs = assembly.inputs.copy()
        self.outputs = self._results = assembly.outputs.copy()
        self._ranges = np.full((2, assembly.parameters.size), [[-np.inf], [np.inf]])
        for v in assembly.variables:
            if v.block == "parameters":
                self._ranges[:, v.slot] = v.minimum, v.maximum
        self._start = self.copy_state()

    def _arguments(self) -> tuple[Bundle[Model], Real, Bundle[State], Real]:
        return self._model, self.parameters, self._state, self.inputs

    def copy_state(self) -> tuple[Index, Real]:
        """Copy of everything that persists, for `restore_state`."""
        return self._state.index.copy(), self._state.real.copy()

    def restore_state(self, saved: tuple[Index, Real]) -> None:
        """Return to a state that `copy_state` gave."""
        self._state.index[:], self._state.real[:] = saved

    def stable_substep(self, h: float) -> float:
        """Stable limit [s] of a substep in the present state, at the motion of the last step, within a step h [s]."""
        return float(_stable_substep(self._model, self.parameters, self._state, self._scratch, h))

    def initialize(self) -> None:
        """Put the instruments at the poses of the inputs; outputs follow. Raises Refused."""
        before = self.copy_state()
        self.restore_state(self._start)
        self._do(self._initialize, (), before)

    def step(self, h: float) -> None:
        """One communication step h [s]. Raises Refused; the state from before the step then stays."""
        self._do(self._step, (h,), self.copy_state())

    def _do(self, entry: Callable[..., int], more: tuple[float, ...], saved: tuple[Index, Real]) -> None:
        """Run an entry of the kernels; if it fails, everything that persists is as it was saved."""
        given = self.outputs.copy()
        status = self._check_parameters() or entry(*self._arguments(), *more, self._results, self._scratch)
        if status != OK:
            self.restore_state(saved)
            self.outputs[:] = given
            raise Refused(STATUSES[status], self.scratch.detail)

    def _check_parameters(self) -> int:
        """Hold the parameters to their ranges, as the FMU does when they are set; the status."""
        low, high = self._ranges
        wrong = np.flatnonzero(~((self.parameters >= low) & (self.parameters <= high)))
        if wrong.size == 0:
            return OK
        self.scratch.detail[:] = wrong[0], self.parameters[wrong[0]]
        return PARAMETER_RANGE


def run(instance: Instance, inputs: Real, h: float) -> Iterator[int]:
    """Run an instance from its start; arguments and errors as for `rollout`.

    Yields
    ------
    int
        Row of the inputs at which the outputs of the instance now are.
    """
    instance.inputs[:] = inputs[0]
    instance.initialize()
    yield 0
    for n, row in enumerate(inputs[1:]):
        instance.inputs[:] = row
        try:
            instance.step(h)
        except WorkError as error:
            raise WorkError(f"step {n + 1} at {n * h:g} s: {error}") from error
        yield n + 1


def rollout(assembly: Assembly, inputs: Real, h: float, parameters: Real | None = None) -> Rollout:
    """Run a scene from its start with the input of every step given.

    Parameters
    ----------
    assembly : Assembly
    inputs : shape [n + 1, inputs]
        Row 0 is set before the first step, row k at the beginning of step k: the instruments reach it at its end.
    h : float
        Communication step [s].
    parameters : shape [parameters], optional
        Instead of the start values.

    Raises
    ------
    WorkError
        A step that could not be done: its number, its time and the reason.
    """
    instance = Instance(assembly)
    if parameters is not None:
        instance.parameters[:] = parameters
    outputs = np.empty((len(inputs), instance.outputs.size))
    for n in run(instance, inputs, h):
        outputs[n] = instance.outputs
    return Rollout(outputs, instance.state)
