"""Mode-balanced training, of every type: off it changes nothing; on, rare ways count as told."""

import json
import logging

import pytest
import torch
from lerobot.policies.factory import get_policy_class
from planted_meta import meta_of
from policy_case import STATE
from policy_cases import CASES
from training_runs import fresh, record, weights

from lerobot_act_chunking.errors import ActChunkingError, ConfigurationError, DatasetError, FeatureError

FIRST = {case.type: case for case in reversed(CASES) if case.inputs == STATE}
"""A case of each type that reads states alone."""
every_type = pytest.mark.parametrize("kind", FIRST)
LENGTHS = (30, 30, 30, 10)
WEIGHT = {0: 100 / 90 / 2, 1: 100 / 10 / 2}
"""Of the modes of three episodes of 30 frames and one of 10, so that both have the same part."""


@pytest.fixture
def meta(tmp_path):
    found = meta_of(tmp_path, lengths=LENGTHS)
    label(found.root, [0, 0, 0, 1])
    return found


def label(folder, modes):
    episodes = [{"episode_index": i, "details": {"mode": mode}} for i, mode in enumerate(modes)]
    (folder / "meta").mkdir(exist_ok=True)
    (folder / "meta/recording.json").write_text(json.dumps({"episodes": episodes}))


def made(kind, meta=None, **settings):
    """A policy in training mode, the same whatever its balance."""
    torch.manual_seed(0)
    policy = get_policy_class(kind)(FIRST[kind].config(**settings), dataset_meta=meta)
    asked, policy.config.balance_modes = policy.config.balance_modes, "none"
    policy = FIRST[kind].kind.finish(policy).train()  # on a batch without episodes
    policy.config.balance_modes = asked
    return policy


def batch_of(kind, episodes):
    return FIRST[kind].batch(len(episodes)) | {"episode_index": torch.tensor(episodes)}


def losses(policy, batch, reduction="none"):
    torch.manual_seed(1)
    return policy(batch, reduction=reduction)[0].detach()


@every_type
def test_off_the_losses_are_those_without_modes_to_the_bit(kind, meta):
    without = {key: value for key, value in batch_of(kind, [0, 3, 1]).items() if key != "episode_index"}
    assert losses(made(kind, meta), batch_of(kind, [0, 3, 1])).equal(losses(made(kind), without))


@every_type
def test_on_each_loss_is_multiplied_by_the_weight_of_its_mode(kind, meta):
    batch = batch_of(kind, [0, 3, 2])
    plain = losses(made(kind, meta), batch)
    found = losses(made(kind, meta, balance_modes="labels"), batch)
    torch.testing.assert_close(found, plain * torch.tensor([WEIGHT[0], WEIGHT[1], WEIGHT[0]]))


@every_type
def test_the_mean_is_that_of_the_weighted_losses(kind, meta):
    batch = batch_of(kind, [3, 3, 0])
    each = losses(made(kind, meta, balance_modes="labels"), batch)
    torch.testing.assert_close(losses(made(kind, meta, balance_modes="labels"), batch, "mean"), each.mean())


@every_type
def test_the_logged_terms_stay_comparable(kind, meta):
    batch, terms = batch_of(kind, [3, 3, 0]), []
    for balance in ("labels", "none"):
        policy = made(kind, meta, balance_modes=balance)
        torch.manual_seed(1)
        terms.append(policy(batch)[1])
    assert terms[0] == terms[1]


@every_type
def test_power_zero_is_off(kind, meta):
    batch = batch_of(kind, [0, 3, 1])
    off = losses(made(kind, meta), batch)
    assert losses(made(kind, meta, balance_modes="labels", mode_balance_power=0.0), batch).equal(off)


@every_type
def test_evaluation_weighs_all_alike(kind, meta):
    batch = batch_of(kind, [0, 3, 1])
    found = losses(made(kind, meta, balance_modes="labels").eval(), batch)
    assert found.equal(losses(made(kind, meta).eval(), batch))


@every_type
def test_nothing_of_it_is_saved_with_the_weights(kind, meta):
    assert made(kind, meta, balance_modes="labels").state_dict().keys() == made(kind).state_dict().keys()


def test_modes_that_are_not_recorded_are_refused_before_training(tmp_path):
    kind = next(iter(FIRST))
    meta = meta_of(tmp_path, lengths=LENGTHS)
    config = FIRST[kind].config(balance_modes="labels")
    with pytest.raises(DatasetError, match="balance_modes=clusters"):
        config.check_dataset(meta.features, meta)
    label(meta.root, [0, 1])
    with pytest.raises(DatasetError, match="the mode of episode 2"):
        made(kind, meta, balance_modes="labels")


@pytest.mark.parametrize("settings", [{"balance_modes": "some"}, {"mode_balance_power": 1.5}])
def test_settings_that_cannot_work_are_refused(settings):
    with pytest.raises(ConfigurationError, match=next(iter(settings))):
        FIRST[next(iter(FIRST))].config(**settings)


def test_what_cannot_be_weighed_is_refused(meta):
    kind = next(iter(FIRST))
    with pytest.raises(FeatureError, match="episode_index"):
        losses(made(kind, meta, balance_modes="labels"), FIRST[kind].batch())
    with pytest.raises(ActChunkingError, match="dataset_meta"):
        losses(made(kind, balance_modes="labels"), batch_of(kind, [0, 1, 2]))


def test_clusters_are_found_in_the_dataset_and_one_way_is_said(tmp_path, caplog):
    kind = next(iter(FIRST))
    meta = meta_of(tmp_path, lengths=(12, 12))
    meta.root = record(tmp_path / "toy")
    with caplog.at_level(logging.WARNING):
        policy = made(kind, meta, balance_modes="clusters")
    assert "balance_modes=clusters found one way" in caplog.text
    assert policy.mode_balance.weights.tolist() == [1.0, 1.0]


@pytest.mark.slow
@pytest.mark.parametrize("kind", FIRST)
def test_a_resumed_run_is_the_undisturbed_one(train, tmp_path, kind):
    dataset = record(tmp_path / "data")
    label(dataset, [0, 1])
    options = ["--steps=4", "--policy.balance_modes=labels", "--policy.mode_balance_power=0.5"]
    train(*fresh(dataset, tmp_path / "whole", *options, policy_type=kind))
    config = tmp_path / "whole/checkpoints/000002/pretrained_model/train_config.json"
    train(f"--config_path={config}", "--resume=true", f"--output_dir={tmp_path / 'resumed'}")
    whole, resumed = weights(tmp_path / "whole", "000004"), weights(tmp_path / "resumed", "000004")
    for name, value in whole.items():
        assert value.equal(resumed[name]), name
