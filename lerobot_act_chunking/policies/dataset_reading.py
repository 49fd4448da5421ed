"""What a policy reads of a dataset, and whether it can."""

from collections.abc import Collection, Mapping
from typing import Any

from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature
from lerobot.utils.constants import ACTION
from lerobot.utils.feature_utils import dataset_to_policy_features

from lerobot_act_chunking.errors import DatasetError
from lerobot_act_chunking.policies.statistics import Normalised, needed_statistics

Features = Mapping[
    str, dict[str, Any]
]  # LeRobot's description of a dataset: "dtype", "shape", "names" by key

READ_TYPES = (FeatureType.STATE, FeatureType.ENV, FeatureType.VISUAL)


class DatasetReading:
    """Mixin for configurations of policies that read ``observation.*`` and predict ``action``.

    ``input_features`` are what LeRobot found in the dataset, or what the user gave; ``state_keys`` chooses
    among its state vectors. Nothing else is checked, normalised or decoded.
    """

    input_features: dict[str, PolicyFeature] | None
    output_features: dict[str, PolicyFeature] | None
    normalization_mapping: dict[str, NormalizationMode]
    state_keys: list[str] | None
    pretrained_path: Any

    def reads(self, key: str, feature: PolicyFeature) -> bool:
        """Whether the policy reads this input."""
        chosen = feature.type is not FeatureType.STATE or self.state_keys is None or key in self.state_keys
        return chosen and feature.type in READ_TYPES

    def keys_read(self, features: Features) -> frozenset[str]:
        """Keys that training reads, of a dataset with these features."""
        return frozenset((*self._inputs(features), ACTION))

    def keep_what_is_read(self) -> None:
        """Forget features that are neither read nor predicted, which LeRobot would normalise.

        Text whose key begins with ``action`` counts as one more output there, a state vector that
        ``state_keys`` leaves out as an input.
        """
        inputs, outputs = self.input_features or {}, self.output_features or {}
        self.input_features = {key: each for key, each in inputs.items() if self.reads(key, each)}
        self.output_features = {key: each for key, each in outputs.items() if key == ACTION}

    def leave_out(self, keys: Collection[str], features: Features) -> str | None:
        """The setting with which the policy does not read ``keys`` (of a dataset); None if it needs them."""
        inputs = self._inputs(features)
        rest = {key: each for key, each in inputs.items() if key not in keys}
        if not rest or self.pretrained_path is not None or not inputs.keys() >= set(keys):
            return None
        if all(inputs[key].type is FeatureType.STATE for key in keys):
            states = [key for key, each in rest.items() if each.type is FeatureType.STATE]
            return f"--policy.state_keys='[{', '.join(states)}]'"
        shown = (
            f"{key}: {{type: {each.type.value}, shape: {list(each.shape)}}}" for key, each in rest.items()
        )
        return f"--policy.input_features='{{{', '.join(shown)}}}'"

    def check_dataset(self, features: Features, meta: Any) -> None:
        """Refuse a dataset whose columns or statistics the policy cannot learn from.

        Args:
            features: the dataset's, by the names that the policy has for them.
            meta: LeRobot's metadata of the dataset: ``repo_id``, ``root``, ``stats``.

        Raises:
            DatasetError: naming the column or the file, and the way out.
        """
        inputs = self._inputs(features)
        numbers = [*(key for key, each in inputs.items() if each.type is not FeatureType.VISUAL), ACTION]
        kinds = {key: features[key]["dtype"] for key in numbers if key in features}
        unusable = [key for key, kind in kinds.items() if not kind.startswith("float")]
        if unusable:
            raise self._unusable(unusable, kinds, features)
        actions = {ACTION: PolicyFeature(FeatureType.ACTION, ())}
        needed = needed_statistics(Normalised(inputs, actions, self.normalization_mapping))
        missing = [key for key in needed if key in meta.features and key not in (meta.stats or {})]
        if missing:
            raise DatasetError(_without_statistics(missing, meta))

    def _unusable(self, keys: list[str], kinds: dict[str, str], features: Features) -> DatasetError:
        held = " and ".join(f"{key!r} holds {kinds[key]}" for key in keys)
        setting = self.leave_out(keys, features)
        way_out = "Record" if setting is None else f"Leave it out with {setting}, or record"
        return DatasetError(f"the policy reads floating-point numbers, but {held}. {way_out} it as float32")

    def _inputs(self, features: Features) -> dict[str, PolicyFeature]:
        """The inputs that are read, before LeRobot has filled them in, too."""
        found = self.input_features or dataset_to_policy_features(dict(features))
        return {key: each for key, each in found.items() if self.reads(key, each)}


def _without_statistics(missing: list[str], meta: Any) -> str:
    imagenet = (
        ". It computes none of cameras, so add --dataset.use_imagenet_stats=false and "
        "--policy.normalization_mapping='{VISUAL: IDENTITY}'"
    )
    return (
        f"{meta.root}/meta/stats.json is missing or has no statistics to normalise {', '.join(missing)} by. "
        f"Make a copy of the dataset with them: lerobot-edit-dataset --repo_id={meta.repo_id} "
        f"--root={meta.root} --operation.type=recompute_stats, and train on that: "
        f"--dataset.repo_id={meta.repo_id}_recomputed_stats, without --dataset.root"
        f"{imagenet if set(missing) & set(meta.camera_keys) else ''}"
    )
