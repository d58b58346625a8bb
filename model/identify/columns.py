"""Columns of a recording: what a title means and in which unit, unless a mapping says otherwise.

A title is a quantity and its unit, `depth_mm` or `depth [mm]`; upper and lower case matter in the unit only.
"""

import difflib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import Discriminator, Field, Tag

from tissue_contact.errors import InputError
from tissue_contact.settings import Settings, nearest, show

# Unit to SI; where a unit seems wrong, the first plausible one is proposed.
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
METRES = {"mm": 1e-3, "m": 1.0, "cm": 1e-2, "um": 1e-6}
SPEEDS = {f"{unit}{per}s": factor for unit, factor in METRES.items() for per in "/_"}
NEWTONS = {"N": 1.0, "mN": 1e-3, "gf": 9.80665e-3, "kN": 1e3, "uN": 1e-6}
PURE = {"": 1.0}


class Quantity(NamedTuple):
    """A quantity that a column may hold; limits in SI units."""

    units: dict[str, float]
    aliases: tuple[str, ...] = ()
    limit: float = float("inf")  # nothing that is measured on an organ goes beyond
    usual: tuple[float, float] = (0.0, float("inf"))  # where the largest value of a recording lies


_FORCE = Quantity(NEWTONS, ("fn",), 1e4, (1e-3, 200.0))
QUANTITIES = {
    "time": Quantity(SECONDS),
    "depth": Quantity(METRES, (), 1.0, (5e-5, 0.2)),
    "rate": Quantity(SPEEDS, (), 100.0, (1e-5, 1.0)),
    "force": _FORCE,
    **{f"force_{axis}": _FORCE._replace(aliases=(f"f{axis}",)) for axis in "xyz"},
    **{axis: Quantity(METRES, (), 10.0, (1e-3, 2.0)) for axis in "xyz"},
    **{f"q{part}": Quantity(PURE) for part in "wxyz"},
}
VECTORS = {
    "force_vector": ("force_x", "force_y", "force_z"),
    "position": ("x", "y", "z"),
    "orientation": ("qw", "qx", "qy", "qz"),
}


# --- mapping ----------------------------------------------------------------------------------------------


class TitleAndUnit(Settings):
    """A column whose title does not tell its unit."""

    column: str = Field(description="title of the column")
    unit: str = Field("", description="unit of the column, such as mm")


def _form(value: object) -> str | None:
    forms: dict[type, str] = {str: "word", list: "list", tuple: "list", dict: "table", TitleAndUnit: "table"}
    return forms.get(type(value))


Named = Annotated[Annotated[str, Tag("word")] | Annotated[TitleAndUnit, Tag("table")], Discriminator(_form)]
Titles = Annotated[tuple[str, ...], Field(min_length=1, strict=False)]
Label = Annotated[Annotated[str, Tag("word")] | Annotated[Titles, Tag("list")], Discriminator(_form)]


def _named(meaning: str) -> Any:
    text = f'{meaning}: title of its column, or {{ column = "title", unit = "mm" }} where the title has no unit'
    return Field(None, description=text)


class Mapping(Settings):
    """Which column holds what; quantities without a key are found by the titles of the columns."""

    time: Named | None = _named("time of the sample")
    depth: Named | None = _named("depth in the tissue, positive inside")
    rate: Named | None = _named("rate of the depth, positive going in")
    force: Named | None = _named("normal force, positive where the tissue pushes back")
    force_x: Named | None = _named("force on the instrument along x")
    force_y: Named | None = _named("force on the instrument along y")
    force_z: Named | None = _named("force on the instrument along z")
    x: Named | None = _named("position of the instrument along x of the world")
    y: Named | None = _named("position of the instrument along y of the world")
    z: Named | None = _named("position of the instrument along z of the world")
    qw: Named | None = _named("orientation of the instrument, body to world, scalar part of the quaternion")
    qx: Named | None = _named("orientation of the instrument, x of the quaternion")
    qy: Named | None = _named("orientation of the instrument, y of the quaternion")
    qz: Named | None = _named("orientation of the instrument, z of the quaternion")
    probe: Label | None = Field(None, description="column that tells probes apart: its title, or a list of titles")
    region: Label | None = Field(None, description="column of what a probe belongs to: its title, or a list of titles")


# --- titles -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Column:
    """Where a quantity stands and what its numbers are multiplied by to be in SI units."""

    quantity: str
    index: int
    title: str
    unit: str

    @property
    def factor(self) -> float:
        return QUANTITIES[self.quantity].units[self.unit]

    def likely_unit(self, largest: float) -> str:
        """The unit with which a largest value [SI] would be a usual one, as a way out of a wrong one."""
        low, high = QUANTITIES[self.quantity].usual
        units = QUANTITIES[self.quantity].units
        fitting = [unit for unit, factor in units.items() if low <= largest / self.factor * factor <= high]
        return f"Its unit is likely {fitting[0]}" if fitting else "Look at the values"


@dataclass(frozen=True)
class Columns:
    """What the header of a file came to; vectors are there whole or not at all."""

    numbers: dict[str, Column]
    probe: tuple[int, ...]  # columns whose words, joined, name the probe
    region: tuple[int, ...]
    notes: tuple[str, ...]

    def has(self, name: str) -> bool:
        """Whether there is a quantity, or a whole vector."""
        return VECTORS.get(name, (name,))[0] in self.numbers


def find(place: str, header: Sequence[str], mapping: Mapping) -> Columns:
    """Columns by their titles and the mapping.

    Parameters
    ----------
    place : file and line of the header, for messages
    header : titles as the file has them
    mapping : goes before the titles

    Raises
    ------
    InputError
        No column of the force, or neither of depth nor of position; two columns of one quantity, or two
        quantities of one column; a quantity without a known unit; a mapping to a column that is not there.

    """
    titles = [title.strip() for title in header]
    numbers: dict[str, Column] = {}
    for name in QUANTITIES:
        named = getattr(mapping, name)
        if named is not None:
            numbers[name] = _mapped(place, titles, name, named)
    for column in numbers.values():
        shared = [other.quantity for other in numbers.values() if other.index == column.index]
        if len(shared) > 1:
            rule, way_out = "a column must hold one quantity", "Mend the mapping"
            raise InputError(place, rule, f"{column.title} for {' and '.join(shared)}", way_out)
    mapped = {column.index for column in numbers.values()}
    notes, unused = [], set()
    for i, title in enumerate(titles):
        column_here = None if i in mapped else _recognised(place, i, title, numbers)
        if column_here is None:
            continue
        before = numbers.setdefault(column_here.quantity, column_here)
        if before.index in mapped:
            unused.add(i)
            notes.append(f"{title} is not read, as the mapping gives {before.title} as {before.quantity}")
        elif before is not column_here:
            rule, way_out = "a quantity must have one column", "Remove one, or name the right one in a mapping"
            raise InputError(place, rule, f"{before.title} and {title} for {before.quantity}", way_out)
    for key, parts in VECTORS.items():
        there = [name for name in parts if name in numbers]
        missing = [name for name in parts if name not in numbers]
        if key == "orientation" and "x" not in numbers:  # the position comes before it
            missing.append("the position")
        if there and missing:
            dropped = [numbers.pop(name) for name in there]
            unused |= {column.index for column in dropped}
            text = ", ".join(column.title for column in dropped)
            notes.append(f"{text} not read, without {', '.join(missing)}")
    _require(place, titles, numbers, ("force", *VECTORS["force_vector"]), "the force")
    _require(place, titles, numbers, ("depth", *VECTORS["position"]), "the depth or the position")
    probe, region = (_label(place, titles, name, getattr(mapping, name)) for name in ("probe", "region"))
    used = {column.index for column in numbers.values()} | {*probe, *region} | unused
    unknown = [title or f"column {i + 1}" for i, title in enumerate(titles) if i not in used]
    if unknown:
        notes.append(f"{', '.join(unknown)} not recognised and not read")
    return Columns(numbers, probe, region, tuple(notes))


def _split(title: str, units: dict[str, float]) -> tuple[str, str] | None:
    """A title without its unit, and the unit; None without one of `units`."""
    for unit in units:
        for ending in (f"_{unit}", f"[{unit}]") if unit else ("",):
            if title.endswith(ending):
                return title.removesuffix(ending).strip(), unit
    return None


def _recognised(place: str, index: int, title: str, mapped: dict[str, Column]) -> Column | None:
    for name, quantity in QUANTITIES.items():
        spellings = (name, *quantity.aliases)
        split = _split(title, quantity.units)
        if split and split[0].casefold() in spellings:
            return Column(name, index, title, split[1])
        bracketed = re.fullmatch(r"(.*?)\s*\[.*\]", title)
        if (bracketed[1] if bracketed else title).casefold() in spellings and name not in mapped:
            raise _no_unit(place, name, title)
    return None


def _no_unit(place: str, name: str, title: str) -> InputError:
    units = QUANTITIES[name].units
    rule = f"the column of {name} must tell its unit, one of {', '.join(units)}"
    way_out = f'Rename it {name}_{next(iter(units))} or the like, or map {name} = {{ column = "{title}", unit = "…" }}'
    return InputError(place, rule, show(title), way_out)


def _mapped(place: str, titles: list[str], name: str, named: str | TitleAndUnit) -> Column:
    title = named if isinstance(named, str) else named.column
    index = _index(place, titles, name, title)
    units = QUANTITIES[name].units
    if isinstance(named, TitleAndUnit):
        if named.unit not in units:
            rule = f"the unit of {name} must be one of {', '.join(units)}"
            raise InputError(f"{place}, mapping of {name}", rule, show(named.unit), "Convert the column")
        return Column(name, index, title, named.unit)
    split = _split(title, units)
    if split is None:
        raise _no_unit(f"{place}, mapping of {name}", name, title)
    return Column(name, index, title, split[1])


def _index(place: str, titles: list[str], name: str, title: str) -> int:
    if titles.count(title) == 1:
        return titles.index(title)
    at = f"{place}, mapping of {name}"
    if title in titles:
        raise InputError(at, "a column must appear once", f"{title} twice", "Rename or remove one of the two")
    raise InputError(at, "the column must exist", show(title), nearest(title, titles, what="columns"))


def _label(place: str, titles: list[str], name: Literal["probe", "region"], named: Any) -> tuple[int, ...]:
    if named is None:
        named = tuple(title for title in titles if title.casefold() == name)
    wanted = (named,) if isinstance(named, str) else named
    return tuple(_index(place, titles, name, title) for title in wanted)


def _require(place: str, titles: list[str], numbers: dict[str, Column], names: tuple[str, ...], what: str) -> None:
    """One of `names` must be there; otherwise say what was found, and what is nearest to it."""
    if any(name in numbers for name in names):
        return
    known = [
        f"{spelling}_{unit}"
        for name in names
        for unit in QUANTITIES[name].units
        for spelling in (name, *QUANTITIES[name].aliases)
    ]
    pairs = [(title, difflib.get_close_matches(title, known, n=1)) for title in titles]
    near = [f"{title} is near {match[0]}" for title, match in pairs if match]
    way_out = f"Rename it, as in {names[0]}_{next(iter(QUANTITIES[names[0]].units))}, or give a mapping"
    found = ", ".join(title or "a column without a title" for title in titles)
    raise InputError(place, f"a recording must have a column of {what}", found, "; ".join([*near, way_out]))
