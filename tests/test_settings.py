import pytest
from cases import RPM, slot

import millax as mx

TOOL = mx.EndMill(0.02, 4)
LAW = mx.FractionalLaw(5e9, 18e-6, 0.1, 0.3)
CUT = mx.Cut.touching(TOOL, 10000 * RPM, 4 / 60, 1e-3)
ROBOT = mx.Structure(("x", "y"), 100.0, 3e5, damping_ratio=0.05)
LIGHT = mx.Structure(("x", "y"), 0.04, 1.34e6, damping_ratio=0.02)


def test_the_simulation_lasts_whole_tooth_periods():
    assert mx.Settings.suited(TOOL, LAW, ROBOT, CUT, 0.0015).periods == 1
    assert mx.Settings.suited(TOOL, LAW, ROBOT, CUT, 0.0015 * 100).periods == 100  # no period more for rounding
    assert mx.Settings.suited(TOOL, LAW, ROBOT, CUT, 1.0).periods == 667
    assert mx.Settings.suited(TOOL, LAW, ROBOT, CUT, 1.0).steps == 26680


@pytest.mark.parametrize(
    ("structure", "depth", "steps"),
    [(ROBOT, 1e-3, 40), (mx.Structure(("x", "y"), 10.0, 3e6, damping_ratio=0.05), 1e-3, 40), (LIGHT, 1e-5, 64)],
    ids=["robot", "spindle", "light tool"],
)
def test_the_chosen_sweeps_converge(structure, depth, steps):
    cut = mx.Cut.touching(TOOL, 10000 * RPM, 4 / 60, depth)
    settings = mx.Settings.suited(TOOL, LAW, structure, cut, 0.06, steps_per_tooth=steps)
    sim = mx.simulate(mx.Case(TOOL, LAW, cut, mx.Stock.box(), structure, settings))
    assert sim.residual < 1e-6


def test_stronger_coupling_asks_for_more_sweeps():
    soft = mx.Settings.suited(TOOL, LAW, ROBOT, CUT, 0.1)
    light = mx.Settings.suited(TOOL, LAW, mx.Structure(("x", "y"), 1.0, 3e5, damping_ratio=0.05), CUT, 0.1)
    assert light.sweeps * light.blocks > soft.sweeps * soft.blocks
    assert mx.Settings.suited(TOOL, LAW, mx.Structure.rigid(), CUT, 0.1).sweeps == 1


def test_there_is_a_sweep_to_spare_where_the_tool_gives_way():
    stiff = mx.Structure(("x", "y"), 1000.0, 1e9, damping_ratio=0.05)
    assert mx.Settings.suited(TOOL, LAW, stiff, CUT, 0.1, blocks=1).sweeps == 3  # two are expected


def test_a_tolerance_has_to_be_positive():
    with pytest.raises(ValueError, match=r"simulation.tolerance: 0 given"):
        mx.Settings(10, tolerance=0.0)


def test_given_blocks_and_sweeps_are_kept():
    settings = mx.Settings.suited(TOOL, LAW, ROBOT, CUT, 0.1, blocks=4, sweeps=9)
    assert (settings.blocks, settings.sweeps) == (4, 9)
    assert mx.Settings.suited(TOOL, LAW, ROBOT, CUT, 0.1, blocks=4).blocks == 4


def test_a_mode_that_the_steps_do_not_resolve():
    # sqrt(1.34e6/0.04)/(2 pi) = 921 Hz; 1.5 ms per tooth period: 8 steps per mode period are 11.06 per tooth.
    with pytest.raises(ValueError, match=r"steps_per_tooth: 11 given; the fastest mode .*921.* Hz.* needs at least 12"):
        mx.Settings.suited(TOOL, LAW, LIGHT, CUT, 0.1, steps_per_tooth=11)
    mx.Settings.suited(TOOL, LAW, LIGHT, CUT, 0.1, steps_per_tooth=12)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"steps_per_tooth": 9}, "steps_per_tooth: 9 given; it must be a whole number of at least 10"),
        ({"steps_per_tooth": 40.0}, "steps_per_tooth: 40.0 given"),
        ({"passes": 0}, "passes: 0 given"),
        ({"sweeps": 0}, "sweeps: 0 given"),
        ({"blocks": 3}, r"blocks: 3 given; it must divide steps_per_tooth \(40\)"),
        ({"width": -1e-6}, "width: -1e-06 m given"),
    ],
)
def test_bad_settings_are_named(settings, message):
    with pytest.raises(ValueError, match=message):
        slot(**settings)


def test_durations_out_of_reach():
    with pytest.raises(ValueError, match="duration: 0 s given"):
        mx.Settings.suited(TOOL, LAW, ROBOT, CUT, 0.0)
    with pytest.raises(ValueError, match=r"duration: 1e\+09 s given; .* time steps"):
        mx.Settings.suited(TOOL, LAW, ROBOT, CUT, 1e9)
