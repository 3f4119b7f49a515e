"""report.html: complete, self-contained, small, and true to the result."""

import dataclasses
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from cases import slot

from identification import Estimate, FitResult, NoiseModel, Profile, Trace, TraceFit, Waterfall
from identification._report import write_report
from identification._words import interval, plain, unit_words, with_error

CASE = slot()


def estimate(name, value, std, **others):
    ci95 = None if std is None else (value - 1.96 * std, value + 1.96 * std)
    fields = {
        "unit": "",
        "at_bound": False,
        "identifiable": std is not None,
        "reason": None,
        "guess": value,
        "bounds": (None, None),
    }
    return Estimate(name=name, value=value, std=std, ci95=ci95, **fields | others)


def result(samples=30_000, **others):
    rng = np.random.default_rng(0)
    time = np.arange(samples) * 3.75e-5
    fitted = np.stack([100 * np.sin(4189 * time), 1e-4 * np.cos(40 * time)], axis=1)
    trace = Trace(
        time, ("Fx", "y"), fitted + rng.normal(size=fitted.shape) * [2, 1e-6], {"Fx": 2.0}, {"y": "um"}, "run <7>.csv"
    )
    fields = {
        "status": "converged",
        "message": "All 2 parameters found.",
        "parameters": (estimate("force.k0", 5000.0, 20.0, unit="N/mm^2"), estimate("force.kr", 0.3, 0.001)),
        "correlation": np.array([[1, -0.7], [-0.7, 1]]),
        "traces": (TraceFit(trace, fitted, {"Fx": 2.0, "y": 1e-6}, 1e-3 * np.abs(fitted), {"Fx": 0, "y": 3}),),
        "cases": (CASE,),
        "begun": True,
        "iterations": 12,
        "seconds": 3.2,
        "versions": {"millax": "0.1.0"},
        "cost": 60_000.0,
        "noise_model": NoiseModel(),
        "solver": "optimistix_lm",
        "asked": None,
        "y": np.zeros(2),
        "noise": None,
        "covariance": np.eye(2),
    }
    return FitResult(**fields | others)


class Page(HTMLParser):
    """The tags, what they point to, and the text of a page; tags must be closed in order."""

    def __init__(self, html):
        super().__init__()
        self.open, self.tags, self.links, self.text = [], [], [], []
        self.feed(html)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.links += [value for name, value in attrs if name in ("src", "href", "xlink:href")]
        if tag not in ("meta", "br", "link", "img"):
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append(tag)
        self.links += [value for name, value in attrs if name in ("src", "href", "xlink:href")]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def page(tmp_path, fit, **keywords):
    path = tmp_path / "report.html"
    write_report(path, fit, title="case.toml", **keywords)
    html = path.read_text(encoding="utf-8")
    return html, Page(html), " ".join(" ".join(Page(html).text).split())


def test_a_report_needs_nothing_else_and_stays_small(tmp_path):
    html, parsed, text = page(tmp_path, result(), truth={"force.kr": 0.302, "force.k0": 5.05e9})
    assert len(html.encode()) < 2_000_000
    assert all(link.startswith(("#", "data:")) for link in parsed.links)
    assert not {"script", "link", "iframe", "img"} & set(parsed.tags)
    assert not re.search(r"url\((?!#)|@import", html)
    # Two figures per trace, the correlation, and a bar per parameter with a truth.
    assert parsed.tags.count("svg") == 2 + 1 + 2
    for words in (
        "Converged: every parameter is known",
        "All 2 parameters found.",
        "run <7>.csv",
        "5000 ± 20 N/mm²",
        "0.3000 ± 0.0010",
        "time [s]",
        "Fx [N]",
        "y [µm]",
        "frequency [Hz]",
        "12 evaluations",
        "millax 0.1.0",
    ):
        assert words in text


def test_truth_and_estimate_are_compared_in_standard_errors(tmp_path):
    si = CASE.force.kr  # the case holds kr = 0.3 and k0 = 5e9, the estimates
    assert float(si) == 0.3
    html, _, text = page(tmp_path, result(), truth={"force.k0": 5.05e9, "force.kr": 0.3005})
    assert "The truth lies in 1 of 2 95 % intervals." in text
    assert "the truth lies 2.5 standard errors from the estimate" in html
    assert "the truth lies 0.5 standard errors from the estimate" in html
    assert "−0.99 %" in text
    without, parsed, _ = page(tmp_path, result())
    assert "truth" not in " ".join(parsed.text)
    assert 'class="bar"' not in without


def test_what_is_not_known_is_said_and_not_numbered(tmp_path):
    unknown = (
        estimate("force.k0", 5000.0, None, reason="force.k0, cut.depth cannot be told apart"),
        estimate("force.kr", 0.3, 0.001),
    )
    nan = np.nan
    fit = result(status="not_identifiable", parameters=unknown, correlation=np.array([[nan, nan], [nan, 1]]))
    html, _, text = page(tmp_path, fit, truth={"force.k0": 5e9})
    assert "Not identifiable: the measurements do not determine every parameter" in text
    assert "force.k0, cut.depth cannot be told apart" in text
    assert "nan" not in html.replace("nano", "").lower().split("<svg")[0]
    assert "Correlation of the estimates" not in text


def test_a_fit_that_never_ran_has_a_report_too(tmp_path):
    unknown = (estimate("force.k0", 5000.0, None, reason="nothing to start from"),)
    fit = result(status="cannot_start", traces=(), parameters=unknown, correlation=np.full((1, 1), np.nan))
    _, parsed, text = page(tmp_path, fit)
    assert "Cannot start" in text
    assert "svg" not in parsed.tags


def test_numbers_on_axes_keep_their_digits(tmp_path):
    root = np.linspace(-3, 3, 7)
    one = Profile("force.kr", "", 0.1234 + 1e-4 * root, root, (0.1232, 0.1236), None)
    text = page(tmp_path, result(500, profiles=(one,)))[2]
    assert re.search(r"0\.123\d", text)


def test_text_from_outside_is_text(tmp_path):
    html, _, _ = page(tmp_path, dataclasses.replace(result(200), message="<script>alert(1)</script>"))
    assert "<script>" not in html


def test_profiles_other_starts_and_the_noise_have_their_place(tmp_path):
    root = np.linspace(-3, 3, 7)
    profiles = (
        Profile("force.k0", "N/mm^2", 5000 + 20 * root, root, (4962.0, 5041.0), None),
        Profile("force.kr", "", np.zeros(0), np.zeros(0), None, "the measurements leave force.kr open above the estimate"),
    )
    ends = np.array([[5000.0, 0.3], [5000.0, 0.3], [9000.0, 0.2], [1.0, 0.1]])
    falls = Waterfall(
        ("force.k0", "force.kr"),
        ("N/mm^2", ""),
        2 * ends,
        ends,
        np.array([0.0, 1e-9, 700.0, np.inf]),
        np.array([0, 0, 1, -1]),
        7,
    )
    fit = result(500, profiles=profiles, waterfall=falls, noise_model=NoiseModel("student", order=2), seed=7)
    _, parsed, text = page(tmp_path, fit)
    assert parsed.tags.count("svg") == 2 + 1 + 2
    for words in (
        "by profile 4962 … 5041",
        "The measurements leave force.kr open above the estimate.",
        "2 of 4 starts reached the best optimum, 1 ended in 1 worse one, 1 reached none",
        "Student's t with 4 degrees of freedom, autoregressive of order 2",
        "seed 7",
        "not white (order 3)",
    ):
        assert words in text


def test_the_same_fit_gives_the_same_file(tmp_path):
    first, _, _ = page(tmp_path, result(500))
    again, _, _ = page(tmp_path, result(500))
    assert first == again


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (5019.0, 16.6, "5019 ± 17"),
        (0.30001, 0.000021, "0.300010 ± 0.000021"),
        (-39.6, 1.25, "-39.6 ± 1.2"),
        (4.9704e9, 9.57e7, "(4.970 ± 0.096)·10⁹"),
        (1.2e-7, 3e-9, "(1.200 ± 0.030)·10⁻⁷"),
        (0.0, 0.02, "0.000 ± 0.020"),
        (0.3, None, "0.3000"),
    ],
)
def test_numbers_with_their_errors(value, std, text):
    assert with_error(value, std) == text


def test_intervals_have_the_digits_of_the_error():
    assert interval((309976.2, 310046.8)) == "309976 … 310047"
    assert interval((0.30996, 0.31007)) == "0.309960 … 0.310070"
    assert interval((4.78e9, 5.16e9)) == "(4.780 … 5.160)·10⁹"
    assert interval((-0.1, 0.1)) == "-0.100 … 0.100"


def test_plain_numbers_and_units():
    assert plain(5130.0) == "5130"
    assert plain(0.018, 3) == "0.0180"
    assert plain(2.5e-7) == "2.500·10⁻⁷"
    assert plain(0.0) == "0"
    assert unit_words("N/mm^2") == "N/mm²"
    assert unit_words("um") == "µm"
    assert unit_words("N/um") == "N/µm"
    assert unit_words("s^-1") == "s⁻¹"
