"""Fitted parameters stored in a scene file, everything else in it kept as it is written."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomlkit

from tissue_contact.errors import InputError
from tissue_contact.files import publish
from tissue_contact.identify.laws import constants_of
from tissue_contact.scene import Scene, parse_scene

# Factors of the FMU on what the scene gives spring by spring.
SCALED = {
    "stiffnessScale": ("stiffness", "youngs_modulus", "bending_stiffness"),
    "dampingScale": ("damping",),
}


def write_scene(scene: Scene, parameters: Mapping[str, float], path: Path, law: str | None = None) -> None:
    """Write ``scene`` with other values of the named FMU parameters to ``path``, whole or not at all.

    ``law`` becomes that of the contacts among them; what only the other law takes is removed. Relative mesh paths stay
    as they are, so a scene with meshes is best written beside the old one.

    Raises
    ------
    InputError
        A parameter that the scene does not have, or a scaled value out of its range.
    """
    document = tomlkit.parse(scene.source.decode())
    names = [(kind, i, thing.name) for kind in ("tissue", "instrument", "contact")
             for i, thing in enumerate(getattr(scene, kind))]  # fmt: skip
    for name, value in parameters.items():
        owner, _, parameter = name.partition(".")
        found = [(kind, i) for kind, i, own in names if own == owner]
        if not found:
            raise InputError(
                f"{scene.place}, {name}", "the scene must have the object", owner, "Give the scene of the fit"
            )
        kind, i = found[0]
        table: Any = document[kind][i]  # type: ignore[index]
        if law is not None and kind == "contact" and law != scene.contact[i].law:
            contact = scene.contact[i]
            old, new = ({c.name for c in constants_of(of, contact.is_field)} for of in (contact.law, law))
            for left in old - new:
                table.pop(left, None)
            table["law"] = law
        key = re.sub("[A-Z]", lambda c: f"_{c[0].lower()}", parameter)
        if parameter in SCALED:
            for scaled in SCALED[parameter]:
                if scaled in table:
                    table[scaled] = float(table[scaled]) * value
        elif key.startswith("grasp_"):
            table["grasp"][key.removeprefix("grasp_")] = value
        else:
            table[key] = value
    text = tomlkit.dumps(document).encode()
    parse_scene(text, scene.folder, str(path))  # what is written can be read
    publish(path, text)
