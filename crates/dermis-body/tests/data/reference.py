"""Writes branched.f64: 1,000 random joint states of branched.urdf, and three points in the root's frame by pinocchio.

Needs `pip install pin yourdfpy`, whose results must agree to 1e-12 m. A row is little-endian float64: rail, turn,
shoulder, elbow, finger; then x, y, z of the point (0.03, -0.02, 0.05) of each of palm, thumb_tip and finger_tip.
"""

from pathlib import Path

import numpy as np
import pinocchio
import yourdfpy

HERE = Path(__file__).parent
FILE = HERE / "branched.urdf"
JOINTS = ["rail", "turn", "shoulder", "elbow", "finger"]
LINKS = ["palm", "thumb_tip", "finger_tip"]
RAIL = np.linalg.norm([1, 2, 0.5])
POINT = np.array([0.03, -0.02, 0.05, 1.0])

rng = np.random.default_rng(37)
low, high = np.array([-0.5, -6.0, -2.5, -2.0, 0.0]), np.array([0.8, 6.0, 2.5, 2.0, 1.5])
states = low + (high - low) * rng.random((1000, 5))

# pinocchio's model ignores mimicry, so the values of mimicking joints are computed here.
model = pinocchio.buildModelFromUrdf(str(FILE))
data = model.createData()
robot = yourdfpy.URDF.load(str(FILE), load_meshes=False, build_scene_graph=True)
rows = []
for state in states:
    values = dict(zip(JOINTS, state))
    values["thumb"] = -0.5 * values["finger"] + 0.2
    q = pinocchio.neutral(model)
    for name, value in values.items():
        joint = model.joints[model.getJointId(name)]
        q[joint.idx_q : joint.idx_q + joint.nq] = [np.cos(value), np.sin(value)] if joint.nq == 2 else [value]
    pinocchio.framesForwardKinematics(model, data, q)
    # yourdfpy slides along the axis as written; pinocchio, and KDL, which ROS uses, along the unit axis.
    robot.update_cfg({name: values[name] / (RAIL if name == "rail" else 1) for name in JOINTS})
    points = []
    for link in LINKS:
        point = (data.oMf[model.getFrameId(link)].homogeneous @ POINT)[:3]
        other = (robot.get_transform(link) @ POINT)[:3]
        assert np.abs(point - other).max() < 1e-12, (link, point, other)
        points.append(point)
    rows.append(np.concatenate([state, *points]))
np.array(rows, dtype="<f8").tofile(HERE / "branched.f64")
print(pinocchio.__version__, yourdfpy.__version__, np.array(rows).shape)
