"""Notices while a robot acts what its policy cannot: frozen and slow cameras, joints that do not follow."""

import logging
import sys
import time
from collections import deque
from collections.abc import Callable, Mapping
from functools import wraps
from typing import Any

import numpy as np
from lerobot.utils.constants import ACTION, OBS_STATE

from lerobot_act_chunking.data.dimension_names import is_hand
from lerobot_act_chunking.policies.trained_on import RemembersTraining, TrainedOn, wrong_rate

ROLLOUT = "lerobot.rollout.context"
STILL = 1.0  # time [s] after which the same picture, or the same place, is no accident
COUNTED = 90  # pictures among which repeated ones are counted
FEWEST_NEW = 2 / 3  # of them; cameras and control loops have clocks of their own
AWAY = 0.1  # of the demonstrated range: as far from its target a joint is elsewhere
MOVED = 0.01  # of it: less is noise
COARSE = 4  # every so many pixels are compared

logger = logging.getLogger(__name__)


class RolloutWatch:
    """Compares each observation with the one before, and warns once of each fault of a camera or joint.

    Args:
        known: of the policy's demonstrations.
        fps: control steps per second.
        clock: the time [s].
    """

    def __init__(self, known: TrainedOn, fps: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._known, self._fps, self._clock = known, fps, clock
        self._told: set[str] = set()
        self._pictures: dict[str, tuple[np.ndarray, float]] = {}  # the last new one, and since when
        self._fresh: dict[str, deque[bool]] = {}
        self._seen = -np.inf
        self._places: np.ndarray | None = None
        self._since = np.zeros(0)
        same = known.names.get(ACTION) == known.names.get(OBS_STATE) and ACTION in known.low
        self._joints = known.names.get(ACTION, []) if same else []

    def see(self, observation: Mapping[str, Any], action: Any) -> None:
        """Look at what the robot sees, and what it is told.

        Args:
            observation: by LeRobot's keys: positions (S,), pictures (height, width, 3).
            action: the last one (A,), in the robot's units; None if there is none.
        """
        now = self._clock()
        for key, value in observation.items():
            if getattr(value, "ndim", 0) == 3:
                self._look(key, np.array(value[::COARSE, ::COARSE]), now)
        if self._joints and action is not None and OBS_STATE in observation:
            self._feel(np.asarray(observation[OBS_STATE]).reshape(-1), np.asarray(action).reshape(-1), now)
        self._seen = now

    def _look(self, key: str, picture: np.ndarray, now: float) -> None:
        before, since = self._pictures.get(key, (None, now))
        is_new = before is None or not np.array_equal(before, picture)
        if is_new:
            self._pictures[key] = picture, now
        elif now - since >= STILL:
            self._tell(key, f"{key} shows the same picture for {STILL:g} s: is the camera frozen?")
        fresh = self._fresh.setdefault(key, deque(maxlen=COUNTED))
        if now - self._seen < 2 / self._fps:
            fresh.append(is_new)
        if len(fresh) == COUNTED and np.mean(fresh) < FEWEST_NEW and key not in self._told:
            text = f"{key} has a new picture in only {np.mean(fresh):.0%} of the control steps"
            few = f"{text}: frames get lost, or the camera delivers fewer than {self._fps:g} a second"
            self._tell(f"{key}, few", few)  # and if it freezes later, that too

    def _feel(self, places: np.ndarray, targets: np.ndarray, now: float) -> None:
        spans = self._known.spans(ACTION)
        if self._places is None:
            self._places, self._since = places.copy(), np.full(len(places), now)
        follows = (np.abs(places - self._places) > MOVED * spans) | (np.abs(targets - places) < AWAY * spans)
        self._places = np.where(follows, places, self._places)
        self._since = np.where(follows, now, self._since)
        for dim in np.flatnonzero(now - self._since >= STILL):
            name = self._joints[dim]
            if not is_hand(name):  # one that holds something stands still as well
                text = f"{name} stays at {places[dim]:.4g} for {STILL:g} s, told to go to {targets[dim]:.4g}"
                self._tell(name, f"{text}: is the joint blocked?")

    def _tell(self, fault: str, text: str) -> None:
        if fault not in self._told:
            self._told.add(fault)
            logger.warning("%s", text)


def install() -> None:
    """Let ``lerobot-rollout`` warn of a wrong rate before a policy of this package acts, and watch it act.

    It tells policies nothing of ``--fps``; what it makes its inference engine of has both. Harmless when
    repeated; nothing happens before LeRobot's rollout is imported.
    """
    module = sys.modules.get(ROLLOUT)
    create = getattr(module, "create_inference_engine", None)
    if create is not None and not hasattr(create, "__wrapped__"):
        vars(module)["create_inference_engine"] = _watching(create)


def _watching(create: Callable[..., Any]) -> Callable[..., Any]:
    @wraps(create)
    def watching(*args: Any, **arguments: Any) -> Any:
        engine = create(*args, **arguments)
        config = getattr(arguments.get("policy"), "config", None)
        if isinstance(config, RemembersTraining) and "fps" in arguments:
            warning = wrong_rate(config, arguments["fps"])
            if warning is not None:
                logger.warning("%s", warning)
            engine.get_action = _seeing(engine.get_action, config, arguments["fps"])
        return engine

    return watching


def _seeing(get_action: Callable[..., Any], config: RemembersTraining, fps: float) -> Callable[..., Any]:
    watch = RolloutWatch(config.trained_on or TrainedOn(), fps)

    @wraps(get_action)
    def seeing(obs_frame: Any) -> Any:
        action = get_action(obs_frame)
        if obs_frame is not None:
            watch.see(obs_frame, action)
        return action

    return seeing
