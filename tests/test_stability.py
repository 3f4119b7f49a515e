"""Stability limits: semi-discretisation, the engine's own Floquet multipliers, and growth in the time domain."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from cases import RPM, slot

import millax as mx
from benchmarks.lobes import lobes, mathieu, mathieu_radius
from identification.cli import main
from millax._krylov import arnoldi, largest
from millax._linearised import leading_multipliers
from millax._semidiscretisation import leading, multipliers
from millax._steady import along_feed, process_matrices, steady


def test_the_delayed_mathieu_equation():
    exact = mathieu_radius(3.0, 2.0, -0.15, 0.1)
    assert exact == pytest.approx(0.51205228410, abs=1e-10)
    errors = [abs(abs(multipliers(mathieu(steps, 3))[0]) - exact) for steps in (80, 160)]
    assert errors[1] < 5e-5
    assert errors[0] / errors[1] > 3.8  # second order: coefficients are means over steps


def test_constant_coefficients_beside_the_characteristic_equation():
    # x'' + 0.1 x' + 3 x = -0.15 x(t - tau), tau no multiple of the step: s² + 0.1 s + 3 + 0.15 exp(-s tau) = 0.
    tau, s = 1.3456, -0.05 + 1.7j
    for _ in range(30):
        f, slope = s**2 + 0.1 * s + 3 + 0.15 * np.exp(-s * tau), 2 * s + 0.1 - 0.15 * tau * np.exp(-s * tau)
        s -= f / slope
    assert abs(multipliers(mathieu(80, 3, eps=0.0, tau=tau))[0]) == pytest.approx(np.exp(2 * np.pi * s.real), rel=1e-6)


def test_a_delay_that_is_too_short_is_refused():
    with pytest.raises(ValueError, match=r"lags: 1 steps given.*at least 1\.5 steps"):
        mathieu(20, 3, tau=2 * np.pi / 20)


def test_eigenvectors_give_the_derivative_of_a_multiplier():
    matrix, change = np.random.default_rng(1).normal(size=(2, 12, 12))
    mu, v, w = leading(matrix)
    moved = [leading(matrix + sign * 1e-6 * change)[0] for sign in (1, -1)]
    moved = [m if abs(m - mu) < 1e-3 else m.conjugate() for m in moved]
    assert w.conj() @ change @ v == pytest.approx((moved[0] - moved[1]) / 2e-6, rel=1e-6)


def test_arnoldi_finds_the_largest_eigenvalue():
    rng = np.random.default_rng(2)
    basis = rng.normal(size=(60, 60))
    matrix = basis @ np.diag(0.7 ** np.arange(60)) @ np.linalg.inv(basis)
    _, h = arnoldi(lambda x: jnp.asarray(matrix) @ x, jnp.asarray(rng.normal(size=60)), 40)
    assert largest(np.asarray(h)) == pytest.approx(1.0, abs=1e-8)


def test_the_process_matrices_are_the_directional_factors_of_the_linear_law():
    case, steps = lobes(), 200
    found = eqx.filter_jit(process_matrices)(steady(case, ()), steps)
    phi = (np.arange(steps)[:, None] + 0.5) * np.pi / steps + np.array([0, np.pi])
    cutting = np.cos(phi) > 0
    force = np.stack([np.sin(phi) - np.cos(phi) / 3, np.cos(phi) + np.sin(phi) / 3])
    normal = np.stack([np.cos(phi), -np.sin(phi)])
    expected = 6e8 * 1e-3 * np.einsum("itz,jtz,tz->tij", force, normal, cutting)
    # The steps in which one tooth leaves and the next one enters hold the kink of both chips.
    np.testing.assert_allclose(found.now, expected, atol=5e-3 * np.abs(expected).max())
    np.testing.assert_allclose(found.earlier[0], -found.now, atol=1e-3 * np.abs(expected).max())


def test_multipliers_as_published():
    # 5 000 rpm, slot, one mode: the moduli against which discretisations are compared in the literature (Ding et al., Int.
    # J. Mach. Tools Manuf. 50, 2010), to the 0.3 % to which they are reproduced.
    case, depths = lobes(), np.array([0.2e-3, 0.5e-3, 0.7e-3, 1.0e-3])
    cuts = np.full(4, float(case.cut.spindle_speed)), np.full(4, float(case.cut.feed_rate)), depths
    found = np.abs(leading_multipliers(case, cuts, (), 160))
    np.testing.assert_allclose(found, [0.8192, 1.0726, 1.2197, 1.4040], rtol=3e-3)


@pytest.mark.parametrize(("immersion", "rpm"), [(0.5, 8000), (0.05, 24500)])  # the second one is 65 mm deep
def test_three_methods_agree(immersion, rpm):
    case = lobes(immersion=immersion, axes=("x", "y"), speed=rpm * RPM)
    limits = [float(mx.limit_depth(case, method=method)) for method in ("semi", "floquet", "time")]
    assert limits[1] == pytest.approx(limits[0], rel=0.01)
    assert limits[2] == pytest.approx(limits[1], rel=0.001)


def test_growth_of_a_vibration_that_dies_away_fast():
    case = lobes(immersion=0.05, axes=("x", "y"), speed=24500 * RPM)
    case = dataclasses.replace(case, cut=dataclasses.replace(case.cut, depth=jnp.asarray(0.052)))
    radii = [float(mx.spectral_radius(case, method=method)) for method in ("floquet", "time")]
    assert radii[0] < 0.96
    assert radii[1] == pytest.approx(radii[0], rel=0.002)


def test_variable_pitch():
    even = lobes(axes=("x", "y"), speed=8000 * RPM)
    limits = {}
    for pitch in ((170.0, 190.0), (180.0, 180.0)):
        case = dataclasses.replace(even, tool=mx.EndMill(0.02, 2, pitch=np.radians(pitch)))
        limits[pitch[0]] = float(mx.limit_depth(case))
        if pitch[0] == 170:
            assert float(mx.limit_depth(case, method="floquet")) == pytest.approx(limits[170.0], rel=0.01)
            by_pitch = jax.grad(mx.limit_depth)(case).tool.pitch
    assert limits[180.0] == pytest.approx(float(mx.limit_depth(even)), rel=1e-9)
    assert abs(limits[170.0] / limits[180.0] - 1) > 0.05
    # By the pitch angles: the second follows from the first.
    moved = [
        float(mx.limit_depth(dataclasses.replace(even, tool=mx.EndMill(0.02, 2, pitch=[first, 2 * np.pi - first]))))
        for first in np.radians(170) + np.array([1e-5, -1e-5])
    ]
    assert float(by_pitch[0]) == pytest.approx((moved[0] - moved[1]) / 2e-5, rel=1e-4)


def test_a_tooth_that_never_cuts_does_not_count():
    """Its runout makes the second tooth cut what is fed in two tooth periods, and leaves nothing to the first."""
    case, single = lobes(speed=8000 * RPM, passes=2), lobes(speed=8000 * RPM)
    case = dataclasses.replace(case, tool=mx.EndMill(0.02, 2, runout=[0.0, 1.5e-6]))
    single = dataclasses.replace(single, tool=mx.EndMill(0.02, 1))
    assert float(mx.limit_depth(case)) == pytest.approx(float(mx.limit_depth(single)), rel=1e-3)


def test_process_damping_is_that_of_the_flanks_in_contact():
    """Of a slot, the mean of C a/V sum n n^T over the teeth in contact is C a N/(4 V)."""
    case = lobes(immersion=1.0, axes=("x", "y"))
    damped = dataclasses.replace(case, force=dataclasses.replace(case.force, process_damping=jnp.asarray(2e5)))
    found = eqx.filter_jit(process_matrices)(steady(damped, ()), 200)
    expected = -2e5 * 1e-3 * 2 / (4 * float(case.cut.spindle_speed) * 0.01)
    np.testing.assert_allclose(found.now_rate.mean(axis=0), expected * np.eye(2), atol=5e-3 * abs(expected))
    assert float(mx.limit_depth(damped)) > 1.2 * float(mx.limit_depth(case))


@pytest.mark.long
def test_derivatives_of_the_limit_depth():
    case = lobes(immersion=0.5, speed=9000 * RPM)
    gradient = jax.grad(mx.limit_depth)(case)
    assert gradient.cut.depth == 0
    for where in (
        lambda c: c.force.kt,
        lambda c: c.structure.stiffness,
        lambda c: c.cut.spindle_speed,
    ):
        x = where(case)
        high, low = (float(mx.limit_depth(eqx.tree_at(where, case, x * (1 + d)))) for d in (1e-4, -1e-4))
        assert float(where(gradient)) == pytest.approx((high - low) / (2e-4 * float(x)), rel=1e-4)


def test_the_diagram(tmp_path):
    case, seen = lobes(), []
    result = mx.stability(case, "9000, 17000 rpm", depths="0.2:4:20 mm", progress=seen.append)
    assert result["limit_depth"].dims == ("analysis", "cut.spindle_speed")
    radius = result["spectral_radius"].to_numpy()
    for speed, row, limit in zip((9000, 17000), radius, result["limit_depth"].to_numpy()[0], strict=True):
        at = dataclasses.replace(case, cut=lobes(speed=speed * RPM).cut)
        assert limit == pytest.approx(float(mx.limit_depth(at)), rel=1e-6)
        depths = result["cut.depth"].to_numpy() * 1e-3
        assert (row[depths < limit] < 1).all()
        assert row[depths > limit][0] >= 1
    assert (seen[-1].method, seen[-1].done, seen[-1].total) == ("semi", 2, 2)


@pytest.mark.parametrize(
    ("case", "message"),
    [
        (slot(axes=()), r"structure: the tool is rigid"),
        (slot(axes=("z",)), r"structure: the tool is rigid in the plane"),
        (slot(feed=0.0), r"cut.feed_rate: 0 m/s given"),
        (slot(stock=mx.Stock.box((0.0, None), (None, -0.02))), r"no tooth meets the stock"),
        (slot(stock=mx.Stock([[0.6, 0.8]], [0.0])), r"oblique to the feed"),
    ],
    ids=["rigid", "along z", "no feed", "in air", "oblique"],
)
def test_where_there_is_no_limit(case, message):
    with pytest.raises(ValueError, match=message):
        mx.limit_depth(case)


def test_what_cannot_be_used_is_refused():
    case = lobes()
    with pytest.raises(ValueError, match=r'speeds: "3000:4000 rpm" given, without how many'):
        mx.stability(case, "3000:4000 rpm")
    with pytest.raises(ValueError, match=r"speeds.*mm cannot be converted"):
        mx.stability(case, "3000, 4000 mm")
    with pytest.raises(ValueError, match=r"depths: -1 mm given"):
        mx.stability(case, "3000 rpm", depths="-1, 1 mm")
    with pytest.raises(ValueError, match=r"method: 'zoa' given; it must be one of semi, floquet, time"):
        mx.limit_depth(case, method="zoa")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"outside jit"):
        eqx.filter_jit(mx.limit_depth)(case)
    with pytest.raises(ValueError, match=r'derivatives are there with "semi"'):
        jax.grad(lambda case: mx.limit_depth(case, method="time"))(case)
    assert along_feed(mx.Stock.box((0.0, 1.0), (-1.0, 1.0))) == (2, 3)


FILE = """\
[tool]
diameter = "20 mm"
teeth = 2
[force]
law = "linear"
kt = "600 N/mm^2"
kr = 0.3333
ke = "0 N/mm"
[cut]
spindle_speed = "9000 rpm"
feed_per_tooth = "1 um"
depth = "1 mm"
[simulation]
duration = "0.01 s"
steps_per_tooth = 80
"""
STRUCTURE = """
[structure]
axes = ["x"]
mass = "0.03993 kg"
stiffness = "1.34 N/um"
damping_ratio = 0.011
"""


def test_the_command(tmp_path, capsys):
    path, out = tmp_path / "case.toml", tmp_path / "result"
    path.write_text(FILE + STRUCTURE)
    arguments = ["stability", str(path), "--out", str(out), "--speeds", "8000, 10000 rpm"]
    assert main([*arguments, "--methods", "semi"]) == 0
    assert {file.name for file in out.iterdir()} == {"stability.nc", "stability.png"}
    assert (out / "stability.png").read_bytes().startswith(b"\x89PNG")
    with xarray.open_dataset(out / "stability.nc", engine="h5netcdf") as result:
        assert result["limit_depth"].sizes == {"analysis": 1, "cut.spindle_speed": 2}
        assert (result["limit_depth"] > 0).all()
    assert "2 of 2 speeds" in capsys.readouterr().out
    assert main([*arguments, "--methods", "semi", "--depths", "1, 2 um"]) == 1
    assert "no limit of stability was found" in capsys.readouterr().err
    assert main([*arguments, "--methods", "magic"]) == 2
    assert "it must be one of semi, floquet, time" in capsys.readouterr().err
    path.write_text(FILE)
    assert main(arguments) == 2
    assert "Give the case a [structure]" in capsys.readouterr().err
