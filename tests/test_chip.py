"""Chip thickness against exact tooth paths."""

import jax.numpy as jnp
import numpy as np
import pytest
from oracles import exact_thickness

from millax._chip import Angles, Commanded, Earlier, paths, thickness

RADIUS, SPEED, TEETH, FEED = 0.01, 10000 * 2 * np.pi / 60, 4, 4 / 60
TAU = 2 * np.pi / (SPEED * TEETH)


def model_thickness(motion, velocity, t, tooth, passes):
    phi = SPEED * t + 2 * np.pi * tooth / TEETH
    angles = Angles(jnp.array([[np.cos(phi)]]), jnp.array([[np.sin(phi)]]))
    times = [t - k * TAU for k in range(1, passes + 1)]
    earlier = Earlier(
        jnp.array([motion(s) for s in times])[:, :, None],
        jnp.array([velocity(s) for s in times])[:, :, None],
        Commanded(*map(jnp.asarray, (FEED * TAU, FEED, SPEED * RADIUS, RADIUS))),
    )
    gap, _ = thickness(paths(angles, earlier, jnp.array(motion(t))[:, None]), jnp.asarray(0.0), 1e-6)
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


def least(passes, width=0.0, step=0.02):
    gap, rate = thickness(tuple((jnp.asarray(gap), jnp.asarray(rate)) for gap, rate in passes), jnp.asarray(width), step)
    return float(gap), float(rate)


def mean_cut(gap, rate, step):
    """Mean positive part of a thickness that changes steadily in a step, by sampling it."""
    return np.maximum(gap + rate * step * (np.linspace(0, 1, 2001) - 0.5), 0).mean()


@pytest.mark.parametrize("turned", [False, True])
def test_the_pass_that_leaves_the_least_in_the_step(turned):
    # In the middle of the step the first pass is out of contact, but over the step it leaves more than the second.
    steep, flat, step = (-0.1e-6, 100e-6), (0.1e-6, 5e-6), 0.02
    assert mean_cut(*flat, step) < mean_cut(*steep, step)
    assert least([flat, steep] if turned else [steep, flat], step=step) == pytest.approx(flat)


def test_of_two_passes_in_full_contact_the_nearer_counts():
    assert least([(5e-6, 1e-5), (4e-6, -3e-5), (6e-6, 0.0)]) == pytest.approx((4e-6, -3e-5))


def test_a_pass_out_of_contact_all_over_the_step_is_preferred_to_any_in_contact():
    rng = np.random.default_rng(3)
    for _ in range(50):
        out = (-rng.uniform(1.01e-6, 5e-6), 1e-4)  # changes by 1e-6 to either side
        others = [(rng.uniform(-0.9e-6, 3e-6), rng.choice([-1, 1]) * 1e-4) for _ in range(2)]
        passes = [out, *others]
        assert least([passes[i] for i in rng.permutation(3)]) == pytest.approx(out)


def test_the_choice_between_two_passes_is_smooth():
    # Blended where they differ by less than width/4, so that the thickness has no jump where they change places.
    width = 1e-6
    moved = np.linspace(-0.5e-6, 0.5e-6, 2001)
    found = np.array([least([(3e-6, 0.0), (3e-6 + d, 1e-6)], width) for d in moved])
    assert least([(3e-6, 0.0), (3e-6, 1e-6)], width) == pytest.approx((3e-6, 0.5e-6))
    clear = np.abs(moved) > width / 4
    assert np.allclose(found[clear, 0], np.minimum(3e-6, 3e-6 + moved[clear]), atol=1e-15)
    assert np.abs(np.diff(found[:, 1])).max() < 5e-9
    assert np.abs(np.diff(found[:, 0])).max() < 2e-9
