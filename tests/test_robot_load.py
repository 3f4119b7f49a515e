"""URDF files: the robot that comes out beside Pinocchio's, and what is refused or warned of."""

import re
import warnings

import jax
import numpy as np
import pytest
from robots import CHAIN, FIXED, FIXED_LINKS, LIMIT, joint, link, robot

from millax.robot import load_urdf

FIELD = np.array([0.4, -0.3, -9.81])


def test_a_chain_with_fixed_links_is_that_of_pinocchio():
    pytest.importorskip("pinocchio")
    from benchmarks import pinocchio_models

    theirs = pinocchio_models.from_urdf(CHAIN, "tool")
    ours = load_urdf(FIXED_LINKS)
    q = np.random.default_rng(1).uniform(-2, 2, (1000, 3))
    computed = jax.jit(jax.vmap(lambda q: (ours.pose(q), ours.jacobian(q), ours.gravity(q, FIELD), ours.mass_matrix(q))))(q)
    for mine, other in zip(computed, pinocchio_models.evaluated(theirs, q, np.zeros(3), FIELD), strict=True):
        assert np.abs(np.asarray(mine) - other).max() < 1e-10 * np.abs(other).max()
    for i, body in enumerate(list(theirs.model.inertias)[1:]):
        np.testing.assert_allclose(ours.mass[i], body.mass, rtol=1e-12)
        np.testing.assert_allclose(ours.centre_of_mass[i], body.lever, atol=1e-12)
        np.testing.assert_allclose(ours.inertia[i], body.inertia, atol=1e-11)
    assert ours.names == ("turn", "lift", "tilt")
    assert ours.kinds == ("revolute", "prismatic", "revolute")
    np.testing.assert_array_equal(ours.lower, [-np.inf, -2, -2])
    np.testing.assert_array_equal(ours.upper, [np.inf, 1.5, 1.5])


def homogeneous(frames, i):
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = frames.rotation[i], frames.position[i]
    return pose


def test_a_part_of_the_chain():
    whole, q = load_urdf(CHAIN), np.array([0.4, 0.3, -0.7])
    frames = whole.frames(q)
    # The foot is fixed to the world: the same joints, seen from elsewhere.
    inside = load_urdf(CHAIN, base="foot")
    assert inside.names == whole.names
    foot = homogeneous(frames, 0) @ np.linalg.inv(homogeneous(inside.frames(q), 0))
    np.testing.assert_allclose(foot[:3, 3], [0.1, 0.2, 0.9], atol=1e-14)
    np.testing.assert_allclose(foot @ inside.pose(q), whole.pose(q), atol=1e-14)
    # From the carriage on there is one joint, as there is from the bracket on, which is fixed to it.
    last = load_urdf(CHAIN, base="carriage")
    assert last.names == load_urdf(CHAIN, base="bracket").names == ("tilt",)
    np.testing.assert_allclose(homogeneous(frames, 1) @ last.pose(q[2:]), whole.pose(q), atol=1e-14)
    # Up to the spindle: the tool is missing, but not its share of the mass.
    short = load_urdf(CHAIN, tip="spindle")
    np.testing.assert_allclose(np.linalg.norm((short.pose(q) - whole.pose(q))[:3, 3]), 0.15)
    np.testing.assert_array_equal(short.mass, whole.mass)


ARM = (
    link("a"),
    joint("one", "revolute", "a", "b"),
    link("b", 5.0),
    joint("two", "revolute", "b", "c"),
    link("c", 3.0),
)


def test_the_default_axis_and_limits_are_those_of_the_format():
    text = robot(*ARM[:4], link("c", 3.0)).replace('<axis xyz="0 0 1"/>' + LIMIT, "")
    ours = load_urdf(text)
    np.testing.assert_array_equal(ours.axis, [[1, 0, 0], [1, 0, 0]])
    ours.check([100.0, -100.0])


@pytest.mark.parametrize(
    ("text", "arguments", "message"),
    [
        (
            robot(*ARM, joint("fly", "floating", "c", "d"), link("d")),
            {},
            "joint fly: type 'floating' given; .* revolute, continuous",
        ),
        (
            robot(*ARM, joint("m", "revolute", "c", "d", more='<mimic joint="one"/>'), link("d")),
            {},
            "joint m: it follows another",
        ),
        (robot(*ARM, joint("bar", "revolute", "a", "c")), {}, "link c: carried by two joints, two and bar: .* loop"),
        (robot(*ARM, joint("back", "revolute", "c", "a")), {}, "link a: it is part of a loop"),
        (robot(*ARM, joint("back", "fixed", "c", "a", **FIXED)), {"base": "b"}, "link a: it is part of a loop"),
        (robot(*ARM), {"base": "z"}, "base: 'z' given; the links are a, b, c"),
        (robot(*ARM), {"tip": "z"}, "tip: 'z' given; the links are a, b, c"),
        (robot(*ARM), {"base": "c", "tip": "b"}, "tip: b is not carried by c; give a base between a and b"),
        (robot(*ARM), {"tip": "a"}, "tip: no joint moves between a and a"),
        (robot(*ARM, joint("x", "revolute", "b", "d"), link("d")), {}, "tip: several links end the robot: c, d; give"),
        (robot(*ARM, link("d")), {}, "base: several links are carried by no joint: a, d; give"),
        (
            robot(link("a"), joint("x", "fixed", "a", "b", **FIXED), link("b")),
            {},
            "tip: no joint moves between a and b; give",
        ),
        (
            robot(*ARM[:3], joint("two", "revolute", "b", "c", axis="0 0 0"), link("c")),
            {},
            "joint two: an axis of no length",
        ),
        (
            robot(*ARM[:3], joint("two", "revolute", "b", "c", axis="0 0 z"), link("c")),
            {},
            "joint two, axis: xyz='0 0 z' given",
        ),
        (
            robot(*ARM[:3], joint("two", "revolute", "b", "c", xyz="0 0"), link("c")),
            {},
            "joint two, origin: xyz='0 0' .* 3 finite",
        ),
        (
            robot(*ARM[:3], joint("two", "revolute", "b", "c", rpy="0 0 inf"), link("c")),
            {},
            "joint two, origin: rpy='0 0 inf'",
        ),
        (robot(*ARM).replace('upper="1.5"', 'upper="-3"'), {}, "joint one: limits from -2 to -3 given; the first must be"),
        (
            robot(*ARM, joint("x", "fixed", "c", "d", **FIXED)),
            {},
            "joint x: its child is 'd'; the links of the file are a, b, c",
        ),
        (robot(*ARM, link("a")), {}, "link a: given twice"),
        (robot(*ARM, joint("one", "fixed", "c", "d", **FIXED), link("d")), {}, "joint one: given twice"),
        (robot(*ARM).replace('<child link="b"/>', ""), {}, r'joint one: no child given; add <child link="\.\.\."/>'),
        (robot(*ARM).replace('name="two" ', ""), {}, "URDF: a <joint> without a name"),
        (robot(*ARM).replace('<mass value="5.0"/>', ""), {}, "link b, inertial: no mass given"),
        (robot(*ARM).replace('"5.0"', '"-5"'), {}, "link b, inertial: a mass of -5 kg given"),
        (robot(), {}, "URDF: no link in it"),
        ("<sdf/>", {}, "URDF: the root element is <sdf>; it must be <robot>"),
        (robot(*ARM)[:-20], {}, r"URDF: not well-formed XML \(.*line 2"),
        (
            '<robot xmlns:xacro="http://ros.org/wiki/xacro"><xacro:include filename="x"/></robot>',
            {},
            "<xacro:include> is to be exp",
        ),
        (robot(*ARM).replace('"5.0"', '"${m}"'), {}, "<mass> is to be expanded first: this is a xacro file"),
        ('<!DOCTYPE r [<!ENTITY a "aaaa">]><robot name="&a;"/>', {}, "URDF: it has a document type or entities"),
        ('<!DOCTYPE r SYSTEM "http://example.com/r.dtd"><robot/>', {}, "URDF: it has a document type or entities"),
    ],
)
def test_what_is_refused(text, arguments, message):
    with pytest.raises(ValueError, match=re.compile(message, re.DOTALL)):
        load_urdf(text, **arguments)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(FileNotFoundError):
        load_urdf(tmp_path / "none.urdf")


@pytest.mark.parametrize(
    ("text", "arguments", "message"),
    [
        (robot(*ARM[:4], link("c")), {}, "no mass given for c, and so none taken for any link: kinematics work"),
        (re.sub(r"<inertia [^>]*>", "", robot(*ARM)), {}, "no inertia given for b, c, and so none .*: gravity works"),
        (
            robot(*ARM, joint("x", "revolute", "b", "d"), link("d")),
            {"tip": "c"},
            "not on the way to the tip: x; they are left out",
        ),
        (robot(*ARM), {"tip": "b"}, "not on the way to the tip: two; they"),
        (robot(*ARM).replace('"5.0"', '"4900"'), {}, "its links weigh 4903 kg together, much for an arm of 0.51 m"),
        (
            robot(*ARM, joint("three", "revolute", "c", "d"), link("d", 3.0)).replace('"5.0"', '"3.0"'),
            {},
            "all its links weigh the same, 3 kg; these look like placeholders",
        ),
        (robot(*ARM[:4], link("c", 3.0, xyz="0 50 0")), {}, "centre of mass of the link of two is 50 m from its joint"),
        (
            robot(*ARM[:4], link("c", 3.0, moments=(0.2, 0.3, 0.8))),
            {},
            "no body has the inertia of the link of two: .* exceeds",
        ),
        (
            robot(*ARM[:4], link("c", 3.0, moments=(0.2, 0.3, -0.1))),
            {},
            "inertia of the link of two is not positive definite",
        ),
    ],
)
def test_what_is_warned_of(text, arguments, message):
    with pytest.warns(UserWarning, match=message) as found:
        load_urdf(text, **arguments)
    assert len(found) == 1
    assert found[0].filename == __file__


def test_missing_numbers_are_missing_for_all_links():
    with pytest.warns(UserWarning, match="no mass given for c,"):
        without = load_urdf(robot(*ARM[:4], link("c")))
    assert without.mass is None
    assert without.centre_of_mass is None
    assert without.inertia is None
    with pytest.warns(UserWarning, match="no inertia given"):
        heavy = load_urdf(re.sub(r"<inertia [^>]*>", "", robot(*ARM)))
    assert heavy.inertia is None
    assert np.isfinite(heavy.gravity(np.zeros(2))).all()


def test_a_good_file_is_loaded_in_silence():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_urdf(robot(*ARM))
        load_urdf("\ufeff\n  " + robot(*ARM).replace('<?xml version="1.0"?>', ""))
