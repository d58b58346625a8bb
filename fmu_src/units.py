"""Units of the variables, resolved to SI base units."""

import re

from tissue_contact.errors import WorkError

# Exponents of the SI base units.
_NAMED: dict[str, dict[str, int]] = {
    "1": {},
    "m": {"m": 1},
    "kg": {"kg": 1},
    "s": {"s": 1},
    "rad": {"rad": 1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
    "W": {"kg": 1, "m": 2, "s": -3},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "Hz": {"s": -1},
}


def base_unit(unit: str) -> dict[str, int]:
    """Exponents of the SI base units in a unit such as ``N.s/m3``, the ones that are not 0.

    ``.`` multiplies, ``/`` divides by the one factor after it, a trailing integer is a power. ``1`` is
    dimensionless.

    Raises
    ------
    WorkError
        A factor is unknown.
    """
    total: dict[str, int] = {}
    for sign, factor in re.findall(r"(^|[./])([^./]*)", unit):
        match = re.fullmatch(r"([A-Za-z]+|1)(-?\d+)?", factor)
        if match is None or match[1] not in _NAMED:
            raise WorkError(f"the unit {unit!r} of a variable has the unknown factor {factor!r}")
        power = int(match[2] or 1) * (-1 if sign == "/" else 1)
        for base, exponent in _NAMED[match[1]].items():
            total[base] = total.get(base, 0) + power * exponent
    return {base: exponent for base, exponent in total.items() if exponent}
