"""The simulation against closed forms, the papers' tables, and a step-by-step program of its own."""

import dataclasses
import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import ENDLESS, RPM, slot
from oracles import exact_thickness, fractional, plane_force
from scipy.integrate import quad
from scipy.linalg import expm

import millax as mx
from millax import _march


def last_revolution(sim):
    return np.asarray(sim.force)[-160:].mean(axis=0)


def test_slot_means_in_first_order():
    # Second-order terms of the thickness vanish with feed/diameter, step and gate errors with their squares.
    case = slot(axes=(), diameter=2000.0, stock=ENDLESS, steps_per_tooth=2000, passes=1, width=0.0, duration=0.003)
    mean = np.asarray(mx.simulate(case).force).mean(axis=0)[:2]

    def per_angle(phi, axis):
        return 4 / (2 * np.pi) * plane_force(phi, 1e-3 * fractional(1e-4 * np.cos(phi), 5e9, 18e-6, 0.1), 0.3)[axis]

    expected = [quad(per_angle, -np.pi / 2, np.pi / 2, args=(axis,))[0] for axis in range(2)]
    assert np.allclose(expected, [-39.637, 132.124], rtol=0, atol=5e-4)  # as published, three decimals
    assert np.allclose(mean, expected, rtol=0, atol=1e-4)
    assert mean[0] / mean[1] == pytest.approx(-0.3, rel=1e-6)  # F_x/F_y = -k_r exactly


@pytest.mark.parametrize("teeth", [1, 3, 4])
def test_rigid_slot_against_exact_tooth_paths(teeth):
    case = slot(axes=(), stock=ENDLESS, steps_per_tooth=160 // teeth, duration=0.006, teeth=teeth)
    sim = mx.simulate(case)
    speed, feed = 10000 * RPM, 4 / 60
    tau = 2 * np.pi / (speed * teeth)
    expected, chips = np.zeros((len(sim.time), 2)), np.zeros((len(sim.time), teeth))
    for j, t in enumerate(np.asarray(sim.time)):
        for tooth in range(teeth):
            h = exact_thickness(lambda s: np.array([feed * s, 0.0]), 0.01, speed, teeth, t, tooth, 3, tau)
            phi = speed * t + 2 * np.pi * tooth / teeth
            expected[j] += plane_force(phi, 1e-3 * fractional(h, 5e9, 18e-6, 0.1), 0.3)
            chips[j, tooth] = max(h, 0.0)
    # A step mean is not a sample where a tooth starts or ends to cut, at +-90 degrees: compare the other steps.
    phi = speed * np.asarray(sim.time)[:, None] + 2 * np.pi * np.arange(teeth) / teeth
    away = (np.abs(np.cos(phi)) > 2 * np.pi / 160 * 2).all(axis=1)
    error = np.abs(np.asarray(sim.force)[:, :2] - expected).max(axis=1) / np.abs(expected).max()
    assert away.mean() > 0.7
    assert error[away].max() < 2e-3  # second order in the step; the largest where thin chips bend the law
    assert np.abs(np.asarray(sim.chip_thickness) - chips)[away].max() < 1e-3 * chips.max()


def step_by_step(case, steps_per_tooth):
    """The same model as a plain loop over time steps: exact transition per step, force found by iteration in each."""
    s, cut, law = case.structure, case.cut, case.force
    n = len(s.axes)
    speed, feed, radius = float(cut.spindle_speed), float(cut.feed_rate), float(case.tool.radius)
    teeth = case.tool.teeth
    dt = 2 * np.pi / (speed * teeth * steps_per_tooth)
    mass, damping, stiffness = (np.asarray(m) for m in (s.mass_matrix, s.damping_matrix, s.stiffness_matrix))
    a = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(mass, np.hstack([stiffness, damping]))]])
    b = np.vstack([np.zeros((n, n)), np.linalg.inv(mass)])

    def discrete(h):
        e = expm(np.block([[a, b], [np.zeros((n, 3 * n))]]) * h)
        return e[: 2 * n, : 2 * n], e[: 2 * n, 2 * n :]

    (whole, whole_in), (half, half_in) = discrete(dt), discrete(dt / 2)
    total = case.settings.periods * steps_per_tooth
    past = case.settings.passes * steps_per_tooth
    u, v = np.zeros((total + past, 2)), np.zeros((total + past, 2))
    forces, z, force = np.zeros((total, 2)), np.zeros(2 * n), np.zeros(2)
    axes = ["xy".index(axis) for axis in s.axes]
    step_angle = 2 * np.pi / (teeth * steps_per_tooth)
    for j in range(total):
        phi = (j + 0.5) * step_angle + 2 * np.pi * np.arange(teeth) / teeth
        normal = np.stack([np.cos(phi), -np.sin(phi)], 1)
        along = np.stack([-np.sin(phi), -np.cos(phi)], 1)
        for _ in range(50):
            middle = half @ z + half_in @ force[axes]
            now = np.zeros(2)
            now[axes] = middle[:n]
            h = np.full(teeth, np.inf)
            for k in range(1, case.settings.passes + 1):
                i = j + past - k * steps_per_tooth
                d = now - u[i] + [k * feed * dt * steps_per_tooth, 0.0]
                nd, ed = normal @ d, along @ d
                slope = normal @ (v[i] + [feed, 0.0])
                h = np.minimum(h, nd + ed**2 / (2 * radius) - slope * ed / (speed * radius))
            tangential = 1e-3 * fractional(h, float(law.k0), float(law.hs), float(law.r))
            new = plane_force(phi, tangential, float(law.kr)).sum(axis=1)
            done, force = np.abs(new - force).max() < 1e-9, new
            if done:
                break
        middle = half @ z + half_in @ force[axes]
        u[j + past, axes], v[j + past, axes] = middle[:n], middle[n:]
        forces[j] = force
        z = whole @ z + whole_in @ force[axes]
    return forces, u[past:, axes]


@pytest.mark.parametrize(
    ("axes", "mass", "stiffness", "numerics"),
    [
        (("x",), 100.0, 3e5, {"sweeps": 4}),
        (("x", "y"), 100.0, 3e5, {"sweeps": 4}),
        (("x", "y"), [[50.0, 5.0], [5.0, 80.0]], [[3e5, -4e4], [-4e4, 9e5]], {"sweeps": 5, "blocks": 4}),
        (("x", "y"), 1.0, 3e6, {"sweeps": 14}),
    ],
    ids=["1-DOF", "2-DOF", "coupled", "chatter"],
)
def test_blocks_and_sweeps_give_the_step_by_step_solution(axes, mass, stiffness, numerics):
    # Fine steps and a narrow gate: the loop samples the thickness that the engine averages over a step.
    structure = mx.Structure(axes, mass, stiffness, damping_ratio=0.05)
    case = slot(structure=structure, stock=ENDLESS, duration=0.03, steps_per_tooth=160, width=1e-9, **numerics)
    sim = mx.simulate(case)
    force, displacement = step_by_step(case, 160)
    assert np.abs(np.asarray(sim.displacement) - displacement).max() < 3e-4 * np.abs(displacement).max()
    assert np.sqrt(((np.asarray(sim.force)[:, :2] - force) ** 2).mean() / (force**2).mean()) < 1e-3


def test_blocks_and_sweeps_do_not_change_the_result():
    reference = mx.simulate(slot(mass=1.0, stiffness=3e6, sweeps=16, duration=0.06, tolerance=1e-12))
    for blocks, sweeps in ((2, 12), (8, 8)):
        case = slot(mass=1.0, stiffness=3e6, blocks=blocks, sweeps=sweeps, duration=0.06, tolerance=1e-12)
        assert np.allclose(mx.simulate(case).force, reference.force, atol=1e-6, rtol=0)


def test_sweeps_are_added_until_the_force_has_converged():
    few, more = slot(mass=1.0, stiffness=3e6, sweeps=2), slot(mass=1.0, stiffness=3e6, sweeps=8)
    assert mx.simulate(few, throw=False).status == 1
    assert mx.simulate(few).status == 0
    assert np.allclose(mx.simulate(few).force, mx.simulate(more).force, atol=1e-4, rtol=0)
    assert not np.allclose(mx.simulate(few, throw=False).force, mx.simulate(more).force, atol=1e-4, rtol=0)


CHATTER = {"mass": 1.0, "stiffness": 3e6}


@pytest.mark.parametrize("case", [{}, CHATTER, CHATTER | {"blocks": 4}], ids=["slot", "chatter", "chatter in blocks"])
def test_the_residual_is_the_error_that_the_sweeps_leave(case):
    converged = np.asarray(mx.simulate(slot(sweeps=20, tolerance=1e-14, **case)).force)

    def error(sim):
        return np.abs(np.asarray(sim.force) - converged).max() / np.abs(converged).max()

    for sweeps in (1, 2, 3, 4):
        sim = mx.simulate(slot(sweeps=sweeps, tolerance=1e-13, **case), throw=False)
        assert error(sim) < 3 * sim.residual + 1e-14
        assert sim.residual < 300 * error(sim) + 1e-14
    for tolerance in (1e-4, 1e-6, 1e-8):
        sim = mx.simulate(slot(sweeps=20, tolerance=tolerance, **case))
        assert sim.residual <= tolerance
        assert error(sim) < 10 * tolerance  # the errors of the blocks add up where the cut is unstable


def test_a_block_takes_no_more_sweeps_than_it_needs():
    # The tool is at rest before it meets the stock, and what it does there is known after one sweep.
    few, many = (mx.simulate(slot(sweeps=sweeps, duration=0.02)) for sweeps in (4, 20))
    assert np.array_equal(few.force, many.force)


def step_means(fine, ratio):
    return np.asarray(fine).reshape(-1, ratio, fine.shape[1]).mean(axis=1)


def rms_error(coarse, fine, ratio):
    mean = step_means(fine, ratio)
    return np.sqrt(((np.asarray(coarse) - mean) ** 2).mean() / (mean**2).mean())


def largest_error(coarse, fine, ratio):
    mean = step_means(fine, ratio)
    return np.abs(np.asarray(coarse) - mean).max() / np.abs(mean).max()


@pytest.mark.parametrize("axes", [(), ("x", "y")], ids=["rigid", "2-DOF"])
def test_second_order_through_the_entry_into_a_border(axes):
    case = {"axes": axes, "duration": 0.16, "sweeps": 5}
    fine = mx.simulate(slot(steps_per_tooth=640, blocks=8, **case))
    runs = {n: mx.simulate(slot(steps_per_tooth=n, **case)).force for n in (10, 20, 40, 80)}
    rms = {n: rms_error(force, fine.force, 640 // n) for n, force in runs.items()}
    largest = {n: largest_error(force, fine.force, 640 // n) for n, force in runs.items()}
    assert largest[40] < 2e-3
    assert rms[40] < 3e-4
    assert min(np.log2([rms[10] / rms[20], rms[20] / rms[40], largest[10] / largest[20], largest[20] / largest[40]])) > 1.7
    # Beyond, the steps become as short as a tooth takes through the border, and the errors of that remain.
    assert rms[80] < rms[40] / 2
    assert largest[80] < largest[40] / 1.5


def test_width_to_zero_is_the_hard_model():
    hard = mx.simulate(slot(width=0.0, sweeps=6, duration=0.06))
    differences = []
    for width in (4e-6, 2e-6, 1e-6, 5e-7):
        soft = mx.simulate(slot(width=width, sweeps=6, duration=0.06))
        differences.append(rms_error(soft.force, hard.force, 1))
    assert all(later < 0.6 * earlier for earlier, later in itertools.pairwise(differences))
    default = mx.simulate(slot(sweeps=6, duration=0.06))
    bias = np.abs(last_revolution(default) - last_revolution(hard)).max() / np.abs(last_revolution(hard)).max()
    assert bias < 3e-3


@pytest.mark.parametrize(
    ("axes", "mass", "stiffness", "static", "overshoot", "frequency"),
    [
        (("x",), 100, 0.3e6, [0.13], [30], [8.8]),
        (("x",), 200, 2.0e6, [0.02], [18], [15.6]),
        (("x", "y"), 100, 1.0e6, [0.04, 0.13], None, [15.6, 14.6]),
    ],
)
def test_rows_of_the_papers_tables(axes, mass, stiffness, static, overshoot, frequency):
    # All 14 rows: make validate. Bounds: 2 % plus the paper's rounding, 2.5 points, 0.5 Hz.
    case = slot(axes=axes, mass=mass, stiffness=stiffness, duration=2.0)
    summary = mx.summarize(mx.simulate(case), case)
    for i, axis in enumerate(axes):
        value = abs(summary[f"static_displacement.{axis}"]["value"]) * 1e3
        assert value == pytest.approx(static[i], abs=0.02 * static[i] + 0.005)
        if overshoot:
            assert summary[f"overshoot.{axis}"]["value"] == pytest.approx(overshoot[i], abs=2.5)
        assert summary[f"first_frequency.{axis}"]["value"] == pytest.approx(frequency[i], abs=0.5)


def test_entry_thickness_is_the_depth_past_the_border():
    # h = min(f_z cos phi, d/cos phi): 1.2 ms after touching, the first tooth past the border is limited by it.
    case = slot(axes=(), steps_per_tooth=400, duration=0.0045, width=0.0)
    sim = mx.simulate(case)
    feed, speed = 4 / 60, 10000 * RPM
    expected = np.zeros((len(sim.time), 4))
    for k in range(32):  # mean over each step, by sampling it finely
        t = np.asarray(sim.time)[:, None] + ((k + 0.5) / 32 - 0.5) * float(sim.time[1] - sim.time[0])
        phi = speed * t + np.arange(4) * np.pi / 2
        depth = feed * t - 0.01 * (1 - np.cos(phi))
        with np.errstate(divide="ignore", invalid="ignore"):
            h = np.where(np.cos(phi) > 0, np.minimum(1e-4 * np.cos(phi), depth / np.cos(phi)), 0.0)
        expected += np.maximum(h, 0.0) / 32
    assert np.abs(np.asarray(sim.chip_thickness) - expected).max() < 1.5e-6  # the second-order terms are 1 % of f_z


def test_partial_immersion_cuts_only_inside_the_stock():
    # Tool centre in the border plane y = 0, stock at y > 0: teeth cut for sin phi < 0 only.
    case = slot(axes=(), stock=mx.Stock.box((None, None), (0.0, None)), duration=0.006)
    sim = mx.simulate(case)
    phi = 10000 * RPM * np.asarray(sim.time)[:, None] + np.arange(4) * np.pi / 2
    inside = (np.sin(phi) < -0.05) & (np.cos(phi) > 0.05)
    outside = (np.sin(phi) > 0.05) | (np.cos(phi) < -0.05)
    h = np.asarray(sim.chip_thickness)
    assert np.allclose(h[inside], (1e-4 * np.cos(phi))[inside], atol=1.2e-6)
    assert h[outside].max() < 1e-7


def test_nothing_moves_before_contact():
    sim = mx.simulate(slot(start=(-0.03, 0.0), duration=0.01))
    assert not np.any(sim.force)
    assert not np.any(sim.displacement)
    assert sim.status == 0


def test_no_force_in_air_before_and_after_a_wall():
    # 1.5 mm of air, a wall of 1.5 mm, then air again.
    sim = mx.simulate(slot(start=(-0.0115, 0.0), stock=mx.Stock.box((0.0, 0.0015)), duration=0.45))
    force = np.abs(np.asarray(sim.force)).max(axis=1)
    travelled = 4 / 60 * np.asarray(sim.time)
    before, after = travelled < 1.4e-3, travelled > 0.0115 + 0.0015 + 0.01 + 1e-3
    assert before.sum() > 500
    assert after.sum() > 500
    assert not force[before].any()
    assert not force[after].any()
    assert not np.asarray(sim.chip_thickness)[before | after].any()
    assert force.max() > 10
    assert not np.asarray(sim.displacement)[before].any()
    assert np.asarray(sim.displacement)[after].any()  # it rings down


BORDERS = {  # three of them are one program
    "entry": {"duration": 0.06},
    "walls": {"duration": 0.09, "stock": mx.Stock.box((0.0, 0.004), (-0.003, 0.005))},
    "far inside": {"duration": 0.09, "stock": mx.Stock.box((-0.03, 0.03), (-0.03, 0.03))},
    "air, wall, air": {"duration": 0.09, "start": (-0.0105, 0.0), "stock": mx.Stock.box((0.0, 0.001), (-0.001, 0.001))},
    "chatter, a border behind the tool": {
        "duration": 0.045,
        "start": (0.0085, -0.0022),
        "stock": mx.Stock(np.array([[-0.239, -0.971]]), np.array([0.0083])),
        "structure": mx.Structure(("x", "y"), 1.0, [3.55e6, 3.78e6], damping_ratio=0.02),
        "force": mx.FractionalLaw(7e8, 18e-6, 0.1, 0.3),
        "feed": 1 / 60,
        "sweeps": 12,
        "blocks": 8,
    },
}


@pytest.mark.parametrize("passes", [1, 3])
def test_what_is_left_out_in_the_air_and_far_from_borders_would_change_nothing(passes, monkeypatch):
    cases = {name: slot(**({"sweeps": 6} | cut), passes=passes) for name, cut in BORDERS.items()}
    sims = {name: mx.simulate(case) for name, case in cases.items()}
    monkeypatch.setattr(_march, "_within_reach", lambda *_: (jnp.ones((1, 1, 1)), jnp.asarray(True), jnp.asarray(True)))
    jax.clear_caches()
    for name, case in cases.items():
        whole = mx.simulate(case)
        for trace in ("force", "displacement", "chip_thickness"):
            ours, theirs = (np.asarray(getattr(s, trace)) for s in (sims[name], whole))
            assert np.abs(ours - theirs).max() <= 1e-12 * np.abs(theirs).max(), (name, trace)
    jax.clear_caches()


def test_borders_out_of_reach_are_like_none():
    far, none = (mx.simulate(slot(stock=stock)) for stock in (mx.Stock.box((-0.03, 0.03), (-0.03, 0.03)), ENDLESS))
    for name in ("force", "displacement", "chip_thickness"):
        ours, theirs = (np.asarray(getattr(s, name)) for s in (far, none))
        assert np.abs(ours - theirs).max() <= 1e-12 * np.abs(theirs).max()


def test_static_displacement_is_the_mean_force_over_the_stiffness():
    case = slot(damping_ratio=0.9, mass=20.0, duration=0.4)
    sim = mx.simulate(case)
    assert np.allclose(np.asarray(sim.displacement)[-160:].mean(axis=0), last_revolution(sim)[:2] / 3e5, rtol=1e-4)


def test_a_case_is_the_same_as_its_parts():
    case = slot()
    parts = (case.tool, case.force, case.structure, case.cut, case.stock, case.settings)
    assert np.array_equal(mx.simulate(case).force, mx.simulate(*parts).force)


@dataclasses.dataclass
class Counter:
    traces: int = 0


def test_only_numbers_change_nothing_is_compiled_again():
    counter = Counter()

    class Counted(mx.FractionalLaw):
        def work(self, low, high):
            counter.traces += 1
            return super().work(low, high)

    case = slot(force=Counted(5e9, 18e-6, 0.1, 0.3))
    mx.simulate(case)
    first = counter.traces
    assert first > 0

    changed = jax.tree.map(lambda leaf: leaf * 1.01 if eqx.is_inexact_array(leaf) else leaf, case)
    assert not np.allclose(mx.simulate(changed).force, mx.simulate(case).force)
    assert counter.traces == first


def test_vmap_and_jit_give_the_same_numbers():
    case = slot()
    depths = jnp.array([0.5e-3, 1e-3, 2e-3])

    @jax.jit
    @jax.vmap
    def forces(depth):
        return mx.simulate(eqx.tree_at(lambda c: c.cut.depth, case, depth)).force

    batch = forces(depths)
    for depth, force in zip(depths, batch, strict=True):
        assert np.allclose(mx.simulate(eqx.tree_at(lambda c: c.cut.depth, case, depth)).force, force, atol=1e-9)


def test_members_of_a_batch_near_and_far_from_a_border_are_what_they_are_alone():
    # One enters the workpiece, one is long inside, one is in the air all the time, one goes out.
    case = slot(stock=mx.Stock.box((0.0, 0.02)), duration=0.015)
    starts = jnp.array([[-0.01, 0.0], [0.0101, 0.0], [-0.05, 0.0], [0.0199, 0.001]])

    def moved(start):
        return eqx.tree_at(lambda c: c.cut.start, case, start)

    batch = jax.jit(jax.vmap(lambda start: mx.simulate(moved(start))))(starts)
    alone = [mx.simulate(moved(start)) for start in starts]
    assert [bool(np.any(sim.force)) for sim in alone] == [True, True, False, True]
    for i, sim in enumerate(alone):
        for name in ("force", "displacement", "chip_thickness"):
            ours, theirs = np.asarray(getattr(batch, name)[i]), np.asarray(getattr(sim, name))
            assert np.abs(ours - theirs).max() <= 1e-12 * np.abs(theirs).max(initial=0.0)
    again = jax.vmap(jax.vmap(lambda start: mx.simulate(moved(start)).force))(starts.reshape(2, 2, 2))
    assert np.allclose(again.reshape(batch.force.shape), batch.force, rtol=0, atol=1e-12 * np.abs(batch.force).max())


class TestFailures:
    def test_a_tool_that_leaves_its_path_by_more_than_its_radius(self):
        case = slot(stiffness=1e3, mass=1.0, duration=0.1, sweeps=6)
        with pytest.raises(mx.SimulationError, match="more than its radius"):
            mx.simulate(case)
        assert mx.simulate(case, throw=False).status == 2

    def test_too_few_sweeps(self):
        # They are doubled twice; so strongly coupled, the force needs more than four.
        case = slot(mass=0.1, stiffness=3e5, sweeps=1)
        with pytest.raises(mx.SimulationError, match="more sweeps"):
            mx.simulate(case)
        assert mx.simulate(case, throw=False).status == 1

    def test_numbers_that_are_not_finite(self):
        case = eqx.tree_at(lambda c: c.force.k0, slot(), jnp.array(jnp.nan))
        with pytest.raises(mx.SimulationError, match="not finite"):
            mx.simulate(case)

    def test_float32_is_announced(self):
        jax.config.update("jax_enable_x64", False)
        try:
            with pytest.warns(UserWarning, match="float32"):
                single = mx.simulate(slot())
        finally:
            jax.config.update("jax_enable_x64", True)
        double = mx.simulate(slot())
        assert np.abs(np.asarray(single.force) - np.asarray(double.force)).max() < 2e-3 * np.abs(double.force).max()
