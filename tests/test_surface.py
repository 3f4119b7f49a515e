"""Walls against closed forms, and against tooth paths sampled densely; the phases of an entry."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import ENDLESS, RPM, slot
from scipy.interpolate import CubicSpline

import millax as mx
from benchmarks.location_error import MODE, TOOL, location_error
from millax.plots import plot_wall

FEED, RADIUS, TEETH = 1e-4, 0.01, 4
SIGN = {"left": 1, "right": -1}
BOTH = pytest.mark.parametrize("side", SIGN)


def rigid(**numbers) -> mx.Case:
    """The papers' slot without borders, rigid. A step is 2.4 mm of the path of a tip: 24 feeds per tooth."""
    return slot(axes=(), **({"stock": ENDLESS, "start": (0.0, 0.0), "duration": 0.06, "steps_per_tooth": 10} | numbers))


def moved(case: mx.Case, x=0.0, y=0.0) -> mx.Simulation:
    """What a simulation of `case` would be if the tool moved so; nothing is cut."""
    steps, teeth = case.settings.steps, case.tool.teeth
    dt = case.cut.tooth_period(case.tool) / case.settings.steps_per_tooth
    return mx.Simulation(
        time=(jnp.arange(steps) + 0.5) * dt,
        force=jnp.zeros((steps, 3)),
        displacement=jnp.stack([jnp.broadcast_to(motion, steps) for motion in (x, y)], axis=1),
        chip_thickness=jnp.zeros((steps, teeth)),
        residual=jnp.zeros(()),
        status=jnp.zeros((), int),
        axes=("x", "y"),
    )


def middle(points: int = 1001) -> np.ndarray:
    """Ten feeds per tooth in the middle of the cut."""
    return np.linspace(1e-3, 2e-3, points)


@BOTH
def test_feed_marks_of_a_rigid_tool_are_those_of_martellotti(side):
    case = rigid()
    wall = mx.wall_profile(case, moved(case), side, middle())
    height = FEED**2 / (8 * RADIUS * (1 + SIGN[side] * FEED * TEETH / (2 * np.pi * RADIUS)) ** 2)
    deviation = np.asarray(wall.deviation)
    assert deviation.max() - deviation.min() == pytest.approx(height, rel=1e-4)
    assert deviation.max() == pytest.approx(FEED**2 / (8 * RADIUS), rel=0.02)
    assert deviation.min() == pytest.approx(0, abs=1e-6 * height)
    assert mx.form_error(wall, (1e-3, 2e-3)) == pytest.approx(height / 3, rel=2e-3)


@BOTH
def test_a_tool_that_stands_aside_leaves_a_wall_that_stands_aside(side):
    case, x = rigid(), middle()
    still, shifted = moved(case), moved(case, 2e-5, 3e-6)
    expected = mx.wall_profile(case, still, side, x - 2e-5).y + 3e-6
    np.testing.assert_allclose(mx.wall_profile(case, shifted, side, x).y, expected, atol=1e-13)


@BOTH
@pytest.mark.parametrize("phase", [0.0, 1.0, 3.0])
def test_a_vibration_counts_at_the_instant_at_which_the_tooth_passes(side, phase):
    case = rigid()
    tau = float(case.cut.tooth_period(case.tool))
    vibration = lambda t: 2e-6 * np.cos(2 * np.pi * t / tau + phase)  # noqa: E731
    abreast = (3 if side == "left" else 1) * tau  # four teeth: a quarter of a turn is one period
    vibrating = moved(case, 0.0, vibration(moved(case).time))
    found, still = (mx.form_error(mx.wall_profile(case, sim, side, middle()), (0, 1)) for sim in (vibrating, moved(case)))
    # A feed mark is cut in 0.5 % of the tooth period, in which the vibration goes on by up to 1.6 % of its amplitude.
    assert float(found - still) == pytest.approx(-SIGN[side] * vibration(abreast), abs=0.01 * 2e-6)


def sampled_wall(case: mx.Case, sim: mx.Simulation, side: str, x: np.ndarray) -> np.ndarray:
    """The wall from tooth paths sampled fifty times in a step: every crossing of x, and the farthest of them."""
    tool, cut, time = case.tool, case.cut, np.asarray(sim.time)
    t = np.arange(time[0], time[-1], (time[1] - time[0]) / 50)
    u = CubicSpline(time, np.asarray(sim.displacement))(t)
    farthest = np.full(x.size, -np.inf)
    for tooth in range(tool.teeth):
        phi = float(cut.spindle_speed) * t + 2 * np.pi * tooth / tool.teeth
        px = float(cut.start[0]) + float(cut.feed_rate) * t + u[:, 0] + float(tool.radius) * np.cos(phi)
        py = SIGN[side] * (float(cut.start[1]) + u[:, 1] - float(tool.radius) * np.sin(phi))
        near = np.flatnonzero((py[:-1] > 0.5 * float(tool.radius)) & (px.min() < x.max()))
        for j, at in enumerate(x):
            i = near[(px[near] <= at) != (px[near + 1] <= at)]
            part = (at - px[i]) / (px[i + 1] - px[i])
            farthest[j] = max(farthest[j], np.max(py[i] + part * (py[i + 1] - py[i]), initial=-np.inf))
    return SIGN[side] * farthest


def robot() -> tuple[mx.Case, mx.Simulation]:
    """A soft robot that swings slowly while it enters."""
    case = slot(stiffness=0.05e6, duration=0.25)
    return case, mx.simulate(case)


def vibration() -> tuple[mx.Case, mx.Simulation]:
    """Faster than the teeth, and not in step with them: the wall is left by every third tooth or so."""
    case = slot(axes=(), duration=0.25)
    t = moved(case).time
    return case, moved(case, 3e-5 * jnp.sin(2 * np.pi * 950 * t), 2e-5 * jnp.cos(2 * np.pi * 1130 * t))


@BOTH
@pytest.mark.parametrize("cut", [robot, vibration])
def test_the_wall_is_the_envelope_of_tooth_paths_sampled_densely(side, cut):
    case, sim = cut()
    x = np.linspace(1e-3, 4e-3, 83)
    expected = sampled_wall(case, sim, side, x)
    assert np.ptp(expected) > 5e-6
    # Between the samples a chord lies up to (8 µm)²/(8 R) below the path; a cubic and a spline differ by 2e-9.
    np.testing.assert_allclose(mx.wall_profile(case, sim, side, x).y, expected, atol=1e-8)


def flexible(side: str, rpm: float, *, feed: float = 5e-5, periods: int = 400, stiffness=MODE["stiffness"]) -> mx.Case:
    """Partial immersion, a tool that gives way in y."""
    tool, law = mx.EndMill(2 * TOOL["radius"], TOOL["teeth"]), mx.LinearLaw(kt=TOOL["kt"], kr=TOOL["kr"])
    tau = 2 * np.pi / (rpm * RPM * TOOL["teeth"])
    cut = mx.Cut(rpm * RPM, feed / tau, TOOL["depth"], (0.0, 0.0))
    inner = TOOL["radius"] - TOOL["immersion"]
    stock = mx.Stock.box((None, None), (inner, None) if side == "left" else (None, -inner))
    structure = mx.Structure(("y",), MODE["mass"], stiffness, damping_ratio=MODE["damping_ratio"])
    return mx.Case(tool, law, cut, stock, structure, mx.Settings(periods, 80, passes=1, blocks=4, sweeps=12, width=1e-9))


def closed_form(side: str, rpm: float, feed: float = 5e-5) -> float:
    return location_error(side, speed=rpm * RPM, feed_per_tooth=feed, **TOOL, **MODE)


@BOTH
def test_surface_location_error_of_up_and_down_milling(side):
    speeds = (9000, 13000, 20000, 27000, 30000)
    expected = np.array([closed_form(side, rpm) for rpm in speeds])
    found = []
    for rpm in speeds:
        case = flexible(side, rpm)
        assert mx.walls(case) == (side,)
        found.append(float(mx.form_error(mx.wall_profile(case, mx.simulate(case), side))))
    # The closed form is first order in the feed over the radius: 0.5 % of the motion, which is up to 6 µm.
    np.testing.assert_allclose(found, expected, atol=0.01 * 6e-6)
    # Where the teeth pass as often as the mode swings (27 660 rpm), the error of down-milling changes its sign.
    if side == "right":
        assert found[3] > 4e-6
        assert found[4] < -2e-7


def test_the_derivative_of_the_form_error_by_the_stiffness():
    def error(stiffness):
        case = flexible("right", 13000.0, stiffness=stiffness).with_settings(tolerance=1e-12)
        return mx.form_error(mx.wall_profile(case, mx.simulate(case, throw=False), "right"))

    k = MODE["stiffness"]
    _, slope = jax.jit(lambda k: jax.jvp(error, (k,), (1.0,)))(k)
    values = [float(error(k * factor)) for factor in (1 - 1e-4, 1 + 1e-4)]
    assert float(slope) == pytest.approx((values[1] - values[0]) / (2e-4 * k), rel=1e-4)


def test_derivatives_and_batches_of_motions():
    """In reverse mode and under vmap; what moves the whole tool by 1 moves the wall by 1."""
    case, side = rigid(), "left"
    sim = moved(case, 0.0, 1e-6 * np.sin(900 * np.arange(case.settings.steps)))

    def error(motion):
        return mx.form_error(mx.wall_profile(case, eqx.tree_at(lambda s: s.displacement, sim, motion), side))

    slope = jax.grad(error)(sim.displacement)
    assert float(slope[:, 1].sum()) == pytest.approx(-SIGN[side], rel=1e-9)
    assert np.isfinite(slope).all()
    both = jax.vmap(error)(jnp.stack([sim.displacement, sim.displacement + jnp.array([0.0, 1e-5])]))
    assert float(both[1] - both[0]) == pytest.approx(-SIGN[side] * 1e-5, rel=1e-9)


def test_a_member_of_a_sweep_is_filled_up_with_nan():
    case = rigid()
    sim, steps = moved(case, 1e-6, 2e-6), case.settings.steps
    filled = jax.tree.map(
        lambda v: jnp.concatenate([v, jnp.full((80, *v.shape[1:]), jnp.nan)]) if v.ndim and len(v) == steps else v, sim
    )
    longer = case.with_settings(periods=case.settings.periods + 2)
    expected, found = (mx.wall_profile(c, s, "right", middle()).y for c, s in ((case, sim), (longer, filled)))
    np.testing.assert_array_equal(found, expected)


def test_roughness_of_parabolic_feed_marks():
    x = np.linspace(0, 1, 20001)
    height = 3e-6
    marks = 4 * height * ((10 * x + 0.5) % 1 - 0.5) ** 2
    # On a wall that is neither parallel to the feed nor where it should be.
    wall = mx.Wall(jnp.asarray(x), jnp.asarray(-2 - (marks + 1e-4 * x - 5e-6)), jnp.asarray(-2.0), "left")
    with np.errstate(all="ignore"):
        ra, rq, rz = mx.roughness(wall, (0.0, 1.0))
    assert ra == pytest.approx(8 / (9 * np.sqrt(12)) * height, rel=1e-3)
    assert rq == pytest.approx(np.sqrt(4 / 45) * height, rel=1e-3)
    assert rz == pytest.approx(height, rel=1e-3)
    assert mx.form_error(wall, (0.0, 1.0)) == pytest.approx(height / 3 + 5e-5 - 5e-6, rel=1e-3)


@pytest.mark.parametrize(
    ("y", "expected"),
    [
        ((-0.1, 0.1), ("left", "right")),
        ((0.0, 0.1), ("left",)),  # up-milling
        ((-0.1, 0.0), ("right",)),  # down-milling
        ((-0.01, 0.01), ()),  # as wide as the tool
        ((-0.003, 0.02), ("left",)),
    ],
)
def test_where_there_are_walls(y, expected):
    case = slot(axes=(), duration=0.2, stock=mx.Stock.box((0.0, 0.002), y))
    assert mx.walls(case) == expected
    for side in SIGN:
        wall = mx.wall_profile(case, moved(case), side)
        there = np.isfinite(wall.y)
        assert there.any() == (side in expected)
        if side in expected:
            assert 0 < wall.x[there].min() < 1e-5
            assert 0.00199 < wall.x[there].max() < 0.002


def test_a_workpiece_without_borders_has_two_walls():
    assert mx.walls(rigid()) == ("left", "right")


def test_a_cut_that_has_not_begun_has_no_wall():
    case = slot(axes=(), duration=0.06, steps_per_tooth=10)  # the tool centre has come to 4 mm before the border
    assert mx.walls(case) == ()
    assert np.isnan(mx.form_error(mx.wall_profile(case, moved(case), "left", middle())))


def test_another_side():
    case = rigid(duration=0.01)
    with pytest.raises(ValueError, match="'top' given; it must be one of 'left', 'right'"):
        mx.wall_profile(case, moved(case), "top")


def test_phases_of_the_papers_entry():
    case = slot(axes=(), duration=0.2)
    found = mx.phases(case, mx.simulate(case))
    tau = float(case.cut.tooth_period(case.tool))
    second = RADIUS * (1 - np.cos(np.pi / TEETH)) / (4 / 60)
    assert 0 < found["Ia"][0] < tau
    assert second < found["Ia"][1] < second + 1.2 * tau
    assert found["Ib"][0] == found["Ia"][1]
    assert found["Ib"][1] == found["II"][0] == pytest.approx(0.15, abs=tau / 40)
    assert found["II"][1] == pytest.approx(case.settings.periods * tau)


def test_phases_of_other_cuts():
    # Of two teeth one is always out of the stock.
    case = slot(axes=(), teeth=2, duration=0.2)
    found = mx.phases(case, mx.simulate(case))
    assert found["Ib"] is None
    assert found["Ia"][1] == found["II"][0] == pytest.approx(0.15, abs=1e-4)
    # At half the feed rate the trace ends when the tool centre is 3.3 mm before the border.
    case = slot(axes=(), feed=2 / 60, duration=0.2)
    found = mx.phases(case, mx.simulate(case))
    assert found["II"] is None
    assert found["Ib"][1] == pytest.approx(0.2, abs=2e-3)
    # No border; and the front of the tool reaches the end of the stock when its centre is 1 mm in.
    case = rigid()
    assert mx.phases(case, moved(case)) == {"Ia": None, "Ib": None, "II": (0.0, pytest.approx(0.06))}
    case = slot(axes=(), stock=mx.Stock.box((0, 0.011)), duration=0.2)
    assert mx.phases(case, moved(case))["II"] == pytest.approx((0.15, 0.165), abs=1e-4)


def test_phases_of_a_traced_simulation():
    case = rigid()
    with pytest.raises(ValueError, match="outside jit"):
        jax.jit(lambda x: mx.phases(case, eqx.tree_at(lambda sim: sim.time, moved(case), x)))(moved(case).time)


def test_the_picture_of_a_wall():
    case = rigid()
    sim = moved(case)
    figure = plot_wall([mx.wall_profile(case, sim, side) for side in mx.walls(case)], case)
    labels = " ".join(f"{axes.get_xlabel()} {axes.get_ylabel()}" for axes in figure.axes)
    assert "x [mm]" in labels
    assert "[nm]" in labels  # feed marks and nothing else


def test_a_tooth_that_stands_out_leaves_marks_of_its_own():
    case = rigid()
    case = eqx.tree_at(lambda c: c.tool, case, mx.EndMill(2 * RADIUS, TEETH, runout=[0.0, 2e-5, 0.0, 0.0]))
    deviation = np.asarray(mx.wall_profile(case, moved(case), "right", middle()).deviation)
    per_turn = TEETH * FEED
    height = per_turn**2 / (8 * RADIUS * (1 - per_turn / (2 * np.pi * RADIUS)) ** 2)
    assert np.ptp(deviation) == pytest.approx(height, rel=4e-3)
    assert deviation.min() == pytest.approx(-2e-5, abs=1e-9)


def test_with_a_helix_every_height_is_cut_at_a_moment_of_its_own():
    """A tool that shakes once per tooth: the wall at height z is its place z tan(beta)/(R Omega) later than at the tip."""
    straight = rigid(steps_per_tooth=40)
    case = eqx.tree_at(lambda c: c.tool, straight, mx.EndMill(2 * RADIUS, TEETH, helix=np.radians(30)))
    height, speed = 5e-3, float(case.cut.spindle_speed)
    later = height * np.tan(np.radians(30)) / RADIUS / speed

    def shaken(by):
        time = moved(straight).time + by
        return moved(straight, y=2e-5 * jnp.sin(speed * TEETH * time + 0.3))

    x = middle(101)
    found = mx.wall_profile(case, shaken(0.0), "left", x, height=height)
    expected = mx.wall_profile(straight, shaken(later), "left", x + FEED * TEETH * speed / (2 * np.pi) * -later)
    np.testing.assert_allclose(found.y, expected.y, atol=2e-9)
    assert abs(float(mx.form_error(found) - mx.form_error(mx.wall_profile(straight, shaken(0.0), "left", x)))) > 1e-6
