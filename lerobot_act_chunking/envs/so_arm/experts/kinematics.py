# pyright: reportAttributeAccessIssue=false
# (mujoco ships no type stubs)
"""Inverse kinematics of the SO-101 by damped least squares, and the targets that make its servos get there.

A tool pose is (x, y, z, tilt, yaw): where the middle of a grasped cube is [m], how far the gripper leans back
from the vertical [rad], and the turn of its fingers about the vertical [rad].
"""

from functools import cache

import mujoco
import numpy as np

from lerobot_act_chunking.envs.so_arm.model import STIFFNESS, make_model
from lerobot_act_chunking.envs.so_arm.tasks import ARM_JOINTS, get_task
from lerobot_act_chunking.envs.so_arm.world import units_of
from lerobot_act_chunking.errors import ConfigurationError

_PAN_AXIS = 0.0388  # x [m] of the axis about which the arm turns
_METRE_PER_RADIAN = 0.1  # weighs errors of orientation against those of position
_DAMPING, _MOST_ITERATIONS = 1e-3, 40
_EXACT, _REACHED = 1e-5, 2e-3  # [m]; the second allows for the few directions that five joints do not have


class Kinematics:
    """The arm alone, to compute with; it is in no simulation."""

    def __init__(self) -> None:
        self._model = make_model(get_task("pick_place"))
        self._data = mujoco.MjData(self._model)
        self.units = units_of(self._model)
        self._site = self._model.site("grasp").id
        self._arm = np.array([self._model.joint(name).qposadr[0] for name in ARM_JOINTS])
        self._limits = np.array([self._model.joint(name).range for name in ARM_JOINTS]).T

    def forward(self, joints: np.ndarray) -> np.ndarray:
        """Tool pose (5,) of arm joints (5,) [rad]."""
        self._move(joints)
        position = self._data.site_xpos[self._site]
        pan = _bearing(*position[:2])
        turned = _turn(2, -pan) @ self._data.site_xmat[self._site].reshape(3, 3)
        tilt = float(np.arctan2(turned[0, 2], turned[2, 2]))
        rest = _turn(1, -tilt) @ turned
        return np.array([*position, tilt, pan + np.arctan2(rest[1, 0], rest[0, 0])])

    def inverse(self, tool: np.ndarray, start: np.ndarray) -> np.ndarray:
        """Arm joints (T, 5) [rad] at which the tool has the poses (T, 5), each sought from the one before it.

        Args:
            tool: poses along a path.
            start: (5,) joints [rad] from which the first is sought.

        Raises:
            ConfigurationError: a pose beyond the arm's reach.
        """
        path, joints = np.empty_like(tool), np.array(start, dtype=np.float64)
        for t, pose in enumerate(tool):
            joints = self._solve(pose, joints)
            path[t] = joints
        return path

    def against_gravity(self, joints: np.ndarray) -> np.ndarray:
        """Targets (T, 5) [rad] at which the servos, which give way under load, hold the joints (T, 5)."""
        targets = joints.copy()
        for t, each in enumerate(joints):
            self._move(each)
            mujoco.mj_comVel(self._model, self._data)
            mujoco.mj_rne(self._model, self._data, 0, self._data.qfrc_bias)
            targets[t] += self._data.qfrc_bias[: len(ARM_JOINTS)] / STIFFNESS
        return targets

    def _solve(self, pose: np.ndarray, joints: np.ndarray) -> np.ndarray:
        turn = _turn(2, _bearing(*pose[:2])) @ _turn(1, pose[3]) @ _turn(2, pose[4] - _bearing(*pose[:2]))
        error = np.zeros(6)
        for _ in range(_MOST_ITERATIONS):
            self._move(joints)
            error, jacobian = self._error(pose[:3], turn), self._jacobian()
            step = np.linalg.solve(
                jacobian.T @ jacobian + _DAMPING**2 * np.eye(len(joints)), jacobian.T @ error
            )
            joints = np.clip(joints + step, *self._limits)
            if np.abs(step).max() < _EXACT:
                break
        if np.linalg.norm(error[:3]) > _REACHED:
            x, y, z = pose[:3].round(3).tolist()
            raise ConfigurationError(
                f"the arm cannot reach x={x} y={y} z={z} m; place objects where the task does"
            )
        return joints

    def _error(self, position: np.ndarray, turn: np.ndarray) -> np.ndarray:
        present = self._data.site_xmat[self._site].reshape(3, 3)
        # Of two near frames: the mean of what takes each axis to where it should be.
        off = 0.5 * np.cross(present, turn, axis=0).sum(axis=1)
        return np.concatenate([position - self._data.site_xpos[self._site], _METRE_PER_RADIAN * off])

    def _jacobian(self) -> np.ndarray:
        move, turn = np.zeros((2, 3, self._model.nv))
        mujoco.mj_jacSite(self._model, self._data, move, turn, self._site)
        whole = np.concatenate([move, _METRE_PER_RADIAN * turn])
        return whole[:, : len(ARM_JOINTS)]

    def _move(self, joints: np.ndarray) -> None:
        self._data.qpos[self._arm] = joints
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)


@cache
def kinematics() -> Kinematics:
    """The arm's kinematics, made once; each result depends on its arguments alone."""
    return Kinematics()


def _bearing(x: float, y: float) -> float:
    return float(np.arctan2(y, x - _PAN_AXIS))


def _turn(axis: int, angle: float) -> np.ndarray:
    turn, (i, j) = np.eye(3), ((axis + 1) % 3, (axis + 2) % 3)
    turn[i, i] = turn[j, j] = np.cos(angle)
    turn[j, i], turn[i, j] = np.sin(angle), -np.sin(angle)
    return turn
