# pyright: reportAttributeAccessIssue=false
# (mujoco ships no type stubs)
"""Off-screen images of a MuJoCo model, at the original's quality or without the costliest effects."""

import atexit
import os
import sys
import weakref
from importlib import import_module
from typing import Any

import mujoco
import numpy as np

from lerobot_act_chunking.envs.options import ObservationOptions
from lerobot_act_chunking.errors import ActChunkingError

_MAX_GEOMS = 1000  # dm_control's and Gymnasium's scene size; FrankaKitchen has 240 geoms, ALOHA thirty
_EFFECTS = [int(mujoco.mjtRndFlag.mjRND_SHADOW), int(mujoco.mjtRndFlag.mjRND_REFLECTION)]


class OffscreenRenderer:
    """One OpenGL context and scene for all cameras of a model, at any size up to a limit.

    ``mujoco.Renderer`` would serve, but its OpenGL platform is fixed when mujoco is first imported and it
    holds one image size; this one chooses the platform at the first image and shares a context between sizes.

    Args:
        model: the MuJoCo model; its framebuffer settings are adapted.
        max_height: tallest image [pixels].
        max_width: widest image [pixels].
        effects: shadows, reflections and multisampling, as in the original's images.

    Raises:
        ActChunkingError: no OpenGL on this machine.
    """

    def __init__(self, model: Any, max_height: int, max_width: int, effects: bool) -> None:
        self._model = model
        frame, quality = model.vis.global_, model.vis.quality
        frame.offheight, frame.offwidth = max(frame.offheight, max_height), max(frame.offwidth, max_width)
        if not effects:
            quality.offsamples = quality.shadowsize = 0
        self._gl, self._context = _open_context(model)
        self.close = weakref.finalize(self, _close_context, self._gl, self._context)
        # MuJoCo's EGL shuts down at exit as well; registered later, this runs before it.
        atexit.register(self.close)
        self._scene = mujoco.MjvScene(model, maxgeom=_MAX_GEOMS)
        if not effects:
            self._scene.flags[_EFFECTS] = 0
        self._option = mujoco.MjvOption()
        self._camera = mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED

    def render(self, data: Any, camera: Any, height: int, width: int) -> np.ndarray:
        """What ``camera``, the model's by name or any ``MjvCamera``, sees now, uint8 (height, width, 3)."""
        if isinstance(camera, str):
            self._camera.fixedcamid = self._model.camera(camera).id
            camera = self._camera
        mujoco.mjv_updateScene(
            self._model, data, self._option, None, camera, mujoco.mjtCatBit.mjCAT_ALL, self._scene
        )
        self._gl.make_current()
        viewport = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(viewport, self._scene, self._context)
        image = np.empty((height, width, 3), np.uint8)
        mujoco.mjr_readPixels(image, None, viewport, self._context)
        return np.ascontiguousarray(image[::-1])  # OpenGL's first row is the lowest


class Images:
    """The cameras of a model; OpenGL is opened at the first image.

    Args:
        model: the MuJoCo model.
        options: the largest images and their quality.
    """

    def __init__(self, model: Any, options: ObservationOptions) -> None:
        self._model, self._options = model, options
        self._renderer: OffscreenRenderer | None = None

    def render(self, data: Any, camera: Any, height: int, width: int) -> np.ndarray:
        """As of `OffscreenRenderer`.

        Raises:
            ActChunkingError: no OpenGL on this machine.
        """
        if self._renderer is None:
            options = self._options
            self._renderer = OffscreenRenderer(
                self._model,
                max_height=max(options.observation_height, options.visualization_height),
                max_width=max(options.observation_width, options.visualization_width),
                effects=options.render_quality == "full",
            )
        return self._renderer.render(data, camera, height, width)

    def close(self) -> None:
        """Free the OpenGL context, if one was ever opened."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


def _open_context(model: Any) -> tuple[Any, Any]:
    try:
        gl = _platform()(model.vis.global_.offwidth, model.vis.global_.offheight)
        gl.make_current()
        context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_150)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, context)
    except Exception as error:  # each platform fails in its own way: ImportError, AttributeError, ...
        raise ActChunkingError(
            f"cannot render: OpenGL is not available ({error}). Without a display, install EGL (Debian and "
            "Ubuntu: apt install libegl1 libopengl0 libgl1-mesa-dri) and set MUJOCO_GL=egl; or use "
            "obs_type=state, which needs no images"
        ) from error
    return gl, context


def _platform() -> Any:
    """MuJoCo's class of OpenGL contexts: what ``MUJOCO_GL`` asks for, EGL on Linux without a display."""
    headless = sys.platform == "linux" and not os.environ.get("DISPLAY")
    choice = os.environ.get("MUJOCO_GL", "").strip().lower() or ("egl" if headless else "")
    if choice in ("egl", "osmesa"):
        return import_module(f"mujoco.{choice}").GLContext  # loads the OpenGL library, so only now
    return mujoco.GLContext


def _close_context(gl: Any, context: Any) -> None:
    gl.make_current()
    context.free()
    gl.free()
