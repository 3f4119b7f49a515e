"""Noise: how residuals are made independent, and what is estimated of it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import cholesky, toeplitz
from scipy.signal import lfilter
from scipy.stats import t as student_t

from identification._colour import correlated_square, process
from identification._noise import Noise, NoiseModel, predictor, reflections, student_scale

K = np.array([0.7, -0.4, 0.2])
"""Reflection coefficients of a process of order 3."""


def correlations(k, samples):
    """Of the process, by the Yule-Walker equations solved for r_1 ... r_p, and their recursion."""
    a, p = predictor(k), len(k)
    matrix, right = np.eye(p), a.copy()
    for i in range(p):
        for j in range(p):
            lag = abs(i - j)
            if lag:
                matrix[i, lag - 1] -= a[j]
    right = np.array([a[i] for i in range(p)])
    r = [1.0, *np.linalg.solve(matrix, right)]
    while len(r) < samples:
        r.append(float(a @ r[-1 : -p - 1 : -1]))
    return np.array(r[:samples])


def test_whitening_is_that_of_the_covariance_matrix():
    samples = 40
    covariance = toeplitz(correlations(K, samples))
    residuals = np.random.default_rng(0).normal(size=(1, samples))
    white = np.asarray(Noise(np.ones(1), K[None], None).white(jnp.asarray(residuals)))[0]
    # Whatever the order of time, the sum of squares is the quadratic form; sample by sample it is Cholesky's.
    exact = np.linalg.solve(cholesky(covariance, lower=True), residuals[0])
    assert white @ white * np.prod(1 - K**2) == pytest.approx(exact @ exact * np.prod(1 - K**2), rel=1e-12)
    np.testing.assert_allclose(white, exact, rtol=1e-11)


def test_reflections_and_order_are_found():
    draws = lfilter([1.0], np.concatenate([[1.0], -predictor(K)]), np.random.default_rng(1).normal(size=(2, 40_000)))
    np.testing.assert_allclose(reflections(np.asarray(draws), 3), [K, K], atol=0.02)
    assert len(process(np.asarray(draws)[0])) == 3
    orders = [len(process(np.random.default_rng(seed).normal(size=2000))) for seed in range(40)]
    assert orders.count(0) >= 38


def test_the_square_through_a_correlation_matrix():
    jacobian = np.random.default_rng(2).normal(size=(2, 400)).cumsum(axis=1)
    jacobian *= np.sin(np.linspace(0, np.pi, 400))  # nothing at the ends, where the impulse response is cut
    exact = jacobian @ toeplitz(correlations(K, 400)) @ jacobian.T
    np.testing.assert_allclose(correlated_square(jacobian, K), exact, rtol=2e-3)
    np.testing.assert_allclose(correlated_square(jacobian, np.zeros(0)), jacobian @ jacobian.T)


def test_independent_residuals_of_students_t_are_its_likelihood():
    noise = NoiseModel("student", 5.0).of(np.array([2.0]))
    residuals = np.array([[-30.0, -1.0, 0.0, 1e-7, 0.5, 400.0]])
    e = np.asarray(noise.independent(jnp.asarray(residuals)))[0] / 2.0
    likelihood = -2 * (student_t.logpdf(residuals[0] / 2.0, 5.0) - student_t.logpdf(0.0, 5.0))
    np.testing.assert_allclose(e**2, likelihood, rtol=1e-9, atol=1e-15)
    slopes = jax.vmap(jax.grad(lambda r: noise.independent(r[None, None])[0, 0]))(jnp.asarray(residuals[0]))
    assert np.isfinite(slopes).all()
    assert slopes[2] == pytest.approx(np.sqrt(6 / 5), rel=1e-12)
    assert abs(slopes[5]) < 0.1 * slopes[2]


def test_the_information_of_students_t_is_that_of_its_score():
    noise = NoiseModel("student", 4.0).of(np.array([1.0]))
    z = student_t.rvs(4.0, size=400_000, random_state=3)
    slope = jax.vmap(jax.grad(lambda r: noise.independent(r[None, None])[0, 0]))(jnp.asarray(z))
    score = 5 * z / (4 + z**2)
    assert noise.information * np.mean(np.asarray(slope) ** 2) == pytest.approx(np.mean(score**2), rel=0.02)
    assert np.mean(score**2) == pytest.approx(5 / 7, rel=0.02)


def test_the_scale_of_students_t_is_hardly_changed_by_outliers():
    z = 3.0 * student_t.rvs(4.0, size=20_000, random_state=4)
    assert student_scale(z, 4.0, 0.0) == pytest.approx(3.0, rel=0.03)
    normal = np.random.default_rng(5).normal(size=20_000)
    spoilt = np.where(np.arange(20_000) % 50 == 0, 1000.0, normal)
    assert student_scale(spoilt, 4.0, 0.0) / student_scale(normal, 4.0, 0.0) < 1.08
    assert student_scale(np.zeros(10), 4.0, 0.0) == 0.0


@pytest.mark.parametrize(
    ("keywords", "words"),
    [
        ({"distribution": "cauchy"}, r"distribution 'cauchy' given; it must be \"normal\" or \"student\""),
        ({"degrees": 2}, "degrees 2 given; it must be a number greater than 2"),
        ({"order": -1}, "order -1 given; it must be a whole number from 0 to 20"),
        ({"order": True}, "order True given"),
    ],
)
def test_noise_that_is_none_is_refused(keywords, words):
    with pytest.raises(ValueError, match=words):
        NoiseModel(**keywords)
