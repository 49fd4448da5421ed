"""The tokenizer in question: that of a policy's checkpoint, or a file of its own."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from lerobot_act_chunking.data.actions import is_dataset
from lerobot_act_chunking.data.timing import ChunkTiming
from lerobot_act_chunking.diagnostics.codebook.coding import ChunkCoder
from lerobot_act_chunking.diagnostics.codebook.scale import ActionScale
from lerobot_act_chunking.diagnostics.core.episodes import ActionEpisodes, read_episodes
from lerobot_act_chunking.diagnostics.core.training import Training, read_training
from lerobot_act_chunking.errors import ConfigurationError, DatasetError, FeatureError

POLICY_TYPE = "vqbet_chunked"


@dataclass(frozen=True)
class Subject:
    """A tokenizer.

    Attributes:
        source: folder, repo id or file.
        kind: what that is.
        coder: the tokenizer with its normalisation.
        settings: what it is built from, by the names of the policy's configuration.
        action_dim: A.
        trained_on: its training data.
        unfinished: how far its training got; None if that is over.
    """

    source: str
    kind: str
    coder: ChunkCoder
    settings: Mapping[str, Any]
    action_dim: int
    trained_on: Training
    unfinished: str | None = None


def load_subject(source: str) -> Subject:
    """Load a `vqbet_chunked` checkpoint, or a file of ``act-chunking train-tokenizer``.

    Raises:
        ConfigurationError: there is neither, or it is of another policy.
    """
    return _from_file(Path(source)) if Path(source).is_file() else _from_policy(source)


def _from_file(path: Path) -> Subject:
    from lerobot.configs import NormalizationMode

    from lerobot_act_chunking.policies.vqbet_chunked.tokenizer_file import load_tokenizer
    from lerobot_act_chunking.tokenizers.make import make_tokenizer

    spec, info, state = load_tokenizer(path)
    tokenizer = make_tokenizer(spec)
    tokenizer.load_state_dict(state)
    scale = ActionScale.of_statistics(NormalizationMode(info.normalization), info.statistics, spec.action_dim)
    return Subject(
        source=str(path),
        kind="tokenizer file",
        coder=ChunkCoder(tokenizer, scale, ChunkTiming(1, spec.chunk_size, info.chunk_stride)),
        settings=asdict(spec),
        action_dim=spec.action_dim,
        trained_on=Training(info.dataset),
    )


def _from_policy(checkpoint: str) -> Subject:
    from lerobot_act_chunking.policies.loading import load_policy, read_config

    config = read_config(checkpoint)
    if config.type == "temporal_ensemble":
        raise ConfigurationError(
            "a temporal_ensemble has no codebook of its own: give the checkpoint it wraps"
        )
    if config.type != POLICY_TYPE:
        raise ConfigurationError(
            f"{config.type} has no codebook: give a {POLICY_TYPE} checkpoint, a file of act-chunking "
            "train-tokenizer, or a LeRobotDataset's folder to compare tokenizers on"
        )
    loaded = load_policy(checkpoint)
    policy, config = loaded.policy, loaded.policy.config
    phase = policy.tokenizer_phase
    message = f"{int(phase.n_learned)} of {phase.n_steps} steps" if phase.comes_first else None
    return Subject(
        source=checkpoint,
        kind=f"{POLICY_TYPE} checkpoint",
        coder=ChunkCoder(policy.tokenizer, ActionScale.of_policy(loaded), config.timing),
        settings=asdict(config.tokenizer_spec),
        action_dim=config.tokenizer_spec.action_dim,
        trained_on=read_training(checkpoint, config),
        unfinished=message,
    )


def training_episodes(subject: Subject) -> ActionEpisodes | None:
    """What the tokenizer was trained on, if that is here."""
    folder, episodes = subject.trained_on.folder, subject.trained_on.episodes
    if folder is None or not is_dataset(folder):
        return None
    found = read_episodes(folder)
    return check_fits(subject, found if episodes is None else found.only(episodes))


def check_fits(subject: Subject, demonstrations: ActionEpisodes) -> ActionEpisodes:
    """The same demonstrations, unless their actions are others than the tokenizer's.

    Raises:
        FeatureError: naming both numbers of dimensions.
        DatasetError: there is no episode.
    """
    if len(demonstrations.names) != subject.action_dim:
        raise FeatureError(
            f"the tokenizer is for {subject.action_dim} action dimensions, the dataset at "
            f"{demonstrations.folder} has {len(demonstrations.names)}: give one of the same robot"
        )
    if not demonstrations.episodes:
        raise DatasetError(
            f"the dataset at {demonstrations.folder} has none of the training's episodes: give another one "
            "as --dataset"
        )
    return demonstrations


def find_data(subject: Subject, folder: str | None) -> tuple[ActionEpisodes | None, ActionEpisodes | None]:
    """The training data, if they are here, and those in ``folder``, if one is given.

    Raises:
        DatasetError: neither is there.
        FeatureError: data of another robot.
    """
    training = training_episodes(subject)
    other = None if folder is None else check_fits(subject, read_episodes(folder))
    if training is None and other is None:
        known = subject.trained_on.folder
        message = (
            f"its training dataset is not at {known}" if known else "it does not say what it was trained on"
        )
        raise DatasetError(f"{message}: give a LeRobotDataset's folder (with meta/info.json) as --dataset")
    return training, other
