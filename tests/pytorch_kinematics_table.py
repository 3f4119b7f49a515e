"""Poses and Jacobians by pytorch-kinematics, for those who do not have it. Run `python tests/pytorch_kinematics_table.py`
with the extra `torch` installed: it writes `pytorch_kinematics.json`, beside this file."""

import json
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytorch_kinematics as pk
import torch
from pytorch_kinematics.urdf_parser_py.urdf import URDF
from robots import files

import millax as mx

TABLE = Path(__file__).with_name("pytorch_kinematics.json")
POSES = 5


def serial_chain(text: str) -> pk.SerialChain:
    """The chain of a URDF file up to the link "tool", in double precision.

    pytorch-kinematics rounds what it reads to single precision, whatever precision it computes in. The numbers are put in
    once more here, by its own functions, from what its parser found.
    """
    chain = pk.build_chain_from_urdf(text).to(dtype=torch.float64)
    for found in URDF.from_xml_string(text).joints:
        joint = chain.find_joint(found.name)
        turned = pk.quaternion_from_euler(double(found.origin.rpy), "sxyz")
        joint.offset = pk.Transform3d(rot=turned, pos=double(found.origin.xyz), dtype=torch.float64)
        if joint.joint_type != "fixed":
            joint.axis = double(found.axis) / double(found.axis).norm()
    return pk.SerialChain(chain, "tool", dtype=torch.float64).to(dtype=torch.float64)


def double(numbers) -> torch.Tensor:
    return torch.tensor(numbers, dtype=torch.float64)


def reference(chain: pk.SerialChain, q) -> list[dict[str, list]]:
    """At each row of q the pose of the end and the Jacobian there, in the axes of the first frame, its linear part first."""
    coordinates = torch.tensor(np.asarray(q), dtype=chain.dtype)
    jacobian, pose = chain.jacobian(coordinates, ret_eef_pose=True)
    columns = (coordinates.tolist(), pose.tolist(), jacobian.tolist())
    return [dict(zip(("q", "pose", "jacobian"), row, strict=True)) for row in zip(*columns, strict=True)]


def main() -> None:
    mx.set_up()  # the built-in robots in double precision too
    rng = np.random.default_rng(1)
    robots = []
    for name, text in files().items():
        chain = serial_chain(text)
        rows = reference(chain, rng.uniform(-2, 2, (POSES, chain.n_joints)))
        robots.append(json.dumps(name) + ": [\n" + ",\n".join(map(json.dumps, rows)) + "]")
    versions = json.dumps({name: version(name) for name in ("torch", "pytorch-kinematics")})
    TABLE.write_text(f'{{"versions": {versions},\n"robots": {{\n' + ",\n".join(robots) + "}}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
