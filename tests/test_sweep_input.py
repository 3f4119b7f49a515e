"""What a sweep is asked: texts, lists and random values; and every way to ask for nothing that can be done."""

import jax.numpy as jnp
import numpy as np
import pytest
from cases import RPM, slot

import millax as mx
from millax._members import member, members_of
from millax._reductions import chosen
from millax._values import read

CASE = slot(stiffness=jnp.array([3e5, 4e5]))


@pytest.mark.parametrize(
    ("given", "numbers", "unit"),
    [
        ("4000:16000:5 rpm", [4000, 7000, 10000, 13000, 16000], "rpm"),
        ("2 : -1 : 4 mm", [2, 1, 0, -1], "mm"),
        ("0.5, 1,2 mm", [0.5, 1, 2], "mm"),
        ("1e-1:3e-1:3", [0.1, 0.2, 0.3], ""),
        ("1 N/mm^2", 1, "N/mm^2"),
        (["1 mm", "5 mm"], [1, 5], "mm"),
        ([1, 2.5], [1, 2.5], None),
        (np.array([3]), [3], None),
        (jnp.arange(2.0), [0, 1], None),
        (0.3, 0.3, None),
        (mx.Values(np.array([1, 2]), "mm"), [1, 2], "mm"),
    ],
)
def test_values_as_they_may_be_written(given, numbers, unit):
    values = read("cut.depth", given)
    np.testing.assert_allclose(values.numbers, numbers, rtol=1e-15)
    assert values.numbers.shape == np.shape(numbers)
    assert values.unit == unit


def test_the_members_of_a_grid_are_in_si_and_the_last_name_runs_fastest():
    members = members_of(CASE, {"cut.spindle_speed": "60, 120 rpm", "cut.depth": "1:3:3 mm", "force.kr": 0.5}, None)
    assert members.names == ("cut.spindle_speed", "cut.depth", "force.kr")
    assert members.dims == {"cut.spindle_speed": 2, "cut.depth": 3}
    np.testing.assert_allclose(members.table[:, 0], 2 * np.pi * np.array([1, 1, 1, 2, 2, 2]), rtol=1e-15)
    np.testing.assert_allclose(members.table[:, 1], [1e-3, 2e-3, 3e-3, 1e-3, 2e-3, 3e-3], rtol=1e-15)
    np.testing.assert_array_equal(members.table[:, 2], 0.5)
    assert members.words(4) == "cut.spindle_speed = 120 rpm, cut.depth = 2 mm, force.kr = 0.5"


def test_the_feed_per_tooth_can_be_held_while_the_speed_varies():
    members = members_of(CASE, {"cut.spindle_speed": "5000, 10000 rpm", "cut.feed_per_tooth": "0.1 mm"}, None)
    for values, rate in zip(members.table, (1 / 30, 1 / 15), strict=True):
        case = member(CASE, members.names, jnp.asarray(values))
        assert float(case.cut.feed_rate) == pytest.approx(rate)
        assert float(case.cut.feed_per_tooth(case.tool)) == pytest.approx(1e-4)


def test_a_unit_with_the_exponent_of_the_law_in_it():
    case = slot(force=mx.ExponentialLaw(kf=1e8, m=0.7, kr=0.3))
    for text in ("1000, 2000 N/mm^1.7", "1000, 2000 N/mm^(1+m)"):
        members = members_of(case, {"force.kf": text}, None)
        np.testing.assert_allclose(members.table[:, 0], np.array([1000, 2000]) * 1e3**1.7, rtol=1e-12)
        assert members.units["force.kf"] == "N/mm^1.7"


def test_random_values_fill_their_range_evenly_and_come_back_with_the_seed():
    ranges = {"force.k0": "4000:6000 N/mm^2", "force.kr": "0.3 ± 0.02"}
    values = mx.sample(ranges, 400, seed=3)
    k0, kr = values["force.k0"], values["force.kr"]
    assert k0.unit == "N/mm^2"
    assert kr.unit == ""
    # A Latin hypercube has exactly one value in each of 400 equal parts.
    np.testing.assert_array_equal(np.sort(((k0.numbers - 4000) / 5).astype(int)), np.arange(400))
    assert kr.numbers.mean() == pytest.approx(0.3, abs=1e-4)
    assert kr.numbers.std() == pytest.approx(0.02, rel=0.01)
    assert abs(np.corrcoef(k0.numbers, kr.numbers)[0, 1]) < 0.15
    np.testing.assert_array_equal(mx.sample(ranges, 400, seed=3)["force.kr"], kr)
    assert (mx.sample(ranges, 400, seed=4)["force.kr"].numbers != kr.numbers).all()


@pytest.mark.parametrize("method", ["latin hypercube", "sobol"])
def test_correlated_normal_values(method):
    ranges = {"force.k0": "5000 +- 100 N/mm^2", "force.hs": "18 ± 1 um", "force.kr": "0.2:0.4"}
    wanted = np.array([[1.0, -0.9, 0.0], [-0.9, 1.0, 0.3], [0.0, 0.3, 1.0]])
    values = mx.sample(ranges, 1024, seed=0, method=method, correlation=wanted)
    found = np.corrcoef(values["force.k0"], values["force.hs"])[0, 1]
    assert found == pytest.approx(-0.9, abs=0.02)
    assert values["force.hs"].numbers.std() == pytest.approx(1.0, rel=0.05)
    assert 0.2 < values["force.kr"].numbers.min() < values["force.kr"].numbers.max() < 0.4


@pytest.mark.parametrize(
    ("grid", "words"),
    [
        ({"cut.dept": "1:2:3 mm"}, "cut.dept: unknown parameter; did you mean cut.depth?"),
        ({"cut.feed_per_toth": "1:2:3 mm"}, "did you mean cut.feed_per_tooth?"),
        ({"structure.stiffness": [1e5]}, "name them one by one: structure.stiffness.x, structure.stiffness.y"),
        ({"tool.teeth": [2, 4]}, "tool.teeth: the number of teeth cannot be varied in one sweep"),
        ({"simulation.duration": [1.0]}, "simulation.duration: the duration belongs to the case"),
        ({"stock.immersion": "1:2:3 mm"}, "stock.immersion: the workpiece cannot be varied in a sweep"),
        ({"cut.depth": "1:2:3 N"}, "unit N cannot be converted to m"),
        ({"cut.depth": "1:2:3"}, 'numbers without a unit given; write it behind them, as in "1 m"'),
        ({"force.kr": "0.1:0.3:3 mm"}, "the unit mm does not belong here"),
        ({"cut.depth": "1:2 mm"}, 'without how many; write "1:2:20 mm"'),
        ({"cut.depth": "1:2:1 mm"}, "a whole number of at least 2"),
        ({"cut.depth": "1:2:3:4 mm"}, "after from and to comes how many"),
        ({"cut.depth": "1:1:3 mm"}, "the two ends are the same"),
        ({"cut.depth": "1:2,3 mm"}, 'it takes "4000:16000:49 rpm"'),
        ({"cut.depth": "thick"}, 'cut.depth: "thick" given; it takes "4000:16000:49 rpm"'),
        ({"cut.depth": ["1 mm", "2 um"]}, "all with the same unit"),
        ({"cut.depth": []}, "cut.depth: no value given"),
        ({"cut.depth": [1e-3, float("nan")]}, "cut.depth: nan given at position 1; every value must be finite"),
        ({"cut.depth": [[1e-3]]}, "an array of shape (1, 1) given; it must have one dimension"),
        ({"cut.depth": object()}, "given; it takes"),
        ({"cut.depth": "1, 2, 1 mm"}, "cut.depth: 1 given twice"),
        ({"cut.depth": "-1:1:3 mm"}, "cut.depth: -1 mm given; it must be greater than 0"),
        ({"cut.depth": [0.0]}, "cut.depth: 0 m given; it must be greater than 0"),
        ({"cut.feed_per_tooth": "0.1, 0.2 mm", "cut.feed_rate": [1.0]}, "cut.feed_per_tooth or cut.feed_rate"),
        ({}, "a grid or as samples"),
    ],
)
def test_a_grid_that_cannot_be_swept_is_named_with_what_is_allowed(grid, words):
    with pytest.raises(ValueError, match=r".") as error:
        mx.sweep(CASE, grid=grid)
    assert words in str(error.value)


def test_grid_and_samples_at_once_and_samples_of_different_lengths():
    with pytest.raises(ValueError, match="only one of them"):
        mx.sweep(CASE, grid={"cut.depth": [1e-3]}, samples={"force.kr": [0.1]})
    with pytest.raises(ValueError, match=r"cut.depth has 2, force.kr has 3 values; every number needs one value per sample"):
        mx.sweep(CASE, samples={"cut.depth": [1e-3, 2e-3], "force.kr": [0.1, 0.2, 0.3]})


def test_a_law_whose_exponent_and_coefficient_vary_takes_si():
    case = slot(force=mx.ExponentialLaw(kf=1e8, m=0.7, kr=0.3))
    with pytest.raises(ValueError, match=r"force.kf: its unit changes with force.m"):
        mx.sweep(case, grid={"force.kf": "1000 N/mm^1.7", "force.m": [0.6, 0.8]})
    members = members_of(case, {"force.kf": [1e8, 2e8], "force.m": [0.6, 0.8]}, None)
    assert members.units["force.kf"] == "N/m^(1+m)"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (({"force.kr": "0.1:0.3:5"}, 10), 'force.kr: "0.1:0.3:5" given; it takes "4000:6000 N/mm^2" (uniform'),
        (({"force.kr": "0.3"}, 10), "it takes"),
        (({"force.kr": "0.3:0.1"}, 10), "the first end must be the smaller"),
        (({"force.kr": "0.3 ± 0"}, 10), "the standard deviation must be greater than 0"),
        (({"force.kr": "0.1:0.3"}, 0), "number: 0 given"),
        (({}, 10), "ranges: none given"),
    ],
)
def test_random_values_that_cannot_be_drawn(arguments, words):
    with pytest.raises(ValueError, match=r".") as error:
        mx.sample(*arguments)
    assert words in str(error.value)


@pytest.mark.parametrize(
    ("correlation", "words"),
    [([[1.0]], "2 by 2"), ([[1, 0.5], [0.4, 1]], "symmetric"), ([[1, 2], [2, 1]], "not positive definite")],
)
def test_a_correlation_that_is_none(correlation, words):
    with pytest.raises(ValueError, match=words):
        mx.sample({"force.kr": "0.1:0.3", "force.r": "0.1:0.3"}, 10, correlation=correlation)


def failing(sim):
    return np.asarray(sim.force).mean()


@pytest.mark.parametrize(
    ("reduce", "words"),
    [
        (["mean_forces"], "reduce: 'mean_forces' given; it takes names out of mean_force, peak_force"),
        ("mean_force", "it takes names out of"),
        ({"x": 3}, "reduce: 3 given for x"),
        ({"status": lambda sim: sim.time[0]}, "'status' given as a name"),
        ({"a/b": lambda sim: sim.time[0]}, "must be a text without /"),
        ({"mine": failing}, "reduce: mine cannot be computed from a Simulation by JAX: TracerArrayConversionError"),
        ({"mine": lambda sim: None}, "reduce: mine returns nothing"),
        ({"mine": lambda sim: jnp.fft.rfft(sim.force[:, 0])}, "reduce: mine is complex"),
        ({"mine": mx.Reduction(lambda sim: sim.force, dims=("time",))}, "but the dimensions ('time',)"),
    ],
)
def test_a_reduction_that_cannot_be_used(reduce, words):
    with pytest.raises(ValueError, match=r".") as error:
        mx.sweep(slot(duration=0.003), grid={"cut.depth": [1e-3]}, reduce=reduce)
    assert words in str(error.value)


def test_names_select_reductions():
    assert list(chosen(["peak_force", "mean_force"])) == ["peak_force", "mean_force"]
    assert list(chosen(None)) == list(mx.REDUCTIONS)
    assert CASE.cut.spindle_speed == pytest.approx(10000 * RPM)
