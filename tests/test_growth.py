"""How the work of a step grows with the mesh: what is counted, and what the page says of it."""

import json
import math
from pathlib import Path

import pytest

from tissue_contact.scenarios import bench, instructions
from tissue_contact.scenarios.growth import AWAY, COUNTED, FREE, WORK, n_log_n, ratios

DATA = Path(__file__).parents[1] / "docs" / "data" / "growth.json"


def test_instructions_of_perf_and_of_valgrind():
    assert instructions.count_of("# started\n\n12345,,instructions:u,100,100.00,,\n") == 12345
    assert instructions.count_of("<not supported>,,instructions:u,0,100.00,,\n") is None
    assert instructions.count_of("==7== \n==7== Collected : 67890\n") == 67890


def test_sheets_are_compared_where_both_were_counted():
    def row(level, factor):
        return {"level": level, "reach": False, "triangles": 0, **dict.fromkeys(WORK, factor)}

    (found,) = ratios([row("6K", 2.0), row("24K", 9.0), row("96K supported", 1.0)])
    assert (found["of"], found["over"]) == ("24K", "6K")
    assert all(found[work] == 4.5 for work in WORK)
    assert found["N log N"] == pytest.approx(4 * math.log(24200) / math.log(6050))


def test_the_counted_step_grows_no_faster_than_n_log_n():
    for row in ratios(json.loads(DATA.read_text("utf-8"))):
        case = f"{row['of']} over {row['over']}"
        if "supported" in row["of"]:  # the same contact, amid 16 times as much tissue
            assert row["detection"] <= 3.0, case
            assert row["response"] <= 3.0, case
        else:
            assert row["no contact"] <= row["N log N"], case
            assert row["pressed"] <= row["N log N"], case


@pytest.mark.parametrize(("preset", "within"), [("fast", True), ("accurate", False)])
def test_a_step_of_four_times_the_triangles_takes_no_more_than_n_log_n(tmp_path, preset, within):
    """But for the explicit integrator, whose substeps grow as well: as N^1.5."""
    if instructions.counter(tmp_path / "log") is None:
        pytest.skip("needs valgrind, or perf on a machine with counters")
    small, large = (
        instructions.of_steps(
            bench.built(bench.scene_text(bench.tissue_text(level, tmp_path), bench.PRESET.format(preset)), tmp_path)[1],
            bench.poses()[1 : FREE + 1] + AWAY,
            bench.STEP,
            COUNTED,
        )
        for level in ("1.5K", "6K")
    )
    assert (large / small <= n_log_n("1.5K", "6K")) == within
