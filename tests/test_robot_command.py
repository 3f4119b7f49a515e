"""`millax robot`, and what it computes: the arm at its pose and over two of its joints."""

import json
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
import xarray

import millax as mx
from identification.cli import main
from millax.robot import Arm, Beam, Loads, _map, models, modes, robot_at_tool, stiffness_map
from millax.robot._felt import damping_ratios
from millax.robot.plots import plot_robot, plot_stiffness_map

SLOT = Path(__file__).parents[1] / "docs" / "cases" / "kr270_slot.toml"
SMALL = ("--map", "robot.joints.joint_2=-80:-20:4 deg", "--map", "robot.joints.joint_3=1.7:2.3:3 rad")
TWO, THREE, FIVE = (f"robot.joints.joint_{i}" for i in (2, 3, 5))


@pytest.fixture(scope="module")
def arm() -> Arm:
    found = mx.load_case(SLOT).robot
    assert found is not None
    return found


@pytest.fixture(scope="module")
def out(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("robot") / "deep" / "out"
    assert main(["robot", str(SLOT), "--out", str(folder), *SMALL]) == 0
    return folder


def at(arm: Arm, joints) -> Arm:
    return eqx.tree_at(lambda a: a.joints, arm, jnp.asarray(joints))


def test_the_files_and_the_words(tmp_path, capsys):
    assert main(["robot", str(SLOT), "--out", str(tmp_path / "out"), *SMALL]) == 0
    assert {path.name for path in tmp_path.rglob("*.*")} == {"robot.json", "robot.nc", "robot.png", "stiffness_map.png"}
    for picture in ("robot.png", "stiffness_map.png"):
        assert (tmp_path / "out" / picture).read_bytes().startswith(b"\x89PNG")
    # Plain lines where nobody looks at a terminal, units and all.
    printed = capsys.readouterr().out
    lines = printed.splitlines()
    assert "\x1b" not in printed
    assert "  locked stiffness [N/µm]: x (feed) 3.081, y 2.678, z (spindle) 8.205" in lines
    assert "  tool centre point [m]: x 0, y -1.631, z 0.2446" in lines
    assert "  joint_1: x (feed) 0, y 97.41, z (spindle) 0" in lines
    assert any("12 poses" in line for line in lines)


def test_the_numbers_are_those_of_a_computation_by_hand(arm, out):
    found = json.loads((out / "robot.json").read_text())
    assert all(entry["definition"] and "unit" in entry for entry in found.values())
    value = {name: entry["value"] for name, entry in found.items()}

    robot, q, compliance = arm.robot, np.asarray(arm.joints), np.asarray(arm.compliance)
    frame = np.kron(np.eye(2), np.asarray(arm.workpiece))
    jacobian = frame.T @ np.asarray(robot.jacobian(q))
    inverse = np.linalg.inv(jacobian)
    stiffness = inverse.T @ np.diag(1 / compliance) @ inverse
    assert stiffness[1, 1] == pytest.approx(2.678e6, rel=1e-3)  # N/m
    assert value["stiffness"]["x"]["z"] == pytest.approx(stiffness[0, 2])
    parts = compliance[:, None] * jacobian[:3].T ** 2
    for i, axis in enumerate("xyz"):
        assert value["locked_stiffness"][axis] == pytest.approx(stiffness[i, i])
        assert value["free_stiffness"][axis] == pytest.approx(1 / parts[:, i].sum())
        shares = [value["contribution"][f"joint_{j + 1}"][axis] for j in range(6)]
        np.testing.assert_allclose(shares, parts[:, i] / parts[:, i].sum(), atol=1e-12)

    ellipsoid = np.linalg.eigvalsh(jacobian[:3] @ np.diag(compliance) @ jacobian[:3].T)
    np.testing.assert_allclose(list(value["principal_compliance"].values()), ellipsoid[::-1])
    # Joint and tool coordinates have the same frequencies, as there are six of each.
    squares = scipy.linalg.eigvalsh(np.diag(1 / compliance), np.asarray(robot.mass_matrix(q)))
    np.testing.assert_allclose(list(value["natural_frequency"].values()), np.sqrt(squares) / (2 * np.pi), rtol=1e-8)
    np.testing.assert_allclose(list(value["damping_ratio"].values()), 0.05, rtol=1e-6)
    np.testing.assert_allclose(
        [sum(shape.values()) for shape in value["workpiece_axes"].values()], [-1, 2**0.5, 0], atol=1e-12
    )


def test_the_labelled_results(arm, out):
    with xarray.open_dataset(out / "robot.nc", engine="h5netcdf") as found:
        structure = arm.structure()
        for name in ("mass", "damping", "stiffness"):
            np.testing.assert_allclose(found[name], getattr(structure, f"{name}_matrix"), rtol=1e-9, atol=1e-6)
        assert list(found["mass"]["row"].to_numpy()[3:]) == ["about_x", "about_y", "about_z"]
        np.testing.assert_allclose(np.linalg.norm(found["mode_shape"], axis=0), 1)
        # At rest the receptance is the compliance; at the first resonance far above it.
        still = found["receptance"].isel(frequency=0) * found["free_stiffness"]
        np.testing.assert_allclose(still, 1, atol=0.1)
        peak = found["receptance"].sel(axis="y").idxmax()
        assert float(peak) == pytest.approx(float(found["natural_frequency"][0]), rel=0.01)
        assert found["map_free_stiffness"].sizes == {TWO: 4, THREE: 3, "axis": 3}
        np.testing.assert_allclose(found[TWO], [-80, -60, -40, -20])
        assert found[TWO].attrs["units"] == "deg"
        assert found[THREE].attrs["units"] == "rad"


def test_a_map_is_what_single_poses_are(arm):
    loaded = eqx.tree_at(
        lambda a: a.loads, arm, Loads((100, 200, -50), (1, 2, 3), (0, 0, -9.81)), is_leaf=lambda x: x is None
    )
    found = stiffness_map(loaded, {TWO: "-80:-20:3 deg", THREE: "100, 120 deg"})
    for (i, j), lowest in np.ndenumerate(found["lowest_frequency"]):
        q = np.array(loaded.joints)
        q[1], q[2] = np.deg2rad([found[TWO][i], found[THREE][j]])
        one = at(loaded, q)
        compliance = np.linalg.inv(one.structure().stiffness)[:3, :3]
        np.testing.assert_allclose(found["free_stiffness"][i, j], 1 / np.diag(compliance), rtol=1e-8)
        least = 1 / np.linalg.eigvalsh((compliance + compliance.T)[:2, :2] / 2)[1]
        assert float(found["least_stiffness"][i, j]) == pytest.approx(least, rel=1e-8)
        assert lowest == pytest.approx(float(modes(one.structure().mass, one.structure().stiffness).frequency[0]), rel=1e-8)
        np.testing.assert_allclose(found["tool_position"][i, j], one.robot.pose(q)[:3, 3], atol=1e-12)


def test_a_map_goes_through_singular_poses(arm):
    """With the wrist stretched, at 0 of joint 5, there is no stiffness matrix."""
    found = stiffness_map(arm, {THREE: "110:130:3 deg", FIVE: "-1e-3, 0, 1e-3 deg"})
    for name in ("free_stiffness", "lowest_frequency"):
        values = found[name].to_numpy()
        assert np.isfinite(values).all()
        np.testing.assert_allclose(values[:, 1], (values[:, 0] + values[:, 2]) / 2, rtol=1e-6)


def test_a_map_is_one_program(arm, monkeypatch):
    """However many its poses are: they are traced once, or twice where the last ones are fewer."""
    traced = []
    one = _map._at
    monkeypatch.setattr(_map, "_at", lambda arm: traced.append(isinstance(arm.joints, jax.core.Tracer)) or one(arm))
    assert stiffness_map(arm)["lowest_frequency"].shape == (41, 41)
    assert traced in ([True], [True, True])


@pytest.mark.long
def test_under_loads(arm):
    force = np.array([100.0, 200.0, -50.0])
    loaded = eqx.tree_at(lambda a: a.loads, arm, Loads(force), is_leaf=lambda x: x is None)
    found = robot_at_tool(loaded)
    moved = found["compliance"].to_numpy()[:3, :3] @ force
    np.testing.assert_allclose(found["static_deflection"], moved, rtol=1e-3, atol=1e-7)
    np.testing.assert_allclose(found["contribution"].sum("spring"), 1, rtol=1e-10)


def test_where_the_springs_do_not_hold_the_loads_is_nothing(arm):
    def pushed(force):
        return eqx.tree_at(lambda a: a.loads, arm, Loads((0, 0, force)), is_leaf=lambda x: x is None)

    values = {TWO: "-80:-20:5 deg", THREE: "90:150:5 deg"}
    lost = np.isnan(stiffness_map(pushed(2e6), values)["lowest_frequency"].to_numpy())
    assert 0 < lost.sum() < lost.size
    with pytest.raises(ValueError, match="at no pose of the map do the springs hold them"):
        stiffness_map(pushed(1e7), values)


def test_default_values_are_between_the_limits_and_beyond_them_is_nothing():
    limited = Arm(models.kuka_kr210_r2700_2(), np.deg2rad([0, -90, 90, 0, 30, 0]), np.full(6, 1e-6), damping_ratio=0.05)
    found = stiffness_map(limited)
    np.testing.assert_allclose([found[TWO][0], found[TWO][-1], found[THREE][0], found[THREE][-1]], [-140, -5, -120, 168])
    assert found["lowest_frequency"].notnull().all()
    beyond = stiffness_map(limited, {TWO: "-160:-100:4 deg", THREE: "80, 90 deg"})
    np.testing.assert_array_equal(np.isnan(beyond["lowest_frequency"][:, 0]), [True, False, False, False])
    np.testing.assert_array_equal(np.isnan(beyond["free_stiffness"][:, 0, 2]), [True, False, False, False])
    # The elbow bends both ways: every place is reached twice, and the picture is one of angles.
    assert plot_stiffness_map(found).axes[2].get_xlabel() == f"{TWO} [deg]"
    assert "height" in plot_stiffness_map(beyond).axes[2].get_ylabel()
    with pytest.raises(ValueError, match="every pose given is beyond the limits"):
        stiffness_map(limited, {TWO: "10, 20 deg", THREE: "80, 90 deg"})


@pytest.mark.long
def test_elastic_links_have_their_part(arm):
    tubes = {"joint_2": Beam.tube(0.3, 0.28)}
    elastic = Arm(arm.robot, arm.joints, arm.compliance, damping=np.full(6, 50.0), beams=tubes)
    found = robot_at_tool(elastic)
    assert list(found["spring"].to_numpy()[:3]) == ["joint_1", "joint_2", "link of joint_2"]
    assert found.sizes["spring"] == 7
    np.testing.assert_allclose(found["contribution"].sum("spring"), 1, rtol=1e-10)
    assert float(found["contribution"].sel(spring="link of joint_2", axis="x")) > 0.01
    assert (found["damping_ratio"] > 0).all()
    over = stiffness_map(elastic, {TWO: "-50, -40 deg", THREE: "110, 120 deg"})
    assert float(over["lowest_frequency"][0, 1]) == pytest.approx(float(found["natural_frequency"][0]), rel=1e-6)
    plot_robot(found)


def test_damping_ratios_of_any_damping():
    mass, stiffness = np.diag([2.0, 1.0, 3.0]), np.diag([8.0, 100.0, 75.0])
    ratio = np.array([0.1, 3.0, 0.02])  # the second does not vibrate
    damping = np.diag(2 * ratio * np.sqrt(np.diag(mass) * np.diag(stiffness)))
    shapes = np.asarray(modes(jnp.asarray(mass), jnp.asarray(stiffness)).shapes)
    np.testing.assert_allclose(damping_ratios(mass, damping, stiffness, shapes), [0.1, 0.02, 1.0], rtol=1e-9)


def test_a_case_without_a_robot(tmp_path, capsys):
    case = SLOT.with_name("kr240_2dof.toml")
    assert main(["robot", str(case), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert f"error: {case}: no table [robot], so no robot to look at" in error
    assert "kr270_slot.toml" in error
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("maps", "words"),
    [
        ([f"{TWO}=-80:-20:4 deg"], "give two of them"),
        ([f"{TWO}=-80:-20:4 deg"] * 2, "given twice"),
        ([f"{TWO}:-80", f"{THREE}=1,2 rad"], "it must be NAME=VALUES"),
        (
            ["joint_2=-80:-20:4 deg", f"{THREE}=1,2 rad"],
            "joint_2: this is no joint of the robot; its joints are robot.joints.joint_1",
        ),
        ([f"{TWO}=-80:-20:4", f"{THREE}=1,2 rad"], 'without a unit; it takes "-120:-20:41 deg"'),
        ([f"{TWO}=-80:-20:4 mm", f"{THREE}=1,2 rad"], "cannot be converted to rad"),
        ([f"{TWO}=30 deg", f"{THREE}=1,2 rad"], "it takes values that differ"),
    ],
)
def test_maps_that_are_none(maps, words, tmp_path, capsys):
    arguments = [part for text in maps for part in ("--map", text)]
    assert main(["robot", str(SLOT), "--out", str(tmp_path / "out"), *arguments]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert "Traceback" not in error
    assert not (tmp_path / "out").exists()
