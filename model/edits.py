"""A scene file with some keys changed, and the scene that it then is."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import tomlkit

from tissue_contact.presets import PRESETS
from tissue_contact.scene import Scene, parse_scene
from tissue_contact.settings import check_word


class Edit(NamedTuple):
    """A key of the scene file, such as ("tissue", 0, "stiffness"), and its new value; None takes the key away."""

    key: tuple[str | int, ...]
    value: Any


def changed(scene: Scene, edits: Iterable[Edit]) -> Scene:
    """The scene of an edited scene file. Raises InputError where that is none."""
    return parse_scene(edited(scene, edits), scene.folder, scene.place)


def with_preset(scene: Scene, name: str | None) -> Scene:
    """The scene with a preset in the place of its own; None leaves that. Raises InputError where there is none such."""
    if name is None:
        return scene
    check_word("--preset", name, PRESETS)
    return changed(scene, [Edit(("solver", "preset"), name)])


def edited(scene: Scene, edits: Iterable[Edit]) -> bytes:
    """The scene file with some keys changed and everything else, comments too, as it is written."""
    document = tomlkit.parse(scene.source.decode())
    for key, value in edits:
        *parents, last = key
        table: Any = document
        for step in parents:
            if isinstance(step, str) and step not in table:
                table[step] = tomlkit.table()
            table = table[step]
        if value is None:
            table.pop(last, None)
        else:
            table[last] = value
    return tomlkit.dumps(document).encode()
