"""`make presets`: what the presets of the solver err by and cost in the shipped scenarios, beside their neighbours.

Every run and every time is kept in a folder beside the output as soon as it is done. When started again, those of the
same scene, motion and sources are taken from there.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import fmpy
import typer
from rich.console import Console

from tissue_contact.assemble import assemble
from tissue_contact.commandline import Workers, guarded
from tissue_contact.edits import Edit, edited
from tissue_contact.files import publish
from tissue_contact.fmu.compile import shared_library
from tissue_contact.pool import Kept, Spread, pool
from tissue_contact.presets import BEYOND_SPRINGS, OF_PROJECTIVE, PRESETS, Preset
from tissue_contact.scenarios import bench
from tissue_contact.scenarios.run import communication_points
from tissue_contact.scenarios.scenario import read_scenario, shipped_names
from tissue_contact.scenarios.trade import Job, check_references, follow, job_of, kept_of, point_of, rows_of, timed
from tissue_contact.scene import Scene, parse_scene
from tissue_contact.settings import check_file, check_word
from tissue_contact.study import levers
from tissue_contact.study.deviation import errors
from tissue_contact.study.front import Point, percent, solver_settings
from tissue_contact.study.levers import Option

Say = Callable[[str], None]

# Sheets of `make bench`: that on which a step has a budget, and one as fine where it is touched. Nothing is expected.
SHEETS = {"bench 6K": "6K sheet", "bench graded": "graded sheet"}
# Every preset is one of these.
CANDIDATES = [*levers.PROJECTIVE, BEYOND_SPRINGS]
SAFETIES = (0.2, 0.1)  # of the two references, shares of the stable limit of symplectic Euler
FINER = 4.0  # times the triangles of the mesh whose error is told beside
WITHIN = {"fast": 0.05, "balanced": 0.01}  # error of the force in the worst of the scenarios that a preset may have
ROUNDS = 3


@dataclass(frozen=True, eq=False)
class Case:
    """A scene and its motion."""

    name: str
    scene: Scene
    job: Job

    @property
    def candidates(self) -> list[Preset]:
        """What can be run in it."""
        springs = not any(tissue.beyond_springs for tissue in self.scene.tissue)
        return [c for c in CANDIDATES if springs or c.integrator != "projective_dynamics"]

    def edited(self, keys: Mapping[str, Any]) -> Job:
        """The same with other keys of the solver."""
        return replace(self.job, source=edited(self.scene, solver_edits(keys)))


def solver_edits(keys: Mapping[str, Any]) -> list[Edit]:
    """Edits of the scene's table `solver`."""
    return [Edit(("solver", key), value) for key, value in keys.items()]


def cases(folder: Path, say: Say) -> list[Case]:
    """Shipped scenarios with a tissue whose meshes are there, and the sheet of the bench, written to a folder."""
    found = []
    for name in shipped_names():
        scenario = read_scenario(name)
        if not scenario.scene.tissue:
            continue  # nothing is integrated
        missing = [b.mesh for b in (*scenario.scene.tissue, *scenario.scene.bodies)
                   if b.mesh and not (scenario.scene.folder / b.mesh).is_file()]  # fmt: skip
        if missing:
            say(f"{name}: {missing[0]} is not there, left out")
            continue
        job = replace(job_of(scenario, scenario.scene.source), expect=scenario.expect)
        found.append(Case(name, scenario.scene, job))
    tissues = bench.MESH.format(name=bench.write_sheet(bench.COMPARED, folder).name), bench.GRADED
    poses = bench.poses()
    times, steps = communication_points(bench.STEP * (len(poses) - 1), bench.STEP)
    names = [f"instrument.position[{k}]" for k in (1, 2, 3)] + [f"instrument.orientation[{k}]" for k in (1, 2, 3, 4)]
    inputs = dict(zip(names, poses.T.copy(), strict=True))
    for name, tissue in zip(SHEETS, tissues, strict=True):
        scene = parse_scene(bench.scene_text(tissue).encode(), folder.resolve(), name)
        found.append(Case(name, scene, Job(scene.source, scene.folder, name, times, steps, inputs)))
    return found


# --- measuring --------------------------------------------------------------------------------------------


def references(case: Case) -> list[Job]:
    """Symplectic Euler with short substeps, then with the shortest; then, where it can be had, on a finer mesh."""
    own = dict.fromkeys(OF_PROJECTIVE)
    exact = {"integrator": "symplectic_euler", **own, "substeps": 0, "max_substeps": 100_000}
    found = [case.edited(exact | {"safety": safety}) for safety in SAFETIES]
    if not levers.meshes_left(case.scene):
        known = levers.grounds(case.scene, assemble(case.scene).model.contact_reach)
        finer = edited(case.scene, levers.reference(case.scene, known, FINER))
        found.append(replace(case.job, source=finer, expect=()))
    return found


def measured(case: Case, folder: Path, spread: Spread, say: Say) -> tuple[Kept, dict[str, Any]]:
    """Run one case in all candidates; what is kept of it, and its figures but for the times."""
    kept = kept_of(case.scene, case.job, folder / f"{case.name}.json")
    truth = references(case)
    jobs = [*reversed(truth), *(case.edited(c.keys) for c in case.candidates)]  # the longest first
    say(f"{case.name}: {len(jobs)} runs")
    done = kept.spread(spread, follow, jobs, [job.key for job in jobs], lambda: None)
    check_references(done[: len(truth)], case.name, ". Name others by --scenarios")
    *finer, finest, fine = done[: len(truth)]
    true, steps = rows_of(finest), case.job.steps
    convergence = errors(rows_of(fine), true, steps)
    runs = {}
    for candidate, result in zip(case.candidates, done[len(truth) :], strict=True):
        point = point_of((), result, true, convergence, steps, None)
        runs[candidate.words] = {
            "error": {measure: _short(error) for measure, error in point.error.items()},
            "substeps": point.substeps,
            "balance": _short(point.balance),
            "failed": result.get("failed", []),
            "refusal": point.refusal,
        }
    return kept, {
        "triangles": len(assemble(case.scene).model.triangle_a),
        "step": case.scene.solver.step,
        "convergence": {measure: _short(error) for measure, error in convergence.items()},
        "mesh": {m: _short(e) for m, e in errors(true, rows_of(finer[0]), steps).items()} if finer else {},
        "failed": finest["failed"],
        "runs": runs,
    }


def time_runs(case: Case, kept: Kept, runs: Mapping[str, dict[str, Any]], say: Say) -> None:
    """Add the median time of a step in contact [µs] to every run, or what refused it there."""
    say(f"{case.name}: times")
    jobs = {c.words: case.edited(c.keys) for c in case.candidates if not runs[c.words]["refusal"]}
    times = timed({job.key: job for job in jobs.values()}, ROUNDS, kept, lambda: None)
    for words, job in jobs.items():
        us = times[job.key]
        runs[words]["refusal" if isinstance(us, str) else "us"] = _short(us)


def _short(value: Any) -> Any:
    return float(f"{value:.4g}") if isinstance(value, float) else value


# --- choosing ---------------------------------------------------------------------------------------------


def points(runs: Mapping[str, Mapping[str, Any]]) -> list[Point]:
    """The runs of one scenario as points of a front, that of symplectic Euler first."""
    found = []
    for candidate in sorted(CANDIDATES, key=lambda c: c != BEYOND_SPRINGS):
        run = runs[candidate.words]
        option = Option("integration", candidate.words, tuple(solver_edits(candidate.keys)))
        found.append(Point((option,), run["error"], run.get("us"), not run["refusal"], refusal=run["refusal"]))
    return found


def chosen(scenarios: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any] | None]:
    """The fastest settings that keep the error of a preset wherever every candidate can be run."""
    sweeps = [points(s["runs"]) for s in scenarios.values() if len(s["runs"]) == len(CANDIDATES)]
    return {name: solver_settings(sweeps, "force", error) for name, error in WITHIN.items()}


def measure(folder: Path, wanted: Sequence[str], workers: int, say: Say) -> dict[str, Any]:
    """All figures; what `folder` keeps is not done again."""
    every = {case.name: case for case in cases(folder, say)}
    for name in wanted:
        check_word("--scenarios", name, every)
    asked = [every[name] for name in wanted or every]
    shared_library(fmpy.platform)  # workers side by side would compile side by side
    with pool(workers, None) as spread:
        found = {case.name: measured(case, folder, spread, say) for case in asked}
    for case in asked:  # alone on the machine
        kept, about = found[case.name]
        time_runs(case, kept, about["runs"], say)
    scenarios = {name: about for name, (_, about) in found.items()}
    return {"presets": {name: preset.words for name, preset in PRESETS.items()}, "finer": FINER,
            "safeties": SAFETIES, "scenarios": scenarios, "chosen": chosen(scenarios)}  # fmt: skip


def main(output: Path = Path("build/presets.json"), scenarios: str = "", workers: Workers = 1) -> None:
    """Measure what is not yet kept beside the output file; all scenarios unless some are named, with commas between."""
    check_file("--output", output)
    console = Console(stderr=True)
    folder = output.with_suffix("")
    folder.mkdir(parents=True, exist_ok=True)
    wanted = [name for name in scenarios.split(",") if name]
    found = measure(folder, wanted, workers, lambda text: console.print(text, style="dim", highlight=False))
    publish(output, (json.dumps(found, indent=1) + "\n").encode())
    for name, keys in found["chosen"].items():
        console.print(f"fastest within {percent(WITHIN[name])}, for {name}: {keys}", highlight=False, markup=False)
    console.print(f"kept in {output}", highlight=False)


if __name__ == "__main__":
    typer.run(guarded(main, "presets"))
