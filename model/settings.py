"""Settings read from TOML: models whose fields carry unit, range and meaning; the one error of a wrong file.

What a field means, its unit and its range stand in the field alone; `setting` reads them back for whoever
needs them (the variable table, the docs), and `validate` for its messages.
"""

import difflib
import tomllib
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import ErrorDetails, PydanticCustomError

from tissue_contact.errors import InputError

Schema = dict[str, Any]
Key = tuple[str | int, ...]


class Settings(BaseModel):
    """Base of every table of a settings file: frozen, no unknown key, no NaN or Inf, no guessing of types."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


Table = TypeVar("Table", bound=Settings)


def quantity(unit: str, low: float, high: float, description: str, default: Any = ...) -> Any:
    """Field of a number in `unit` between `low` and `high`; required without `default`."""
    return Field(default, ge=low, le=high, description=description, json_schema_extra={"unit": unit})


def items(unit: str, description: str, default: Any = ...) -> Any:
    """Field of a list, its numbers in `unit`."""
    # A TOML array arrives as a list, which a strict tuple would refuse; its members stay strict.
    return Field(default, strict=False, description=description, json_schema_extra={"unit": unit})


def broken(key: Key, rule: str, found: object, way_out: str) -> PydanticCustomError:
    """The error for a validator to raise when a rule between several keys is broken.

    `key` is relative to the table of the validator; `rule` and `way_out` as in `InputError`.
    """
    told = {"key": key, "rule": rule, "found": found, "way_out": way_out}
    return PydanticCustomError("broken", "{rule}", told)  # type: ignore[arg-type]


# --- what a field says of itself --------------------------------------------------------------------------


class Setting(NamedTuple):
    """Unit, range and meaning of one number in a settings file."""

    unit: str
    minimum: float
    maximum: float
    description: str


def setting(table: type[Settings], name: str) -> Setting:
    """What field `name` of `table` says of itself; the range is that of every item when it is a list."""
    root = table.model_json_schema()
    found = _resolved(root["properties"][name], root)
    bounds = _resolved(found["items"], root) if "items" in found else found
    low, high = bounds.get("minimum", float("-inf")), bounds.get("maximum", float("inf"))
    return Setting(found.get("unit", "1"), low, high, found.get("description", ""))


def _resolved(node: Schema, root: Schema) -> Schema:
    """`node` with its reference followed and an optional's null branch left out."""
    if "$ref" in node:
        target = root["$defs"][node["$ref"].rsplit("/", 1)[1]]
        node = {**target, **{k: v for k, v in node.items() if k != "$ref"}}
    branches = [b for b in node.get("anyOf", []) if b.get("type") != "null"]
    if len(branches) == 1:
        node = {**_resolved(branches[0], root), **{k: v for k, v in node.items() if k != "anyOf"}}
    return node


def _schema_at(table: type[Settings], loc: Key) -> Schema:
    """The part of the table's schema that describes the place `loc` of a pydantic error."""
    root = table.model_json_schema()
    node = _resolved(root, root)
    for step in loc:
        whole: Schema = {k: node[k] for k in ("description", "unit") if k in node}
        tags = node.get("discriminator", {}).get("mapping", {})
        if step in node.get("properties", {}):
            node = node["properties"][step]
        elif isinstance(step, int):
            node = {**whole, **node.get("items", {})}
        elif step in tags:
            node = {"$ref": tags[step]}
        else:  # a choice between a word, a number, a list and a table
            kind = {"word": "string", "number": "number", "list": "array"}.get(step, "object")
            branches = [_resolved(b, root) for b in node.get("anyOf", []) + node.get("oneOf", [])]
            node = {**whole, **next((b for b in branches if b.get("type") == kind), {})}
        node = _resolved(node, root)
    return node


# --- reading ----------------------------------------------------------------------------------------------


def read_toml(path: Path, what: str) -> tuple[bytes, dict[str, Any]]:
    """Bytes and content of a TOML file; InputError when it is missing or not TOML.

    `what` names the kind of file in the message, such as "scene".
    """
    if not path.is_file():
        near = sorted(p.name for p in path.parent.glob("*.toml")) if path.parent.is_dir() else []
        way_out = f"The folder has {', '.join(near)}" if near else f"Give the path of a {what} file"
        raise InputError(str(path), f"the {what} file must exist", "no such file", way_out)
    source = path.read_bytes()
    return source, parse_toml(source, str(path))


def check_recording(path: Path) -> None:
    """InputError where the CSV file of a recording is missing."""
    if not path.is_file():
        near = sorted(p.name for p in path.parent.glob("*.csv")) if path.parent.is_dir() else []
        way_out = nearest(path.name, near, what="recordings")
        raise InputError(str(path), "the recording must exist", "no such file", way_out)


def check_folder(option: str, path: Path) -> None:
    """InputError where a folder for results cannot be, as there is a file."""
    for part in (path, *path.parents):
        if part.exists() and not part.is_dir():
            raise InputError(option, "results need a folder", f"the file {part}", "Name another, which may be new")


def check_file(option: str, path: Path) -> None:
    """InputError where a file of results cannot be, as there is a folder, or a file where its folder should be."""
    if path.is_dir():
        raise InputError(option, "the result is a file", f"the folder {path}", "Name a file in it")
    check_folder(option, path.parent)


def parse_toml(source: bytes, place: str) -> dict[str, Any]:
    """Content of a TOML file; InputError with the line where it is not TOML."""
    rule, way_out = "the file must be TOML", "Mend the syntax there"
    try:
        return tomllib.loads(source.decode())
    except UnicodeDecodeError as error:
        raise InputError(place, "the file must be UTF-8 text", str(error), "Save it as UTF-8") from error
    except tomllib.TOMLDecodeError as error:
        raise InputError(place, rule, str(error), way_out) from error


def validate(table: type[Table], data: dict[str, Any], place: str) -> Table:
    """`data` as a `table`; otherwise exactly one InputError: `place`, key, rule, value, way out."""
    try:
        return table.model_validate(data)
    except ValidationError as error:
        found = error.errors(include_url=False)
    # A misspelt key also makes its right spelling missing: the spelling is what to say.
    first = min(found, key=lambda e: e["type"] != "extra_forbidden")
    raise _input_error(table, data, place, first)


def nearest(word: str, known: Iterable[str], *, what: str = "names") -> str:
    """Way out of a misspelling: the nearest of the known words, or all of them."""
    known = list(known)
    near = difflib.get_close_matches(word, known, n=1, cutoff=0.6)
    if near:
        return f"The nearest right spelling is {near[0]}"
    return f"Known {what}: {', '.join(known)}" if known else f"There are no {what} here"


def check_word(option: str, word: str, known: Collection[str]) -> None:
    """Refuse a word that an option does not know, with InputError."""
    if word not in known:
        way_out = nearest(word, known, what="values")
        raise InputError(option, f"the value must be {' or '.join(known)}", word, way_out)


def _input_error(table: type[Settings], data: dict[str, Any], place: str, error: ErrorDetails) -> InputError:
    loc, kind, told = error["loc"], error["type"], error.get("ctx", {})
    if kind == "broken":
        key = _key(data, (*loc, *told["key"]), named_last=True)
        return InputError(f"{place}, {key}" if key else place, told["rule"], told["found"], told["way_out"])
    at = f"{place}, {_key(data, loc, named_last=kind in ('missing', 'extra_forbidden'))}"
    found = show(error["input"])
    if kind == "extra_forbidden":
        known = _schema_at(table, loc[:-1]).get("properties", {})
        return InputError(at, f"{loc[-1]} is not a key here", found, nearest(str(loc[-1]), known, what="keys"))
    node = _schema_at(table, loc)
    meaning = f"It means: {node['description']}" if "description" in node else "See the schema of the file"
    if kind == "missing":
        return InputError(at, "the key must be given", "nothing", meaning)
    if kind.startswith("union_tag"):
        words = list(node.get("discriminator", {}).get("mapping", {}))
        word = error["input"].get("kind") if isinstance(error["input"], dict) else None
        if not words:
            return InputError(at, "the value must be of one of the forms allowed here", found, meaning)
        if word is None:
            return InputError(at, "kind must say what is meant", found, f"Known kinds: {', '.join(words)}")
        return InputError(
            f"{at}.kind", "the kind must be a known one", show(word), nearest(str(word), words, what="kinds")
        )
    if kind == "literal_error":
        words = [str(w) for w in node.get("enum", [node.get("const")])]
        rule = f"the value must be {' or '.join(words)}"
        way_out = nearest(str(error["input"]), words, what="values")
        return InputError(at, rule, found, way_out if len(words) > 1 else meaning)
    return InputError(at, _rule(kind, told, node), found, meaning)


def _rule(kind: str, told: dict[str, Any], node: Schema) -> str:
    unit = f" {node['unit']}" if node.get("unit", "1") != "1" else ""
    low, high = node.get("minimum"), node.get("maximum")
    between = f" between {low:g} and {high:g}{unit}" if low is not None and high is not None else unit
    if kind in ("float_type", "finite_number", "greater_than_equal", "less_than_equal"):
        return f"the value must be a {'whole ' if node.get('type') == 'integer' else ''}number{between}"
    if kind.startswith("int_"):
        return f"the value must be a whole number{between}"
    if kind == "tuple_type" and "$ref" in node.get("items", {}):
        return "the table must be written in double brackets, [[…]], because there may be several"
    if kind.endswith(("too_short", "too_long")) and "pattern" not in node:
        text = kind.startswith("string")
        form, unit, end = ("text", "characters", "Length") if text else ("list", "entries", "Items")
        least, most = node.get(f"min{end}"), node.get(f"max{end}")
        count = least if least == most else f"at most {most}" if kind.endswith("long") else f"{least} or more"
        return f"the {form} must have {count} {unit}"
    if kind.startswith("string_"):
        shape = "a name: a letter first, then letters, digits or _, 64 at most" if "pattern" in node else "a text"
        return f"the value must be {shape}"
    forms = {"bool_type": "true or false", "tuple_type": "a list", "list_type": "a list"}
    return f"the value must be {forms.get(kind, 'a table')}"


def _key(data: object, loc: Sequence[str | int], *, named_last: bool) -> str:
    """The place of an error as the file spells it: `tissue[liver].stiffness`, an unnamed table by its number.

    Pydantic puts the tag of a union into the place; a step that the data does not have is such a tag, but for
    the last one where the error is about a key that is (or should be) there.
    """
    key = ""
    for n, step in enumerate(loc):
        if isinstance(step, int):
            data = data[step] if isinstance(data, list) and step < len(data) else None
            name = data.get("name") if isinstance(data, dict) else None
            key += f"[{name if isinstance(name, str) and name else step}]"
        elif isinstance(data, dict) and step in data:
            data = data[step]
            key += f".{step}"
        elif named_last and n == len(loc) - 1:
            key += f".{step}"
    return key.lstrip(".")


def show(value: object) -> str:
    """A value as TOML spells it, cut to a readable length."""
    if isinstance(value, bool):
        text = str(value).lower()
    elif isinstance(value, str):
        text = f'"{value}"'
    elif isinstance(value, list | tuple):
        text = f"[{', '.join(show(v) for v in value[:8])}{', …' if len(value) > 8 else ''}]"
    elif isinstance(value, dict):
        text = f"{{{', '.join(f'{k} = {show(v)}' for k, v in value.items())}}}"
    else:
        text = str(value)
    return text if len(text) <= 100 else text[:99] + "…"
