"""The columns that a training run reads of a dataset: known for this package's policies only."""

import functools
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata

from lerobot_act_chunking.data.fast_chunks.image_switch import ImageSwitch
from lerobot_act_chunking.nn.image_view import Size

Timestamps = dict[str, list[float]] | None
Resolve = Callable[..., Timestamps]

_rename_map: dict[str, str] = {}
"""The ``--rename_map`` of the run whose datasets are being made, which LeRobot 0.6.1 does not hand on."""


class Reading(dict[str, list[float]]):
    """LeRobot's delta timestamps of the columns that a policy reads, and what else its reader must know.

    Attributes:
        columns: keys of the dataset that are read; items also hold LeRobot's own (``index``, ...).
        leave_out: the setting that leaves the given columns out, None if there is none.
        image_switch: tells for which batches images are wanted; None for always.
        resize_shape: (height, width) that the policy resizes images to; None for as they are.
    """

    def __init__(
        self,
        timestamps: Mapping[str, list[float]],
        columns: frozenset[str],
        leave_out: Callable[[Iterable[str]], str | None],
        image_switch: ImageSwitch | None,
        resize_shape: Size | None = None,
    ):
        super().__init__({key: steps for key, steps in timestamps.items() if key in columns})
        self.columns = columns
        self.leave_out = leave_out
        self.image_switch = image_switch
        self.resize_shape = resize_shape


def is_ours(config: object) -> bool:
    """Whether a policy's configuration is of this package."""
    return type(config).__module__.partition(".")[0] == __name__.partition(".")[0]


def begin_run(cfg: Any) -> None:
    """Note those of a training run's settings that its policy's configuration does not know."""
    _rename_map.clear()
    _rename_map.update(getattr(cfg, "rename_map", None) or {})
    switch = getattr(cfg.trainable_config, "image_switch", None)
    if isinstance(switch, ImageSwitch):
        switch.expect_workers(cfg.num_workers, cfg.prefetch_factor)


def with_reading(resolve: Resolve) -> Resolve:
    """LeRobot's ``resolve_delta_timestamps``; for policies that tell what they read, of that alone.

    A dataset that such a policy cannot learn from is refused here, where its features are known.
    """

    @functools.wraps(resolve)
    def resolve_read(config: Any, ds_meta: LeRobotDatasetMetadata, *args: Any, **kwargs: Any) -> Timestamps:
        timestamps = resolve(config, ds_meta, *args, **kwargs)
        if not hasattr(config, "keys_read"):
            return timestamps
        names = {key: _rename_map.get(key, key) for key in ds_meta.features}  # in the policy's words
        features = {names[key]: feature for key, feature in ds_meta.features.items()}
        config.check_dataset(features, ds_meta)
        read = config.keys_read(features)
        columns = frozenset(key for key, name in names.items() if name in read)
        leave_out = functools.partial(_leave_out, config, names, features)
        view = getattr(config, "image_view", None)
        size = None if view is None else view.resize_shape
        return Reading(timestamps or {}, columns, leave_out, getattr(config, "image_switch", None), size)

    return resolve_read


def _leave_out(
    config: Any, names: dict[str, str], features: dict[str, dict], keys: Iterable[str]
) -> str | None:
    return config.leave_out([names[key] for key in keys], features)
