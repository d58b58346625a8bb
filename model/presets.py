"""Presets: named settings of the solver that fill in what a scene does not say itself.

What each of them costs and errs by is measured by `make presets`; docs/presets.md tells it.
"""

from typing import Any, Literal, NamedTuple

OF_PROJECTIVE = ("iterations", "tolerance")  # keys of the table `solver` without a meaning for other integrators

PresetName = Literal["fast", "balanced", "accurate"]


class Preset(NamedTuple):
    """Keys of the scene's table `solver`; None leaves one out."""

    integrator: str
    iterations: int | None = None
    tolerance: float | None = None

    @property
    def keys(self) -> dict[str, Any]:
        """The keys with their values."""
        return {key: value for key, value in self._asdict().items() if value is not None}

    @property
    def words(self) -> str:
        """The preset in words."""
        if self.iterations is None:
            return self.integrator
        until = "" if self.tolerance is None else f", tolerance {100 * self.tolerance:g} %"
        return f"{self.integrator}, {self.iterations} iteration{'s' * (self.iterations > 1)}{until}"


PRESETS: dict[PresetName, Preset] = {
    "fast": Preset("projective_dynamics", 1),
    "balanced": Preset("projective_dynamics", 3, 0.01),
    "accurate": Preset("symplectic_euler"),
}
# For every preset where a tissue resists by more than linear springs, of which projective dynamics knows nothing.
BEYOND_SPRINGS = Preset("symplectic_euler")
