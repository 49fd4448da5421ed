"""While the tokenizer learns alone, no images are decoded."""

import pytest
from cases_vqbet_chunked import VQBET
from lerobot.configs.default import DatasetConfig
from lerobot.configs.train import TrainPipelineConfig
from lerobot.datasets import factory
from lerobot.policies.factory import make_policy, make_pre_post_processors
from lerobot.utils.import_utils import register_third_party_plugins
from recorded_sets import TOP, images, record
from torch.utils.data import default_collate

from lerobot_act_chunking.data.fast_chunks import install
from lerobot_act_chunking.policies.vqbet_chunked.configuration_vqbet_chunked import VqbetChunkedConfig


@pytest.fixture(autouse=True)
def plugged():
    register_third_party_plugins()
    assert install()


def test_the_tokenizers_phase_decodes_no_images(tmp_path):
    root = record(tmp_path / "set", images((TOP,)))
    config = VqbetChunkedConfig(**VQBET | {"n_vqvae_training_steps": 9}, device="cpu", push_to_hub=False)
    source = DatasetConfig("tests/read", root=str(root), use_imagenet_stats=False)
    dataset = factory.make_dataset(TrainPipelineConfig(source, policy=config, num_workers=0))
    policy = make_policy(config, ds_meta=dataset.meta)
    preprocessor, _ = make_pre_post_processors(config, dataset_stats=dataset.meta.stats)
    decoded = []
    for _ in range(12):
        batch = preprocessor(default_collate(dataset.__getitems__([0, 5, 20])))
        decoded.append(TOP in batch)
        policy.train().forward(batch)
    ahead = config.image_switch.ahead
    assert decoded == [False] * (10 - ahead) + [True] * (2 + ahead)
    # A resumed run finds the phase where it was, before its first batch.
    config.image_switch.want_images_in(100)
    policy.load_state_dict(policy.state_dict())
    assert TOP in dataset[0]


def test_images_are_wanted_again_before_workers_make_the_first_batch_that_is_looked_at():
    switch = VqbetChunkedConfig().image_switch
    switch.expect_workers(num_workers=4, prefetch_factor=5)
    switch.want_images_in(24)
    assert switch.off
    switch.want_images_in(23)
    assert not switch.off
