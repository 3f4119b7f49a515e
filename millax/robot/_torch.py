"""A chain of pytorch-kinematics as a `Robot`. Imports neither it nor torch: whoever has a chain has both."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from ._chain import Frames, Robot
from ._load import HERE, placement, serial_chain
from ._urdf import Joint

TYPES = ("revolute", "prismatic", "fixed")


def from_pytorch_kinematics(chain: Any, tip: str | None = None) -> Robot:
    """The robot of a pytorch-kinematics chain, with its poses and Jacobians, from its first frame to the frame `tip`.

    Whatever pytorch-kinematics reads (URDF, SDF, MJCF) or is built of by hand can be had so: placements, axes, kinds and
    limits of the joints [m], [rad]. What is fixed to one another becomes one link; B is where the chain places its first
    frame. Of masses a chain knows nothing: they are None.

    The chain is taken for what it is, which need not be what its file says. The readers of pytorch-kinematics (0.8 to 0.10)
    round all but limits to single precision, which `chain.to(dtype=torch.float64)` does not undo. Of a URDF file they take z
    for an axis left out, which is x, and a joint that follows another for one that does not: `load_urdf` is the better
    reader. They take the angles of an SDF pose in reverse order, and move what an MJCF joint carries by its `pos`. Where a
    file gives no limits some of them write equal ones: those are none.

    **Arguments:**

    - `chain`: a `SerialChain`, which may also begin at any frame, or a `Chain`.
    - `tip`: the name of a frame. None: the last one, where there is only one.

    Raises `ValueError` for a `tip` that is unknown, is not given where several frames end the chain, or stands still, for
    types of joints other than revolute, prismatic and fixed, for names given twice, and where the first frame moves. Warns
    where a branch is left out.
    """
    first = chain.find_frame(chain.get_frame_names(exclude_fixed=False)[0])
    if first.joint.joint_type != "fixed":
        raise ValueError(
            f"frame {first.name}: the first of the chain, and moved by joint {first.joint.name}; put a fixed frame before it"
        )
    joints = list(_joints(first))
    frames = [first.name, *(joint.child for joint in joints)]
    for name in frames:
        if frames.count(name) > 1:
            raise ValueError(f"frame {name!r}: given twice; give every frame (of MJCF: body and site) a name of its own")
    return serial_chain(frames, joints, first.name, tip).robot(base=placement(_place(first)))


def _joints(parent) -> Iterator[Joint]:
    """Of every frame that the given one carries."""
    for frame in parent.children:
        yield _joint(parent.name, frame)
        yield from _joints(frame)


def _joint(parent: str, frame) -> Joint:
    joint = frame.joint
    if joint.joint_type not in TYPES:
        raise ValueError(f"joint {joint.name}: type {joint.joint_type!r} given; it must be one of {', '.join(TYPES)}")
    lower, upper = (-np.inf, np.inf) if joint.limits is None else map(float, joint.limits)
    if lower == upper:
        lower, upper = -np.inf, np.inf
    return Joint(joint.name, joint.joint_type, parent, frame.name, _place(frame), _array(joint.axis), lower, upper)


def _place(frame) -> Frames:
    """Of a frame in the one before, where its joint is at zero."""
    place = HERE
    for offset in (frame.link.offset, frame.joint.offset):
        if offset is not None:
            matrix = _array(offset.get_matrix())[0]
            place = place.then(Frames(matrix[:3, :3], matrix[:3, 3]))
    return place


def _array(tensor) -> np.ndarray:
    return np.asarray(tensor.detach().cpu(), dtype=float)
