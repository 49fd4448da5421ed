# pyright: reportAttributeAccessIssue=false
# (mujoco ships no type stubs)
"""The ring, its gates and the mass, in MuJoCo; lengths in metres, seen from above."""

import mujoco
import numpy as np

from lerobot_act_chunking.errors import ActChunkingError, FeatureError

ACTION_NAMES = ("target_x", "target_y")
"""A name for each number of an action."""
FPS = 10
"""Control steps a second."""
LIMIT = 0.5
"""Largest coordinate of a target."""
RADIUS = 0.3
"""Of the ring, at the middle of its wall."""
START_RADIUS = 0.03
"""Of the disc around the centre in which episodes start."""
OUTSIDE = 0.36
"""Distance from the centre from which on the mass is behind the wall."""
_MASS_RADIUS, _WALL, _OPENING = 0.03, 0.02, 0.12
IN_A_GATE = RADIUS - _WALL
"""Distance from the centre beyond which the mass is between two ends of the wall."""

_ANGLES = np.deg2rad([90.0, 210.0, 330.0])
GATES = RADIUS * np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)
"""Middle of each gate, (3, 2). At equal distances: no gate lies between two others."""
_GATE_SECTOR = np.deg2rad(30.0)  # to either side of a gate's middle, for a mass that leaves fast and aslant

_SUBSTEPS = 10
_WALL_PIECES = 6  # straight ones, from a gate to the next


def make_model() -> mujoco.MjModel:
    """A mass on two slides, moved by position actuators, in a ring of straight pieces of wall."""
    half_opening = np.arcsin(_OPENING / 2 / RADIUS)
    edges = np.linspace(half_opening, np.deg2rad(120) - half_opening, _WALL_PIECES + 1)
    half_length = RADIUS * np.tan(np.diff(edges[:2])[0] / 2)
    middles = (edges[:-1] + edges[1:]) / 2 + _ANGLES[:, None]
    walls = "".join(
        f'<geom type="box" pos="{RADIUS * np.cos(angle)} {RADIUS * np.sin(angle)} 0" euler="0 0 {angle}" '
        f'size="{_WALL / 2} {half_length} .03" rgba=".35 .4 .5 1"/>'
        for angle in middles.flat
    )
    slides = "".join(
        f'<joint name="{name}" type="slide" axis="{axis}" damping="28"/>'
        for name, axis in (("x", "1 0 0"), ("y", "0 1 0"))
    )
    motors = "".join(
        f'<position joint="{name}" kp="200" ctrlrange="{-LIMIT} {LIMIT}"/>' for name in ("x", "y")
    )
    return mujoco.MjModel.from_xml_string(
        f"""<mujoco><compiler angle="radian"/><option timestep="{1 / FPS / _SUBSTEPS}" gravity="0 0 0"/>
        <worldbody><light pos="0 0 2"/><camera name="top" pos="0 0 1.2"/>
        <geom type="plane" size="1 1 .1" pos="0 0 -.03" rgba=".85 .85 .85 1" contype="0" conaffinity="0"/>
        {walls}<body>{slides}<geom size="{_MASS_RADIUS}" mass="1" rgba=".8 .2 .2 1"/></body></worldbody>
        <actuator>{motors}</actuator></mujoco>"""
    )


class ThreeGatesWorld:
    """The simulation; all of its state lives in ``model`` and ``data``."""

    def __init__(self) -> None:
        self.model = make_model()
        self.data = mujoco.MjData(self.model)

    def reset(self, position: np.ndarray) -> None:
        """Put the mass, at rest, at ``position`` (2,)."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = position
        mujoco.mj_forward(self.model, self.data)

    def step(self, target: np.ndarray) -> None:
        """Advance 0.1 s towards ``target`` (2,); MuJoCo clips it to -`LIMIT` .. `LIMIT`.

        Raises:
            FeatureError: wrong shape or not finite.
            ActChunkingError: the simulation diverged.
        """
        target = np.asarray(target)
        if target.shape != (2,) or not np.isfinite(target).all():
            raise FeatureError(f"an action is a target x, y: two finite numbers, got {target.tolist()}")
        self.data.ctrl[:] = target
        mujoco.mj_step(self.model, self.data, _SUBSTEPS)
        if self.data.warning.number.any():
            raise ActChunkingError("the three_gates simulation diverged")

    def qpos(self) -> np.ndarray:
        """Where the mass is, (2,)."""
        return self.data.qpos.copy()

    def qvel(self) -> np.ndarray:
        """Its velocity (2,) [m/s]."""
        return self.data.qvel.copy()

    def touches_wall(self) -> bool:
        """Whether the mass touches the wall, which is all that it can touch."""
        return bool(self.data.ncon)

    def gates(self) -> np.ndarray:
        """The gates' middles as seen from the mass, (6,): x and y of each."""
        return (GATES - self.data.qpos).ravel()


def gate_of(position: np.ndarray) -> int:
    """The gate behind which ``position`` (2,) is, wholly outside the ring; -1 of none."""
    if np.hypot(*position) < OUTSIDE:
        return -1
    away = np.abs((np.arctan2(position[1], position[0]) - _ANGLES + np.pi) % (2 * np.pi) - np.pi)
    return int(away.argmin()) if away.min() <= _GATE_SECTOR else -1
