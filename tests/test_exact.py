"""Exact paths of general cutters against closed forms and the papers' grid, and the engine against exact paths."""

import numpy as np
import pytest
from oracles import exact_thickness

import millax as mx
from benchmarks import exact, grid
from benchmarks.exact import Cutter, law_of, linear, motion
from benchmarks.slot import FEED, SPEED, down_milling, slot, strong_chatter, up_milling

RADIUS, TEETH = 0.01, 4
TAU = 2 * np.pi / (SPEED * TEETH)
FEED_PER_TOOTH = FEED * TAU
SECOND_ORDER = FEED_PER_TOOTH**2 / RADIUS
"""What first-order closed forms of the chip thickness lack, per pass [m]: 1 um."""
ENDLESS = mx.Stock.box((None, None))
STRAIGHT = motion((0.0, 0.0), FEED)


def rms(values):
    return np.sqrt((np.asarray(values) ** 2).mean())


def thicknesses(cutter, phi, *, position=STRAIGHT, stock=ENDLESS, passes=8, level=0):
    """h of every tooth when it stands at `phi`, half a second and a turn after the start: shape (teeth, angles)."""
    tooth, phi = np.meshgrid(np.arange(cutter.teeth), np.asarray(phi), indexing="ij")
    t = 2 * np.pi * 84 / SPEED + (phi - cutter.angle(0.0, level, tooth)) / SPEED
    rays = t.ravel(), np.full(t.size, level), tooth.ravel()
    return exact.thickness(cutter, position, stock, *rays, passes).reshape(t.shape)


def vibrating(amplitude, frequency):
    """A tool that trembles in both directions, and came in without."""

    def position(t):
        t = np.asarray(t)
        phase, swell = 2 * np.pi * frequency * t, amplitude * np.maximum(t, 0.0) / (0.004 + np.maximum(t, 0.0))
        return np.array([-RADIUS / 2 + FEED * t + swell * np.sin(phase), 0.7 * swell * np.cos(1.3 * phase)])

    return position


@pytest.mark.parametrize("amplitude", [0.0, 5e-5])
def test_crossings_against_a_bracketing_solver(amplitude):
    position, cutter = vibrating(amplitude, 900.0), Cutter.end_mill(RADIUS, TEETH, SPEED, 1e-3)
    rng = np.random.default_rng(1)
    t, tooth = rng.uniform(0.02, 0.03, 40), rng.integers(TEETH, size=40)
    found = exact.thickness(cutter, position, ENDLESS, t, np.zeros_like(tooth), tooth, passes=5)
    pairs = zip(t, tooth, strict=True)
    expected = [max(0.0, exact_thickness(position, RADIUS, SPEED, TEETH, s, i, 5, TAU)) for s, i in pairs]
    assert 0.3 < (found > 0).mean() < 0.9
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)


def test_a_pass_out_of_reach_is_skipped():
    now = 84 * 2 * np.pi / SPEED  # tooth 0 points along the feed

    def position(t):
        return np.array([FEED * t, np.where(t < now - 1.5 * TAU, 2.5 * RADIUS, 0.0)])

    ray = Cutter.end_mill(RADIUS, TEETH, SPEED, 1e-3), position, ENDLESS, np.array([now]), np.array([0]), np.array([0])
    one, all_passes = (exact.thickness(*ray, passes)[0] for passes in (1, 6))
    assert one == all_passes == pytest.approx(FEED_PER_TOOTH, rel=1e-3)


def test_a_slot_is_feed_times_cosine_to_second_order():
    phi = np.linspace(-1.4, 1.4, 15)
    cutter = Cutter.end_mill(RADIUS, TEETH, SPEED, 1e-3)
    errors = []
    for factor in (1.0, 0.5):
        h = thicknesses(cutter, phi, position=motion((0.0, 0.0), factor * FEED))
        np.testing.assert_allclose(h, h[:1].repeat(TEETH, axis=0), atol=1e-14)
        errors.append(np.abs(h - factor * FEED_PER_TOOTH * np.cos(phi)).max())
    assert 0.1 * SECOND_ORDER < errors[0] < SECOND_ORDER
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.02)


@pytest.mark.parametrize("deviation", [2e-5, -2e-5, 1.5e-4])
def test_one_tooth_that_stands_out(deviation):
    # Tooth 0 meets so much more, and tooth 3, which follows it, so much less; what that leaves, tooth 2 meets.
    phi = np.linspace(-1.2, 1.2, 13)
    cutter = Cutter.end_mill(RADIUS, TEETH, SPEED, 1e-3, runout=[deviation, 0, 0, 0])
    cos = FEED_PER_TOOTH * np.cos(phi)
    # The tooth that cut k passes before tooth i is i + k; where that is tooth 0, it left so much less.
    left = [
        [k * cos + (deviation if i == 0 else 0.0) - (deviation if (i + k) % TEETH == 0 else 0.0) for k in range(1, 5)]
        for i in range(TEETH)
    ]
    expected, passes = np.maximum(0.0, np.min(left, axis=1)), np.argmin(left, axis=1) + 1
    found = thicknesses(cutter, phi)
    assert (np.abs(found - expected) < passes**2 * SECOND_ORDER).all()
    assert (found[3] == 0).any() == (deviation > FEED_PER_TOOTH)


def test_runout_needs_as_many_passes_as_there_are_teeth():
    # What stands out most has left the surface that the next three meet, and meets its own a turn later.
    phi, cutter = np.linspace(-1.2, 1.2, 13), Cutter.end_mill(RADIUS, TEETH, SPEED, 1e-3, runout=[4e-4, 0.0, 0.0, 0.0])
    one_less, a_turn, more = (thicknesses(cutter, phi, passes=passes) for passes in (TEETH - 1, TEETH, 8))
    np.testing.assert_array_equal(a_turn, more)
    assert (one_less[0] > a_turn[0] + 1e-5).all()


def test_variable_pitch_gives_each_tooth_its_own_feed():
    pitch = np.radians([70.0, 100.0, 85.0, 105.0])
    phi = np.linspace(-1.2, 1.2, 13)
    found = thicknesses(Cutter.end_mill(RADIUS, TEETH, SPEED, 1e-3, pitch=pitch), phi)
    np.testing.assert_allclose(found, FEED / SPEED * np.outer(pitch, np.cos(phi)), rtol=0, atol=2 * SECOND_ORDER)


def test_entry_into_a_border():
    cutter, phi = Cutter.end_mill(RADIUS, TEETH, SPEED, 1e-3), np.linspace(-0.4, 0.4, 9)
    for past in (1e-6, 2e-5, 6e-5, 3e-4):
        # The tool touches the border when a tooth points along the feed: every tooth is then `past` it by its own time.
        begin = motion((-RADIUS - FEED * 2 * np.pi * 84 / SPEED + past, 0.0), FEED)
        d = past - RADIUS * (1 - np.cos(phi)) + FEED * (phi - np.pi / 2 * np.arange(TEETH)[:, None]) / SPEED
        expected = np.maximum(0.0, np.minimum(FEED_PER_TOOTH * np.cos(phi), d / np.cos(phi)))
        found = thicknesses(cutter, phi, position=begin, stock=mx.Stock.box())
        full = expected == FEED_PER_TOOTH * np.cos(phi)
        np.testing.assert_allclose(found[~full], expected[~full], rtol=0, atol=1e-14)
        np.testing.assert_allclose(found[full], expected[full], rtol=0, atol=SECOND_ORDER)
        assert found.any()


def test_a_slice_of_a_helix_is_a_straight_cutter_that_lags():
    phi, helix = np.linspace(-1.3, 1.3, 9), np.radians(35)
    cutter = Cutter.end_mill(RADIUS, TEETH, SPEED, 6e-3, slices=3, helix=helix)
    np.testing.assert_allclose(cutter.z, [1e-3, 3e-3, 5e-3])
    straight = thicknesses(Cutter.end_mill(RADIUS, TEETH, SPEED, 6e-3), phi)
    for level, z in enumerate(cutter.z):
        assert cutter.angle(0.0, level, 2) == pytest.approx(np.pi - z * np.tan(helix) / RADIUS)
        np.testing.assert_allclose(thicknesses(cutter, phi, level=level), straight, rtol=0, atol=1e-14)


@pytest.mark.parametrize("helix", [0.0, np.radians(30)])
def test_mean_edge_and_axial_forces_of_a_slot(helix):
    kt, kr, ka, kte, kre, kae, depth = 8e8, 0.3, 0.2, 2e4, 3e4, 1e4, 2e-3
    cutter = Cutter.end_mill(RADIUS, TEETH, SPEED, depth, slices=2, helix=helix)
    steps = 4 * 40
    dt = 2 * np.pi / SPEED / steps
    time = 0.1 + (np.arange(steps) + 0.5) * dt
    found = exact.cut_along(cutter, STRAIGHT, ENDLESS, linear(kt, kr, ka, kte, kre, kae), time, dt, passes=2)
    each = TEETH * depth / (2 * np.pi)
    chip = kt * FEED_PER_TOOTH
    # Of h = f cos phi + (f sin phi)²/(2 R): contact begins f/(2 R) before a quarter turn and lasts as much longer.
    x, y = -(kr * chip * np.pi / 2 + 2 * kre), chip * np.pi / 2 + 2 * kte
    more = FEED_PER_TOOTH / RADIUS
    z = ka * chip * (2 + np.pi / 4 * more) + kae * (np.pi + more)
    mean = found.force.mean(axis=0)
    np.testing.assert_allclose(mean[:2], [each * x, each * y], rtol=3e-3)
    assert mean[2] == pytest.approx(each * z, rel=1e-4)
    assert found.thickness.mean() == pytest.approx(FEED_PER_TOOTH / np.pi * (1 + np.pi / 8 * more), rel=1e-4)


def test_parts_of_a_step_leave_the_error_that_they_are_said_to():
    # Down-milling with edge forces: a jump as a tooth enters, and one as it leaves.
    cutter, dt = Cutter.end_mill(RADIUS, TEETH, SPEED, 1e-3), TAU / 40
    stock, law = mx.Stock.box((None, None), (None, 0.0)), linear(8e8, 0.3, kte=2e4)
    time = 0.01 + (np.arange(160) + 0.37) * dt
    fine = exact.cut_along(cutter, STRAIGHT, stock, law, time, dt, passes=2, parts=64).force
    for parts in (8, 16):
        error = np.abs(exact.cut_along(cutter, STRAIGHT, stock, law, time, dt, passes=2, parts=parts).force - fine)
        jump = 1e-3 * (8e8 * FEED_PER_TOOTH + 2e4)
        assert error.max() < 1.1 * jump / (2 * parts**2)


CUTTERS = {
    "even": {},
    "runout": {"runout": [3e-5, 0.0, -2e-5, 1e-5]},
    "pitch": {"pitch": np.radians([70.0, 100.0, 85.0, 105.0])},
    "all": {
        "slices": 2,
        "helix": np.radians(30),
        "pitch": np.radians([80.0, 100.0, 80.0, 100.0]),
        "runout": [[2e-5, 0.0, -2e-5, 0.0], [0.0, 2e-5, 0.0, -2e-5]],
    },
}


@pytest.mark.parametrize("name", CUTTERS)
@pytest.mark.parametrize("stock", [ENDLESS, mx.Stock.box((0.0, None), (None, 0.002))], ids=["slot", "corner"])
def test_exact_paths_against_the_grid(name, stock):
    # Trembling by 30 um at 400 Hz: teeth lose contact now and then, runout makes them do so all the time.
    cutter = Cutter.end_mill(RADIUS, TEETH, SPEED, 4e-3, **CUTTERS[name])
    dt, spacing = TAU / 40, 10e-6
    time = (np.arange(6 * 40) + 0.5) * dt
    cut = cutter, vibrating(3e-5, 400.0), stock, linear(8e8, 0.3, 0.2, 2e4, 1e4, 5e3), time, dt
    ours, nodes = exact.cut_along(*cut, passes=12), grid.cut_along(*cut, spacing=spacing, finer=2, early=160)
    assert (ours.thickness.mean(axis=0) > 1e-6).all()
    assert abs(ours.thickness.mean() - nodes.thickness.mean()) < 3e-8
    assert rms(ours.thickness - nodes.thickness) < 0.02 * rms(ours.thickness)
    assert rms(ours.force - nodes.force) < 0.03 * rms(ours.force)


def test_the_thickness_of_the_papers_is_less_by_its_square():
    case = slot(duration=0.009, border=False, axes=())
    dt = TAU / 40
    time = (np.arange(case.settings.steps) + 0.5) * dt
    h = exact.cut_along(Cutter.of(case), motion(case.cut.start, FEED), ENDLESS, law_of(case), time, dt, passes=2).thickness
    papers = grid.simulate(case, 5e-6).thickness
    settled = slice(160, None)  # the first teeth meet a circle instead of the path of a tooth
    assert abs((papers - (h - h**2 / (2 * RADIUS)))[settled].mean()) < 0.02e-6
    assert abs((papers - h)[settled].mean()) > 0.03e-6


ENGINE = {
    "entry into a slot": (slot, 1e-3),
    "half immersion, up": (up_milling, 1e-3),
    "half immersion, down": (down_milling, 1e-3),
    "strong chatter": (strong_chatter, 1e-2),
}


@pytest.mark.parametrize("name", ENGINE)
def test_the_engine_against_exact_paths(name):
    build, limit = ENGINE[name]
    case = build(duration=0.06, passes=8)
    sim = mx.simulate(case)
    found = exact.cut_along(*exact.followed(case, sim), passes=8)
    assert rms(sim.force - found.force) < limit * rms(found.force)
    assert rms(sim.chip_thickness - found.thickness) < 2 * limit * rms(found.thickness)


def test_a_swing_wider_than_the_feed_meets_what_was_cut_many_passes_ago():
    # The path of the centre is more curved than the tool, v²/(omega² A) = 0.7 mm: a tooth meets the wall that it left on
    # the way there, and few passes find chips where nothing is left.
    def position(t):
        return np.array([FEED * t, 4e-4 * (1 - np.cos(2 * np.pi * 20 * np.maximum(t, 0.0)))])

    dt = TAU / 40
    time = (np.arange(15 * 40) + 0.5) * dt
    cut = Cutter.end_mill(RADIUS, TEETH, SPEED, 1e-3), position, ENDLESS, linear(8e8, 0.3), time, dt
    nodes = grid.cut_along(*cut, spacing=10e-6, finer=1, early=160).force
    few, many = (rms(exact.cut_along(*cut, passes=passes).force - nodes) / rms(nodes) for passes in (8, 32))
    assert few > 0.05
    assert many < 0.01
