"""What a URDF file says: its links and joints as they stand there, numbers checked one by one."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element, ParseError

import numpy as np
from defusedxml import DefusedXmlException
from defusedxml.ElementTree import fromstring

from ._chain import Frames, rotation_of

MOVING = ("revolute", "continuous", "prismatic")
TYPES = (*MOVING, "fixed")


def inverse(place: Frames) -> Frames:
    """Where a frame stands in the one that stands at `place` in it."""
    return Frames(place.rotation.T, -place.rotation.T @ place.position)


def rpy_of(r: np.ndarray) -> np.ndarray:
    """Roll, pitch, yaw [rad] of a rotation. The roll is what is left after the other two, so that where the pitch is a right
    angle and yaw is anything, the three still are the rotation."""
    yaw, pitch = np.arctan2(r[1, 0], r[0, 0]), np.arctan2(-r[2, 0], np.hypot(r[0, 0], r[1, 0]))
    s, c = np.sin(yaw), np.cos(yaw)
    return np.array([np.arctan2(s * r[0, 2] - c * r[1, 2], c * r[1, 1] - s * r[0, 1]), pitch, yaw])


class Body(NamedTuple):
    """Mass [kg], centre of mass [m] and inertia about it [kg m²] (None where it is not given), in axes of a link."""

    mass: float
    centre: np.ndarray
    inertia: np.ndarray | None

    def at(self, place: Frames) -> "Body":
        """The same in the frame in which its link stands at `place`."""
        r = place.rotation
        return Body(self.mass, place.position + r @ self.centre, None if self.inertia is None else r @ self.inertia @ r.T)

    def with_body(self, other: "Body") -> "Body":
        """Both as one, by the parallel axis theorem."""
        mass = self.mass + other.mass
        if mass == 0:
            return self
        centre = (self.mass * self.centre + other.mass * other.centre) / mass
        inertia = [body.inertia_about(centre) for body in (self, other) if body.inertia is not None]
        return Body(mass, centre, inertia[0] + inertia[1] if len(inertia) == 2 else None)

    def inertia_about(self, point: np.ndarray) -> np.ndarray:
        assert self.inertia is not None
        d = self.centre - point
        return self.inertia + self.mass * (d @ d * np.eye(3) - np.outer(d, d))


@dataclass(frozen=True)
class Joint:
    """A joint of the file; limits in rad, of a sliding joint in m."""

    name: str
    type: str
    parent: str
    child: str
    place: Frames
    axis: np.ndarray
    lower: float
    upper: float


def read(path_or_text: str | Path) -> tuple[dict[str, Body | None], list[Joint]]:
    """Links by name, with what they weigh if that is given, and joints, in the order of the file."""
    root = _parsed(path_or_text)
    links: dict[str, Body | None] = {}
    for element in root.findall("link"):
        name = _name(element)
        if name in links:
            raise ValueError(f"link {name}: given twice; give every link a name of its own")
        links[name] = _body(element, name)
    joints = [_joint(element) for element in root.findall("joint")]
    if not links:
        raise ValueError("URDF: no link in it; a robot has at least two <link> and a <joint> between them")
    names = [joint.name for joint in joints]
    for joint in joints:
        if names.count(joint.name) > 1:
            raise ValueError(f"joint {joint.name}: given twice; give every joint a name of its own")
        for role, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in links:
                raise ValueError(f"joint {joint.name}: its {role} is {link!r}; the links of the file are {', '.join(links)}")
    return links, joints


def _parsed(path_or_text: str | Path) -> Element:
    text = path_or_text.lstrip("\ufeff \t\r\n") if isinstance(path_or_text, str) else ""
    given = text if text.startswith("<") else Path(path_or_text).read_bytes()
    try:
        root = fromstring(given, forbid_dtd=True)
    except ParseError as error:
        raise ValueError(f"URDF: not well-formed XML ({error}); look at that line, or export the file again") from None
    except DefusedXmlException:
        raise ValueError(
            "URDF: it has a document type or entities, which can make a small file huge or read other files, and which no "
            "robot needs; take <!DOCTYPE ...> and <!ENTITY ...> out"
        ) from None
    for element in root.iter():
        if "xacro" in element.tag or any(re.search(r"\$[{(]", value) for value in element.attrib.values()):
            raise ValueError(
                f"URDF: <{re.sub('{.*}', 'xacro:', element.tag)}> is to be expanded first: this is a xacro file. Expand it "
                "with `xacro robot.urdf.xacro > robot.urdf` (the xacro package of ROS), and load what that writes"
            )
    if root.tag != "robot":
        raise ValueError(f"URDF: the root element is <{root.tag}>; it must be <robot>")
    return root


def _name(element: Element) -> str:
    name = element.get("name")
    if not name:
        raise ValueError(f"URDF: a <{element.tag}> without a name; give it one")
    return name


def _numbers(element: Element | None, key: str, default: str, where: str) -> np.ndarray:
    """As many numbers as the default has."""
    text = default if element is None else element.get(key, default)
    try:
        found = np.array([float(word) for word in text.split()])
    except ValueError:
        found = np.array([])
    if len(found) != len(default.split()) or not np.isfinite(found).all():
        raise ValueError(
            f"{where}: {key}={text!r} given; it must be {len(default.split())} finite number(s), such as {default!r}"
        )
    return found


def _place(element: Element, where: str) -> Frames:
    origin = element.find("origin")
    xyz, rpy = (_numbers(origin, key, "0 0 0", f"{where}, origin") for key in ("xyz", "rpy"))
    return Frames(rotation_of(rpy), xyz)


def _body(element: Element, name: str) -> Body | None:
    inertial = element.find("inertial")
    if inertial is None:
        return None
    where = f"link {name}, inertial"
    given = inertial.find("mass")
    if given is None or given.get("value") is None:
        raise ValueError(f'{where}: no mass given; add <mass value="..."/> [kg], or leave the whole <inertial> out')
    (mass,) = _numbers(given, "value", "0", f"{where}, mass")
    if mass < 0:
        raise ValueError(f"{where}: a mass of {mass:g} kg given; it must be 0 or greater")
    moments = inertial.find("inertia")
    inertia = None
    if moments is not None:
        xx, xy, xz, yy, yz, zz = (
            _numbers(moments, key, "0", f"{where}, inertia")[0] for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        )
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return Body(float(mass), np.zeros(3), inertia).at(_place(inertial, where))


def _joint(element: Element) -> Joint:
    name, kind = _name(element), element.get("type", "none")
    where = f"joint {name}"
    if kind not in TYPES:
        raise ValueError(
            f"{where}: type {kind!r} given; it must be one of {', '.join(TYPES)}. Replace it by such joints, with links of "
            "no mass between them, or fix it"
        )
    if element.find("mimic") is not None:
        raise ValueError(
            f"{where}: it follows another joint (<mimic>); in a serial chain every joint moves by itself. Take <mimic> out "
            "where the joint is driven, or make it fixed"
        )
    parent, child = (_end(element, role, where) for role in ("parent", "child"))
    axis = _numbers(element.find("axis"), "xyz", "1 0 0", f"{where}, axis")
    length = np.linalg.norm(axis)
    if kind in MOVING and length == 0:
        raise ValueError(f"{where}: an axis of no length given, {axis}; it must be a direction, such as '0 0 1'")
    limit, lower, upper = element.find("limit"), -np.inf, np.inf
    if kind in ("revolute", "prismatic") and limit is not None:
        (lower,), (upper,) = (_numbers(limit, key, "0", f"{where}, limit") for key in ("lower", "upper"))
        if not lower < upper:
            raise ValueError(f"{where}: limits from {lower:g} to {upper:g} given; the first must be the smaller")
    return Joint(name, kind, parent, child, _place(element, where), axis / (length or 1.0), float(lower), float(upper))


def _end(element: Element, role: str, where: str) -> str:
    found = element.find(role)
    link = None if found is None else found.get("link")
    if not link:
        raise ValueError(f'{where}: no {role} given; add <{role} link="..."/>')
    return link
