"""Robots beside pytorch-kinematics: beside a table of its results always, beside itself where it is installed."""

import json
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from robots import BUILT_IN, CHAIN, FIXED, SLIDING, files, joint, link, robot

from millax.robot import Robot, from_pytorch_kinematics, load_urdf
from millax.robot._urdf import read

TABLE = json.loads(Path(__file__).with_name("pytorch_kinematics.json").read_text(encoding="utf-8"))["robots"]
"""Of each robot, at some q, pose and Jacobian. Made by `pytorch_kinematics_table.py` in double precision."""
SINGLE = 1e-6
"""Agreement with a chain as pytorch-kinematics reads it, in single precision: some roundings of 6e-8."""

pytestmark = pytest.mark.filterwarnings("ignore:robot. no mass given")


def columns(rows) -> list[np.ndarray]:
    return [np.array([row[name] for row in rows]) for name in ("q", "pose", "jacobian")]


def assert_agrees(ours: Robot, rows, tolerance: float) -> None:
    q, *theirs = columns(rows)
    computed = jax.jit(jax.vmap(lambda q: (ours.pose(q), ours.jacobian(q))))(q)
    for mine, reference in zip(computed, theirs, strict=True):
        assert np.abs(np.asarray(mine) - reference).max() < tolerance * np.abs(reference).max()


@pytest.mark.parametrize("name", TABLE)
def test_files_give_the_poses_and_jacobians_of_the_table(name):
    assert_agrees(load_urdf(files()[name]), TABLE[name], 1e-10)


@pytest.mark.parametrize("name", BUILT_IN)
def test_built_in_robots_have_the_poses_and_jacobians_of_the_table(name):
    assert_agrees(BUILT_IN[name](), TABLE[name], 1e-10)


class Tensor(np.ndarray):
    """As much of a tensor of torch as is asked for."""

    def detach(self):
        return self

    cpu = detach


def offset(rotation=None, position=None):
    matrix = np.eye(4)
    matrix[:3, :3] = np.eye(3) if rotation is None else rotation
    matrix[:3, 3] = 0.0 if position is None else position
    return SimpleNamespace(get_matrix=lambda: matrix[None].view(Tensor))


def imitation(text: str):
    """A chain of pytorch-kinematics without its package, in double precision. As of MJCF, joints stand on offsets of links;
    as of URDF and SDF, limits that are not known are equal, or None."""
    links, joints = read(text)
    nothing = SimpleNamespace(joint_type="fixed", offset=None)
    frames = {n: SimpleNamespace(name=n, children=[], link=SimpleNamespace(offset=None), joint=nothing) for n in links}
    for one in joints:
        frame = frames[one.child]
        frame.link.offset = offset(position=one.place.position)
        frame.joint = SimpleNamespace(
            name=one.name,
            joint_type={"continuous": "revolute"}.get(one.type, one.type),
            axis=one.axis.view(Tensor),
            offset=offset(rotation=one.place.rotation),
            limits=None if one.type == "fixed" else (0, 0) if np.isinf(one.lower) else (one.lower, one.upper),
        )
        frames[one.parent].children.append(frame)
    return SimpleNamespace(find_frame=frames.get, get_frame_names=lambda exclude_fixed: list(frames))


@pytest.mark.parametrize("name", TABLE)
def test_a_chain_is_the_robot_of_its_file(name):
    text = files()[name]
    ours, expected = from_pytorch_kinematics(imitation(text)), load_urdf(text)
    assert (ours.names, ours.kinds) == (expected.names, expected.kinds)
    np.testing.assert_array_equal([ours.lower, ours.upper], [expected.lower, expected.upper])
    assert ours.mass is None
    assert_agrees(ours, TABLE[name], 1e-10)


def test_a_part_of_a_chain_and_what_branches_off():
    chain = imitation(CHAIN)
    ours, expected = from_pytorch_kinematics(chain, "spindle"), load_urdf(CHAIN, tip="spindle")
    q = np.array([0.4, 0.3, -0.7])
    np.testing.assert_allclose(ours.pose(q), expected.pose(q), atol=1e-14)
    with pytest.warns(UserWarning, match="not on the way to the tip: tilt; they are left out") as found:
        short = from_pytorch_kinematics(chain, "carriage")
    assert found[0].filename == __file__
    assert short.names == ("turn", "lift")


def test_the_first_frame_may_stand_elsewhere():
    chain, q = imitation(CHAIN), np.array([0.4, 0.3, -0.7])
    stand = offset([[0, -1, 0], [1, 0, 0], [0, 0, 1]], [0.3, -0.2, 1.5])
    chain.find_frame("world").joint.offset = stand
    expected = np.asarray(stand.get_matrix()[0] @ load_urdf(CHAIN).pose(q))
    np.testing.assert_allclose(from_pytorch_kinematics(chain).pose(q), expected, atol=1e-14)


def changed(change):
    chain = imitation(SLIDING)
    change(chain)
    return chain


FORKED = robot(link("a"), link("b"), joint("x", "revolute", "a", "b"), link("c"), joint("y", "prismatic", "a", "c"))
RIGID = robot(link("a"), link("b"), joint("x", "fixed", "a", "b", **FIXED))


@pytest.mark.parametrize(
    ("chain", "tip", "message"),
    [
        (imitation(SLIDING), "hand", "tip: 'hand' given; the links are floor, carriage, arm, quill, tool"),
        (imitation(FORKED), None, "tip: several links end the robot: b, c; give the one that holds the tool as `tip`"),
        (imitation(RIGID), None, "tip: no joint moves between a and b"),
        (imitation(SLIDING), "floor", "tip: no joint moves between floor and floor"),
        (
            changed(lambda chain: setattr(chain.find_frame("arm").joint, "joint_type", "screw")),
            None,
            "joint swing: type 'screw' given; it must be one of revolute, prismatic, fixed",
        ),
        (
            changed(lambda chain: setattr(chain.find_frame("floor"), "joint", chain.find_frame("arm").joint)),
            None,
            "frame floor: the first of the chain, and moved by joint swing; put a fixed frame before it",
        ),
        (
            changed(lambda chain: setattr(chain.find_frame("arm"), "name", "floor")),
            None,
            "frame 'floor': given twice; give every frame .* a name of its own",
        ),
    ],
)
def test_chains_that_are_refused(chain, tip, message):
    with pytest.raises(ValueError, match=message):
        from_pytorch_kinematics(chain, tip)


@pytest.fixture(scope="module")
def live():
    """The script that made the table: it needs torch and pytorch-kinematics."""
    pytest.importorskip("pytorch_kinematics")
    import pytorch_kinematics_table

    return pytorch_kinematics_table


@pytest.mark.parametrize("name", TABLE)
def test_the_table_is_what_pytorch_kinematics_computes(live, name):
    chain = live.serial_chain(files()[name])
    q, *stored = columns(TABLE[name])
    for now, then in zip(columns(live.reference(chain, q))[1:], stored, strict=True):
        np.testing.assert_allclose(now, then, atol=1e-12 * np.abs(then).max())
    # The placements that the script puts in are those that were read.
    as_read = live.pk.build_serial_chain_from_urdf(files()[name], "tool")
    for now, then in zip(columns(live.reference(as_read, q))[1:], stored, strict=True):
        np.testing.assert_allclose(now, then, atol=SINGLE * np.abs(then).max())


@pytest.mark.parametrize("name", TABLE)
def test_a_chain_of_pytorch_kinematics_is_the_robot_of_its_file(live, name):
    text = files()[name]
    assert_agrees(from_pytorch_kinematics(live.serial_chain(text)), TABLE[name], 1e-10)
    chain = live.pk.build_chain_from_urdf(text)
    ours, expected = from_pytorch_kinematics(chain), load_urdf(text)
    assert (ours.names, ours.kinds) == (expected.names, expected.kinds)
    np.testing.assert_array_equal([ours.lower, ours.upper], [expected.lower, expected.upper])
    assert ours.mass is None
    assert_agrees(ours, TABLE[name], SINGLE)


def assert_is(live, chain, names: tuple[str, ...], lower, upper) -> None:
    """The robot is the chain up to the frame "tool", with the placement of its first frame as a `Chain` and without it as a
    `SerialChain`."""
    ours = from_pytorch_kinematics(chain, "tool")
    assert ours.names == names
    np.testing.assert_array_equal([ours.lower, ours.upper], [lower, upper])
    q = np.random.default_rng(3).uniform(-2, 2, (5, len(names)))
    poses = chain.forward_kinematics(live.torch.tensor(q, dtype=chain.dtype))["tool"].get_matrix().tolist()
    for one, pose in zip(q, poses, strict=True):
        np.testing.assert_allclose(ours.pose(one), pose, atol=SINGLE * np.abs(pose).max())
    first = chain.get_frame_names(exclude_fixed=False)[0]
    serial = live.pk.SerialChain(chain, "tool", first)
    assert_agrees(from_pytorch_kinematics(serial), live.reference(serial, q), SINGLE)


INERTIAL = "<inertial><mass>1</mass><inertia>{}</inertia></inertial>".format(
    "".join(f"<{name}>{int(name[1] == name[2])}</{name}>" for name in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
)
SDF = f"""<sdf version="1.6"><model name="made-up">
<link name="base"><pose>0.1 0.2 0.3 0.4 -0.5 0.6</pose>{INERTIAL}</link>
<link name="arm"><pose>0.1 0.2 1.3 0.1 0.5 -0.6</pose>{INERTIAL}</link>
<link name="ram"><pose>0.5 -0.2 1.9 -1.1 0.2 2.6</pose>{INERTIAL}</link>
<link name="tool"><pose>0.6 -0.3 1.9 0.3 0.2 0.1</pose>{INERTIAL}</link>
<joint name="swing" type="revolute"><parent>base</parent><child>arm</child>
<axis><xyz>0 1 2</xyz><limit><lower>-1</lower><upper>2</upper></limit></axis></joint>
<joint name="slide" type="prismatic"><parent>arm</parent><child>ram</child><axis><xyz>1 0 0.5</xyz></axis></joint>
<joint name="mount" type="fixed"><parent>ram</parent><child>tool</child><axis><xyz>0 0 1</xyz></axis></joint>
</model></sdf>"""


def test_an_sdf_file(live):
    chain = live.pk.build_chain_from_sdf(SDF)
    assert_is(live, chain, ("swing", "slide"), [-1, -np.inf], [2, np.inf])


MJCF = """<mujoco><compiler angle="radian"/><worldbody>
<body name="arm" pos="0 0.2 1" quat="0.5 0.5 0.1 0.2">
<joint name="swing" pos="0.1 0.2 0.05" axis="0 1 1"/><geom size="0.1"/>
<body name="ram" pos="0.2 0.1 0.4">
<joint name="slide" type="slide" axis="1 0 0.5" range="-0.1 0.2"/><geom size="0.1"/>
<site name="tool" pos="0 0 0.2" euler="0 1 0.3"/></body></body></worldbody></mujoco>"""


def test_an_mjcf_file(live):
    pytest.importorskip("mujoco")
    try:
        chain = live.pk.build_chain_from_mjcf(MJCF)
    except KeyError as error:
        pytest.skip(f"this MuJoCo counts types of joints in a way that this pytorch-kinematics does not know: {error}")
    assert_is(live, chain, ("swing", "slide"), [-np.inf, -0.1], [np.inf, 0.2])
