"""Maps of stability and the loop with a haptic device: against closed forms, against eigenvalues, and the command."""

import csv
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes import assembled, chain
from scipy.linalg import expm
from test_cli import command, refused

from tissue_contact import simulate
from tissue_contact.assemble import INTEGRATORS
from tissue_contact.errors import InputError
from tissue_contact.kernels.slots import AREAL_DENSITY, SUPPORT_DAMPING, TISSUE_PARAMETERS
from tissue_contact.pool import Kept, in_line, pool
from tissue_contact.scenarios import stability
from tissue_contact.scenarios.run import Interrupted
from tissue_contact.scene import read_scene
from tissue_contact.study import stability_map
from tissue_contact.study.haptic import (
    Device,
    bisect,
    close_loop,
    dies_away,
    exact_stiffness,
    lag,
    linear_stiffness,
    loop_matrix,
    passive_stiffness,
)
from tissue_contact.study.press import Press, find_press
from tissue_contact.study.stability_map import (
    MARGINAL,
    REFUSED,
    STABLE,
    UNSTABLE,
    Bench,
    Row,
    judge,
    try_automatic,
    try_row,
    try_scheme,
)
from tissue_contact.study.z_width import Search, stiff_contact, stiffness_range, wall_stiffness, z_width

SEED = 83
T = 1e-3  # s

SHEET = """
[solver]
{solver}
[[tissue]]
shape = {{ kind = "patch", size = [0.02, 0.02], triangles = 60, seed = 1 }}
areal_density = 2.0
stiffness = 100.0
support_stiffness = 1e5
support_damping = 2000.0
{tissue}
[[instrument]]
shape = {{ kind = "sphere", radius = 0.005, triangles = 400 }}
start_position = [0.0, 0.0, 0.001]
[[contact]]
{contact}
"""
FIELD = "stiffness_per_area = 2e7\ndamping_per_area = 1e4"
HULL = 'response = "hull"\nstiffness = 500.0'
DOWN = np.array([0.0, 0.0, -1.0])


def sheet(solver: str = "", tissue: str = "", contact: str = FIELD):
    return assembled(SHEET.format(solver=solver, tissue=tissue, contact=contact))


# --- the press --------------------------------------------------------------------------------------------


def test_a_press_begins_where_the_instrument_meets_the_tissue():
    """The lowest point of the ball is its origin, 1 mm above a flat sheet."""
    press = find_press(sheet(), 0, 3.0 * DOWN, "scene")
    # The field is read at points up to a quarter of the ball's radius apart: one of them lies this far off its axis.
    assert 1e-3 <= press.touch < 1e-3 + (0.25 * 0.005) ** 2 / (2 * 0.005)
    assert press.axis == pytest.approx(DOWN)


def test_an_axis_that_leads_past_the_tissue_is_refused():
    with pytest.raises(InputError, match="must meet the tissue"):
        find_press(sheet(), 0, np.array([0.0, 0.0, 1.0]), "scene")


# --- maps -------------------------------------------------------------------------------------------------


def chain_bench(scheme: str) -> tuple[Bench, float]:
    """Undamped chain of six masses, and the exact limit of symplectic Euler on it [s]."""
    k, m, n = 40.0, 0.02, 6
    assembly = chain(n, k, m, 0.01, integrator=scheme, substeps=1)
    own = {"step": 1e-3, "stiffness": k, "damping": 0.0, "support_damping": 0.0, "density": m,
           "contact_stiffness": 1.0, "speed": 1.0, "detection_period": 1e-3}  # fmt: skip
    print("seed", SEED)
    fastest = 2 * np.sqrt(k / m) * np.sin(n * np.pi / (2 * (n + 1)))
    return Bench(assembly, own, Press(0, DOWN, 0.0, 1.0), 1.0, SEED), 2.0 / fastest


@pytest.mark.parametrize("scale", [1.0, 9.0])
def test_the_scheme_is_stable_below_its_limit_and_unstable_above(scale):
    bench, exact = chain_bench("symplectic_euler")
    exact /= math.sqrt(scale)
    stiffness = scale * bench.values["stiffness"]
    calm, swinging, wild = (try_scheme(bench, {"stiffness": stiffness, "step": f * exact}) for f in (0.2, 0.98, 1.03))
    # A motion at the share s of its limit swings by s²/(1 - s²), 0.04 for a fifth and 24 for 0.98.
    assert (calm.verdict, swinging.verdict, wild.verdict) == (STABLE, MARGINAL, UNSTABLE)
    assert wild.status
    # The bound of the kernels takes 4 k for the largest eigenvalue, this chain has 3.8 k.
    assert 0.95 * exact < calm.limit < exact


def test_explicit_euler_without_damping_grows_at_any_step_and_implicit_euler_at_none():
    (explicit, exact), (implicit, _) = chain_bench("explicit_euler"), chain_bench("implicit_euler")
    grown = try_scheme(explicit, {"step": 0.1 * exact})
    assert grown.limit == 0.0 and grown.verdict == UNSTABLE
    calm = try_scheme(implicit, {"step": 30 * exact})
    assert calm.limit == math.inf and calm.verdict == STABLE and calm.gain <= 0.0


def test_verdicts():
    grows, swings = np.linspace(0, 3, 30), np.tile([0.0, 3.0], 15)
    assert [judge(g) for g in (grows, swings, 0.05 * swings, 0.02 * swings)] == [UNSTABLE, MARGINAL, MARGINAL, STABLE]


def sheet_bench(assembly, **own: float) -> Bench:
    values = {"step": T, "stiffness": 100.0, "damping": 0.0, "support_damping": 2000.0, "density": 2.0,
              "contact_stiffness": 2e7, "speed": 0.5, "detection_period": 1e-3} | own  # fmt: skip
    press = find_press(assembly, 0, DOWN, "scene")
    return Bench(assembly, values, press, press.reach, SEED)


@pytest.mark.parametrize("scheme", ["symplectic_euler", "explicit_euler", "implicit_euler", "runge_kutta_4"])
def test_automatic_substeps_hold_until_the_budget_and_are_refused_beyond(scheme):
    bench = sheet_bench(sheet(f'integrator = "{scheme}"\nmax_substeps = 50'))
    limit = try_automatic(bench, {}).limit
    longest = 0.95 * 50 * min(limit, 1e-3)
    assert try_automatic(bench, {"step": 0.8 * longest}).verdict == STABLE
    beyond = try_automatic(bench, {"step": 1.3 * longest})
    if scheme == "implicit_euler":
        assert beyond.verdict == STABLE
    else:
        assert (beyond.verdict, beyond.status) == (REFUSED, "substep_budget")


def test_a_choice_that_fails_where_more_substeps_hold_is_unstable():
    """The kernels cannot be made to choose wrongly: a safety of 3, at which all blows up, stands for it."""
    assembly = sheet("max_substeps = 200")
    assembly.model.safety[0] = 3.0
    cell = try_automatic(sheet_bench(assembly), {})
    assert cell.verdict == UNSTABLE and cell.status
    # Where the budget ends below what is stable, it is refused rightly.
    assembly.model.substeps_max[0] = cell.substeps or 1
    assert try_automatic(sheet_bench(assembly), {}).verdict == REFUSED


def test_every_value_of_a_cell_reaches_the_model():
    bench = sheet_bench(sheet(tissue="damping = 0.01"), damping=0.01)
    values = {"step": 1.0, "stiffness": 300.0, "damping": 0.02, "support_damping": 70.0, "density": 5.0,
              "contact_stiffness": 1e6, "speed": 2.0, "detection_period": 2e-3}  # fmt: skip
    instance = stability_map._instance(bench, values, 7)
    named = {v.name: instance.parameters[v.slot] for v in bench.assembly.variables if v.block == "parameters"}
    assert named["tissue.stiffnessScale"] == 3.0 and named["tissue.dampingScale"] == 2.0
    assert named["tissue.supportDamping"] == 70.0 and named["tissue.arealDensity"] == 5.0
    assert named["contact.stiffnessPerArea"] == pytest.approx(1e6)
    model = instance._model.fields
    assert model.substeps_fixed[0] == 7 and model.detection_period[0] == 2e-3


def test_a_varied_value_is_that_of_all_tissues_and_another_stays_that_of_each():
    """Also the value that the first tissue has, and the one that stands for a support damping that the scene lacks."""
    bare = SHEET.replace("support_damping = 2000.0\n", "")
    other = bare[bare.index("[[tissue]]") : bare.index("[[instrument]]")].replace("2.0\n", "4.0\n")
    between = 'between = ["one", "instrument"]\n'
    contact = f"{FIELD}\n{between}" + other.format(tissue='name = "two"')
    assembly = assembled(bare.format(solver="", tissue='name = "one"', contact=contact))
    bench = sheet_bench(assembly, support_damping=44.0)

    def found(**varied: float) -> list[list[float]]:
        parameters = stability_map._instance(bench, varied, 1).parameters[: 2 * TISSUE_PARAMETERS]
        return parameters.reshape(2, -1)[:, [AREAL_DENSITY, SUPPORT_DAMPING]].tolist()

    assert found() == [[2.0, 0.0], [4.0, 0.0]]
    assert found(density=2.0) == [[2.0, 0.0], [2.0, 0.0]]
    assert found(support_damping=44.0) == [[2.0, 44.0], [4.0, 44.0]]


def test_rows_are_the_same_from_another_process():
    bench = sheet_bench(sheet())
    row = Row(bench, False, {"density": 1.0}, "step", [1e-4, 3e-3])
    with pool(2) as spread:
        apart = spread(try_row, [row, row], lambda n, done: None)
    assert apart == in_line(try_row, [row, row], lambda n, done: None)
    assert [c.verdict for c in apart[0]] == [STABLE, UNSTABLE]


def _refuse(_: int) -> None:
    instance = simulate.Instance(sheet())
    instance.step(1e9)


def test_a_refused_step_comes_whole_from_another_process():
    with pool(2) as spread, pytest.raises(simulate.Refused, match="communication step is 1e") as refused:
        spread(_refuse, [0], lambda n, done: None)
    assert refused.value.status.name == "step_size"


# --- a device ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("damping", [0.0, 1e-7, 0.3, 50.0])
def test_a_device_moves_as_its_equation_says(damping):
    """Against the exponential of the matrix of (x, v, F/m)."""
    device, t, force = Device(0.1, damping), 0.03, 0.7
    matrix = np.array([[0.0, 1.0, 0.0], [0.0, -damping / 0.1, 1.0], [0.0, 0.0, 0.0]])
    exact = expm(t * matrix) @ [0.2, -0.4, force / 0.1]
    # At a damping of 1e-7 the difference 1 - p leaves eight digits of q.
    assert device.advance(0.2, -0.4, force, t) == pytest.approx(exact[:2], rel=1e-8)


@pytest.mark.parametrize(("delay", "whole", "rest"), [(0.0, 0, 0.0), (3e-3, 3, 0.0), (2.5e-3, 2, 0.5e-3)])
def test_a_delay_is_whole_periods_and_a_rest(delay, whole, rest):
    assert lag(delay, T) == (whole, pytest.approx(rest, abs=1e-15))


def spring(stiffness: float, virtual: float):
    """A bilateral spring with a damper, sampled."""
    before = [0.0]

    def force(x: float) -> float:
        rate, before[0] = (x - before[0]) / T, x
        return stiffness * x + virtual * rate

    return force


@pytest.mark.parametrize("delay", [0.0, 0.4e-3, 2e-3, 2.7e-3])
def test_a_loop_is_the_matrix_of_the_loop(delay):
    device = Device(0.1, 0.5, push=0.0)
    places = close_loop(spring(300.0, 0.2), device, T, delay, 40, 0.05)
    matrix = loop_matrix(device, 300.0, 0.2, T, delay)
    state, linear = np.eye(len(matrix))[1] * 0.05, []
    for _ in range(40):
        linear.append(state[0])
        state = matrix @ state
    assert places == pytest.approx(linear, rel=1e-9, abs=1e-15)


@pytest.mark.parametrize("delay", [0.0, 0.5e-3, 1e-3, 5e-3])
@pytest.mark.parametrize("virtual", [0.0, 0.1, 1.0])
def test_the_bound_of_passivity_is_below_the_limit_of_any_device(delay, virtual):
    """And without virtual damping one that is heavy against the delay comes within a hundredth of it."""
    bound = passive_stiffness(1.0, virtual, T, delay)
    limits = [exact_stiffness(Device(mass, 1.0), virtual, T, delay) for mass in (0.02, 0.1, 1.0, 10.0)]
    print(bound, limits)
    assert min(limits) >= bound
    if virtual == 0.0:
        assert limits[-1] == pytest.approx(bound, rel=0.01)


@pytest.mark.parametrize("share", [1e-4, 1e4])
@pytest.mark.parametrize("delay", [0.0, 5e-3])
def test_the_limit_goes_with_mass_and_dampings(share, delay):
    """Stiffness, damping and mass stand in every term of the loop: limits are soft or stiff as the device is light."""
    limit = exact_stiffness(Device(0.1, 0.4), 0.1, T, delay)
    scaled = exact_stiffness(Device(0.1 * share, 0.3 * share, hand_damping=0.1 * share), 0.1 * share, T, delay)
    assert scaled == pytest.approx(share * limit, rel=1e-5)


@pytest.mark.parametrize(("damping", "delay"), [(0.05, 0.1), (0.004, 5e-3), (0.5, 0.0)])
def test_a_heavy_device_has_the_limit_of_small_dampings(damping, delay):
    device = Device(10.0, damping)
    assert exact_stiffness(device, 0.0, T, delay) == pytest.approx(linear_stiffness(device, 0.0, T, delay), rel=1e-3)


def test_the_bound_of_passivity_is_that_of_the_condition_for_any_controller():
    """Colgate and Schenkel: b > T/2 Re[(1 - e^-jwT) H] / (1 - cos wT) at every frequency, for whole periods."""
    b, virtual = 1.0, 0.3
    angle = np.linspace(1e-4, np.pi, 20_000)
    back = np.exp(-1j * angle)
    for delay in (0, 1, 5):
        k = passive_stiffness(b, virtual, T, delay * T)

        def needed(k: float, delay: int = delay) -> float:
            h = (k + virtual / T * (1 - back)) * back**delay
            return float((0.5 * T * ((1 - back) * h).real / (1 - np.cos(angle))).max())

        # Without delay the two terms do not peak together: at w = 0 the damper helps.
        assert needed(k) <= b * (1 + 1e-6)
        # Of a spring alone the bound is exact.
        alone = passive_stiffness(b, 0.0, T, delay * T)
        assert 0.5 * T * ((1 - back) * alone * back**delay).real[0] / (1 - np.cos(angle[0])) == pytest.approx(b, 1e-4)


def test_runs_that_die_away_are_told_from_limit_cycles():
    t = T * np.arange(4000)
    wave = 1e-3 * np.sin(60 * t)
    assert dies_away(wave * np.exp(-0.5 * t), 0.0)
    assert not dies_away(wave, 0.0) and not dies_away(wave * np.exp(0.1 * t), 0.0)
    assert not dies_away(wave * (1 + np.exp(-10 * t)), 0.0), "to a limit cycle from above"
    assert dies_away(wave, 1e-3), "two steps of the encoder"


def test_bisection_says_where_a_bracket_ends():
    assert bisect(lambda k: k < 50, 100, 200, 1.01) == (0.0, 100)
    assert bisect(lambda k: k < 500, 100, 200, 1.01) == (200, math.inf)
    low, high = bisect(lambda k: k < 150, 100, 200, 1.01)
    assert low < 150 <= high <= 1.01 * low


# --- a device on a scene ----------------------------------------------------------------------------------

RIGID = "fixed = { box = [[-1, -1, -1], [1, 1, 1]] }"


def searched(contact: str, virtual: float, delay: float) -> Search:
    held = sheet("energy_gain = 1e6", RIGID, contact)
    press = find_press(held, 0, DOWN, "scene")
    device = Device(0.1, 0.5, push=0.05)
    low, high = stiffness_range(held, press, device.push)
    about = (0.5 + virtual) / (0.5 * T + delay)
    return Search(held, held, press, True, device, virtual, delay, T, 0.0, math.inf,
                  max(low, 0.3 * about), min(high, 3 * about))  # fmt: skip


@pytest.mark.parametrize(("virtual", "delay"), [(0.0, 0.0), (0.5, 0.0), (0.0, 2e-3)])
def test_a_rigid_wall_bears_what_the_eigenvalues_of_the_loop_say(virtual, delay):
    """The ball dips into the held sheet by its lowest vertex: one spring and one damper."""
    search = searched(HULL, virtual, delay)
    width = z_width(search)
    exact = exact_stiffness(search.device, virtual, T, delay)
    print(width, exact)
    # The two values lie 5 % apart, and what falls by less than 0.2 % in a window is called a limit cycle.
    assert 0.93 * exact < width.borne <= exact < 1.01 * width.not_borne * 1.05
    assert width.status == ""


@pytest.mark.parametrize("contact", [FIELD, HULL, 'law = "hunt_crossley"\nstiffness_per_area = 1e9\nexponent = 1.8'])
def test_the_contact_has_the_stiffness_that_is_asked_for(contact):
    held = sheet("", RIGID, contact)
    press = find_press(held, 0, DOWN, "scene")
    given = stiff_contact(held, press, 0.05, 400.0, 0.3)
    scene = given.stiffness / held.parameters[given.slots]
    assert wall_stiffness(held, press, 0.05, float(scene[0])) == pytest.approx(400.0, rel=1e-3)
    if contact == HULL:
        assert given.stiffness == pytest.approx([400.0], rel=1e-3) and given.damping == pytest.approx([0.3], rel=1e-3)


def test_soft_tissue_bears_a_stiffer_contact_than_a_rigid_wall():
    held = searched(FIELD, 0.0, 5e-3)
    soft = replace(held, assembly=sheet(), rigid=False, soft=20.0)
    on_rigid, on_tissue = z_width(held), z_width(soft)
    assert on_rigid.not_borne < math.inf and on_tissue.borne > on_rigid.borne


# --- the command ------------------------------------------------------------------------------------------


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    file = tmp_path / "scene.toml"
    file.write_text('name = "sheet"\n' + SHEET.format(solver="", tissue="", contact=FIELD))
    return file


def test_the_command_maps_both_kinds(scene, tmp_path):
    out = tmp_path / "out"
    done = command("stability", scene, "-o", out, "--grid", "3", "--integrator", "symplectic_euler",
                   "--integrator", "runge_kutta_4", "--seed", "5")  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert sorted(p.name for p in out.iterdir()) == ["automatic.png", "one.png", "stability.csv", "stability.json"]
    rows = list(csv.DictReader((out / "stability.csv").open()))
    assert len(rows) == 2 * 2 * 9
    one = [r for r in rows if r["substeps"] == "one"]
    assert all((r["verdict"] == UNSTABLE) <= (float(r["share of the limit [1]"]) > 1) for r in one)
    assert {r["verdict"] for r in one} >= {STABLE, UNSTABLE}
    told = json.loads((out / "stability.json").read_text())
    assert told["seed"] == 5 and sum(told["maps"][0]["cells"].values()) == 9
    assert "seed 5" in done.stdout and "none of 9 cells is unstable" in done.stdout


def test_the_command_fails_where_the_automatic_choice_is_unstable(scene, tmp_path, monkeypatch):
    def blown(row: Row):
        return [stability_map.Cell(UNSTABLE, "energy_gain", 2.0, 1e-4 * (n + 1), 9) for n, _ in enumerate(row.along)]

    monkeypatch.setattr(stability, "try_row", blown)
    request = stability.MapRequest(
        read_scene(scene), tmp_path / "out", grid=2, integrators=["symplectic_euler"], kinds=["automatic"]
    )
    assert not stability.stability(request)
    worst = json.loads((tmp_path / "out" / "stability.json").read_text())["maps"][0]
    assert worst["cells"][UNSTABLE] == 4 and worst["statuses"] == {"energy_gain": 4}


def stiffening(scene: Path) -> Path:
    """The scene, with springs that stiffen."""
    scene.write_text(scene.read_text().replace("areal_density", "nonlinearity = 1.0\nareal_density"))
    return scene


def test_projective_dynamics_is_left_out_where_it_does_not_know_the_forces(scene, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(stability, "try_row", lambda row: [stability_map.Cell(STABLE, "", 0.0, 1e-3, 1)] * 2)
    request = stability.MapRequest(read_scene(stiffening(scene)), tmp_path / "out", grid=2, kinds=["one"])
    assert stability.stability(request)
    told = json.loads((request.output / "stability.json").read_text())
    assert {m["integrator"] for m in told["maps"]} == set(INTEGRATORS) - {"projective_dynamics"}
    assert "projective_dynamics is left out, for it does not know the nonlinearity of tissue" in capsys.readouterr().err


def test_a_preset_that_is_replaced_and_dampings_that_the_scene_has_not_are_told(scene, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(stability, "try_row", lambda row: [stability_map.Cell(STABLE, "", 0.0, 1e-3, 1)] * 2)
    text = stiffening(scene).read_text().replace("support_damping = 2000.0", "")
    scene.write_text(text.replace("[solver]", '[solver]\npreset = "fast"'))
    asked = {"x": "damping", "y": "support_damping", "grid": 2, "kinds": ["one"], "integrators": ["symplectic_euler"]}
    request = stability.MapRequest(read_scene(scene), tmp_path / "out", **asked)
    assert stability.stability(request)
    assert f"{request.scene.remarks[0]}\n" in capsys.readouterr().err
    values = json.loads((request.output / "stability.json").read_text())["values"]
    assert values["damping"] == values["support_damping"] == 0.0 < values["density"]
    row = next(csv.DictReader((request.output / "stability.csv").open()))
    assert float(row["damping [N.s/m]"]) > 0.0 < float(row["support_damping [N.s/m3]"])
    with pytest.raises(InputError, match=r"The scene has 0\."):
        stability.stability(replace(request, x_range=(1.0, 0.5)))


def test_projective_dynamics_is_refused_by_the_option_that_asks_for_it(scene, tmp_path):
    words = ["--integrator", "projective_dynamics", "--integrator", "implicit_euler"]
    said = refused("stability", stiffening(scene), "-o", tmp_path / "out", *words, cwd=tmp_path)
    assert said.startswith("tissue-contact: --integrator: ") and "nonlinearity of tissue" in said


@pytest.fixture
def interrupted_map(scene, tmp_path, monkeypatch) -> tuple[stability.MapRequest, list[float]]:
    """A map of three rows that was interrupted in the second, and the stiffness of every row that was begun."""
    tried: list[float] = []

    def stopping(row: Row):
        tried.append(row.fixed["stiffness"])
        if len(tried) == 2:
            raise KeyboardInterrupt
        return [stability_map.Cell(STABLE, "", 0.0, 1e-3, 1) for _ in row.along]

    monkeypatch.setattr(stability, "try_row", stopping)
    request = stability.MapRequest(
        read_scene(scene), tmp_path / "out", grid=3, integrators=["symplectic_euler"], kinds=["one"]
    )
    with pytest.raises(Interrupted, match="the same command goes on there"):
        stability.stability(request)
    assert [p.name for p in request.output.iterdir()] == [request.KEPT]
    return request, tried


def test_an_interrupted_map_goes_on_where_it_was(interrupted_map):
    request, tried = interrupted_map
    assert stability.stability(request)
    assert len(tried) == 4 and len(set(tried)) == 3, "the first row is not done again"
    assert not (request.output / request.KEPT).exists()


def test_nothing_counts_as_kept_before_it_is_in_the_file(tmp_path, monkeypatch):
    def interrupted(path: Path, content: bytes) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("tissue_contact.pool.publish", interrupted)
    kept = Kept(tmp_path / "kept.json", "problem")
    with pytest.raises(KeyboardInterrupt):
        kept.spread(in_line, str, [1, 2], ["a", "b"], lambda: None)
    assert kept.done == {}


def test_what_other_sources_have_finished_is_done_again(interrupted_map, monkeypatch):
    request, tried = interrupted_map
    monkeypatch.setattr("tissue_contact.__version__", "other")
    assert stability.stability(request)
    assert len(tried) == 5


def test_a_loop_leaves_an_interrupted_map_in_its_folder(interrupted_map, monkeypatch):
    request, tried = interrupted_map
    monkeypatch.setattr(stability.widths, "z_width", lambda search: (search.low, search.high, ""))
    assert stability.stability(stability.HapticRequest(request.scene, request.output, delays=[0.0], virtual=[0.0]))
    assert stability.stability(request)
    assert len(tried) == 4


def test_an_interruption_tells_of_nothing_that_another_map_has_kept(interrupted_map, monkeypatch):
    def stop(row: Row):
        raise KeyboardInterrupt

    monkeypatch.setattr(stability, "try_row", stop)
    with pytest.raises(Interrupted, match="Nothing kept"):
        stability.stability(replace(interrupted_map[0], x="density"))


def test_what_cannot_be_written_is_kept(interrupted_map, monkeypatch):
    request, tried = interrupted_map
    errors = iter([KeyboardInterrupt, OSError])

    def fail(path: Path, content: bytes):
        raise next(errors)

    with monkeypatch.context() as patched:
        patched.setattr(stability, "publish", fail)
        with pytest.raises(Interrupted, match="the same command goes on there"):
            stability.stability(request)
        with pytest.raises(OSError):
            stability.stability(request)
    assert stability.stability(request)
    assert len(tried) == 4
    assert not (request.output / request.KEPT).exists()


def test_the_command_closes_the_loop(scene, tmp_path):
    out = tmp_path / "out"
    done = command("stability", scene, "--haptic", "-o", out, "--delay", "0.005", "--virtual-damping", "0")
    assert done.returncode == 0, done.stderr
    assert sorted(p.name for p in out.iterdir()) == ["z-width.csv", "z-width.json", "z-width.png"]
    rigid, tissue = csv.DictReader((out / "z-width.csv").open())
    assert float(rigid["borne [N/m]"]) < float(tissue["borne [N/m]"])
    assert "0 of 1 limits lie below the bound" in done.stdout


def test_a_device_that_no_linear_loop_bears_is_told_of(scene, tmp_path, monkeypatch, capsys):
    """Its virtual damping is more than the mass over a period."""
    monkeypatch.setattr(stability.widths, "z_width", lambda search: (0.0, search.low, "energy_gain"))
    request = stability.HapticRequest(read_scene(scene), tmp_path / "out", delays=[5e-3], virtual=[1e3])
    assert stability.stability(request)
    rows = csv.DictReader((request.output / "z-width.csv").read_text().splitlines())
    assert [float(row["linear limit [N/m]"]) for row in rows] == [0.0, 0.0]
    assert capsys.readouterr().out.count("the linear loop of this device is unstable at any stiffness") == 2


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--x", "stifness"], "nearest right spelling is stiffness"),
        (["--x", "density", "--y", "density"], "the axes must be two"),
        (["--integrator", "euler"], "the value must be symplectic_euler or"),
        (["--substeps", "two"], "the value must be one or automatic"),
        (["--y", "density=5:1"], "must be in order and within"),
        (["--y", "density=1e-9:1"], "within 0.001 to 1000 kg/m2"),
        (["--y", "density=1"], "NAME=LOW:HIGH"),
        (["--axis", "0", "0", "0"], "an axis must have a direction"),
        (["--instrument", "knife"], "must have the instrument"),
        (["--scheduler", "tcp://127.0.0.1:9"], "dask scheduler must answer"),
    ],
)
def test_wrong_words_get_one_line_and_no_file(scene, tmp_path, monkeypatch, words, told):
    monkeypatch.setattr("tissue_contact.pool.CONNECT_TIMEOUT", 0.5)  # [s]
    assert told in refused("stability", scene, "-o", tmp_path / "out", *words, cwd=tmp_path)
    assert not (tmp_path / "out").exists()
