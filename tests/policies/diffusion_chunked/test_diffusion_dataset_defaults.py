"""What of `diffusion_chunked` follows from the dataset, beside what is so for every type."""

import pytest
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.utils.constants import ACTION
from planted_meta import meta_of
from policy_case import STATE, A

from lerobot_act_chunking.policies.dataset_defaults import fit_to_dataset
from lerobot_act_chunking.policies.diffusion_chunked.configuration_diffusion_chunked import (
    DiffusionChunkedConfig,
)


@pytest.mark.parametrize(
    ("fps", "given", "expected"),
    [
        (50, {}, (20, 5, 1)),
        (25, {}, (24, 2, 2)),
        (10, {}, (20, 1, 5)),
        (50, {"actions_per_token": 4}, (20, 5, 4)),
    ],
    ids=str,
)
def test_a_token_lasts_five_control_steps_at_most_unless_it_was_given(fps, given, expected, tmp_path):
    config = DiffusionChunkedConfig(
        input_features=STATE,
        output_features={ACTION: PolicyFeature(FeatureType.ACTION, (A,))},
        device="cpu",
        push_to_hub=False,
        **given,
    )
    assert config.actions_per_token == given.get("actions_per_token", 5)
    fit_to_dataset(config, meta_of(tmp_path, fps=fps, lengths=(400,)))
    assert (config.horizon, config.chunk_stride, config.actions_per_token) == expected
