"""What of `act_chunked` follows from the dataset, beside what is so for every type."""

import pytest
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.utils.constants import ACTION
from planted_meta import meta_of
from policy_case import STATE, A

from lerobot_act_chunking.policies.act_chunked.configuration_act_chunked import ActChunkedConfig
from lerobot_act_chunking.policies.dataset_defaults import fit_to_dataset


def fitted(folder, fps=50, **settings):
    config = ActChunkedConfig(
        input_features=STATE,
        output_features={ACTION: PolicyFeature(FeatureType.ACTION, (A,))},
        device="cpu",
        push_to_hub=False,
        **settings,
    )
    fit_to_dataset(config, meta_of(folder, fps=fps, lengths=(400,)))
    return config


@pytest.mark.parametrize(("fps", "actions_per_query"), [(50, 2), (30, 2), (25, 4), (10, 10)])
def test_a_query_lasts_ten_control_steps_at_most(fps, actions_per_query, tmp_path):
    config = fitted(tmp_path, fps)
    assert config.actions_per_query == actions_per_query
    assert config.actions_per_query * config.chunk_stride <= 10


def test_the_actions_of_a_query_that_were_given_are_kept(tmp_path):
    config = fitted(tmp_path, actions_per_query=1)
    assert (config.chunk_size, config.chunk_stride, config.actions_per_query) == (20, 5, 1)


def test_the_autoregressive_preset_predicts_every_step(tmp_path):
    config = fitted(tmp_path, preset="autoregressive")
    assert (config.chunk_size, config.chunk_stride) == (50, 1)
