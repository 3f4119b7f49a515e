"""The mean force of a step: its slope by what a tooth meets has no jumps, so that fits do not come to rest at one."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import millax as mx
from millax._chip import thickness
from millax._contact import fully_inside

STEP, WIDTH = 2 * np.pi / 128, 1e-6

KT, KE = 8e8, 2e4

LAW = mx.LinearLaw(kt=KT, kr=0.3, ke=KE, ka=0.1, kre=3e4, kae=1e4)


def tangential(gap, rate):
    return fully_inside(LAW, gap, rate, STEP, WIDTH).tangential


def engaged(gap, rate):
    return fully_inside(LAW, gap, rate, STEP, WIDTH).engaged


def of_passes(gap, rate):
    """Force where other passes leave about as much, one of them as a tooth begins to cut."""
    others = [(jnp.full_like(gap, g), jnp.full_like(gap, r)) for g, r in ((1e-6, 8e-5), (4e-6, -2e-5))]
    return tangential(*thickness(((gap, rate), *others), WIDTH, STEP))


def jump(of, rate, points):
    """Largest change of the slope between neighbouring points, over the largest slope."""
    gap = jnp.linspace(-8e-6, 12e-6, points)
    slope = np.asarray(jax.grad(lambda gap: jnp.sum(of(gap, jnp.full_like(gap, rate))))(gap))
    return np.abs(np.diff(slope)).max() / np.abs(slope).max()


@pytest.mark.parametrize("rate", [0.0, 3e-6, 9e-5])
@pytest.mark.parametrize("of", [tangential, engaged, of_passes])
def test_slopes_have_no_jumps(of, rate):
    # Of a slope that is continuous, four times as many points leave a quarter of it.
    coarse, fine = jump(of, rate, 8_001), jump(of, rate, 32_001)
    assert 0 < fine < 0.3 * coarse < 0.03


@pytest.mark.parametrize("width", [0.0, WIDTH])
@pytest.mark.parametrize("rate", [0.0, 2e-5, 9e-5])
def test_a_crossing_keeps_its_impulse(rate, width):
    # Over all places at which contact may begin: half of them are cut, and the thickness is that of the hard model. The step
    # adds a²/6 to its integral, the width less than w²/6.
    gap, change = jnp.linspace(-1e-5, 1e-5, 200_001), rate * STEP / 2
    met = fully_inside(LAW, gap, jnp.full_like(gap, rate), STEP, width)
    engaged = met.engaged
    assert engaged is not None
    assert float(jnp.mean(engaged)) == pytest.approx(0.5, abs=1e-5)
    thickness = float(jnp.mean(met.thickness))
    assert thickness == pytest.approx(0.25e-5 + change**2 / 6 / 2e-5, rel=1e-4, abs=width**2 / 6 / 2e-5)
    force = KT * met.thickness + KE * engaged
    assert np.allclose(met.tangential, force, rtol=1e-9, atol=1e-9 * float(jnp.max(force)))
