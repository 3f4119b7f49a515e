"""A URDF file as a `Robot`: the chain from one of its links to another."""

import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ._chain import Frames, Placement, Robot
from ._plausible import implausible
from ._urdf import MOVING, Body, Joint, inverse, read, rpy_of

HERE = Frames(np.eye(3), np.zeros(3))


def load_urdf(path_or_text: str | Path, base: str | None = None, tip: str | None = None) -> Robot:
    """The serial chain of a URDF file, from the link `base` to the link `tip`.

    Revolute, continuous and prismatic joints become joints of the robot, continuous ones without limits. Links that are
    fixed to one another become one, with the mass, centre of mass and inertia of all of them; the base frame is that of the
    link `base`, the flange that of the link `tip`. Meshes, transmissions and the like are not read, files of other names not
    opened.

    **Arguments:**

    - `path_or_text`: a file, or its text (a string that begins with "<").
    - `base`: None: the link that no joint carries.
    - `tip`: None: the last link of the chain, where there is only one.

    Raises `ValueError` for what no serial chain can be made of, `OSError` for a file that cannot be read. Warns where masses
    or inertia are missing, in which case they are None for all links, where a branch of the robot is left out, and for
    numbers that no robot has: placeholders are common in such files.
    """
    links, joints = read(path_or_text)
    chain = serial_chain(list(links), joints, base, tip)
    robot = chain.robot(**_inertial(links, chain))
    for words in implausible(robot):
        warnings.warn(words, stacklevel=2)
    return robot


class Chain(NamedTuple):
    """The joints that move between two links, each with its origin O_i; the flange; and of each link of the robot the one
    that moves it, with where it stands in that one's frame."""

    joints: list[Joint]
    origins: list[Frames]
    flange: Frames
    leader: dict[str, str]
    place: dict[str, Frames]

    def robot(self, **others) -> Robot:
        """Its `Robot`, with what else is known of it."""
        return Robot(
            names=tuple(joint.name for joint in self.joints),
            kinds=tuple("prismatic" if joint.type == "prismatic" else "revolute" for joint in self.joints),
            xyz=np.array([origin.position for origin in self.origins]),
            rpy=np.array([rpy_of(origin.rotation) for origin in self.origins]),
            axis=np.array([joint.axis for joint in self.joints]),
            zero=np.zeros(len(self.joints)),
            flange=placement(self.flange),
            lower=np.array([joint.lower for joint in self.joints]),
            upper=np.array([joint.upper for joint in self.joints]),
            **others,
        )


def placement(frames: Frames) -> Placement:
    """The same as `Placement`, which has angles."""
    return Placement(frames.position, rpy_of(frames.rotation))


def serial_chain(links: list[str], joints: list[Joint], base: str | None, tip: str | None) -> Chain:
    """The chain from one link to another, None as in `load_urdf`; what is fixed to one another is one link.

    Warns of branches that are left out, as if by the caller of its caller.
    """
    carrier: dict[str, Joint] = {}
    for joint in joints:
        if joint.child in carrier:
            raise ValueError(
                f"link {joint.child}: carried by two joints, {carrier[joint.child].name} and {joint.name}: the chain is "
                "closed to a loop. Leave one out; of a parallelogram, the one that has no drive"
            )
        carrier[joint.child] = joint
    for name, link in (("base", base), ("tip", tip)):
        if link is not None and link not in links:
            raise ValueError(f"{name}: {link!r} given; the links are {', '.join(links)}")
    leader, place = _rigid_groups(links, carrier)
    base = _root(links, carrier) if base is None else base
    tip = _leaf(links, joints, leader) if tip is None else tip
    chain = _path(base, tip, carrier, leader)
    _warn_of_branches(chain, joints, leader)
    before = [inverse(place[base]).then(place[chain[0].parent]), *(place[joint.parent] for joint in chain[1:])]
    origins = [rigid.then(joint.place) for rigid, joint in zip(before, chain, strict=True)]
    return Chain(chain, origins, place[tip], leader, place)


def _path(base: str, tip: str, carrier: dict[str, Joint], leader: dict[str, str]) -> list[Joint]:
    """The joints that move between the two links, from base to tip."""
    chain: list[Joint] = []
    link = leader[tip]
    while link != leader[base]:
        if link not in carrier:
            raise ValueError(f"tip: {tip} is not carried by {base}; give a base between {link} and {tip}, or another tip")
        if carrier[link] in chain:
            raise _loop(link)
        chain.insert(0, carrier[link])
        link = leader[chain[0].parent]
    if not chain:
        raise ValueError(f"tip: no joint moves between {base} and {tip}; give a tip that moves, or a base below")
    return chain


def _rigid_groups(links, carrier: dict[str, Joint]) -> tuple[dict[str, str], dict[str, Frames]]:
    """Of each link the one nearest to the root among those it is fixed to, and where it stands in that one's frame."""
    leader, place = {}, {}
    for name in links:
        link, found, seen = name, HERE, set()
        while link in carrier and carrier[link].type == "fixed":
            if link in seen:
                raise _loop(link)
            seen.add(link)
            found = carrier[link].place.then(found)
            link = carrier[link].parent
        leader[name], place[name] = link, found
    return leader, place


def _loop(link: str) -> ValueError:
    return ValueError(
        f"link {link}: it is part of a loop of joints, or carried by one; a chain begins at a link that no joint carries"
    )


def _root(links, carrier) -> str:
    roots = [link for link in links if link not in carrier]
    if not roots:
        raise _loop(next(iter(links)))
    if len(roots) > 1:
        raise ValueError(
            f"base: several links are carried by no joint: {', '.join(roots)}; give the one to begin at as `base`"
        )
    return roots[0]


def _leaf(links, joints: list[Joint], leader) -> str:
    """The only link that carries nothing, not counting those beside a moving joint: a counterweight is no tip."""
    parents = {joint.parent for joint in joints}
    carriers = {leader[joint.parent] for joint in joints if joint.type in MOVING}
    leaves = [link for link in links if link not in parents and leader[link] not in carriers]
    if not leaves:
        raise _loop(next(iter(links)))
    if len(leaves) > 1:
        raise ValueError(f"tip: several links end the robot: {', '.join(leaves)}; give the one that holds the tool as `tip`")
    return leaves[0]


def _inertial(links: dict[str, Body | None], chain: Chain) -> dict[str, np.ndarray]:
    """Masses, centres of mass and inertia of the links that move, with those fixed to them, as far as all are known."""
    moving = [joint.child for joint in chain.joints]
    bodies: list[Body | None] = []
    for link in moving:
        found = None
        for other, body in links.items():
            if chain.leader[other] == link and body is not None:
                here = body.at(chain.place[other])
                found = here if found is None else found.with_body(here)
        bodies.append(found)
    known = [body for body in bodies if body is not None]
    if len(known) < len(bodies):
        _warn_of_missing("mass", [link for link, body in zip(moving, bodies, strict=True) if body is None])
        return {}
    centres = np.array([body.centre for body in known])
    weights = {"mass": np.array([body.mass for body in known]), "centre_of_mass": centres}
    inertia = [body.inertia for body in known]
    if any(one is None for one in inertia):
        _warn_of_missing("inertia", [link for link, one in zip(moving, inertia, strict=True) if one is None])
        return weights
    return weights | {"inertia": np.array(inertia)}


def _warn_of_missing(what: str, links: list[str]) -> None:
    needs = "kinematics work, gravity and dynamics do not" if what == "mass" else "gravity works, dynamics do not"
    warnings.warn(f"robot: no {what} given for {', '.join(links)}, and so none taken for any link: {needs}", stacklevel=4)


def _warn_of_branches(chain: list[Joint], joints: list[Joint], leader) -> None:
    carried = {leader[joint.parent] for joint in chain} | {chain[-1].child}
    beside = [j.name for j in joints if j.type in MOVING and j not in chain and leader[j.parent] in carried]
    if beside:
        warnings.warn(
            f"robot: not on the way to the tip: {', '.join(beside)}; they are left out, and all that they carry",
            stacklevel=4,
        )
