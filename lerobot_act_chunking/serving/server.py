"""LeRobot 0.6's policy server for every installed policy type, and for the checkpoints that were allowed."""

import copy
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from time import perf_counter
from typing import Any, cast

import numpy as np
import torch
from lerobot.async_inference import helpers
from lerobot.configs import FeatureType
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from lerobot.rollout.inference.rtc import supports_rtc_inference
from lerobot.transport import services_pb2, services_pb2_grpc
from lerobot.transport.utils import receive_bytes_in_chunks
from lerobot.utils.constants import OBS_STATE

from lerobot_act_chunking.errors import ActChunkingError, ConfigurationError, need
from lerobot_act_chunking.policies.loading import check_complete, explained, read_config
from lerobot_act_chunking.policies.rollout_watch import RolloutWatch
from lerobot_act_chunking.serving.messages import read

grpc = need("grpc", "act-chunking serve", "lerobot_policy_act_chunking[serve]")
_logger_with_file = helpers.get_logger
helpers.get_logger = lambda name, _=True: _logger_with_file(
    name, False
)  # else importing makes a folder `logs`
from lerobot.async_inference import policy_server  # noqa: E402
from lerobot.async_inference.configs import PolicyServerConfig  # noqa: E402

LOOPBACK = ("127.0.0.1", "localhost", "::1")
REMEMBERED = 10  # chunks, by whose longest time to compute the next one is expected
WORKERS = 4  # calls that are answered at a time: observations come in while a chunk is computed


@dataclass(frozen=True)
class Served:
    """A checkpoint that clients may ask for.

    Attributes:
        path: as clients name it, a folder or a repo id.
        config: its configuration.
    """

    path: str
    config: Any

    @classmethod
    def of(cls, path: str, settings: Sequence[str] = ()) -> "Served":
        """The checkpoint at ``path``, with other settings.

        Args:
            path: folder or repo id.
            settings: as in ``action_limits=demonstrations``.

        Raises:
            ConfigurationError: there is none, it lacks weights or processors, or a setting cannot work.
        """
        config = read_config(path, settings)
        check_complete(path, config.type)
        return cls(path, config)

    def is_called(self, name: str) -> bool:
        """Whether a client that asks for ``name`` means this one."""
        return name == self.path or Path(name).absolute() == Path(self.path).absolute()

    def check_client(self, specs: Any) -> None:
        """Refuse a client whose robot is not the one that the policy knows.

        Raises:
            ConfigurationError: naming what differs.
        """
        if specs.policy_type != self.config.type:
            raise ConfigurationError(
                f"{self.path} is of type {self.config.type}: set --policy_type={self.config.type}, not "
                f"{specs.policy_type}"
            )
        seen = {specs.rename_map.get(key, key) for key in specs.lerobot_features}
        cameras = [key for key, each in self.config.input_features.items() if each.type == FeatureType.VISUAL]
        missing = [key for key in cameras if key not in seen]
        if missing:
            has = ", ".join(sorted(key for key in seen if "image" in key)) or "none"
            raise ConfigurationError(
                f"the policy sees {', '.join(missing)}, but the robot has {has}: name its cameras so in "
                "--robot.cameras"
            )
        self._check_state(specs.lerobot_features.get("observation.state"))

    def _check_state(self, state: Mapping[str, Any] | None) -> None:
        known = self.config.input_features.get("observation.state")
        if known is None or (state is not None and tuple(state["shape"]) == tuple(known.shape)):
            return
        has = "no joint positions" if state is None else f"{state['shape'][0]} values {state['names']}"
        raise ConfigurationError(
            f"the policy sees observation.state of {known.shape[0]} values, but the robot has {has}"
        )


class ChunkServer(policy_server.PolicyServer):
    """Answers LeRobot's ``robot_client``, which asks for a policy, sends observations and gets chunks.

    Args:
        served: the checkpoints that clients may ask for.
        config: LeRobot's settings.
    """

    def __init__(self, served: list[Served], config: PolicyServerConfig):
        super().__init__(config)
        self._served = served
        self._seconds: deque[float] = deque(maxlen=REMEMBERED)
        self._received = perf_counter()  # the observation that a chunk is computed from
        self._watching: RolloutWatch | None = None
        self._sent: tuple[int, torch.Tensor] | None = None  # the last chunk, and the step at which it begins

    def Ready(self, request: Any, context: Any) -> Any:  # noqa: N802 (LeRobot's protocol)
        """A client begins anew."""
        self.last_processed_obs = None  # pyright: ignore[reportAttributeAccessIssue]
        self._sent = None
        if self.policy is not None:
            self.policy.reset()
        return super().Ready(request, context)

    def SendPolicyInstructions(self, request: Any, context: Any) -> Any:  # noqa: N802
        """Load the policy that a client asks for."""
        with _told(context, self.logger):
            specs = read(request.data)
            served = self._find(specs.pretrained_name_or_path)
            served.check_client(specs)
            self._load(served, specs)
            self.logger.info(f"{context.peer()} acts with {served.path} on {specs.device}")
        return services_pb2.Empty()  # pyright: ignore[reportAttributeAccessIssue]

    def _find(self, name: str) -> Served:
        for served in self._served:
            if served.is_called(name):
                return served
        allowed = ", ".join(served.path for served in self._served)
        raise ConfigurationError(
            f"{name} is not served: set --pretrained_name_or_path to one of {allowed}, or start the server "
            "with it"
        )

    def _load(self, served: Served, specs: Any) -> None:
        self.device, self.policy_type = specs.device, specs.policy_type
        self.lerobot_features, self.actions_per_chunk = specs.lerobot_features, specs.actions_per_chunk
        device = {"device": specs.device}
        with explained(served.path):
            config = copy.deepcopy(served.config)
            policy = get_policy_class(specs.policy_type).from_pretrained(served.path, config=config)
            self.policy = policy.to(specs.device).eval()
            self.preprocessor, self.postprocessor = make_pre_post_processors(
                policy.config,
                pretrained_path=served.path,
                preprocessor_overrides={
                    "device_processor": device,
                    "rename_observations_processor": {"rename_map": specs.rename_map},
                },
                postprocessor_overrides={"device_processor": device},
            )
        known = getattr(served.config, "trained_on", None)
        self._watching = None if known is None else RolloutWatch(known, known.fps or self.config.fps)

    def SendObservations(self, request_iterator: Any, context: Any) -> Any:  # noqa: N802
        """Take an observation; the newest one is used."""
        with _told(context, self.logger):
            if self.policy is None:
                raise ConfigurationError(
                    "the client asked another server for its policy, perhaps this one before it was started "
                    "again: start the client again, too; its robot holds"
                )
            received = perf_counter()
            stopped: Any = self.shutdown_event
            message = receive_bytes_in_chunks(request_iterator, None, stopped, "observation")
            if message is not None:
                seen = read(message)
                self._watch(seen)
                if self._enqueue_observation(seen):
                    self._received = received
        return services_pb2.Empty()  # pyright: ignore[reportAttributeAccessIssue]

    def _watch(self, seen: Any) -> None:
        """Notice cameras and joints of the client that stand still."""
        if self._watching is None:
            return
        raw, going_on, postprocessor = seen.get_observation(), self._sent, cast(Any, self.postprocessor)
        names = self.lerobot_features.get(OBS_STATE, {}).get("names", [])
        frame = {key: value for key, value in raw.items() if getattr(value, "ndim", 0) == 3}
        action = None
        if going_on is not None and 0 <= seen.get_timestep() - going_on[0] < going_on[1].shape[1]:
            action = postprocessor(going_on[1][:, seen.get_timestep() - going_on[0]])[0].cpu()
        self._watching.see({**frame, OBS_STATE: np.array([raw[name] for name in names])}, action)

    def _obs_sanity_checks(self, obs: Any, previous_obs: Any) -> bool:
        # LeRobot leaves out what is less than 1 away from the observation before: of joints in radians, all.
        return obs.get_timestep() not in self._predicted_timesteps

    def _predict_action_chunk(self, observation_t: Any) -> Any:
        actions = super()._predict_action_chunk(observation_t)
        self._seconds.append(perf_counter() - self._received)
        return actions

    def _get_action_chunk(self, observation: dict[str, Any]) -> torch.Tensor:
        # A client sends observations from time to time: those before are no history of the one that came.
        going_on, delay = self._going_on()
        policy: Any = self.policy
        arguments = {"inference_delay": delay, "prev_chunk_left_over": going_on}
        with torch.inference_mode():
            chunk = policy.predict_action_chunk(
                observation, **(arguments if supports_rtc_inference(policy) else {})
            )
        chunk = (chunk if chunk.ndim == 3 else chunk[None])[:, : self.actions_per_chunk]
        chunk = self._within_limits(chunk, going_on, delay)
        self._sent = self._step, chunk
        return chunk

    @property
    def _step(self) -> int:
        """Of the observation that was taken last."""
        seen: Any = self.last_processed_obs
        return seen.get_timestep()

    def _going_on(self) -> tuple[torch.Tensor | None, int]:
        """What the client does until the new chunk arrives (1, P, A), and for how many steps at most.

        Its first action is the one of the observation, as that of the new chunk.
        """
        if self._sent is None:
            return None, 0
        begun, before = self._sent
        left = before[:, min(self._step - begun, before.shape[1] - 1) :]
        policy: Any = self.policy
        known = getattr(policy.config, "trained_on", None)
        fps = (known and known.fps) or self.config.fps
        delay = 1 + ceil(fps * max(self._seconds, default=0.0))
        held = max(0, delay - left.shape[1])  # steps for which the client has run out, and holds the last one
        return torch.cat([left, left[:, -1:].expand(-1, held, -1)], dim=1), delay

    def _within_limits(self, chunk: torch.Tensor, going_on: torch.Tensor | None, delay: int) -> torch.Tensor:
        """The chunk (1, T, A) that may be executed; speeds are limited from where the client will be."""
        limits = getattr(self.policy, "limits", None)
        if limits is None:
            return chunk
        if going_on is not None:
            delay = min(delay, chunk.shape[1])
            chunk = torch.cat([going_on[:, :delay], chunk[:, delay:]], dim=1)
        limits.reset()
        return torch.stack([limits.normalised(action) for action in chunk.unbind(1)], dim=1)


@contextmanager
def _told(context: Any, logger: Any) -> Iterator[None]:
    """Tell the client why it is refused, in place of LeRobot's "Exception calling application"."""
    try:
        yield
    except ActChunkingError as error:
        logger.error(str(error))
        context.abort(grpc.StatusCode.INVALID_ARGUMENT, str(error))


def start(served: list[Served], host: str, port: int) -> Any:
    """A server that answers clients in threads of its own.

    Args:
        served: the checkpoints that clients may ask for.
        host: address to listen at.
        port: of it.

    Raises:
        ConfigurationError: nothing can listen there.
    """
    server = grpc.server(ThreadPoolExecutor(WORKERS), options=[("grpc.so_reuseport", 0)])
    servicer = ChunkServer(served, PolicyServerConfig(host=host, port=port, inference_latency=0.0))
    services_pb2_grpc.add_AsyncInferenceServicer_to_server(servicer, server)
    try:
        server.add_insecure_port(f"{host}:{port}")
    except RuntimeError as error:
        raise ConfigurationError(
            f"nothing can listen at {host}:{port}, perhaps because another server does: set another --port"
        ) from error
    server.start()
    return server
