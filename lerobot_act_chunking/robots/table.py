"""The table at which a simulated robot stands: its world in real time, and its episodes.

Physics is not computed in a thread of its own but caught up with whenever somebody looks or acts: between two
looks the servos' targets do not change, so that the result is the same.
"""

import logging
from collections import deque
from collections.abc import Callable
from threading import RLock
from typing import Any, Literal
from weakref import WeakValueDictionary

import numpy as np
from lerobot.utils.errors import DeviceNotConnectedError

from lerobot_act_chunking.envs.so_arm.model import SUBSTEPS
from lerobot_act_chunking.envs.so_arm.success import Progress
from lerobot_act_chunking.envs.so_arm.tasks import sample_places
from lerobot_act_chunking.envs.so_arm.world import SoArmWorld

logger = logging.getLogger(__name__)

_ROUNDING = 1e-6  # [s]
_REMEMBERED = 300  # control steps of joint positions, for who looks late


class Table:
    """One world that goes on with the wall clock, from one episode to the next.

    Between episodes the objects are put elsewhere, and the arm stays where it is. LeRobot's commands announce
    to the person who operates the robot when an episode and when the time to reset begins; whoever stands at
    this table hears it too.

    Args:
        world: the simulation.
        seed: of the first episode's places; it counts up.
        clock: the time [s].
    """

    def __init__(self, world: SoArmWorld, seed: int, clock: Callable[[], float]) -> None:
        self.world, self.clock, self.seed = world, clock, seed
        self.lock = RLock()
        self.phase: Literal["free", "episode", "reset"] = "free"
        """``free`` as long as nobody announces anything."""
        self.outcomes: list[str | None] = []
        """How each finished episode failed; None where it succeeded."""
        self._started: float | None = None
        self._joints: deque[tuple[float, np.ndarray]] = deque(maxlen=_REMEMBERED)
        self._set_out()

    def start(self) -> None:
        """Let time begin, with the arm at home."""
        self._set_out()
        self.phase, self._started = "free", self.clock()
        self._remember()

    def stop(self) -> None:
        """Let time end, and tell how the last episode went."""
        self.catch_up()
        self._started = None
        self._judge()
        self.seed += 1
        succeeded = self.outcomes.count(None)
        logger.info("so_arm_sim: %d of %d episodes succeeded", succeeded, len(self.outcomes))

    def catch_up(self) -> None:
        """Compute what has happened since anybody last looked."""
        with self.lock:
            if self._started is None:
                return
            timestep = self.world.model.opt.timestep
            due = int((self.clock() - self._started + _ROUNDING) / timestep)
            while self._steps < due:
                steps = min(due - self._steps, SUBSTEPS - self._steps % SUBSTEPS)
                self.world.advance(steps)
                self._steps += steps
                if self._steps % SUBSTEPS == 0:
                    self._progress.update()
                    self._remember()

    def command(self, action: np.ndarray) -> None:
        """Give the servos new targets now."""
        with self.lock:
            self.catch_up()
            self.world.command(action)

    def joints(self, age: float = 0.0) -> np.ndarray:
        """Where the motors are (6,), or were ``age`` [s] ago."""
        with self.lock:
            self.catch_up()
            if not age:
                return self.world.joints()
            past = [joints for time, joints in self._joints if time <= self.clock() - age + _ROUNDING]
            return (past[-1] if past else self._joints[0][1]).copy()

    def block(self, joint: str) -> None:
        """Let a joint stick where it is from now on."""
        with self.lock:
            self.catch_up()
            self.world.block(joint)

    def show(self, data: Any) -> None:
        """Bring MuJoCo's ``data`` to where everything is now."""
        with self.lock:
            self.catch_up()
            self.world.copy_to(data)

    def hear(self, announcement: str) -> None:
        """Do what a person beside the robot does when LeRobot says this."""
        if announcement.startswith("Recording episode"):
            self.phase = "episode"
        elif announcement == "Reset the environment":
            self.phase = "reset"
            self.next_episode()

    def next_episode(self) -> None:
        """End the present episode and put the objects where the next one begins."""
        with self.lock:
            self.catch_up()
            self._judge()
            self.seed += 1
            self.world.place(self.places)
            self._progress = Progress(self.world)

    def _set_out(self) -> None:
        self._steps = 0
        self._joints.clear()
        self.world.reset(self.places)
        self._progress = Progress(self.world)

    def _judge(self) -> None:
        failure = None if self._progress.successes["released"] else self._progress.failure
        self.outcomes.append(failure)
        logger.info("so_arm_sim: the episode of seed %d %s", self.seed, _told(failure))

    @property
    def places(self) -> np.ndarray:
        """Where the objects lay when the present episode began, as the environment has them for its seed."""
        return sample_places(self.world.task, np.random.default_rng(self.seed))

    def _remember(self) -> None:
        started = self._started or 0.0
        time = started + self._steps * self.world.model.opt.timestep
        self._joints.append((time, self.world.joints()))


class Announcements(logging.Handler):
    """Passes on what LeRobot's commands say to the operator, which they also log.

    Args:
        hear: what to do with it.
    """

    def __init__(self, hear: Callable[[str], None]) -> None:
        super().__init__(logging.INFO)
        self._hear = hear

    def emit(self, record: logging.LogRecord) -> None:
        """Pass on one record of the root logger."""
        if record.name == "root":
            self._hear(record.getMessage())


_TABLES: WeakValueDictionary[str | None, Table] = WeakValueDictionary()


def set_up(robot_id: str | None, table: Table) -> None:
    """Let teleoperators in this process find the table of a robot."""
    _TABLES[robot_id] = table


def table_of(robot_id: str | None) -> Table:
    """The table of a robot in this process.

    Raises:
        DeviceNotConnectedError: there is no such robot.
    """
    table = _TABLES.get(robot_id)
    if table is None:
        known = ", ".join(map(str, _TABLES)) or "none"
        raise DeviceNotConnectedError(
            f"no so_arm_sim robot with id {robot_id} in this process (ids: {known}): the scripted operator "
            "needs --robot.type=so_arm_sim, and --teleop.robot_id where the robot has an id"
        )
    return table


def _told(failure: str | None) -> str:
    return "succeeded" if failure is None else f"failed: {failure}"
