"""Helix, pitch, runout, axial forces, process damping: beside exact tooth paths and straight tools; their derivatives."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import ENDLESS, slot

import millax as mx
from benchmarks import exact

HELIX = np.radians(30)
UP, DOWN = mx.Stock.box((None, None), (0.0, None)), mx.Stock.box((None, None), (None, 0.0))
PITCH = np.radians([82, 97, 86, 95])
EDGES = mx.LinearLaw(1.5e9, 0.3, ke=1.5e4, ka=-0.25, kre=2e4, kae=-4e3)
WORN = dataclasses.replace(EDGES, kr=[0.3, 0.5, 0.3, 0.2], ke=[1e4, 4e4, 0.0, 2e4], kae=[-1e3, -9e3, 0.0, 1e3])


def cut(*, stock=None, force=None, structure=None, duration=0.012, depth=1e-3, settings=None, **tool) -> mx.Case:
    """The papers' slot with another tool, its settings chosen to suit it."""
    case = slot(stock=stock, force=force, structure=structure)
    tool = mx.EndMill(0.02, 4, **tool)
    feed = dataclasses.replace(case.cut, depth=depth)
    suited = mx.Settings.suited(tool, case.force, case.structure, feed, duration, **(settings or {}))
    return dataclasses.replace(case, tool=tool, cut=feed, settings=suited)


def difference(ours, theirs) -> float:
    ours, theirs = np.asarray(ours), np.asarray(theirs)
    return float(np.sqrt(((ours - theirs) ** 2).sum() / (theirs**2).sum()))


EVEN = {"pitch": np.full(4, np.pi / 2)}
CUTS = {
    "helix, down": {"helix": HELIX, "stock": DOWN},
    "runout, down": {"runout": [0.0, 2e-5, 5e-6, -8e-6], "stock": DOWN},
    "pitch, runout": {"pitch": PITCH, "runout": [0.0, 1e-5, 5e-6, -8e-6]},
    "process damping, down": {"force": mx.FractionalLaw(5e9, 18e-6, 0.1, 0.3, process_damping=3e7), "stock": DOWN},
    "offset, helix, up": {"offset": 1e-5, "offset_angle": 0.3, "helix": HELIX, "stock": UP},
    "edge and axial forces, helix, offset": {
        "force": EDGES,
        "helix": HELIX,
        "offset": 1e-5,
        "offset_angle": 0.3,
        "stock": ENDLESS,
    },
    "worn teeth, up": {"force": WORN, "stock": UP},
}


@pytest.mark.parametrize("numbers", CUTS.values(), ids=CUTS.keys())
def test_forces_beside_exact_tooth_paths(numbers):
    case = cut(**numbers, settings={"passes": 8})
    sim = mx.simulate(case)
    reference = exact.cut_along(*exact.followed(case, sim), passes=8, flank=exact.flank_of(case))
    # An edge force jumps in the step in which contact begins: at the sides of a slot several earlier passes vie for it.
    assert difference(sim.force, reference.force) < (1.5e-3 if case.force.own_edges is None else 1e-2)
    assert difference(sim.chip_thickness, reference.thickness) < 3e-3


def test_slices_resolve_the_helix():
    case = cut(helix=HELIX, structure=mx.Structure.rigid())
    few, many = mx.simulate(case), mx.simulate(case.with_settings(slices=8 * case.settings.slices))
    assert difference(few.force, many.force) < 1e-3
    deep = cut(helix=HELIX, depth=0.01, structure=mx.Structure.rigid())
    assert deep.settings.slices < 25


def test_a_helix_of_no_angle_is_straight():
    straight, helical = mx.simulate(cut()), mx.simulate(cut(helix=0.0, settings={"slices": 3}))
    assert difference(helical.force, straight.force) < 1e-12


def test_teeth_said_to_be_equal_are_equal():
    settings, stock = {"passes": 3, "steps_per_tooth": 40}, mx.Stock.box((0.0, 0.004), (-0.003, 0.005))
    numbers = {"settings": settings, "stock": stock, "duration": 0.06}
    plain, table = mx.simulate(cut(**numbers)), mx.simulate(cut(runout=np.zeros(4), **numbers))
    for name in ("force", "displacement", "chip_thickness"):
        assert difference(getattr(table, name), getattr(plain, name)) < 1e-9


def test_teeth_said_to_be_equally_spaced_are():
    plain, spaced = (mx.simulate(cut(stock=DOWN, duration=0.06, settings={"passes": 4}, **pitch)) for pitch in ({}, EVEN))
    for name in ("force", "displacement", "chip_thickness"):
        assert difference(getattr(spaced, name), getattr(plain, name)) < 1e-8


def test_a_tooth_cuts_what_is_fed_during_its_pitch():
    case = cut(pitch=PITCH, structure=mx.Structure.rigid(), stock=ENDLESS)
    chip, time = np.asarray(mx.simulate(case).chip_thickness)[-160:], np.asarray(mx.simulate(case).time)[-160:]
    phi = float(case.cut.spindle_speed) * time[:, None] + np.concatenate([[0.0], np.cumsum(PITCH)[:-1]])
    feed = float(case.cut.feed_rate / case.cut.spindle_speed) * PITCH * np.cos(phi)
    full = feed > 2e-5
    assert full.sum() > 200
    assert np.allclose(chip[full], feed[full], atol=1e-6)  # first order in f_z/R = 1 %


def test_pitch_that_is_no_turn_is_refused():
    with pytest.raises(ValueError, match=r"tool.pitch: the angles given sum to 350 deg; .*must sum to a turn, 360 deg"):
        mx.EndMill(0.02, 4, pitch=np.radians([80, 100, 85, 85]))
    with pytest.raises(ValueError, match=r"tool.pitch: shape \(3,\) given"):
        mx.EndMill(0.02, 4, pitch=np.radians([120, 120, 120]))
    with pytest.raises(ValueError, match=r"tool.pitch: -0.1\d* rad given; it must be greater than 0"):
        mx.EndMill(0.02, 4, pitch=np.radians([-10, 190, 85, 95]))


def test_blocks_longer_than_a_pitch_are_refused():
    with pytest.raises(ValueError, match=r"blocks: 1 given; the shortest pitch of tool.pitch is 0.911.* Give 2 or more"):
        cut(pitch=PITCH, settings={"blocks": 1})
    with pytest.raises(ValueError, match=r"tool.pitch: the shortest pitch is 0.0333 of the mean one"):
        cut(pitch=np.radians([3, 177, 85, 95]))
    # Where no one could look, as in a sweep of the pitch, the simulation says so.
    case = cut(pitch=PITCH, settings={"blocks": 2})
    short = eqx.tree_at(lambda c: c.tool.pitch, case, jnp.asarray(np.radians([40, 140, 85, 95])))
    assert int(mx.simulate(short, throw=False).status) == 3


def test_an_offset_is_a_runout_that_turns_with_the_tool():
    angle = np.arange(4) * np.pi / 2
    offset, runout = cut(offset=1e-5, offset_angle=0.4), cut(runout=1e-5 * np.cos(angle - 0.4))
    assert difference(mx.simulate(offset).force, mx.simulate(runout).force) < 1e-12


def test_a_tooth_that_stands_out_takes_its_lead_from_the_next():
    """Rigid tool, h = f_z cos phi + R_i - R_(i+1): what one tooth takes more, the one after it finds gone."""
    same = {"structure": mx.Structure.rigid(), "stock": ENDLESS, "settings": {"steps_per_tooth": 40}}
    case = cut(runout=[0.0, 2e-5, 0.0, 0.0], **same)
    even = np.asarray(mx.simulate(cut(**same)).chip_thickness)
    more = np.asarray(mx.simulate(case).chip_thickness) - even
    full = even[-160:] > 5e-5
    for tooth, lead in enumerate((-2e-5, 2e-5, 0.0, 0.0)):
        assert np.allclose(more[-160:, tooth][full[:, tooth]], lead, atol=1e-8)


def test_axial_force_is_a_share_of_the_tangential_one():
    law = slot().force
    rigid = mx.Structure.rigid()
    one, two = (
        np.asarray(mx.simulate(cut(force=dataclasses.replace(law, ka=jnp.asarray(ka)), structure=rigid)).force)
        for ka in (-0.2, 0.4)
    )
    none = np.asarray(mx.simulate(cut(structure=rigid)).force)
    assert np.allclose(one[:, :2], none[:, :2], rtol=1e-12)
    assert not none[:, 2].any()
    assert np.allclose(two[:, 2], -2 * one[:, 2], rtol=1e-12)
    # F_t of all teeth from h: each tooth cuts by itself, and only half of them at a time.
    assert one[:, 2].min() == pytest.approx(-0.2 * 1e-3 * float(law.tangential(2e-4 / 2)) * 1.0, rel=0.5)


def test_axial_force_moves_a_coupled_structure():
    coupled = mx.Structure(
        ("x", "y", "z"), 10.0, [[3e6, 0.0, 8e5], [0.0, 3e6, 0.0], [8e5, 0.0, 3e6]], damping=[1000.0, 1000.0, 1000.0]
    )
    law = dataclasses.replace(slot().force, ka=jnp.asarray(-0.5))
    sim = mx.simulate(cut(force=law, structure=coupled, duration=0.15))
    mean = np.asarray(sim.force)[-160:].mean(axis=0)
    static = np.linalg.solve(coupled.stiffness_matrix, mean)
    assert np.allclose(np.asarray(sim.displacement)[-160:].mean(axis=0), static, rtol=0.02)
    assert mean[2] < -10


def test_edge_forces_of_a_full_slot():
    """Budak, Altintas and Armarego 1996: mean forces of a slot, to first order in f_z/R = 1 %."""
    case = cut(force=EDGES, structure=mx.Structure.rigid(), stock=ENDLESS, duration=0.02)
    mean = np.asarray(mx.simulate(case).force)[-160:].mean(axis=0)
    depth, feed, teeth, law = 1e-3, float(case.cut.feed_per_tooth(case.tool)), 4, EDGES
    kt, kr, ke, ka, kre, kae = (float(x) for x in (law.kt, law.kr, law.ke, law.ka, law.kre, law.kae))
    x = -teeth * depth / 4 * kr * kt * feed - teeth * depth / np.pi * kre
    y = teeth * depth / 4 * kt * feed + teeth * depth / np.pi * ke
    z = teeth * depth / np.pi * ka * kt * feed + teeth * depth / 2 * kae
    assert np.allclose(mean, [x, y, z], rtol=6e-3)


def test_coefficients_of_each_tooth_that_are_all_the_same_are_one_number():
    for law in (EDGES, mx.FractionalLaw(5e9, 18e-6, 0.1, 0.3, ka=0.2, ke=1e4, process_damping=2e6)):
        listed = jax.tree.map(lambda x: jnp.full(4, x), law)
        plain, table = (mx.simulate(cut(force=force, stock=DOWN, settings={"passes": 4})) for force in (law, listed))
        for name in ("force", "displacement", "chip_thickness"):
            assert difference(getattr(table, name), getattr(plain, name)) < 1e-9


def test_coefficients_of_another_number_of_teeth_are_refused():
    with pytest.raises(ValueError, match=r"force.kr: shape \(3,\) given; it must be one number, or one for each of the 4"):
        mx.simulate(cut(force=dataclasses.replace(EDGES, kr=[0.3, 0.2, 0.1])))


@pytest.mark.long
def test_derivatives_of_the_tool_and_its_edges():
    def where(c):
        t, law = c.tool, c.force
        edges = [law.kr, law.ka, law.ke, law.kre, law.kae, law.process_damping]
        return [t.helix, t.pitch, t.runout, t.offset, t.offset_angle, t.diameter, *edges, c.cut.depth]

    structure = mx.Structure(("x", "y", "z"), 5.0, [[3e6, 2e5, 1e5], [2e5, 3e6, 4e5], [1e5, 4e5, 6e6]], damping=[300.0] * 3)
    case = cut(
        helix=0.5,
        pitch=PITCH,
        runout=[0.0, 4e-6, 8e-6, -4e-6],
        offset=5e-6,
        offset_angle=0.7,
        force=dataclasses.replace(WORN, process_damping=jnp.asarray([2e6, 1e6, 0.0, 3e6])),
        structure=structure,
        stock=mx.Stock.box((None, None), (-0.02, 0.001)),
        duration=0.009,
        settings={"tolerance": 1e-13, "sweeps": 20, "slices": 2, "steps_per_tooth": 40},
    )
    weights = jax.random.normal(jax.random.key(0), (case.settings.steps, 6))

    def weighed(factors):
        scaled = eqx.tree_at(where, case, [leaf * factor for leaf, factor in zip(where(case), factors, strict=True)])
        sim = mx.simulate(scaled, throw=False)
        return jnp.sum(weights * jnp.concatenate([sim.force / 100, sim.displacement / 1e-5], axis=1))

    one = jnp.ones(len(where(case)))
    backward, value = jax.jit(jax.grad(weighed))(one), jax.jit(weighed)
    for i in range(len(one)):
        step = 1e-6 if i == 1 else 1e-5  # a pitch angle is large: the teeth soon move by the width of the gates
        differences = (value(one.at[i].add(step)) - value(one.at[i].add(-step))) / (2 * step)
        assert backward[i] == pytest.approx(float(differences), rel=1e-6)


def test_runout_beyond_the_feed_is_pointed_out():
    with pytest.warns(UserWarning, match="differ in radius by 150 µm, more than the feed per tooth, 100 µm"):
        cut(runout=[0.0, 1.5e-4, 0.0, 0.0])


def test_slices_that_do_not_resolve_the_helix_are_refused():
    with pytest.raises(ValueError, match=r"slices: 1 given; .* wraps by 9.5 time steps.*\n?.*Give 5 or more"):
        cut(helix=np.radians(75), settings={"slices": 1})
    # Where it was made steeper afterwards, the simulation says so.
    steeper = eqx.tree_at(lambda c: c.tool.helix, cut(helix=0.1), jnp.asarray(np.radians(75)))
    with pytest.raises(mx.SimulationError, match=r"the helix wraps by more time steps than the slices resolve"):
        mx.simulate(steeper)
