"""The report on an identification: what the page and the summary say, and that the page is complete in itself."""

import base64
import io
from pathlib import Path

import numpy as np
import pytest
from lxml import html
from PIL import Image
from rich.console import Console

from tissue_contact.identify.contact_fit import Options, Probe, fit_laws
from tissue_contact.identify.figures import SHOWN, chosen_curves
from tissue_contact.identify.laws import Touches
from tissue_contact.identify.report import Curve, summary, write_report
from tissue_contact.identify.result import Estimate, Fitted, HeldOut, Result
from tissue_contact.identify.wording import interval, measure, number, unit

HOSTILE = "$x^{$<script>alert('1')</script> & \"co\""  # starts with mathematics that matplotlib cannot read
LAWS = ("hunt_crossley", "kelvin_voigt")
STIFFNESS = Estimate(
    name="stiffness",
    unit="N/m3",
    value=1234.5,
    standard_error=12.3,
    low=1210.4,
    high=1259.1,
    verdict="identified",
)
DISSIPATION = Estimate(
    name="dissipation", unit="s/m", value=None, verdict="not identifiable", reason="the file has no times"
)
EXPONENT = Estimate(
    name="exponent",
    unit="1",
    value=1.0,
    standard_error=0.2,
    low=1.0,
    high=1.4,
    verdict="at bound",
    reason="the best value is the least that is allowed, 1",
)
DAMPING = Estimate(
    name="damping",
    unit="N.s/m",
    value=0.5,
    standard_error=0.4,
    low=0.0,
    high=1.3,
    verdict="weak",
    reason="the standard error is 80% of the value",
)


def fitted(law: str, scope: str = "pooled", label: str = "all probes", **changes: object) -> Fitted:
    own = {
        "hunt_crossley": ((STIFFNESS, DISSIPATION, EXPONENT), ((1.0, -0.4321), (-0.4321, 1.0)), 0.08, -500.0),
        "kelvin_voigt": ((STIFFNESS, DAMPING), ((1.0, 0.1), (0.1, 1.0)), 0.1, -450.0),
    }
    estimates, correlation, rmse, aic = own[law]
    parts = {
        "scope": scope,
        "label": label,
        "law": law,
        "estimates": estimates,
        "correlation": correlation,
        "samples": 20,
        "rmse": rmse,
        "r2": 0.9,
        "aic": aic,
        "autocorrelation": 0.1,
        "evaluations": 7,
        "converged": True,
        "message": "",
    }
    return Fitted(**{**parts, **changes})


def identification(probes: int = 9, **changes: object) -> Result:
    labels = [f"p{k}" for k in range(probes)]
    fits = [fitted(law) for law in LAWS]
    fits += [fitted(law, "region", r) for law in LAWS for r in ("left", HOSTILE)]
    fits += [fitted(law, "probe", label) for law in LAWS for label in labels]
    parts = {
        "data": ("probing.csv",),
        "probes": probes,
        "samples": 20 * probes,
        "excluded": (),
        "notes": ("Depth was turned from mm into m.",),
        "fits": tuple(fits),
        "held_out": tuple(
            HeldOut(law=law, what="probes", folds=5, rmse=rmse, r2=0.8)
            for law, rmse in zip(LAWS, (0.081, 0.1), strict=True)
        ),
        "chosen": "hunt_crossley",
        "parameters": {"probe.stiffness": 1234.5},
    }
    return Result(**{**parts, **changes})


def curves(probes: int = 9) -> list[Curve]:
    """Probes whose error grows with their number, in two regions."""
    noise, depth = np.random.default_rng(1), np.linspace(0.0, 0.003, 20)
    made = []
    for k in range(probes):
        force = 300.0 * depth + (1 + k) * 0.01 * noise.standard_normal(20)
        fits = dict.fromkeys(LAWS, 300.0 * depth)
        made.append(Curve(f"p{k}", ("left", HOSTILE)[k % 2], depth, "depth", "m", force, fits, fits))
    return made


def page_of(tmp_path: Path, result: Result, of: list[Curve]) -> tuple[str, html.HtmlElement]:
    path = tmp_path / "new" / "report.html"
    write_report(result, of, path)
    text = path.read_text("utf-8")
    return text, html.document_fromstring(text)


def told(result: Result) -> list[str]:
    console = Console(width=80, file=io.StringIO(), record=True)
    console.print(summary(result))
    return console.export_text().splitlines()


def words(lines: list[str]) -> str:
    return " ".join(" ".join(lines).split())


def text_of(element: html.HtmlElement) -> str:
    return " ".join(" ".join(element.itertext()).split())


def test_the_page_tells_constants_verdicts_and_laws(tmp_path: Path) -> None:
    _, page = page_of(tmp_path, identification(), curves())
    rows = [[text_of(c) for c in row] for row in page.find(".//table").findall(".//tbody/tr")]
    bound = "at bound: the best value is the least that is allowed, 1"
    assert rows == [
        ["stiffness", "1,234 ± 12 N/m³", "1,210 to 1,259", "identified"],
        ["dissipation", "not identifiable", "the file has no times"],
        ["exponent", "1.00 ± 0.20", "1.00 to 1.40", bound],
    ]
    whole = text_of(page)
    for said in (
        "9 probes, 180 samples, from probing.csv",
        "Depth was turned from mm into m.",
        "hunt_crossley errs 19 % less than kelvin_voigt on held-out probes: 0.0810 N against 0.100 N. "
        "Its AIC is 50.0 lower.",
        "RMSE, held-out data [N] 0.0810 0.100",
        "−0.4321",
        "0.500 ± 0.40 (weak)",
        "exponent 9 1.00 1.00 1.00 1.00 1.00 at bound 9",
        "probe.stiffness 1234.5",
        "stiffnesses with different exponents cannot be compared",
    ):
        assert said in whole
    captions = [text_of(c) for c in page.iter("caption")]
    assert len(captions) == len(list(page.iter("table")))
    assert {"hunt_crossley, fitted to each of 9 probes", "kelvin_voigt, fitted to each of 9 probes"} <= {*captions}


def test_the_page_is_complete_in_itself_and_well_formed(tmp_path: Path) -> None:
    text, page = page_of(tmp_path, identification(), curves())
    assert "http:" not in text and "https:" not in text and "url(" not in text
    assert not list(page.iter("script", "link", "iframe", "object", "base"))
    pictures = list(page.iter("img"))
    # Probes, residuals of two laws, two of their distribution, two constants with a number.
    assert len(pictures) == SHOWN + 2 + 2 + 2
    for picture in pictures:
        kind, _, data = picture.get("src").partition(",")
        assert kind == "data:image/png;base64" and picture.get("alt")
        Image.open(io.BytesIO(base64.b64decode(data))).verify()
    # HTML mends what is left open: as XML, without the void elements, it must be right as it stands.
    closed = text.replace("<!DOCTYPE html>", "")
    for void in ("meta", "img"):
        closed = "".join(
            part if k == 0 else f"<{void} {part.replace('>', '/>', 1)}"
            for k, part in enumerate(closed.split(f"<{void} "))
        )
    html.etree.fromstring(closed)


def test_hostile_names_are_told_as_they_are(tmp_path: Path) -> None:
    result = identification(data=(HOSTILE,), notes=(HOSTILE,), excluded=(HOSTILE,))
    result = result.model_copy(update={"parameters": {HOSTILE: 1.0}})
    text, page = page_of(tmp_path, result, curves())
    assert "<script" not in text
    assert text_of(page).count(HOSTILE) > 10
    odd = fitted("kelvin_voigt").model_copy(update={"law": "[red]"})
    # Over the constants, and over its column in the comparison.
    assert words(told(identification(fits=(odd,), chosen="[red]", held_out=()))).count("[red]") == 2


def test_what_has_no_number_is_told_without_one(tmp_path: Path) -> None:
    none = fitted("hunt_crossley", estimates=(DISSIPATION,), correlation=(), r2=None)
    fits = [none] + [none.model_copy(update={"scope": "probe", "label": f"p{k}"}) for k in range(3)]
    result = identification(fits=tuple(fits), held_out=())
    _, page = page_of(tmp_path, result, curves(3))
    assert "None" not in text_of(page) and "nan" not in text_of(page)
    cells = [text_of(c) for row in page.iter("tr") if row[0].text_content() == "dissipation" for c in row[1:]]
    assert cells == ["not identifiable", "the file has no times"]
    assert "not identifiable the file has no times" in words(told(result)).replace("– ", "")


def test_warnings(tmp_path: Path) -> None:
    good = fitted("kelvin_voigt")
    calm = identification(fits=(good,), chosen="kelvin_voigt", held_out=())
    _, page = page_of(tmp_path, calm, [])
    assert not page.find_class("warnings") and not list(page.iter("img")) and "Warning" not in words(told(calm))

    astray = fitted("hunt_crossley", autocorrelation=0.31, converged=False, message="500 evaluations were not enough")
    own = [fitted("hunt_crossley", "probe", f"p{k}", converged=k > 0) for k in range(3)]
    bad = identification(fits=(astray, good, *own))
    _, page = page_of(tmp_path, bad, curves(3))
    said = [text_of(li) for li in page.find_class("warnings")[0].iter("li")]
    assert [s.split(":")[0] for s in said] == [
        "The intervals are too narrow",
        "The fit of hunt_crossley to all data did not converge",
        "exponent is at its bound",
        "1 of 3 fits to a single probe did not converge.",
        "3 of 3 fits to a single probe have a constant at its bound.",
    ]
    assert all(s in words(told(bad)) for s in said)


def test_the_first_exclusions_are_told_and_the_others_counted(tmp_path: Path) -> None:
    _, page = page_of(tmp_path, identification(excluded=tuple(f"probing.csv, line {k}" for k in range(1060))), [])
    lines = [text_of(li) for li in page.iter("li") if "line" in text_of(li) or "more" in text_of(li)]
    assert len(lines) == 51 and lines[49:] == ["probing.csv, line 49", "and 1,010 more"]


def test_the_summary_fits_a_terminal() -> None:
    lines = told(identification())
    assert len(lines) <= 30 and max(map(len, lines)) <= 80
    for said in ("1,234 ± 12 N/m³", "1,210 to 1,259", "not identifiable", "hunt_crossley errs 19 % less"):
        assert said in words(lines)


def test_a_page_on_many_probes_stays_small(tmp_path: Path) -> None:
    text, _ = page_of(tmp_path, identification(200), curves(200))
    assert len(text) < 400_000


def test_worst_median_and_best_are_drawn() -> None:
    some = curves()
    picked = chosen_curves(some[::-1], "hunt_crossley")
    errors = sorted((c.rmse("hunt_crossley") for c in some), reverse=True)
    assert [word for word, _ in picked] == ["worst"] * 2 + ["median"] * 2 + ["best"] * 2
    assert [c.rmse("hunt_crossley") for _, c in picked] == [errors[k] for k in (0, 1, 3, 4, 7, 8)]
    few = [c for _, c in chosen_curves(some[:3], "hunt_crossley")]
    assert few == sorted(some[:3], key=lambda c: -c.rmse("hunt_crossley"))


def test_a_fit_of_time_series_without_regions(tmp_path: Path) -> None:
    """The correlations of a real fit belong to the constants with a number."""
    time = np.linspace(0.0, 1.0, 50)
    depth = 0.002 * np.sin(np.pi * time)
    touches = Touches(np.arange(50), depth, np.gradient(depth, time), np.ones((50, 1)), 50)
    force = 3e4 * depth**1.5 + 0.001 * np.random.default_rng(2).standard_normal(50)
    still = Touches(touches.sample, np.full(50, 0.001), touches.rate, touches.weight, 50)
    for t in (touches, still):
        fits, held, _ = fit_laws([Probe("only", "", t, force)], Options(), True, "")
        result = identification(1, fits=tuple(fits), held_out=tuple(held))
        for fit in fits:
            known = [e for e in fit.estimates if e.value is not None and e.verdict != "given"]
            assert len(fit.correlation) == len(known)
        curve = Curve("only", "", time, "time", "s", force, {"hunt_crossley": force}, {})
        _, page = page_of(tmp_path, result, [curve])
        assert "held-out stretches of the recording" in text_of(page)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0.00"),
        (0.99951, "1.00"),
        (-0.012345, "−0.0123"),
        (12345.0, "12,300"),
        (999_999.0, "1.00 × 10⁶"),
        (1.5e-7, "1.50 × 10⁻⁷"),
        (-2e9, "−2.00 × 10⁹"),
    ],
)
def test_numbers(value: float, text: str) -> None:
    assert number(value) == text


@pytest.mark.parametrize(
    ("value", "error", "low", "high", "text", "reach"),
    [
        (332.783, 5.853, 321.5, 344.462, "332.8 ± 5.9", "321.5 to 344.5"),
        (4.7649e7, 2.4149e7, 1.7634e7, 1.2875e8, "(4.76 ± 2.4) × 10⁷", "1.76 × 10⁷ to 1.29 × 10⁸"),
        (300.0, 1e-9, 300.0, 300.0, "300.000 ± 1.0 × 10⁻⁹", "300.000 to 300.000"),
        (0.0, 0.2, 0.0, 0.4, "0.00 ± 0.20", "0.00 to 0.400"),
        (5.0, None, None, None, "5.00", "–"),
    ],
)
def test_values_have_the_digits_of_their_errors(
    value: float, error: float | None, low: float | None, high: float | None, text: str, reach: str
) -> None:
    e = Estimate(name="a", unit="1", value=value, standard_error=error, low=low, high=high, verdict="identified")
    assert (measure(e), interval(e)) == (text, reach)


def test_units() -> None:
    assert [unit(u) for u in ("1", "N.s/m3", "N/m")] == ["", "N·s/m³", "N/m"]
