"""Chip thickness against exact tooth paths."""

import jax.numpy as jnp
import numpy as np
import pytest
from oracles import exact_thickness

from millax._chip import Angles, past_surfaces, thickness

RADIUS, SPEED, TEETH, FEED = 0.01, 10000 * 2 * np.pi / 60, 4, 4 / 60
TAU = 2 * np.pi / (SPEED * TEETH)


def model_thickness(motion, velocity, t, tooth, passes):
    phi = SPEED * t + 2 * np.pi * tooth / TEETH
    angles = Angles(jnp.array([[np.cos(phi)]]), jnp.array([[np.sin(phi)]]))
    earlier = [t - k * TAU for k in range(1, passes + 1)]
    past = past_surfaces(
        angles,
        jnp.array([motion(s) for s in earlier])[:, :, None],
        jnp.array([velocity(s) for s in earlier])[:, :, None],
        jnp.asarray(FEED * TAU),
        jnp.asarray(FEED),
        jnp.asarray(SPEED * RADIUS),
    )
    gap, _ = thickness(angles, past, jnp.array(motion(t))[:, None], jnp.asarray(RADIUS), jnp.asarray(0.0), 1e-6)
    return float(gap[0, 0])


@pytest.mark.parametrize(
    ("amplitude", "frequency", "passes", "tolerance"),
    [(0.0, 1.0, 1, 8e-9), (5e-6, 37.0, 3, 2e-8), (3e-5, 900.0, 3, 6e-7)],
    ids=["rigid", "slow", "chatter"],
)
def test_second_order_thickness_against_exact_paths(amplitude, frequency, passes, tolerance):
    omega = 2 * np.pi * frequency

    def motion(t):
        return np.array([amplitude * np.sin(omega * t), 0.7 * amplitude * np.cos(1.3 * omega * t)])

    def velocity(t):
        return np.array([amplitude * omega * np.cos(omega * t), -0.91 * amplitude * omega * np.sin(1.3 * omega * t)])

    def position(t):
        return motion(t) + np.array([FEED * t, 0.0])

    worst = 0.0
    for tooth in range(TEETH):
        for t in np.linspace(0.1003, 0.1003 + TAU, 17):
            exact = exact_thickness(position, RADIUS, SPEED, TEETH, t, tooth, passes, TAU)
            if exact > 0:
                worst = max(worst, abs(model_thickness(motion, velocity, t, tooth, passes) - exact))
    assert 0 < worst < tolerance


def test_a_pass_out_of_reach_is_skipped():
    def still(_):
        return np.zeros(2)

    now = 60 * TAU  # a tooth points along the feed: the displacement across it is along y

    def far(t):
        return np.array([0.0, 2 * RADIUS]) if t < now - 1.5 * TAU else np.zeros(2)

    near = model_thickness(still, still, now, 0, 1)
    assert near > 0
    assert model_thickness(far, still, now, 0, 2) == pytest.approx(near, rel=1e-12)
