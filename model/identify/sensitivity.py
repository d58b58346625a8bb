"""Derivatives of all that a rollout gives by tunable parameters: the kernels themselves, run on dual numbers."""

from collections.abc import Sequence

import numpy as np

from tissue_contact.assembly import Assembly
from tissue_contact.kernels.bundle import Bundle
from tissue_contact.kernels.dual import DualBundle, dual_initialize, dual_step
from tissue_contact.kernels.layout import Model, Real, State
from tissue_contact.simulate import Instance, run


class DualInstance(Instance):
    """A running copy that has the derivatives of its outputs by one parameter beside them, in ``tangents``."""

    _bundle, _initialize, _step = DualBundle, staticmethod(dual_initialize), staticmethod(dual_step)

    def __init__(self, assembly: Assembly, parameters: Real, slot: int) -> None:
        super().__init__(assembly)
        self._parameters = np.zeros((parameters.size, 2))
        self._parameters[:, 0] = parameters
        self._parameters[slot, 1] = 1.0
        self._results = np.zeros((self.outputs.size, 2))
        self.parameters = self._parameters[:, 0]
        self.outputs, self.tangents = self._results.T

    def _arguments(self) -> tuple[Bundle[Model], Real, Bundle[State], Real]:
        return self._model, self._parameters, self._state, self.inputs


def sensitivities(
    assembly: Assembly, inputs: Real, h: float, parameters: Real, slots: Sequence[int]
) -> tuple[Real, Real]:
    """Run a scene as `simulate.rollout` does, once for each parameter asked for.

    The derivatives are exact for the branches taken: that the number of substeps, the triangles that touch or the
    iterations of a solver change with a parameter is not seen.

    Parameters
    ----------
    assembly, inputs, h, parameters
        As for `simulate.rollout`.
    slots : one or more
        Of the parameters by which to differentiate.

    Returns
    -------
    outputs : shape [n + 1, outputs]
        The same numbers as of `simulate.rollout`.
    derivatives : shape [n + 1, outputs, slots]
        Unit of the output per unit of the parameter.

    Raises
    ------
    WorkError
        As `simulate.rollout`.
    """
    outputs = np.empty((len(inputs), assembly.outputs.size))
    derivatives = np.empty((*outputs.shape, len(slots)))
    for k, slot in enumerate(slots):
        instance = DualInstance(assembly, parameters, slot)
        for n in run(instance, inputs, h):
            outputs[n], derivatives[n, :, k] = instance.outputs, instance.tangents
    return outputs, derivatives
