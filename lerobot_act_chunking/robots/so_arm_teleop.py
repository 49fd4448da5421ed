"""A scripted person at a leader arm, as a LeRobot teleoperator."""

from contextlib import suppress
from typing import Any

import numpy as np
from lerobot.lerobot_types import RobotAction
from lerobot.teleoperators.teleoperator import Teleoperator
from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected
from lerobot.utils.errors import DeviceNotConnectedError

from lerobot_act_chunking.envs.demonstration import minimum_jerk
from lerobot_act_chunking.envs.so_arm.env import FPS
from lerobot_act_chunking.envs.so_arm.experts import plan
from lerobot_act_chunking.envs.so_arm.options import SoArmOptions
from lerobot_act_chunking.envs.so_arm.tasks import NAMES
from lerobot_act_chunking.envs.so_arm.world import HOME
from lerobot_act_chunking.recording.simulated import noise_stream
from lerobot_act_chunking.recording.so_arm import SoArmSource
from lerobot_act_chunking.robots.config_so_arm_teleop import SoArmTeleopConfig
from lerobot_act_chunking.robots.table import Table, table_of

_WAY_HOME = 1.0  # [s]
_PAUSE = 1.0  # [s] between two demonstrations where nobody says when the next one begins


class SoArmTeleop(Teleoperator):
    """Demonstrates the task of a ``so_arm_sim`` robot, episode by episode, as ``act-chunking record`` does.

    In ``lerobot-record`` it begins when an episode is announced, stays at home when it is done, and goes home
    while the environment is reset. Where nothing is announced, one demonstration follows the other.

    Args:
        config: its options.
    """

    config_class = SoArmTeleopConfig
    name = "so_arm_sim"

    def __init__(self, config: SoArmTeleopConfig) -> None:
        self._connected = False
        super().__init__(config)
        self.config = config
        self._planned: int | None = None
        self._actions = np.array([HOME])
        self._began: float | None = None
        self._last, self._left = np.array(HOME), 0.0

    @property
    def action_features(self) -> dict[str, type]:
        """Motors, in the robot's units."""
        return dict.fromkeys(NAMES, float)

    @property
    def feedback_features(self) -> dict[str, type]:
        """None: the leader arm has no force."""
        return {}

    @property
    def is_connected(self) -> bool:
        """Whether somebody is there."""
        return self._connected

    @property
    def is_calibrated(self) -> bool:
        """Always."""
        return True

    @check_if_already_connected
    def connect(self, calibrate: bool = True) -> None:
        """Take the leader arm, and look at the table if there is one already.

        Raises:
            DeviceAlreadyConnectedError: somebody has it.
        """
        with suppress(DeviceNotConnectedError):
            self._look(table_of(self.config.robot_id))
        self._connected = True

    def calibrate(self) -> None:
        """There is nothing to calibrate."""

    def configure(self) -> None:
        """There is nothing to configure."""

    @check_if_not_connected
    def get_action(self) -> RobotAction:
        """Where the leader arm is now.

        Raises:
            DeviceNotConnectedError: not connected, or there is no robot to lead.
        """
        table = table_of(self.config.robot_id)
        self._last = self._going_home(table) if table.phase == "reset" else self._demonstrating(table)
        return dict(zip(NAMES, self._last.tolist(), strict=True))

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Nothing is felt."""

    @check_if_not_connected
    def disconnect(self) -> None:
        """Leave.

        Raises:
            DeviceNotConnectedError: nobody is there.
        """
        self._connected = False

    def _demonstrating(self, table: Table) -> np.ndarray:
        now = table.clock()
        if self._planned != table.seed:
            self._look(table)
        if self._began is None:
            self._began = now
        step = FPS * (now - self._began)
        ended = step - (len(self._actions) - 1)
        if table.phase == "free" and ended > FPS * _PAUSE:
            table.next_episode()
        return _between(self._actions, step)

    def _going_home(self, table: Table) -> np.ndarray:
        now = table.clock()
        if self._planned != table.seed:
            self._look(table)
            self._from, self._left = self._last, now
        share = minimum_jerk(np.array((now - self._left) / _WAY_HOME))
        return self._from + share * (np.array(HOME) - self._from)

    def _look(self, table: Table) -> None:
        """Plan the episode that the table shows."""
        task, seed = table.world.name, table.seed
        source = SoArmSource(SoArmOptions(task=task), operators=self.config.operators)
        script = plan(
            task, table.places, source.options_of(seed), noise_stream(seed), mode=source.mode_of(seed)
        )
        self._planned, self._actions, self._began = seed, script.actions, None


def _between(actions: np.ndarray, step: float) -> np.ndarray:
    """The row at ``step``, which lies between two of them."""
    step = min(step, len(actions) - 1.0)
    row = min(int(step), len(actions) - 2) if len(actions) > 1 else 0
    share = step - row
    return (1 - share) * actions[row] + share * actions[min(row + 1, len(actions) - 1)]
