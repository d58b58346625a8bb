"""The variables of an FMU: one table from which the description, the native code and the reference page are made."""

from typing import Literal, NamedTuple

Block = Literal["inputs", "parameters", "outputs"]

CAUSALITY: dict[Block, str] = {"inputs": "input", "parameters": "parameter", "outputs": "output"}
VARIABILITY: dict[Block, str] = {"inputs": "continuous", "parameters": "tunable", "outputs": "continuous"}


class Variable(NamedTuple):
    """One scalar Real of the FMU. Its value reference is its place in the table.

    ``block`` and ``slot`` say where the step finds it; ``minimum`` and ``maximum`` may be infinite.
    """

    name: str
    block: Block
    slot: int
    unit: str
    start: float
    minimum: float
    maximum: float
    description: str
