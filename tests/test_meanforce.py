"""Force coefficients from mean forces: the linear map against the engine and formulas written out by hand, what noise makes
of the coefficients, and what cannot be known."""

import dataclasses
import math

import numpy as np
import pytest
from cases import ENDLESS, RPM

import millax as mx
from identification import Trace, TraceError, mean_force_fit
from identification._meanforce import mean_map
from identification._meanresult import COEFFICIENTS
from identification._steady import steady
from identification._turns import turn_means
from identification._weighted import weighted

TRUTH = np.array([9e8, 2.5e8, -1.5e8, 16e3, 19e3, -18e3])
KTC, KRC, KAC, KTE, KRE, KAE = TRUTH
LAW = mx.LinearLaw(kt=KTC, kr=KRC / KTC, ke=KTE, ka=KAC / KTC, kre=KRE, kae=KAE)
RADIUS, DEPTH, TURN = 0.01, 2e-3, 0.01
STOCKS = {
    "slot": ENDLESS,
    "half up": mx.Stock.box((None, None), (0.0, None)),
    "half down": mx.Stock.box((None, None), (None, 0.0)),
    "quarter down": mx.Stock.box((None, None), (None, -RADIUS / 2)),
    "strip": mx.Stock.box((None, None), (-4e-3, 7e-3)),
}
FORCES = ("Fx", "Fy", "Fz")


def cut_case(feed_per_tooth=5e-5, stock=ENDLESS, start=(0.0, 0.0), teeth=3, periods=1, settings=None, **tool):
    """6000 rpm, 20 mm, 2 mm deep."""
    end_mill = mx.EndMill(2 * RADIUS, teeth, **tool)
    cut = mx.Cut(6000 * RPM, feed_per_tooth * teeth / TURN, DEPTH, start)
    return mx.Case(end_mill, LAW, cut, stock, mx.Structure.rigid(), mx.Settings(periods, **(settings or {})))


def means(case):
    """Of the linear law, by the linear map."""
    return mean_map(case, steady(case)) @ TRUTH


def constant(values, channels=FORCES, turns=10, noise=0.0, seed=0, name="trace", begin=0.0):
    """A trace of these means, 100 samples per turn."""
    time = begin + (np.arange(100 * turns) + 0.5) * TURN / 100
    scatter = np.random.default_rng(seed).normal(scale=noise or 1e-30, size=(len(time), len(channels)))
    return Trace(time, channels, np.asarray(values)[: len(channels)] + scatter, name=name)


def fitted(cases, **others):
    return mean_force_fit(cases, [constant(means(case), seed=i, **others) for i, case in enumerate(cases)])


def values(found):
    return np.array([np.nan if one.value is None else one.value for one in found.coefficients])


def test_a_slot_has_the_formulas_of_the_textbook():
    f, n, a = 5e-5, 3, DEPTH
    by_hand = [
        -n * a / 4 * KRC * f - n * a / math.pi * KRE,
        n * a / 4 * KTC * f + n * a / math.pi * KTE,
        n * a / math.pi * KAC * f + n * a / 2 * KAE,
    ]
    np.testing.assert_allclose(means(cut_case(f)), by_hand, rtol=1e-14)


def test_half_up_milling_has_the_formulas_written_out_by_hand():
    """Up-milling at half immersion: from phi = -90 deg, in the stock at the left, to 0."""
    f, per_angle = 5e-5, 3 * DEPTH / (2 * math.pi)
    by_hand = [
        per_angle * (f * (-KTC / 2 - KRC * math.pi / 4) - KTE - KRE),
        per_angle * (f * (KTC * math.pi / 4 - KRC / 2) + KTE - KRE),
        per_angle * (f * KAC + KAE * math.pi / 2),
    ]
    np.testing.assert_allclose(means(cut_case(f, STOCKS["half up"])), by_hand, rtol=1e-12)


@pytest.mark.parametrize("stock", STOCKS.values(), ids=STOCKS.keys())
@pytest.mark.parametrize("helix", [None, np.deg2rad(30)], ids=["straight", "helix"])
def test_the_engine_has_the_same_means(stock, helix):
    """What is left is of first order in f_z/R: the path of the earlier tooth, and the ends of the engagement."""
    f = 1e-5
    settings = {"steps_per_tooth": 200, "width": 0.0, "slices": 1 if helix is None else 40}
    case = cut_case(f, stock, periods=3, settings=settings, helix=helix)
    force = np.asarray(mx.simulate(case).force).mean(axis=0)
    expected = means(case)
    np.testing.assert_allclose(force, expected, atol=f / RADIUS * np.abs(expected).max())


def test_exact_means_give_the_coefficients_back():
    cases = [cut_case(f, STOCKS[name]) for name in ("slot", "half down", "strip") for f in (3e-5, 6e-5, 1e-4)]
    found = fitted(cases)
    np.testing.assert_allclose(values(found), TRUTH, rtol=1e-9)
    assert found["ktc"].unit == "N/m^2"
    assert found.misfit == dict.fromkeys(FORCES, 0.0)
    assert found.r2 == pytest.approx(dict.fromkeys(FORCES, 1.0))
    for cut, case in zip(found.cuts, cases, strict=True):
        assert cut.turns == 10
        np.testing.assert_allclose(cut.measured, means(case), rtol=1e-12)
        np.testing.assert_allclose(cut.fitted, means(case), rtol=1e-9)


def test_cuts_may_be_of_different_tools():
    found = fitted([cut_case(5e-5), cut_case(1e-4, teeth=5), cut_case(8e-5, teeth=2, helix=0.5)])
    np.testing.assert_allclose(values(found), TRUTH, rtol=1e-9)


def test_the_law_has_the_coefficients():
    law = fitted([cut_case(f) for f in (3e-5, 6e-5)]).law()
    h = 4e-5
    assert float(law.tangential(h)) == pytest.approx(KTC * h + KTE)
    assert float(law.kr * law.kt) == pytest.approx(KRC)
    assert float(law.ka * law.kt) == pytest.approx(KAC)
    assert (float(law.kre), float(law.kae)) == pytest.approx((KRE, KAE))


def test_a_law_without_axial_force_and_one_with_a_negative_edge_force():
    cases = [cut_case(f) for f in (3e-5, 6e-5)]
    law = fitted(cases, channels=("Fx", "Fy")).law()
    assert law.ka is None
    assert law.kae is None
    less = np.array([0.0, 2 * 3 * DEPTH / math.pi * KTE, 0.0])  # as of -KTE
    found = mean_force_fit(cases, [constant(means(case) - less) for case in cases])
    assert found["kte"].value == pytest.approx(-KTE)
    assert float(found.law().ke) == 0
    assert float(found.law().kre) == pytest.approx(KRE)
    flipped = mean_force_fit(cases, [constant(-means(case)) for case in cases])
    with pytest.raises(
        ValueError, match=r"ktc is -9e\+08 N/m\^2; it must be greater than 0. Are the forces those on the tool"
    ):
        flipped.law()


def test_noise_is_within_the_standard_errors():
    cases = [cut_case(f, STOCKS[name]) for name in ("slot", "half up") for f in (3e-5, 6e-5, 1e-4)]
    found = fitted(cases, noise=20.0, turns=100)
    for one, true in zip(found.coefficients, TRUTH, strict=True):
        assert one.value is not None
        assert one.std is not None
        assert abs(one.value - true) < 3 * one.std
        assert one.std < 0.1 * abs(true)


def test_standard_errors_are_the_spread_of_the_estimates():
    """2000 draws tell their spread to 2 %. A misfit found in mere noise makes the errors a little too large; one that is
    there is known from 12 degrees of freedom: the spread of Student's t is then 1.1."""
    rng = np.random.default_rng(3)
    design = np.concatenate([mean_map(case, steady(case))[:2] for case in map(cut_case, np.linspace(2e-5, 1e-4, 8))])
    design = design[:, [0, 1, 3, 4]]
    truth, std = TRUTH[[0, 1, 3, 4]], np.linspace(0.5, 2.0, len(design))
    for extra in (0.0, 5.0):
        found = [weighted(design, design @ truth + rng.normal(scale=np.hypot(std, extra)), std) for _ in range(2000)]
        z = np.array([(one.value - truth) / one.std for one in found])
        assert z.mean(axis=0) == pytest.approx(np.zeros(4), abs=0.1)
        assert z.std(axis=0) == pytest.approx(np.full(4, 1.1 if extra else 0.95), abs=0.06)
        assert np.sqrt(np.mean([one.misfit**2 for one in found])) == pytest.approx(extra, rel=0.1, abs=0.7)


def test_a_bent_law_is_a_misfit_and_makes_the_errors_large():
    cases = [cut_case(f) for f in (2e-5, 6e-5, 1e-4, 1.4e-4)]
    bend = 5.0 * np.array([-1, 1, 1, -1])
    traces = [constant(means(case) + np.array([b, 0, 0]), noise=1.0, turns=50) for case, b in zip(cases, bend, strict=True)]
    found = mean_force_fit(cases, traces)
    straight = fitted(cases, noise=1.0, turns=50)
    assert found.misfit["Fx"] == found.misfit["Fy"] == pytest.approx(5 * math.sqrt(4 / 4), rel=0.05)
    assert found.misfit["Fz"] < 0.1
    assert found["krc"].std > 20 * straight["krc"].std
    # The straight line through the means by NumPy, with equal weights: the misfit is far above the scatter.
    feeds, fx = np.array([(cut.feed_per_tooth, cut.measured[0]) for cut in found.cuts]).T
    slope, at_zero = np.polyfit(feeds, fx, 1)
    assert found["krc"].value == pytest.approx(-slope / (3 * DEPTH / 4), rel=1e-3)
    assert found["kre"].value == pytest.approx(-at_zero / (3 * DEPTH / math.pi), rel=1e-3)
    assert found.r2["Fx"] == pytest.approx(np.corrcoef(feeds, fx)[0, 1] ** 2, abs=1e-6)


@pytest.mark.parametrize("r", [0.0, 0.5])
def test_the_error_of_a_mean_is_that_of_correlated_turns(r):
    rng = np.random.default_rng(5)
    case, turns, apart = cut_case(), 200, []
    for _ in range(300):
        each = np.empty(turns)
        each[0] = rng.normal()
        for k in range(1, turns):
            each[k] = r * each[k - 1] + math.sqrt(1 - r**2) * rng.normal()
        values = np.repeat(30 + each, 100)[:, None]
        trace = Trace((np.arange(len(values)) + 0.5) * TURN / 100, ("Fx",), values)
        found = turn_means(trace, case, steady(case))
        apart.append((found.mean[0] - 30) / found.std[0])
    assert np.std(apart) == pytest.approx(1.0, abs=0.15)


def test_turns_need_not_be_whole_samples_nor_begin_with_one():
    """The ripple of the teeth goes out of the mean: what is left is below its height over the samples in the trace."""
    case = cut_case()
    time = 0.3e-2 + np.arange(1270) * TURN / 97.3
    trace = Trace(time, ("Fy",), 100 + 80 * np.cos(2 * np.pi * 3 * time / TURN)[:, None])
    found = turn_means(trace, case, steady(case))
    assert found.turns == 13
    assert found.mean[0] == pytest.approx(100, abs=0.02)


def test_only_steady_cutting_counts():
    """The tool enters a block of 12 mm and leaves it: its teeth are all in from x = 0 to 2 mm of its centre."""
    case = cut_case(1e-5, mx.Stock.box((0.0, 12e-3)), start=(-1e-3, 0.0))
    within, feed = steady(case), 3e-5 / TURN
    assert (within.begin, within.end) == pytest.approx((1e-3 / feed, 3e-3 / feed))
    trace = constant([10.0, 20.0], ("Fx", "Fy"), turns=120)
    values = np.where((trace.time > within.begin)[:, None] & (trace.time < within.end)[:, None], trace.values, 0.0)
    found = turn_means(dataclasses.replace(trace, values=values), case, within)
    assert found.turns == 66
    assert found.mean == pytest.approx([10.0, 20.0])


def test_steady_cutting_begins_when_the_rearmost_engaged_angle_is_in():
    """Up-milling at half immersion, teeth engaged from -90 deg to 0: the one at -90 deg is beside the centre."""
    assert steady(cut_case(stock=mx.Stock.box((0.0, None), (0.0, None)))).begin == pytest.approx(0.0, abs=1e-12)
    narrow = steady(cut_case(stock=mx.Stock.box((0.0, None), (-5e-3, 5e-3)), start=(-RADIUS, 0.0)))
    assert (narrow.low, narrow.high) == pytest.approx((-0.5, 0.5))
    assert narrow.begin == pytest.approx((1 - math.cos(math.radians(30))) * RADIUS / (1.5e-4 / TURN))


def test_one_feed_cannot_tell_cutting_from_edge():
    found = fitted([cut_case(), cut_case(teeth=2)])
    assert np.isnan(values(found)).all()
    assert [one.std for one in found.coefficients] == [None] * 6
    assert found["ktc"].reason == (
        "ktc, kte cannot be told apart by what was measured. All cuts have the same feed per tooth, 0.05 mm: measure at "
        "others too"
    )
    assert found["kre"].reason is not None
    assert found["kre"].reason.startswith("krc, kre cannot be told apart")
    assert found["kac"].reason is not None
    assert found["kac"].reason.startswith("kac, kae cannot be told apart")
    np.testing.assert_allclose(found.cuts[0].fitted, found.cuts[0].measured, rtol=1e-9)
    assert found.misfit["Fz"] == 0.0
    with pytest.raises(ValueError, match="ktc is not known, and without it there is no force law: ktc, kte cannot"):
        found.law()


def test_one_feed_at_several_engagements_can():
    found = fitted([cut_case(stock=STOCKS[name]) for name in ("half up", "half down", "quarter down")])
    np.testing.assert_allclose(values(found), TRUTH, rtol=1e-9)


def test_what_was_not_measured_is_named():
    cases = [cut_case(f) for f in (3e-5, 6e-5)]
    found = fitted(cases, channels=("Fx", "Fy"))
    np.testing.assert_allclose(values(found)[[0, 1, 3, 4]], TRUTH[[0, 1, 3, 4]], rtol=1e-9)
    assert found["kac"].reason == found["kae"].reason == "no trace has Fz"
    assert found.misfit == {"Fx": None, "Fy": None}
    assert found.r2 == {"Fx": None, "Fy": None}
    # In a slot Fx says nothing of the tangential force, elsewhere it has a share of all.
    found = fitted(cases, channels=("Fx",))
    np.testing.assert_allclose(values(found)[[1, 4]], TRUTH[[1, 4]], rtol=1e-9)
    assert found["ktc"].reason == ("ktc changes nothing that was measured. Measure both Fx and Fy, and at more feeds")
    found = fitted([cut_case(f, STOCKS["half up"]) for f in (3e-5, 6e-5)], channels=("Fx",))
    assert found["kre"].reason is not None
    assert found["kre"].reason.startswith("kte, kre cannot be told apart")


def test_only_the_axial_force_gives_only_axial_coefficients():
    cases = [cut_case(f) for f in (3e-5, 6e-5)]
    traces = [constant(means(case)[2:], ("Fz",)) for case in cases]
    found = mean_force_fit(cases, traces)
    assert (found["kac"].value, found["kae"].value) == pytest.approx((KAC, KAE))
    assert found["krc"].reason == "no trace has Fx or Fy"


def test_a_pitch_that_is_not_equal_has_the_same_mean():
    """In a slot, where each tooth cuts all the way."""
    pitch = np.deg2rad([100.0, 120.0, 140.0])
    settings = {"steps_per_tooth": 240, "width": 0.0, "passes": 3, "blocks": 2}
    case = cut_case(1e-5, periods=6, settings=settings, pitch=pitch)
    force = np.asarray(mx.simulate(case).force)[-3 * 240 :].mean(axis=0)
    np.testing.assert_allclose(force, means(case), atol=1e-3 * np.abs(means(case)).max())


CASE, TRACE = cut_case(), constant([1.0, 2.0, 3.0], name="a.csv")


@pytest.mark.parametrize(
    ("cases", "traces", "error", "message"),
    [
        ([CASE, CASE], [TRACE], ValueError, "2 cases given for 1 traces; give one case for each"),
        ([], [], ValueError, "0 cases given for 0 traces"),
        (
            [CASE, cut_case(stock=mx.Stock.box((None, None), (0.02, None)))],
            [TRACE, TRACE],
            ValueError,
            "case 2 of 2: stock: the tool, its centre at y = 0 m, passes beside it: no tooth is ever engaged",
        ),
        (cut_case(0.0), TRACE, ValueError, "case 1 of 1: cut.feed_rate: 0 m/s given; a tool that is not fed never cuts"),
        (
            CASE,
            Trace(TRACE.time, ("x",), TRACE.values[:, :1], name="b.csv"),
            TraceError,
            "b.csv: no force among its channels, x; give some of Fx, Fy, Fz",
        ),
        (
            CASE,
            Trace(TRACE.time[:60], FORCES, TRACE.values[:60], name="c.csv"),
            TraceError,
            r"c.csv: 0.6 turns of the spindle \(0.01 s each\) in steady cutting; at least 5 are needed",
        ),
        (
            cut_case(stock=mx.Stock.box((0.0, 5e-3))),
            TRACE,
            ValueError,
            "case 1 of 1: stock: so short along the feed",
        ),
        (
            CASE,
            Trace(TRACE.time * 50, FORCES, TRACE.values),
            TraceError,
            "sampled every 0.005 s, 0.67 times per tooth period",
        ),
    ],
)
def test_bad_input_is_told(cases, traces, error, message):
    with pytest.raises(error, match=message):
        mean_force_fit(cases, traces)


def test_an_unknown_coefficient_is_told():
    with pytest.raises(KeyError, match="kt is no force coefficient; there are ktc, krc"):
        fitted([CASE])["kt"]
    assert list(COEFFICIENTS) == [one.name for one in fitted([CASE]).coefficients]
