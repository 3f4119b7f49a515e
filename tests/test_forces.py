import dataclasses

import jax
import numpy as np
import pytest
from scipy.integrate import quad

import millax as mx
from millax._forces import work

LAWS = {
    "linear": mx.LinearLaw(kt=8e8, kr=0.3, ke=1.2e4),
    "exponential": mx.ExponentialLaw(kf=3e6, m=0.7, kr=0.3),
    "fractional": mx.FractionalLaw(k0=5e9, hs=18e-6, r=0.1, kr=0.3),
    "exponential with an edge": mx.ExponentialLaw(kf=3e6, m=0.7, kr=0.3, ke=1.2e4),
    "fractional with an edge": mx.FractionalLaw(k0=5e9, hs=18e-6, r=0.1, kr=0.3, ke=1.2e4),
}


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS.keys())
@pytest.mark.parametrize(("low", "high"), [(0.0, 1e-4), (2e-5, 2.1e-5), (0.0, 1e-9), (3e-5, 3e-5)])
def test_work_is_the_integral_of_the_force(law, low, high):
    expected, _ = quad(lambda h: float(law.tangential(h)), low, high, epsabs=0, epsrel=1e-12)
    assert float(law.work(low, high)) == pytest.approx(expected, rel=1e-9, abs=1e-20)


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS.keys())
@pytest.mark.parametrize(("low", "high"), [(1e-5, 1e-4), (2e-5, 2.1e-5), (0.0, 4e-5)])
def test_the_derivative_of_the_work_by_its_limits_is_the_force(law, low, high):
    by_low, by_high = jax.grad(lambda low, high: work(law, low, high), argnums=(0, 1))(low, high)
    assert float(by_low) == -float(law.tangential(low))
    assert float(by_high) == float(law.tangential(high))

    def difference(integral, limit):
        step = 1e-4 * limit
        return float(integral(limit + step) - integral(limit - step)) / (2 * step)

    assert difference(lambda h: law.work(low, h), high) == pytest.approx(float(by_high), rel=1e-7)
    if low:
        assert difference(lambda h: law.work(h, high), low) == pytest.approx(float(by_low), rel=1e-7)


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS.keys())
def test_the_derivative_of_the_work_by_the_law_is_that_of_its_integral(law):
    low, high = 1e-5, 6e-5
    gradient = jax.grad(lambda law: work(law, low, high))(law)
    expected = jax.grad(lambda law: law.work(low, high))(law)
    for ours, theirs in zip(jax.tree.leaves(gradient), jax.tree.leaves(expected), strict=True):
        assert float(ours) == pytest.approx(float(theirs), rel=1e-12)
    everything = jax.jvp(lambda *at: work(*at), (law, low, high), (law, 1.0, 2.0))[1]
    integral = jax.jvp(lambda *at: type(law).work(*at), (law, low, high), (law, 1.0, 2.0))[1]
    assert float(everything) == pytest.approx(float(integral), rel=1e-9)


def test_fractional_slopes_are_the_ones_that_define_it():
    law = LAWS["fractional"]
    slope = jax.grad(law.tangential)
    assert float(slope(1e-12)) == pytest.approx(5e9, rel=1e-6)
    assert float(slope(1.0)) == pytest.approx(0.1 * 5e9, rel=1e-6)


def test_published_formulas():
    h = 5e-5
    assert float(LAWS["linear"].tangential(h)) == pytest.approx(8e8 * h + 1.2e4)
    assert float(LAWS["exponential"].tangential(h)) == pytest.approx(3e6 * h**0.7)
    u = h / 18e-6
    assert float(LAWS["fractional"].tangential(h)) == pytest.approx(5e9 * 18e-6 * (u + 0.1 * u**2) / (1 + u))


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS.keys())
def test_gradients_of_the_work_are_finite_out_of_contact(law):
    for low, high in ((0.0, 0.0), (0.0, 1e-6)):
        gradient = jax.grad(lambda leaves, low, high: leaves.work(low, high), argnums=(0, 1, 2))(law, low, high)
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: mx.LinearLaw(kt=-1.0, kr=0.3), "force.kt: -1 N/m^2 given; it must be greater than 0"),
        (lambda: mx.LinearLaw(kt=1.0, kr=0.3, ke=-2.0), "force.ke: -2 N/m given"),
        (lambda: mx.ExponentialLaw(kf=1.0, m=0.0, kr=0.3), "force.m: 0 given"),
        (lambda: mx.FractionalLaw(5e9, 0.0, 0.1, 0.3), "force.hs: 0 m given"),
        (lambda: mx.FractionalLaw(5e9, 18e-6, 0.1, float("nan")), "force.kr: nan given; it must be a finite number"),
    ],
)
def test_bad_coefficients_are_named(make, message):
    with pytest.raises(ValueError, match=message.replace("^", r"\^")):
        make()


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS.keys())
def test_edges_of_every_law(law):
    assert law.own_edges is None
    ke, kre, kae = law.edges
    assert float(kre) == pytest.approx(0.3 * float(ke))
    assert float(kae) == 0
    own = dataclasses.replace(law, ka=0.2, kre=2e4, kae=-1e3)
    # F_r = k_r (F_t - k_E) + k_rE, and the same of F_a.
    assert [float(x) for x in own.own_edges] == pytest.approx([2e4 - 0.3 * float(ke), -1e3 - 0.2 * float(ke)])
    with pytest.raises(ValueError, match=r"force.kae: given without force.ka"):
        dataclasses.replace(law, kae=1e3)
