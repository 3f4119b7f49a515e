"""The stock: the border of a radial immersion, its derivatives and its forces, and where a tool overlaps a stock."""

import math

import jax
import numpy as np
import pytest
from cases import slot

import millax as mx
from millax._stock import passage

TOOL = mx.EndMill(0.02, 4)


@pytest.mark.parametrize("milling", ["up", "down"])
def test_the_border_moves_with_immersion_diameter_and_axis(milling):
    def offset(diameter, immersion, axis_y):
        return mx.Stock.immersed(mx.EndMill(diameter, 4), immersion, milling, axis_y=axis_y).offsets[1]

    slopes = jax.jit(jax.grad(offset, argnums=(0, 1, 2)))(0.02, 0.005, 0.003)
    np.testing.assert_allclose(slopes, [-0.5, 1.0, 1.0 if milling == "down" else -1.0])


@pytest.mark.parametrize(("milling", "begin", "end"), [("up", -90, -30), ("down", 30, 90)])
def test_teeth_cut_where_the_immersion_lets_them(milling, begin, end):
    # a_e = R/2: a tip is inside for abs(sin phi) > 1/2.
    stock = mx.Stock.immersed(TOOL, 0.005, milling, x=(None, None))
    case = slot(axes=(), stock=stock, duration=0.006, steps_per_tooth=90)
    tooth = np.asarray(mx.simulate(case).chip_thickness)[:, 0]
    phi = np.arange(len(tooth)) + 0.5  # a degree per step
    phi = (phi + 180) % 360 - 180
    feed = 1e-4 * np.cos(np.deg2rad(phi))
    inside = (phi > begin + 1) & (phi < end - 1)
    np.testing.assert_allclose(tooth[inside], feed[inside], rtol=0.02, atol=1e-6)
    assert (tooth[(phi < begin - 1) | (phi > end + 1)] < 1e-9).all()


@pytest.mark.parametrize(("milling", "side"), [("up", "left"), ("down", "right")])
def test_the_stock_goes_on_beyond_the_tool_where_the_wall_is_left(milling, side):
    case = slot(stock=mx.Stock.immersed(TOOL, 0.005, milling), start=(0.0, 0.0))
    assert mx.walls(case) == (side,)


@pytest.mark.parametrize("immersion", [0.0, -1e-3, 0.021, math.nan])
def test_an_immersion_out_of_range(immersion):
    with pytest.raises(ValueError, match=r"stock\.immersion: .* mm given; .* at most tool\.diameter, 20 mm"):
        mx.Stock.immersed(TOOL, immersion, "up")


@pytest.mark.parametrize(("milling", "words"), [(None, "none given"), ("left", "'left' given")])
def test_a_side_that_is_none(milling, words):
    with pytest.raises(ValueError, match=rf'stock\.milling: {words}; .* "up" .* or "down"'):
        mx.Stock.immersed(TOOL, 0.005, milling)


OBLIQUE = mx.Stock([[-0.6, -0.8]], [0.0])  # beyond a line through the origin

PASSAGES = {
    "endless": (mx.Stock.box((None, None)), 0.0, (-math.inf, math.inf)),
    "beyond a border": (mx.Stock.box(), 0.0, (-1.0, math.inf)),
    "a rectangle": (mx.Stock.box((2.0, 5.0), (-3.0, 3.0)), 1.0, (1.0, 6.0)),
    "a narrow one": (mx.Stock.box((2.0, 5.0), (-1e-9, 1e-9)), 0.0, (1.0, 6.0)),
    "its corners": (mx.Stock.box((2.0, 5.0), (0.6, 3.0)), 0.0, (2.0 - 0.8, 5.0 + 0.8)),
    "an oblique border": (OBLIQUE, 0.0, (-1 / 0.6, math.inf)),
    "the corner of a wedge": (mx.Stock([[-0.6, -0.8], [-0.6, 0.8]], [-1.2, -1.2]), 0.0, (1.0, math.inf)),
    "beside": (mx.Stock.box((None, None), (1.5, 3.0)), 0.0, None),
    "touching": (mx.Stock.box((None, None), (1.0, 3.0)), 0.0, None),
    "beside a wedge": (mx.Stock([[-0.6, -0.8], [0.6, -0.8]], [-1.2, -1.2]), 0.0, None),
    "empty": (mx.Stock([[1.0, 0.0], [-1.0, 0.0]], [0.0, -1.0]), 0.0, None),
}


@pytest.mark.parametrize(("stock", "y", "expected"), PASSAGES.values(), ids=PASSAGES.keys())
def test_where_a_disc_of_radius_1_overlaps_a_stock(stock, y, expected):
    found = passage(stock, y, 1.0)
    assert found == (None if expected is None else pytest.approx(expected))


def test_the_passage_of_a_disc_by_any_stock():
    rng = np.random.default_rng(3)
    for _ in range(100):
        angles, offsets = rng.uniform(0, 2 * np.pi, 3), rng.uniform(-0.5, 1, 3)
        normals = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        # A grid of heights in place of the candidates among which `passage` looks.
        d = np.linspace(-1, 1, 20001)[:, None]
        x = (offsets - normals[:, 1] * d) / normals[:, 0]
        low = np.max(x, axis=1, where=normals[:, 0] < 0, initial=-np.inf)
        high = np.min(x, axis=1, where=normals[:, 0] > 0, initial=np.inf)
        w = np.sqrt(1 - d[:, 0] ** 2)[low < high]
        expected = ((low[low < high] - w).min(), (high[low < high] + w).max()) if w.size else None
        assert passage(mx.Stock(normals, offsets), 0.0, 1.0) == (expected and pytest.approx(expected, abs=2e-3))
