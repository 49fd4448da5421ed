# pyright: reportAttributeAccessIssue=false
# (mujoco ships no type stubs)
"""A simulated camera: a thread of its own takes pictures of the table, and they arrive late."""

import logging
import time
from collections import deque
from threading import Event, Lock, Thread
from typing import Any

import mujoco
import numpy as np
from lerobot.cameras.camera import Camera
from lerobot.cameras.configs import CameraConfig
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from lerobot_act_chunking.envs.rendering import OffscreenRenderer
from lerobot_act_chunking.robots.config_so_arm_sim import CameraOptions, SoArmSimConfig
from lerobot_act_chunking.robots.table import Table

logger = logging.getLogger(__name__)

_FIRST_PICTURE = 30.0  # [s] to wait for it: the first one opens OpenGL


class SoArmCamera(Camera):
    """One camera at a table, read as LeRobot's cameras are.

    Args:
        name: of the model's camera.
        options: of the robot.
        table: what it sees.
        rng: of the frames that are lost.
    """

    def __init__(self, name: str, options: SoArmSimConfig, table: Table, rng: np.random.Generator) -> None:
        camera: CameraOptions = options.cameras[name]
        super().__init__(CameraConfig(fps=camera.fps, width=camera.width, height=camera.height))
        self.name = name
        self._size = camera.height, camera.width
        self._period = 1 / camera.fps
        self._options, self._faults, self._table, self._rng = options, options.faults, table, rng
        self._arrivals: deque[tuple[float, np.ndarray]] = deque()
        self._lock = Lock()
        self._latest: tuple[float, np.ndarray] | None = None
        self._seen: float | None = None
        self._stop = Event()
        self._thread: Thread | None = None
        self._error: BaseException | None = None

    @property
    def is_connected(self) -> bool:
        """Whether pictures are taken."""
        return self._thread is not None

    @staticmethod
    def find_cameras() -> list[dict[str, Any]]:
        """Simulated cameras are not found but named in the robot's options."""
        return []

    def connect(self, warmup: bool = True) -> None:
        """Begin to take pictures, and wait for the first.

        Raises:
            DeviceAlreadyConnectedError: it takes pictures already.
            ActChunkingError: no OpenGL on this machine.
        """
        if self.is_connected:
            raise DeviceAlreadyConnectedError(f"the simulated camera {self.name} is already connected")
        self._stop.clear()
        self._connected_at = np.inf
        self._thread = Thread(target=self._run, name=f"so_arm_sim {self.name}", daemon=True)
        self._thread.start()
        if warmup:
            self._await_first()
        self._connected_at = self._table.clock()

    def read(self) -> np.ndarray:
        """The next picture, uint8 (height, width, 3)."""
        self._seen = self._table.clock()
        return self.async_read(timeout_ms=10_000)

    def async_read(self, timeout_ms: float = 200) -> np.ndarray:
        """The latest picture that was not read before, waited for if necessary.

        Raises:
            TimeoutError: none comes.
            DeviceNotConnectedError: not connected.
        """
        deadline = time.perf_counter() + timeout_ms / 1000
        while time.perf_counter() < deadline:
            latest = self._arrived()
            if latest is not None and (self._seen is None or latest[0] > self._seen):
                self._seen = latest[0]
                return latest[1]
            time.sleep(0.001)
        raise TimeoutError(f"timed out waiting {timeout_ms} ms for a picture of the camera {self.name}")

    def read_latest(self, max_age_ms: int = 500) -> np.ndarray:
        """The latest picture that has arrived.

        Raises:
            TimeoutError: it is older than ``max_age_ms``, as that of an unplugged camera.
            DeviceNotConnectedError: not connected.
        """
        latest = self._arrived()
        if latest is None:
            raise RuntimeError(f"no picture of the camera {self.name} has arrived yet")
        age = 1000 * (self._table.clock() - latest[0])
        if age > max_age_ms:
            raise TimeoutError(
                f"the latest picture of the camera {self.name} is too old: {age:.0f} ms "
                f"(at most {max_age_ms} ms)"
            )
        return latest[1]

    def disconnect(self) -> None:
        """Stop taking pictures.

        Raises:
            DeviceNotConnectedError: not connected.
        """
        if self._thread is None:
            raise DeviceNotConnectedError(f"the simulated camera {self.name} is not connected")
        self._stop.set()
        self._thread.join()
        self._thread, self._latest, self._seen = None, None, None
        self._arrivals.clear()

    def _arrived(self) -> tuple[float, np.ndarray] | None:
        if self._thread is None:
            raise DeviceNotConnectedError(f"the simulated camera {self.name} is not connected")
        with self._lock:
            while self._arrivals and self._arrivals[0][0] <= self._table.clock():
                self._latest = self._arrivals.popleft()
            return self._latest

    def _await_first(self) -> None:
        deadline = time.perf_counter() + _FIRST_PICTURE
        while self._arrived() is None and time.perf_counter() < deadline:
            if self._error is not None:
                self.disconnect()
                raise self._error
            time.sleep(0.005)

    def _run(self) -> None:
        try:
            self._take_pictures()
        except Exception as error:  # told by whoever waits for the first picture
            self._error = error
            logger.exception("the simulated camera %s stopped", self.name)

    def _take_pictures(self) -> None:
        model = self._table.world.model
        renderer = OffscreenRenderer(model, *self._size, effects=self._options.render_quality == "full")
        data, frozen, due = mujoco.MjData(model), None, self._table.clock()
        try:
            while not self._stop.is_set():
                taken = self._table.clock()
                if frozen is None:
                    self._table.show(data)
                    mujoco.mj_kinematics(model, data)
                    mujoco.mj_camlight(model, data)
                    picture = renderer.render(data, self.name, *self._size)
                else:
                    picture = frozen
                frozen = picture if self._broken("frozen_camera") else None
                self._publish(max(taken + self._options.camera_latency_s, self._table.clock()), picture)
                due = max(due + self._period, self._table.clock())
                self._stop.wait(due - self._table.clock())
        finally:
            renderer.close()

    def _publish(self, arrival: float, picture: np.ndarray) -> None:
        lost = self._latest is not None and self._rng.random() < self._faults.dropped_frames
        if not (lost or self._broken("unplugged_camera")):
            with self._lock:
                self._arrivals.append((arrival, picture))

    def _broken(self, fault: str) -> bool:
        since = self._table.clock() - self._connected_at
        return getattr(self._faults, fault) == self.name and since >= self._faults.after_s
