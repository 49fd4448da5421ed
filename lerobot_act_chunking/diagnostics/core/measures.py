"""Actions as points in space, so that the difference between two of them is a distance."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from lerobot_act_chunking.data.dimension_names import dimension_names
from lerobot_act_chunking.envs.aloha.experts import kinematics
from lerobot_act_chunking.envs.aloha.tasks import JOINT_NAMES, mjcf_path

_SIDES: tuple[kinematics.Arm, kinematics.Arm] = ("left", "right")
_MM = 1000.0


class Measure(Protocol):
    """What an action means in space."""

    @property
    def unit(self) -> str:
        """Unit of the coordinates."""
        ...

    @property
    def names(self) -> Sequence[str]:
        """One per point."""
        ...

    def points(self, actions: np.ndarray) -> np.ndarray:
        """Coordinates (..., P, C) of actions (..., A)."""
        ...


@dataclass(frozen=True)
class RawUnits:
    """Every action dimension is a point on a line of its own, in the units of the dataset."""

    names: Sequence[str]
    unit: str = "raw units"

    def points(self, actions: np.ndarray) -> np.ndarray:
        """Coordinates (..., A, 1)."""
        return np.asarray(actions, np.float64)[..., None]


@dataclass(frozen=True)
class AlohaGraspPoints:
    """The points between the fingertips of ALOHA's two arms, from joint targets, by forward kinematics [mm].

    Link poses and axes are read from gym-aloha's MuJoCo model. The closed form of the experts
    (`envs.aloha.experts.kinematics`) presumes that the forearm does not roll, which policies do not know; it
    says where on the last link the grasp point sits. How far the grippers are open does not count.
    """

    names: Sequence[str] = tuple(f"{side} gripper" for side in _SIDES)
    unit: str = "mm"

    def points(self, actions: np.ndarray) -> np.ndarray:
        """Coordinates (..., 2, 3) of actions (..., 14) in the order of ``JOINT_NAMES``."""
        actions = np.asarray(actions, np.float64)
        joints = actions.reshape(-1, 2, len(JOINT_NAMES) // 2)[..., :-1]  # without grippers
        points = [chain.tip(joints[:, arm]) for arm, chain in enumerate(self._chains)]
        return _MM * np.stack(points, axis=1).reshape(*actions.shape[:-1], 2, 3)

    @cached_property
    def _chains(self) -> list["_Chain"]:
        return [_read_chain(side) for side in _SIDES]


@dataclass(frozen=True)
class _Chain:
    """One arm: its base, each link's offset (J, 3) [m] from its parent and joint axis (J, 3), its tip."""

    base: np.ndarray
    facing: np.ndarray
    offsets: np.ndarray
    axes: np.ndarray
    tip_offset: np.ndarray

    def tip(self, joints: np.ndarray) -> np.ndarray:
        """World positions (n, 3) [m] of the grasp point at joint angles (n, J)."""
        position, frame = self.last_link(joints)
        return position + frame @ self.tip_offset

    def last_link(self, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions (n, 3) and frames (n, 3, 3) of the link that carries the gripper."""
        from scipy.spatial.transform import Rotation

        position = np.broadcast_to(self.base, (len(joints), 3))
        frame = np.broadcast_to(self.facing, (len(joints), 3, 3))
        for joint, (offset, axis) in enumerate(zip(self.offsets, self.axes, strict=True)):
            position = position + frame @ offset
            frame = frame @ Rotation.from_rotvec(joints[:, joint, None] * axis).as_matrix()
        return position, frame


def _read_chain(side: kinematics.Arm) -> _Chain:
    import mujoco
    from scipy.spatial.transform import Rotation

    model = mujoco.MjModel.from_xml_path(str(mjcf_path("transfer_cube")))  # pyright: ignore[reportAttributeAccessIssue]
    body = model.body(f"vx300s_{side}/gripper_link").id
    offsets, axes = [], []
    while model.body_jntnum[body]:
        offsets.append(model.body_pos[body].copy())
        axes.append(model.jnt_axis[model.body_jntadr[body]].copy())
        body = model.body_parentid[body]
    facing = Rotation.from_quat(model.body_quat[body], scalar_first=True).as_matrix()
    chain = _Chain(
        model.body_pos[body].copy(), facing, np.array(offsets[::-1]), np.array(axes[::-1]), np.zeros(3)
    )
    home = np.array(kinematics.HOME_JOINTS)
    position, frame = chain.last_link(home[None])
    return replace(chain, tip_offset=frame[0].T @ (kinematics.forward(side, home)[:3] - position[0]))


def is_aloha(action_names: Sequence[str]) -> bool:
    """Whether these are ALOHA's 14 joint targets, under our names or LeRobot's (without ``_arm``)."""
    return tuple(name.replace("_arm_", "_") for name in action_names) == tuple(
        name.replace("_arm_", "_") for name in JOINT_NAMES
    )


def distances(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Distance (...) between two sets of points (..., P, C): that of the pair that is farthest apart."""
    return np.linalg.norm(points - others, axis=-1).max(-1)


def measure_of(action: dict[str, Any]) -> Measure:
    """Grasp points for ALOHA's joints, raw units for all other actions of a LeRobot feature."""
    names = dimension_names(action)
    return AlohaGraspPoints() if is_aloha(names) else RawUnits(names)
