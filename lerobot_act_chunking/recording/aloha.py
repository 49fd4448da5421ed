"""ALOHA demonstrations: the scripted experts as a source of episodes."""

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_act_chunking.envs.aloha.env import AlohaSimEnv
from lerobot_act_chunking.envs.aloha.options import AlohaSimOptions
from lerobot_act_chunking.envs.aloha.tasks import JOINT_NAMES, get_task
from lerobot_act_chunking.envs.experts import ExpertOptions, plan
from lerobot_act_chunking.recording.episode import DatasetFormat, Episode
from lerobot_act_chunking.recording.lossless import LosslessEncoder
from lerobot_act_chunking.recording.recorder import RecordingProgress, RecordResult, Target, record_source
from lerobot_act_chunking.recording.spec import RecordSpec

_OBJECTS = {"transfer_cube": ("cube",), "insertion": ("peg", "socket")}
_POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
# The environment's observations, named and ordered as LeRobot's preprocessing names them in evaluation.
_FEATURES = {
    "agent_pos": "observation.state",
    "agent_vel": "observation.agent_vel",
    "environment_state": "observation.environment_state",
}
_DISTRIBUTIONS = ("lerobot_policy_act_chunking", "lerobot", "mujoco", "gym-aloha", "numpy")


@dataclass(frozen=True)
class AlohaSource:
    """Episodes of a scripted expert; seed s begins like seed s of gym-aloha."""

    environment: AlohaSimOptions
    expert: ExpertOptions

    @property
    def format(self) -> DatasetFormat:
        """Joints, object poses and cameras as LeRobot features."""
        features = {_FEATURES[name]: _numbers(names) for name, names in self._vectors().items()}
        for camera in self._cameras():
            features[f"observation.images.{camera}"] = {
                "dtype": "video",
                "shape": (self.environment.observation_height, self.environment.observation_width, 3),
                "names": ["height", "width", "channels"],
            }
        features["action"] = _numbers(JOINT_NAMES)
        instruction = get_task(self.environment.task).instruction
        return DatasetFormat(AlohaSimEnv.metadata["render_fps"], instruction, "aloha", features)

    @property
    def settings(self) -> dict[str, Any]:
        """Task, observations, success rule and expert."""
        environment = asdict(self.environment)
        unused = {"visualization_height", "visualization_width"}
        if not self._cameras():
            unused |= {"cameras", "observation_height", "observation_width", "render_quality"}
        kept = {name: value for name, value in environment.items() if name not in unused}
        return {"source": "aloha_sim expert", **kept, "expert": asdict(self.expert)}

    @property
    def versions(self) -> dict[str, str]:
        """Versions of the simulator, the models and this package."""
        return {name: version(name) for name in _DISTRIBUTIONS}

    @contextmanager
    def open(self) -> Iterator[Callable[[int], Episode]]:
        """Build the environment; its renderer is freed on leaving."""
        with closing(AlohaSimEnv(render_mode=None, **asdict(self.environment))) as env:
            yield lambda seed: self._play(env, seed)

    def _play(self, env: AlohaSimEnv, seed: int) -> Episode:
        observation, info = env.reset(seed=seed)
        # A stream of its own: the environment draws the object pose from the plain seed.
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1,)))
        script = plan(env.task, env.world.environment_state(), self.expert, rng)
        vectors: dict[str, list[np.ndarray]] = {name: [] for name in self._vectors()}
        size = self.environment.observation_height, self.environment.observation_width
        cameras = {camera: LosslessEncoder(*size) for camera in self._cameras()}
        for command in script.commands:
            for name, rows in vectors.items():
                rows.append(observation[name])
            for camera, encoder in cameras.items():
                encoder.append(observation["pixels"][camera])
            observation, _, _, _, info = env.step(command)
        arrays = {_FEATURES[name]: np.asarray(rows, np.float32) for name, rows in vectors.items()}
        return Episode(
            seed=seed,
            success=info["is_success"],
            arrays={**arrays, "action": script.actions.astype(np.float32)},
            videos={f"observation.images.{camera}": encoder.finish() for camera, encoder in cameras.items()},
            details={
                "success_touch": info["success_touch"],
                "success_hold": info["success_hold"],
                "expert": asdict(self.expert),
            },
        )

    def _vectors(self) -> dict[str, tuple[str, ...]]:
        """The environment's vector observations with the names of their entries."""
        vectors: dict[str, tuple[str, ...]] = {}
        if self.environment.obs_type != "pixels":
            vectors["agent_pos"] = JOINT_NAMES
        if self.environment.agent_vel:
            vectors["agent_vel"] = JOINT_NAMES
        if self.environment.obs_type == "state":
            objects = _OBJECTS[self.environment.task]
            vectors["environment_state"] = tuple(f"{thing}_{entry}" for thing in objects for entry in _POSE)
        return vectors

    def _cameras(self) -> list[str]:
        return [] if self.environment.obs_type == "state" else self.environment.cameras


def record(
    spec: RecordSpec, *, progress: Callable[[RecordingProgress], None] = lambda _: None
) -> RecordResult:
    """Record demonstrations of an ALOHA task, or finish doing so; see ``record_source``.

    Args:
        spec: what to record.
        progress: called after every attempt.

    Raises:
        ConfigurationError: the dataset's folder holds something else or cannot be written, or the recording
            begun there had other settings.
        DatasetError: an episode that is not finite, an expert that keeps failing, a dead worker, a full disk.
    """
    source = AlohaSource(spec.environment(), spec.expert)
    target = Target(_root(spec), spec.repo_id, spec.episodes, spec.seed)
    return record_source(source, target, workers=spec.workers, progress=progress)


def _root(spec: RecordSpec) -> Path:
    if spec.root is not None:
        return spec.root.expanduser().resolve()
    from lerobot.utils.constants import HF_LEROBOT_HOME

    return HF_LEROBOT_HOME / spec.repo_id


def _numbers(names: tuple[str, ...]) -> dict[str, Any]:
    return {"dtype": "float32", "shape": (len(names),), "names": list(names)}
