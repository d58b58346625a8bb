"""The command `tissue-contact`. Heavy imports stand inside the commands, so that help answers at once.

Some come only after the scene or scenario is read, so that what is wrong there is told at once as well.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from tissue_contact.commandline import Workers, guarded
from tissue_contact.errors import InputError

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Contact between surgical instruments and soft tissue, built as an FMI 2.0 co-simulation FMU.",
)

# Options that several commands take.
ScenarioName = Annotated[
    str, typer.Argument(metavar="SCENARIO", help="Folder or file of a scenario, or the name of a shipped one.")
]
PresetOption = Annotated[
    str | None,
    typer.Option("--preset", metavar="NAME", help="fast, balanced or accurate, in the place of the scene's preset."),
]
Scheduler = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="Dask scheduler to spread the work over instead.")
]
ProgressBar = Annotated[bool, typer.Option(help="Show a progress bar on a terminal.")]
Measure = Annotated[str, typer.Option(help="Error to go by: force, peak, impulse, depth or torque.")]
Runs = Annotated[int, typer.Option(min=1, max=10_000, help="Most configurations to try.")]
Rounds = Annotated[
    int, typer.Option(min=1, max=100, help="Timed runs of each, of which the fastest counts at every step.")
]
Refine = Annotated[float, typer.Option(min=4, max=256, help="Triangles of the reference for each of the scene's.")]


def _command(example: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Register a command, whose errors are one line on stderr."""

    def register(function: Callable[..., None]) -> Callable[..., None]:
        return app.command(epilog=f"Example: {example}")(guarded(function, "tissue-contact"))

    return register


@_command("tissue-contact build scene.toml -o press.fmu --platform linux64 --platform win64")
def build(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="Scene file.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="X.fmu", help="FMU to write.")],
    platform: Annotated[
        list[str] | None,
        typer.Option(help="Platform of a binary, may be given several times. All of them by default."),
    ] = None,
    preset: PresetOption = None,
) -> None:
    """Build the FMU of a scene."""
    from tissue_contact.edits import with_preset
    from tissue_contact.scene import read_scene
    from tissue_contact.settings import check_file, nearest

    if output.suffix != ".fmu":
        raise InputError("--output", "the name of an FMU must end in .fmu", output, "Add the suffix")
    check_file("--output", output)
    read = with_preset(read_scene(scene), preset)
    for remark in read.remarks:
        _tell(remark)
    from tissue_contact.assemble import assemble
    from tissue_contact.fmu.build import build as build_fmu
    from tissue_contact.fmu.compile import ALL
    from tissue_contact.scenarios.report import still

    for name in platform or []:
        if name not in ALL:
            way_out = nearest(name, ALL, what="platforms")
            raise InputError("--platform", "the platform must be a known one", name, way_out)
    assembly = assemble(read)
    _tell("drawing the scene")
    build_fmu(assembly, output, platforms=platform or ALL, picture=still(read, assembly), on_progress=_tell)
    typer.echo(f"wrote {output}")


@_command("tissue-contact run press -o results --set contact.stiffness=300")
def run(
    scenario: ScenarioName,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="DIR", help="Folder for the results, build/NAME by default."),
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="Value of an FMU parameter, may be given several times."),
    ] = None,
    parameters: Annotated[
        Path | None,
        typer.Option(metavar="RESULT", help="Result of a fit, whose parameters are set; --set goes before them."),
    ] = None,
    preset: PresetOption = None,
    figures: Annotated[bool, typer.Option(help="Draw the figures.")] = True,
    progress: ProgressBar = True,
) -> None:
    """Run a scenario: CSV, figures and a summary. Exit code 1 when an expectation fails."""
    values = _assignments(set_ or [])
    from tissue_contact.scenarios.scenario import read_scenario
    from tissue_contact.settings import check_folder

    read = read_scenario(scenario, preset)
    folder = output or Path("build") / read.name
    check_folder("--output", folder)
    if parameters is not None:
        from tissue_contact.identify.result import read_result

        values = read_result(parameters).parameters | values
    from tissue_contact.scenarios.run import run as run_scenario

    outcome = run_scenario(read, folder, values, progress, figures)
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


@_command("tissue-contact fit probing.csv --law hunt_crossley -o fitted")
def fit(
    data: Annotated[list[Path], typer.Argument(metavar="DATA...", help="CSV files of recordings.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Folder for the results.")],
    mapping: Annotated[
        Path | None, typer.Option(metavar="MAP.toml", help="Which column is what, and how the data are treated.")
    ] = None,
    treat: Annotated[
        list[str] | None,
        typer.Option(metavar="KEY=VALUE", help="Treatment of the data, such as low_pass=20; before that of --mapping."),
    ] = None,
    law: Annotated[
        list[str] | None, typer.Option(help="Force law, may be given several times. Both by default.")
    ] = None,
    scene: Annotated[
        Path | None, typer.Option(metavar="SCENE", help="Scene whose geometry, or with --parameter model, is fitted.")
    ] = None,
    fmu: Annotated[Path | None, typer.Option(metavar="X.fmu", help="FMU to fit instead of a scene.")] = None,
    parameter: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Tunable parameter to fit with the whole model, may be given several times."),
    ] = None,
    instrument: Annotated[str | None, typer.Option(metavar="NAME", help="Instrument that was recorded.")] = None,
    contact: Annotated[str | None, typer.Option(metavar="NAME", help="Contact whose law is fitted.")] = None,
    tip_radius: Annotated[
        float | None, typer.Option(min=1e-5, max=1, help="Radius of a round tip [m]: fits an elastic foundation.")
    ] = None,
    tip_area: Annotated[
        float | None, typer.Option(min=1e-10, max=1, help="Area of a flat tip [m2]: fits an elastic foundation.")
    ] = None,
    fix: Annotated[list[str] | None, typer.Option(metavar="NAME=VALUE", help="Constant that is not fitted.")] = None,
    bounds: Annotated[list[str] | None, typer.Option(metavar="NAME=LOW:HIGH", help="Bounds of a constant.")] = None,
    grid: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=LOW:HIGH:COUNT", help="Values of a parameter to try before the fit."),
    ] = None,
    loss: Annotated[str, typer.Option(help="linear, or one that bears outliers: huber, soft_l1, cauchy.")] = "linear",
    folds: Annotated[int, typer.Option(min=2, max=100, help="Parts of which each is held out in turn.")] = 5,
    starts: Annotated[int, typer.Option(min=1, max=1000, help="Fits of a whole model, each from elsewhere.")] = 1,
    seed: Annotated[int, typer.Option(min=0, help="Number that picks folds and starts.")] = 0,
    workers: Workers = 1,
    scheduler: Scheduler = None,
    write_scene: Annotated[
        Path | None, typer.Option(metavar="OUT.toml", help="Write the scene with the constants that were found.")
    ] = None,
    progress: ProgressBar = True,
) -> None:
    """Identify constants from measured force: of a contact law alone, or with --parameter of a whole model."""
    from tissue_contact.settings import check_recording, check_word

    for path in data:  # before the imports, which take seconds
        check_recording(path)
    from tissue_contact.identify.laws import LAWS
    from tissue_contact.identify.least_squares import LOSSES
    from tissue_contact.scenarios.fit import Request
    from tissue_contact.scenarios.fit import fit as fit_data

    for option, words, known in (("--law", law or [], tuple(LAWS)), ("--loss", [loss], LOSSES)):
        for word in words:
            check_word(option, word, known)
    fit_data(
        Request(
            data=data,
            output=output,
            mapping=mapping,
            treatment=treat or [],
            laws=law or tuple(LAWS),
            scene=scene,
            fmu=fmu,
            parameters=parameter or [],
            instrument=instrument,
            contact=contact,
            tip_radius=tip_radius,
            tip_area=tip_area,
            given=_assignments(fix or [], "--fix"),
            bounds={name: (low, high) for name, (low, high) in _ranges(bounds or [], "--bounds", 2).items()},
            grid={name: (low, high, _whole(n)) for name, (low, high, n) in _ranges(grid or [], "--grid", 3).items()},
            loss=loss,
            folds=folds,
            starts=starts,
            seed=seed,
            workers=workers,
            scheduler=scheduler,
            write_scene=write_scene,
            progress=progress,
        )
    )


@_command("tissue-contact trade press -o build/press-trade --workers 2")
def trade(
    scenario: ScenarioName,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="DIR", help="Folder for the results, build/NAME-trade by default."),
    ] = None,
    measure: Measure = "force",
    runs: Runs = 60,
    rounds: Rounds = 3,
    refine: Refine = 16.0,
    workers: Workers = 1,
    scheduler: Scheduler = None,
    progress: ProgressBar = True,
) -> None:
    """Sweep what costs time and what errs in a scenario: table, CSV, figure and what to choose."""
    _check_measure(measure)
    from tissue_contact.scenarios.scenario import read_scenario
    from tissue_contact.settings import check_folder

    read = read_scenario(scenario)
    folder = output or Path("build") / f"{read.name}-trade"
    check_folder("--output", folder)
    from tissue_contact.scenarios.trade import Request
    from tissue_contact.scenarios.trade import trade as trade_scenario

    request = Request(measure, runs, rounds, refine, workers, scheduler, progress)
    trade_scenario(read, folder, request)


@_command("tissue-contact tune press --budget-us 200 -o fast.toml")
def tune(
    scenario: ScenarioName,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="SCENE.toml", help="Scene file to write.")],
    budget_us: Annotated[
        float | None,
        typer.Option(metavar="US", min=1e-3, help="Time of a step in contact [µs]: the most accurate within it."),
    ] = None,
    error: Annotated[
        str | None, typer.Option(metavar="SHARE", help="Error, such as 1%: the fastest within it.")
    ] = None,
    data: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of trade, whose runs are used again; build/NAME-trade by default."),
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="The output may be the scenario's own scene.")] = False,
    measure: Measure = "force",
    runs: Runs = 60,
    rounds: Rounds = 3,
    refine: Refine = 16.0,
    workers: Workers = 1,
    scheduler: Scheduler = None,
    progress: ProgressBar = True,
) -> None:
    """Write the scene that is most accurate within a time, or fastest within an error."""
    _check_measure(measure)
    from tissue_contact.scenarios.scenario import read_scenario
    from tissue_contact.settings import check_file, check_folder

    check_file("--output", output)
    read = read_scenario(scenario)
    folder = data or Path("build") / f"{read.name}-trade"
    check_folder("--data", folder)
    from tissue_contact.scenarios.trade import Request
    from tissue_contact.scenarios.tune import Wish
    from tissue_contact.scenarios.tune import tune as tune_scenario

    wish = Wish.of(budget_us, error)
    request = Request(measure, runs, rounds, refine, workers, scheduler, progress)
    tune_scenario(read, folder, request, wish, output, overwrite)


def _check_measure(measure: str) -> None:
    from tissue_contact.settings import check_word
    from tissue_contact.study.deviation import MEASURES

    check_word("--measure", measure, MEASURES)


@_command("tissue-contact stability scene.toml --x step --y stiffness=10:1000 -o stability")
def stability(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="Scene file.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Folder for the results.")],
    x: Annotated[
        str, typer.Option(metavar="AXIS[=LOW:HIGH]", help="Constant along x; a range round the scene's own by default.")
    ] = "step",
    y: Annotated[str, typer.Option(metavar="AXIS[=LOW:HIGH]", help="Constant along y.")] = "stiffness",
    grid: Annotated[int, typer.Option(min=2, max=1000, help="Values on each axis.")] = 16,
    integrator: Annotated[
        list[str] | None,
        typer.Option(help="Scheme in time, may be given several times. All that know the tissues' forces by default."),
    ] = None,
    substeps: Annotated[
        list[str] | None,
        typer.Option(
            help="one a step, for the limit of the scheme, or automatic; may be given twice, both by default."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Number that picks the random motion.")] = 0,
    depth: Annotated[float | None, typer.Option(min=1e-6, max=1, help="Way of the press beyond the touch [m].")] = None,
    haptic: Annotated[bool, typer.Option("--haptic", help="Close the loop with a haptic device instead.")] = False,
    device_mass: Annotated[float, typer.Option(min=1e-4, max=100, help="Mass of the device [kg].")] = 0.1,
    device_damping: Annotated[float, typer.Option(min=1e-4, max=1e4, help="Damping of the device [N.s/m].")] = 0.5,
    hand_mass: Annotated[float, typer.Option(min=0, max=100, help="Mass of the hand on the device [kg].")] = 0.0,
    hand_damping: Annotated[float, typer.Option(min=0, max=1e4, help="Damping of that hand [N.s/m].")] = 0.0,
    quantum: Annotated[float, typer.Option(min=0, max=0.01, help="Step of the encoder [m], 0 for none.")] = 0.0,
    push: Annotated[
        float | None, typer.Option(min=1e-6, max=1e3, help="Steady force of the hand [N]; a light one by default.")
    ] = None,
    delay: Annotated[
        list[float] | None,
        typer.Option(min=0, max=0.1, help="Delay of the force [s], may be given several times; 0, 0.001 and 0.005."),
    ] = None,
    virtual_damping: Annotated[
        list[float] | None,
        typer.Option(min=0, max=1e5, help="Damping of the contact [N.s/m], may be given several times."),
    ] = None,
    speed: Annotated[
        float | None,
        typer.Option(min=1e-6, max=1e3, help="Speed of a press [m/s], or of the device at the touch, 0.5 and 0."),
    ] = None,
    instrument: Annotated[str | None, typer.Option(metavar="NAME", help="Instrument that presses.")] = None,
    axis: Annotated[
        tuple[float, float, float], typer.Option(metavar="X Y Z", help="Direction of the press in the world.")
    ] = (0.0, 0.0, -1.0),
    workers: Workers = 1,
    scheduler: Scheduler = None,
    progress: ProgressBar = True,
) -> None:
    """Map where a scene is stable, or how stiff a contact a haptic device bears.

    Axes: step, stiffness, damping, support_damping, density, contact_stiffness, speed, detection_period. Exit code 1
    when the automatic choice of substeps is unstable somewhere.
    """
    from tissue_contact.scene import read_scene
    from tissue_contact.settings import check_folder

    check_folder("--output", output)
    read = read_scene(scene)
    from tissue_contact.scenarios.stability import HapticRequest, MapRequest
    from tissue_contact.scenarios.stability import stability as study

    common: dict[str, Any] = {
        "scene": read, "output": output, "instrument": instrument, "axis": axis, "workers": workers,
        "scheduler": scheduler, "progress": progress,
    }  # fmt: skip
    request: Any
    if haptic:
        request = HapticRequest(
            **common, mass=device_mass, damping=device_damping, hand_mass=hand_mass, hand_damping=hand_damping,
            quantum=quantum, push=push, delays=tuple(delay or (0.0, 1e-3, 5e-3)), virtual=tuple(virtual_damping or ()),
            speed=speed or 0.0,
        )  # fmt: skip
    else:
        ranges = {name: _ranges([word], name, 2) for name, word in (("--x", x), ("--y", y)) if "=" in word}
        spans = {name: next(iter(span.values())) for name, span in ranges.items()}
        more: dict[str, Any] = {"kinds": tuple(substeps)} if substeps else {}
        request = MapRequest(
            **common, x=x.partition("=")[0], y=y.partition("=")[0], x_range=_pair(spans.get("--x")),
            y_range=_pair(spans.get("--y")), grid=grid, integrators=tuple(integrator or ()), seed=seed, depth=depth,
            speed=speed or 0.5, **more,
        )  # fmt: skip
    if not study(request):
        raise typer.Exit(1)


def _pair(span: list[float] | None) -> tuple[float, float] | None:
    return (span[0], span[1]) if span else None


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
    from tissue_contact.settings import check_file

    if repair is not None:
        check_file("--repair", repair)
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


def _assignments(words: list[str], option: str = "--set") -> dict[str, float]:
    return {name: value for name, (value,) in _ranges(words, option, 1).items()}


def _ranges(words: list[str], option: str, count: int) -> dict[str, list[float]]:
    """Names with so many numbers each, as NAME=NUMBER:NUMBER gives them."""
    values = {}
    form = {1: "VALUE", 2: "LOW:HIGH", 3: "LOW:HIGH:COUNT"}[count]
    example = {1: "contact.stiffness=300", 2: "stiffness=100:400", 3: "contact.stiffness=100:400:7"}[count]
    for word in words:
        name, _, text = word.partition("=")
        try:
            values[name.strip()] = [float(part) for part in text.split(":")]
            wrong = not name.strip() or len(values[name.strip()]) != count
        except ValueError:
            wrong = True
        if wrong:
            rule = f"it must be written as NAME={form} with {'a number' if count == 1 else 'numbers'}"
            raise InputError(option, rule, word, f"Write for instance {example}")
    return values


def _whole(count: float) -> int:
    if not count.is_integer():  # nor is what is not finite
        raise InputError("--grid", "COUNT must be a whole number", f"{count:g}", "Write for instance 100:400:7")
    return int(count)


def main() -> None:
    """Run the command and exit: 0 done, 1 the work failed, 2 wrong usage or input, 130 interrupted."""
    app()
