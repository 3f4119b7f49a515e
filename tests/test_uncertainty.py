"""Uncertainties against SciPy and closed forms, and the questions that have no answer."""

import jax.numpy as jnp
import numpy as np
import pytest
from cases import slot
from scipy.optimize import curve_fit

from identification import Parameter
from identification._parameters import free
from identification._uncertainty import uncertainty

CASE = slot()
RNG = np.random.default_rng(7)
DESIGN = RNG.normal(size=(200, 4)) * [1e-9, 1e5, 30.0, 800.0]
SIGMA = 0.3


def jacobian(numbers, y, design=DESIGN):
    """Whitened residuals of a model that is linear in the parameters."""
    return design * np.asarray(numbers.slopes(jnp.asarray(y))) / SIGMA


def four():
    return free(
        CASE,
        [
            Parameter("force.k0", 5e9),  # logarithm
            Parameter("force.hs", 18e-6, (1e-6, 1e-4)),  # logit
            Parameter("force.kr", 0.3, (None, 1.0)),  # logarithm of the distance to the upper bound
            Parameter("cut.start.y", 1e-3),  # no transform
        ],
    )


def test_standard_errors_and_correlation_are_those_of_scipy_whatever_the_transform():
    numbers = four()
    y = np.array([0.2, -0.1, 0.3, 0.4])
    value = np.asarray(numbers.values(jnp.asarray(y)))
    data = DESIGN @ value + SIGMA * RNG.normal(size=200)
    _, covariance = curve_fit(
        lambda x, *p: x @ np.array(p), DESIGN, data, p0=value, sigma=np.full(200, SIGMA), absolute_sigma=True
    )
    known = uncertainty(numbers, y, jacobian(numbers, y))
    assert known.reason == (None,) * 4
    std = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(known.std, std, rtol=1e-5)
    np.testing.assert_allclose(known.correlation, covariance / np.outer(std, std), atol=1e-5)


def test_one_parameter_has_the_closed_form():
    numbers = free(CASE, [Parameter("force.kr", 0.3)])
    column = np.linspace(1, 2, 50)[:, None]
    known = uncertainty(numbers, np.zeros(1), jacobian(numbers, np.zeros(1), column))
    std = SIGMA / np.linalg.norm(column)
    assert known.std[0] == pytest.approx(std, rel=1e-12)
    assert known.ci95[0] == pytest.approx((0.3 - 1.959964 * std, 0.3 + 1.959964 * std), rel=1e-9)


def test_intervals_stay_within_the_bounds_where_the_normal_one_would_not():
    numbers = free(CASE, [Parameter("force.r", 0.02, (0, 1)), Parameter("force.kr", 0.1, (None, 0.2))])
    known = uncertainty(numbers, np.zeros(2), np.diag([1.2, 1.2]))
    for interval, low, high, value in zip(known.ci95, (0, -np.inf), (1, 0.2), (0.02, 0.1), strict=True):
        assert interval is not None
        assert low < interval[0] < value < interval[1] < high
    assert known.std[0] is not None
    assert 0.02 - 1.96 * known.std[0] < 0


def test_a_combination_that_cannot_be_known_is_named_and_the_others_keep_their_errors():
    numbers = four()
    design = DESIGN.copy()
    design[:, 1] = design[:, 0] * 5e9 / 18e-6  # as if only the product k0 hs mattered
    known = uncertainty(numbers, np.zeros(4), jacobian(numbers, np.zeros(4), design))
    assert known.identifiable == (False, False, True, True)
    assert known.std[:2] == (None, None)
    assert known.ci95[:2] == (None, None)
    assert "force.k0, force.hs cannot be told apart" in known.reason[0]
    assert "+1 % of force.k0 with -1 % of force.hs" in known.reason[0] or (
        "-1 % of force.k0 with +1 % of force.hs" in known.reason[0]
    )
    assert np.isnan(known.correlation[0]).all()
    assert np.isnan(known.correlation[:, 1]).all()
    # The product is known: what remains is the problem with one parameter in place of the two.
    reduced = free(CASE, [Parameter("force.k0"), Parameter("force.kr", 0.3, (None, 1.0)), Parameter("cut.start.y", 1e-3)])
    expected = uncertainty(reduced, np.zeros(3), jacobian(reduced, np.zeros(3), DESIGN[:, [0, 2, 3]]))
    np.testing.assert_allclose(known.std[2:], expected.std[1:], rtol=1e-6)


def test_a_parameter_without_effect_and_one_with_hardly_any_get_no_number():
    numbers = four()
    design = DESIGN * [1.0, 0.0, 1.0, 1e-6]
    known = uncertainty(numbers, np.zeros(4), jacobian(numbers, np.zeros(4), design))
    assert known.identifiable == (True, False, True, False)
    assert known.reason[1] == "force.hs changes nothing that was measured"
    assert "too large against its value" in known.reason[3]
    assert known.std[1] is None
    assert known.std[3] is None


def test_a_parameter_at_its_bound_is_told_and_held_for_the_others():
    numbers = four()
    y = np.array([0.0, 12.0, 0.0, 0.0])
    known = uncertainty(numbers, y, jacobian(numbers, y))
    assert known.at_bound == (False, True, False, False)
    assert known.std[1] is None
    assert "the bound decides force.hs" in known.reason[1]
    kept = free(CASE, [Parameter("force.k0", 5e9), Parameter("force.kr", 0.3, (None, 1.0)), Parameter("cut.start.y", 1e-3)])
    expected = uncertainty(kept, np.zeros(3), jacobian(kept, np.zeros(3), DESIGN[:, [0, 2, 3]]))
    np.testing.assert_allclose([known.std[i] for i in (0, 2, 3)], expected.std, rtol=1e-9)
