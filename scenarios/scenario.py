"""A scenario: a scene, what moves its instruments, for how long, and what is expected of the outcome."""

from pathlib import Path
from typing import Any, Literal

from pydantic import Field, PrivateAttr, model_validator

from tissue_contact.edits import with_preset
from tissue_contact.errors import InputError
from tissue_contact.scenarios.stimulus import Declared, Still, Stimulus, no_jaws
from tissue_contact.scene import Scene, read_scene
from tissue_contact.settings import Settings, broken, nearest, quantity, read_toml, show, validate

SHIPPED = Path(__file__).parent
FILE = "scenario.toml"


class Expectation(Settings):
    """A bound on an output over the run."""

    output: str = Field(min_length=1, description="name of the output")
    statistic: Literal["max", "min", "final", "mean", "peak"] = Field(
        description="what of the output over time is bounded; peak is the greatest magnitude"
    )
    at_least: float | None = quantity("1", -1e300, 1e300, "least value, in the unit of the output or as a share", None)
    at_most: float | None = quantity("1", -1e300, 1e300, "greatest value, likewise", None)
    of: str = Field("", description="an output of whose greatest magnitude over the run the bounds are shares")
    reason: str = Field("", description="why this is expected")

    @model_validator(mode="after")
    def _bounded(self) -> "Expectation":
        if self.at_least is None and self.at_most is None:
            raise broken((), "an expectation must have a bound", "neither", "Give at_least, at_most or both")
        if self.at_least is not None and self.at_most is not None and self.at_least > self.at_most:
            found = f"{self.at_least:g} and {self.at_most:g}"
            raise broken((), "at_least must not exceed at_most", found, "Swap the two")
        return self


class Scenario(Settings):
    """Everything that a scenario file declares. Read it with `read_scenario`."""

    description: str = Field("", max_length=1000, description="one sentence about the scenario")
    scene_file: str = Field(
        "scene.toml", alias="scene", min_length=1, description="scene file, relative to the scenario file"
    )
    stop_time: float | None = quantity("s", 1e-6, 1e6, "end of the run; by default that of the scene", None)
    declared: tuple[Declared, ...] = Field(
        (), alias="stimulus", strict=False, description="what moves the instruments, one for each that moves"
    )
    expect: tuple[Expectation, ...] = Field((), strict=False, description="bounds that the outcome must keep")
    _name: str = PrivateAttr("scenario")
    _place: str = PrivateAttr(FILE)
    _scene: Scene = PrivateAttr()
    _stimulus: Stimulus = PrivateAttr()

    @property
    def name(self) -> str:
        """Name of the scenario's folder, or of its file when that is not `scenario.toml`."""
        return self._name

    @property
    def place(self) -> str:
        """The scenario file's name, for messages."""
        return self._place

    @property
    def scene(self) -> Scene:
        """The scene it runs in."""
        return self._scene

    @property
    def stimulus(self) -> Stimulus:
        """What moves the instruments."""
        return self._stimulus

    @property
    def duration(self) -> float:
        """How long it runs [s]."""
        return self.scene.solver.stop_time if self.stop_time is None else self.stop_time


def shipped_names() -> list[str]:
    """Names of the scenarios that come with the package."""
    return sorted(p.parent.name for p in SHIPPED.glob(f"*/{FILE}"))


def find_scenario(word: str | Path) -> Path:
    """The scenario file that `word` means: a file, a folder with a `scenario.toml`, or a shipped name.

    Raises
    ------
    InputError
        It is none of the three.

    """
    path = Path(word)
    if path.is_file():
        return path
    if (path / FILE).is_file():
        return path / FILE
    if str(word) in shipped_names():
        return SHIPPED / word / FILE
    rule = f"a scenario must be a folder with a {FILE}, such a file, or a shipped name"
    found = f"a folder without {FILE}" if path.is_dir() else "no such file or folder"
    raise InputError(str(word), rule, found, nearest(path.name, shipped_names(), what="shipped scenarios"))


def read_scenario(word: str | Path, preset: str | None = None) -> Scenario:
    """Read a scenario (see `find_scenario`) and its scene, with a preset in the place of the scene's own.

    Raises
    ------
    InputError
        One, whatever is wrong: place, key, rule, value, way out.

    """
    path = find_scenario(word)
    _, data = read_toml(path, "scenario")
    scenario = validate(Scenario, data, str(path))
    scenario._name = path.resolve().parent.name if path.name == FILE else path.stem
    scenario._place = str(path)
    scenario._scene = with_preset(read_scene(path.parent / scenario.scene_file), preset)
    instruments = {i.name: i for i in scenario.scene.instrument}
    names = list(instruments)
    paths: list[Any] = []
    for i, declared in enumerate(scenario.declared):
        place = f"{path}, stimulus[{i}]"
        here = f"{place}.instrument"
        word = declared.instrument
        if not word and len(names) != 1:
            way_out = f"Name one of {', '.join(names)}" if names else "Declare an [[instrument]] in the scene"
            raise InputError(here, "a stimulus must name its instrument", f"{len(names)} in the scene", way_out)
        if word and word not in names:
            raise InputError(here, "the instrument must be in the scene", show(word), nearest(word, names))
        chosen = word or names[0]
        if chosen in [p.instrument for p in paths]:
            rule = "an instrument may have one stimulus only"
            raise InputError(here, rule, show(chosen), "Remove one, or join them as waypoints")
        if declared.jaw and instruments[chosen].grasp is None:
            raise no_jaws(f"{place}.jaw", chosen, "the key")
        paths.append(declared.model_copy(update={"instrument": chosen}))
        if isinstance(declared, Still):
            paths[-1]._start = (instruments[chosen].start_position, instruments[chosen].start_orientation)
    graspers = frozenset(name for name, instrument in instruments.items() if instrument.grasp is not None)
    scenario._stimulus = Stimulus(tuple(paths), path.parent, graspers)
    return scenario
