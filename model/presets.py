"""Presets: named settings of the solver that fill in what a scene does not say itself.

What each of them costs and errs by is measured by `make presets`; docs/presets.md tells it.
"""

from typing import Any, Literal, NamedTuple

# keys of the table `solver` without a meaning for other integrators
OF_PROJECTIVE = ("iterations", "tolerance", "motion_limit")

PresetName = Literal["fast", "balanced", "accurate"]


class Preset(NamedTuple):
    """Keys of the scene's table `solver`; those of `OF_PROJECTIVE` have no meaning for other integrators."""

    integrator: str
    iterations: int = 0
    tolerance: float = 0.0
    motion_limit: float = 0.0

    @property
    def keys(self) -> dict[str, Any]:
        """The keys that have a meaning with their values."""
        return self._asdict() if self.integrator == "projective_dynamics" else {"integrator": self.integrator}

    @property
    def words(self) -> str:
        """The preset in words."""
        if self.iterations == 0:
            return self.integrator
        until = f", tolerance {100 * self.tolerance:g} %" if self.tolerance > 0.0 else ""
        slow = f", motion limit {1000 * self.motion_limit:g} mm" if self.motion_limit > 0.0 else ""
        return f"{self.integrator}, {self.iterations} iteration{'s' * (self.iterations > 1)}{until}{slow}"


PRESETS: dict[PresetName, Preset] = {
    "fast": Preset("projective_dynamics", 1, motion_limit=2e-4),
    "balanced": Preset("projective_dynamics", 3, 0.008, 1e-4),
    "accurate": Preset("symplectic_euler"),
}
DEFAULT: PresetName = "balanced"
# For every preset where a tissue resists by more than linear springs, of which projective dynamics knows nothing.
BEYOND_SPRINGS = Preset("symplectic_euler")
