"""The command `tissue-contact`. Heavy imports stand inside the commands, so that help answers at once."""

import functools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer

from tissue_contact.errors import InputError, TissueContactError

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Contact between surgical instruments and soft tissue, built as an FMI 2.0 co-simulation FMU.",
)


def _command(example: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Register a command that turns errors into one line on stderr and an exit code."""

    def register(function: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(function)
        def guarded(*args: Any, **kwargs: Any) -> None:
            try:
                function(*args, **kwargs)
            except InputError as error:
                _fail(str(error), 2)
            except TissueContactError as error:
                _fail(str(error), 1)
            except KeyboardInterrupt as error:
                _fail(str(error) or "interrupted", 130)

        return app.command(epilog=f"Example: {example}")(guarded)

    return register


def _fail(text: str, code: int) -> NoReturn:
    typer.echo(f"tissue-contact: {' '.join(text.split())}", err=True)
    raise typer.Exit(code)


@_command("tissue-contact build scene.toml -o press.fmu --platform linux64 --platform win64")
def build(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="Scene file.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="X.fmu", help="FMU to write.")],
    platform: Annotated[
        list[str] | None,
        typer.Option(help="Platform of a binary, may be given several times. All of them by default."),
    ] = None,
) -> None:
    """Build the FMU of a scene."""
    from tissue_contact.assemble import assemble
    from tissue_contact.fmu.build import build as build_fmu
    from tissue_contact.fmu.compile import ALL
    from tissue_contact.scenarios.report import still
    from tissue_contact.scene import read_scene
    from tissue_contact.settings import nearest

    for name in platform or []:
        if name not in ALL:
            way_out = nearest(name, ALL, what="platforms")
            raise InputError("--platform", "the platform must be a known one", name, way_out)
    if output.suffix != ".fmu":
        raise InputError("--output", "the name of an FMU must end in .fmu", output, "Add the suffix")
    read = read_scene(scene)
    assembly = assemble(read)
    _tell("drawing the scene")
    build_fmu(assembly, output, platforms=platform or ALL, picture=still(read), on_progress=_tell)
    typer.echo(f"wrote {output}")


@_command("tissue-contact run press -o results --set contact.stiffness=300")
def run(
    scenario: Annotated[
        str,
        typer.Argument(metavar="SCENARIO", help="Folder or file of a scenario, or the name of a shipped one."),
    ],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="DIR", help="Folder for the results, build/NAME by default."),
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="Value of an FMU parameter, may be given several times."),
    ] = None,
    figures: Annotated[bool, typer.Option(help="Draw the figures.")] = True,
    progress: Annotated[bool, typer.Option(help="Show a progress bar on a terminal.")] = True,
) -> None:
    """Run a scenario: CSV, figures and a summary. Exit code 1 when an expectation fails."""
    values = _assignments(set_ or [])
    from tissue_contact.scenarios.scenario import read_scenario

    read = read_scenario(scenario)
    from tissue_contact.scenarios.run import run as run_scenario

    outcome = run_scenario(read, output or Path("build") / read.name, values, progress, figures)
    if not outcome.holds:
        raise typer.Exit(1)


@_command("tissue-contact check press.fmu")
def check(fmu: Annotated[Path, typer.Argument(metavar="X.fmu", help="FMU to check.")]) -> None:
    """Check an FMU against the standard. Exit code 1 when there are findings."""
    if not fmu.is_file():
        raise InputError(str(fmu), "the FMU must exist", "no such file", "Build it with tissue-contact build")
    from tissue_contact.fmu.check import check as check_fmu

    findings = check_fmu(fmu)
    for finding in findings:
        typer.echo(finding)
    typer.echo(f"{fmu}: {len(findings)} findings" if findings else f"{fmu}: no findings")
    if findings:
        raise typer.Exit(1)


@_command("tissue-contact mesh liver.stl --scale 0.001 --repair liver-mended.stl")
def mesh(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="STL, OBJ, PLY or OFF file.")],
    scale: Annotated[float, typer.Option(help="Metres per unit of the file, 0.001 for millimetres.")] = 1.0,
    open_surface: Annotated[bool, typer.Option("--open-surface", help="A sheet is meant.")] = False,
    many_parts: Annotated[bool, typer.Option("--many-parts", help="Several pieces are meant.")] = False,
    repair: Annotated[Path | None, typer.Option(metavar="OUT.stl", help="Write the repaired mesh, in metres.")] = None,
) -> None:
    """Report on a mesh before and after repair. Exit code 1 when it suits neither tissue nor instrument."""
    from tissue_contact import geometry

    raw = geometry.read(file, scale)
    mended, repairs = geometry.repair(raw)
    before, after = vars(geometry.inspect(raw)), vars(geometry.inspect(mended))
    units = {"edge": " [m]", "extent": " [m]", "area": " [m2]", "volume": " [m3]"}
    typer.echo(f"{'':28}{'as read':>14}{'repaired':>14}")
    for name in before:
        title = name.replace("_", " ") + units.get(name.split("_")[0], "")
        if name == "bounds":
            for end, low, high in zip(("least", "greatest"), before[name], after[name], strict=True):
                for axis, a, b in zip("xyz", low, high, strict=True):
                    typer.echo(f"{f'{end} {axis} [m]':28}{_cell(a):>14}{_cell(b):>14}")
            continue
        typer.echo(f"{title:28}{_cell(before[name]):>14}{_cell(after[name]):>14}")
    for done in repairs:
        typer.echo(f"repaired: {done}")
    suits = 0
    for purpose in ("tissue", "instrument"):
        try:
            geometry.load(file, scale=scale, open_surface=open_surface, many_parts=many_parts, purpose=purpose)
        except InputError as error:
            typer.echo(f"no {purpose}: {error.rule}; found {error.value}. {error.way_out}.")
        else:
            typer.echo(f"suits a {purpose}" if purpose == "tissue" else f"suits an {purpose}")
            suits += 1
    if repair is not None:
        from tissue_contact.files import publish
        from tissue_contact.surfaces import stl_bytes

        publish(repair, stl_bytes(mended))
        typer.echo(f"wrote {repair}")
    if not suits:
        raise typer.Exit(1)


def _cell(value: object) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


@_command("tissue-contact schema > scene.schema.json")
def schema() -> None:
    """Print the JSON schema of the scene file, for editors."""
    from tissue_contact.scene import scene_schema

    typer.echo(json.dumps(scene_schema(), indent=2))


def _tell(text: str) -> None:
    typer.echo(text, err=True)


def _assignments(words: list[str]) -> dict[str, float]:
    values = {}
    for word in words:
        name, equals, value = word.partition("=")
        try:
            values[name.strip()] = float(value)
        except ValueError:
            rule = "a parameter must be set as NAME=VALUE with a number"
            raise InputError("--set", rule, word, "Write for instance contact.stiffness=300") from None
        if not (equals and name.strip()):
            rule = "a parameter must be set as NAME=VALUE with a number"
            raise InputError("--set", rule, word, "Write for instance contact.stiffness=300")
    return values


def main() -> None:
    """Run the command and exit: 0 done, 1 the work failed, 2 wrong usage or input, 130 interrupted."""
    app()
