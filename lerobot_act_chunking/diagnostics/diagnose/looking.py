"""Looks for the causes that can be seen, in the checkpoint, in its demonstrations and in its episodes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from lerobot.envs.configs import EnvConfig
from lerobot.utils.constants import ACTION

from lerobot_act_chunking.diagnostics.core.executable import Executable, predicting
from lerobot_act_chunking.diagnostics.core.normalisers import (
    differing,
    far_away,
    processor_statistics,
    spreads_of,
)
from lerobot_act_chunking.diagnostics.core.training import read_training, untrained
from lerobot_act_chunking.diagnostics.diagnose import causes
from lerobot_act_chunking.diagnostics.diagnose.causes import Finding
from lerobot_act_chunking.diagnostics.diagnose.demonstrations import Demonstrations, Knowledge, ask
from lerobot_act_chunking.diagnostics.diagnose.observing import Starts, observe_starts
from lerobot_act_chunking.diagnostics.diagnose.records import Record
from lerobot_act_chunking.diagnostics.diagnose.starts import Outside, out_of_range, starts_outside
from lerobot_act_chunking.policies.loading import LoadedPolicy


@dataclass(frozen=True)
class Seen:
    """What could be seen.

    Attributes:
        findings: of every cause that was looked for.
        own: how well the policy knows the demonstrations of its training; None if they are not here.
        other: the same of demonstrations that it has not seen.
        statistics: whether those of the processors are not the demonstrations'.
        outside: starts beyond those of the demonstrations; None without them, or without episodes.
    """

    findings: list[Finding]
    own: Knowledge | None
    other: Knowledge | None
    statistics: bool
    outside: Outside | None


def look(
    executable: Executable,
    policy: LoadedPolicy,
    demonstrations: Demonstrations | None,
    env_config: EnvConfig | None,
    records: Sequence[Record],
) -> Seen:
    """Look for every cause that can be seen.

    Args:
        executable: the checkpoint.
        policy: the same, loaded.
        demonstrations: of its training, or like them.
        env_config: of the environment; None without one.
        records: episodes of the policy as it is.
    """
    config = predicting(executable.config)
    spreads = spreads_of(processor_statistics(policy), config)
    starts = Starts({}, {})
    if env_config is not None and records:
        starts = observe_starts(env_config, executable.config, [each.episode.seed for each in records])
    seen = unseen = None
    if demonstrations is not None:
        seen = ask(policy, demonstrations, demonstrations.seen or demonstrations.unseen)
        unseen = ask(policy, demonstrations, demonstrations.unseen) if demonstrations.seen else None
    differ = None if demonstrations is None else _differing(config, spreads, demonstrations)
    inert = causes.inert_statistics(spreads)
    failing = [each for each in records if not each.episode.success]
    outside = _outside(demonstrations, starts, records)
    far = far_away(spreads, starts.vectors)
    statistics = causes.other_statistics([], {}) if inert.found else causes.other_statistics(differ, far)
    normalised = not inert.found and not differ
    findings = [
        causes.initial_weights(untrained(executable.checkpoint)),
        inert,
        statistics,
        _rate(executable, env_config),
        _images(config, starts, demonstrations),
        causes.holds_still(failing, _spans(demonstrations, spreads)),
        causes.hardly_learned(seen if normalised else None),
        causes.stalls(failing),
        out_of_range(outside),
        causes.weak_training(seen if normalised else None, unseen),
        causes.modes_and_boundaries(seen),
    ]
    return Seen(findings, seen, unseen, bool(differ) or bool(inert.found), outside)


def _differing(config: Any, spreads: Any, demonstrations: Demonstrations) -> list[str]:
    floor = float(getattr(config, "norm_std_floor", 0.0) or 0.0)
    return differing(spreads, spreads_of(demonstrations.stats, config), floor)


def _rate(executable: Executable, env_config: EnvConfig | None) -> Finding:
    trained = read_training(executable.checkpoint, predicting(executable.config)).fps
    if env_config is None:
        return Finding("control rate", None, "Without an environment there is no rate to compare with.")
    return causes.control_rate(trained, env_config.fps)


def _spans(demonstrations: Demonstrations | None, spreads: Any) -> np.ndarray:
    """Range (A,) of the commands: of the demonstrations, else four times the spread in the postprocessor."""
    if demonstrations is not None:
        stats = demonstrations.stats[ACTION]
        return np.ravel(stats["max"]) - np.ravel(stats["min"])
    own = spreads.get(ACTION)
    return np.zeros(0) if own is None or own.is_inert else 4 * own.half


def _images(config: Any, starts: Starts, demonstrations: Demonstrations | None) -> Finding:
    declared = {key: feature.shape for key, feature in config.image_features.items() if key in starts.images}
    stats = {} if demonstrations is None else demonstrations.stats
    recorded = {key: np.ravel(stats[key]["mean"]) for key in declared if "mean" in stats.get(key, {})}
    if config.image_features and not declared:
        return Finding("images", None, "Without an environment no image is rendered.")
    return causes.images(declared, {key: starts.images[key] for key in declared}, recorded)


def _outside(
    demonstrations: Demonstrations | None, starts: Starts, records: Sequence[Record]
) -> Outside | None:
    if demonstrations is None or not records or not starts.vectors:
        return None
    success = np.array([each.episode.success for each in records])
    return starts_outside(demonstrations.starts, starts.vectors, success)
