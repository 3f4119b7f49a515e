"""Free parameters: names, bounds and the way from a solver's coordinates to a case."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import slot

import millax as mx
from identification import Parameter, Prior, Tie
from identification._parameters import free
from identification._transforms import Above, Below, Between, Scaled, transform_for

INF = float("inf")
CASE = slot(stiffness=jnp.array([3e5, 4e5]), damping_ratio=jnp.array([0.05, 0.06]))


@pytest.mark.parametrize(
    ("kind", "guess", "low", "high"),
    [
        (Scaled, 0.3, -INF, INF),
        (Scaled, 0.0, -INF, INF),
        (Above, 5e9, 0.0, INF),
        (Above, 2.0, 1.5, INF),
        (Below, -2.0, -INF, 3.0),
        (Between, 0.02, 0.0, 0.5),
    ],
)
def test_a_transform_starts_at_the_guess_goes_there_and_back_and_keeps_its_bounds(kind, guess, low, high):
    transform = transform_for(guess, low, high)
    assert type(transform) is kind
    np.testing.assert_allclose(transform(jnp.array(0.0)), guess, rtol=1e-14, atol=1e-15)
    for y in np.linspace(-4, 4, 9):
        v = transform(jnp.array(y))
        assert low < v < high
        np.testing.assert_allclose(transform.inverse(v), y, rtol=1e-10, atol=1e-12)
        h = 1e-6
        difference = (transform(jnp.array(y + h)) - transform(jnp.array(y - h))) / (2 * h)
        slope = jax.grad(transform)(jnp.array(y))
        assert slope > 0
        np.testing.assert_allclose(slope, difference, rtol=1e-7)


def test_the_kind_of_quantity_sets_the_bounds_that_are_not_given():
    numbers = free(CASE, [Parameter(n) for n in ("force.k0", "structure.stiffness.x", "force.r", "force.kr")])
    assert [type(t) for t in numbers.transforms] == [Above, Above, Above, Scaled]
    bounded = free(CASE, [Parameter("force.r", bounds=(None, 1.0))])
    assert isinstance(bounded.transforms[0], Between)


def test_only_the_free_numbers_of_the_case_change():
    numbers = free(
        CASE,
        [
            Parameter("structure.damping_ratio.y", 0.1),
            Parameter("force.k0", "10 kN/mm^2"),
            Parameter("structure.damping_ratio.x", "4 %"),
            Parameter("cut.start.y", "1 mm"),
        ],
    )
    case = numbers.insert(CASE, jnp.zeros(4))
    np.testing.assert_allclose(case.structure.damping_ratio, [0.04, 0.1])
    np.testing.assert_allclose(case.cut.start, [-0.01, 1e-3])
    assert float(case.force.k0) == pytest.approx(1e10)
    unchanged = mx.Case(
        CASE.tool,
        case.force,
        case.cut,
        CASE.stock,
        mx.Structure(
            CASE.structure.axes, CASE.structure.mass, CASE.structure.stiffness, damping_ratio=jnp.array([0.04, 0.1])
        ),
        CASE.settings,
    )
    for a, b in zip(jax.tree.leaves(case), jax.tree.leaves(unchanged), strict=True):
        np.testing.assert_array_equal(a, b)


def test_inserting_is_differentiable_and_agrees_with_the_slopes():
    numbers = free(CASE, [Parameter("force.hs"), Parameter("structure.stiffness.y", bounds=("1e5 N/m", "1e6 N/m"))])
    y = jnp.array([0.3, -0.5])
    jacobian = jax.jacfwd(
        lambda y: jnp.stack([numbers.insert(CASE, y).force.hs, numbers.insert(CASE, y).structure.stiffness[1]])
    )(y)
    np.testing.assert_allclose(jacobian, np.diag(numbers.slopes(y)), rtol=1e-12)


def test_other_numbers_are_no_reason_to_compile_again():
    traced = []

    @jax.jit
    def insert(numbers, y):
        traced.append(1)
        return numbers.insert(CASE, y).force.k0

    for guess, low in ((1e9, 1e8), (2e9, 1e7)):
        insert(free(CASE, [Parameter("force.k0", guess, (low, 1e10))]), jnp.zeros(1))
    assert len(traced) == 1


def test_the_unit_of_an_exponential_coefficient_follows_its_exponent():
    case = slot(force=mx.ExponentialLaw(kf=1e8, m=0.7, kr=0.3))
    numbers = free(case, [Parameter("force.kf", "1000 N/mm^1.7")])
    assert float(numbers.guess[0]) == pytest.approx(1000 * 1e3**1.7)


def test_numbers_of_every_trace_ties_and_priors():
    """The first case has one speed, the second another; the others are shared."""
    other = eqx.tree_at(lambda c: c.cut.spindle_speed, CASE, jnp.array(900.0))
    numbers = free(
        [CASE, other],
        [
            Parameter("cut.spindle_speed", each=True, unit="rpm"),
            Parameter("structure.stiffness.x", "4e5 N/m", prior=Prior("5e5 N/m", "1e5 N/m")),
            Tie("structure.stiffness.y", "structure.stiffness.x", 1.5),
            Tie("cut.feed_rate", "cut.spindle_speed", 1e-4),
            Parameter("force.hs", "20 um", prior=Prior("10 um", factor=2.0)),
        ],
    )
    assert numbers.names == ("cut.spindle_speed.trace_1", "cut.spindle_speed.trace_2", "structure.stiffness.x", "force.hs")
    y = jnp.array([0.1, -0.2, 0.3, 0.4])
    values = numbers.values(y)
    np.testing.assert_allclose(numbers.guess[:2], [CASE.cut.spindle_speed, 900.0])
    for place, case in enumerate((CASE, other)):
        found = numbers.insert(case, y, place)
        np.testing.assert_allclose(found.cut.spindle_speed, values[place], rtol=1e-15)
        np.testing.assert_allclose(found.cut.feed_rate, 1e-4 * values[place], rtol=1e-15)
        np.testing.assert_allclose(found.structure.stiffness, values[2] * np.array([1.0, 1.5]), rtol=1e-15)
        np.testing.assert_allclose(found.force.hs, values[3], rtol=1e-15)
    np.testing.assert_allclose(
        numbers.prior(y), [(values[2] - 5e5) / 1e5, np.log(values[3] / 10e-6) / np.log(2)], rtol=1e-12
    )
    assert free(CASE, [Parameter("force.k0")]).prior(jnp.zeros(1)).shape == (0,)


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ([], "no free parameters"),
        ([Parameter("force.kO0")], "did you mean force.k0"),
        ([Parameter("force.k0"), Parameter("force.k0")], "given twice"),
        ([Parameter("force.k0", "5 N")], "cannot be converted to N/m"),
        ([Parameter("force.k0", unit="mm")], "unit of force.k0"),
        ([Parameter("force.k0", "1 kN/mm^2", ("2 kN/mm^2", None))], "guess 1 kN/mm^2 must lie strictly between 2 kN/mm^2"),
        ([Parameter("force.k0", -1.0)], "must lie strictly between 0"),
        ([Parameter("force.r", bounds=(-1, 2))], "must be 0 or greater"),
        ([Parameter("force.kr", bounds=(0, 1, 2))], "3 given; they are two"),  # pyright: ignore[reportArgumentType]
        ([Parameter("force.kr", [0.1, 0.2])], "must be one number"),  # pyright: ignore[reportArgumentType]
        ([Parameter("force.kr", prior=Prior(0.3))], "prior of force.kr: give std or factor, and only one of them"),
        ([Parameter("force.kr", prior=Prior(0.3, 0.1, 2.0))], "prior of force.kr: give std or factor"),
        ([Parameter("force.kr", prior=Prior(0.3, 0.0))], "prior of force.kr: std 0 given; it must be greater than 0"),
        ([Parameter("force.kr", prior=Prior("3 N", 1))], "prior of force.kr: "),
        ([Parameter("force.kr", prior=Prior(0.3, factor=2))], "a factor is for numbers that are positive by their bounds"),
        ([Parameter("force.hs", prior=Prior("18 um", factor=1))], "factor 1 given; it must be greater than 1"),
        ([Parameter("force.kr", 0.3, (0, 1), prior=Prior(2, 1))], "its mean 2 lies outside the bounds, 0 to 1"),
        ([Tie("force.kr", "force.r")], "no free parameters given"),
        ([Parameter("force.k0"), Tie("force.kr", "force.hs")], "force.kr: tied to force.hs, which is not free"),
        ([Parameter("force.k0"), Tie("force.k0", "force.k0")], "force.k0: given twice"),
        ([Parameter("force.r"), Tie("force.hss", "force.r")], "did you mean force.hs"),
        (
            [Parameter("force.kr"), Tie("force.hs", "force.kr")],
            "which goes from -inf to inf, given; it must be greater than 0",
        ),
        ([Parameter("force.r"), Tie("force.kr", "force.r", 0.0)], "0 times force.r"),
    ],
)
def test_a_parameter_that_cannot_be_used_is_named_with_what_is_allowed(parameters, words):
    with pytest.raises(ValueError, match=r".") as error:
        free(CASE, parameters)
    assert words in str(error.value)
