# pyright: reportAttributeAccessIssue=false
# (mujoco ships no type stubs)
"""Images of a gymnasium-robotics world from any of its cameras, without touching its physics."""

from collections.abc import Iterable
from typing import Any

import mujoco
import numpy as np

from lerobot_act_chunking.envs.rendering import Images
from lerobot_act_chunking.envs.robotics.options import RoboticsOptions


class Views:
    """Every camera of an original environment; the goal is marked as the original's ``render()`` marks it.

    Args:
        original: the bare environment.
        options: the largest images and their quality.
    """

    def __init__(self, original: Any, options: RoboticsOptions) -> None:
        self._original = original
        self._data = mujoco.MjData(original.model)
        self._view = self._free_camera()
        self._images = Images(original.model, options)

    def images(self, cameras: Iterable[str], height: int, width: int) -> dict[str, np.ndarray]:
        """What each of the ``cameras`` sees now, uint8 (height, width, 3).

        Raises:
            ActChunkingError: no OpenGL on this machine.
        """
        data = self._marked_data()
        views = {camera: self._view if camera == "view" else camera for camera in cameras}
        return {camera: self._images.render(data, view, height, width) for camera, view in views.items()}

    def close(self) -> None:
        """Free the OpenGL context, if one was ever opened."""
        self._images.close()

    def _marked_data(self) -> Any:
        """The world's state with the goal's marker in its place."""
        original = self._original
        if not hasattr(original, "_render_callback"):
            return original.data
        # The callback refreshes all of MuJoCo's derived quantities, from which FetchPickAndPlace's next step
        # starts: on the original's own data, looking would change the episode. So it works on a copy.
        data = original.data
        mujoco.mj_copyData(self._data, original.model, data)
        original.data = self._data
        try:
            original._render_callback()
        finally:
            original.data = data
        return self._data

    def _free_camera(self) -> Any:
        # As Gymnasium's MujocoRenderer does it, which for want of a setting looks at the middle of the scene
        # at its first image; here it is that of the model's reference pose, the same in every episode.
        model, data = self._original.model, self._data
        mujoco.mj_forward(model, data)
        camera = mujoco.MjvCamera()
        camera.lookat[:] = np.median(data.geom_xpos, axis=0)
        camera.distance = model.stat.extent
        simulation = getattr(self._original, "robot_env", self._original)
        for name, value in (simulation.mujoco_renderer.default_cam_config or {}).items():
            if name == "lookat":
                camera.lookat[:] = value
            else:
                setattr(camera, name, value)
        return camera
