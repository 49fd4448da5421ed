import re
import sys

import pytest
import torch
from lerobot.policies.act.modeling_act import ACTTemporalEnsembler
from policy_cases import CASES, A, B, T

from lerobot_act_chunking.errors import ConfigurationError, DatasetError, FeatureError
from lerobot_act_chunking.hub.card import policy_section
from lerobot_act_chunking.policies.act_chunked.modeling_act_chunked import ActChunkedPolicy

STATE, ENVIRONMENT, VECTORS, CAMERAS, MIXED, SAMPLED, SERIAL = (
    case for case in CASES if case.type == "act_chunked"
)


def train(policy, batch, steps):
    optimizer = torch.optim.AdamW(policy.get_optim_params(), lr=1e-2)
    policy.train()
    for _ in range(steps):
        policy.forward(batch)[0].backward()
        optimizer.step()
        optimizer.zero_grad()
        policy.update()


def test_training_learns_from_the_style_that_actions_show_and_evaluation_scores_acting():
    policy, batch = VECTORS.policy(kl_weight=10.0), VECTORS.batch()
    loss, metrics = policy.eval().forward(batch)
    assert loss.item() == pytest.approx(metrics["l1_loss"])
    assert metrics["l1_loss_posterior"] != metrics["l1_loss"]
    acted = policy.predict_action_chunk(batch)
    valid = ~batch["action_is_pad"]
    assert loss.item() == pytest.approx((acted - batch["action"])[valid].abs().mean().item(), rel=1e-5)
    loss, metrics = policy.train().forward(batch)
    assert loss.item() == pytest.approx(metrics["l1_loss"] + 10 * metrics["kld_loss"])
    assert metrics["l1_loss_prior"] != metrics["l1_loss"]


def test_the_loss_weighs_the_divergence():
    losses = {}
    for weight in (0.0, 10.0):
        policy = VECTORS.policy(kl_weight=weight).train()
        torch.manual_seed(3)
        loss, metrics = policy.forward(VECTORS.batch())
        losses[weight] = loss.item()
    assert losses[0.0] == pytest.approx(metrics["l1_loss"])
    assert losses[10.0] == pytest.approx(metrics["l1_loss"] + 10 * metrics["kld_loss"])


def test_padding_may_count_in_the_denominator():
    valid, everything = (
        STATE.policy(pad_normalization=name).forward(STATE.batch())[0] for name in ("valid", "all")
    )
    assert everything.item() == pytest.approx(valid.item() * (T + 2 + 4) / (3 * T))


def test_dropout_is_off_when_acting():
    policy, batch = STATE.policy(dropout=0.5).train(), STATE.batch()
    assert torch.equal(policy.predict_action_chunk(batch), policy.predict_action_chunk(batch))


def test_only_the_executed_queries_are_decoded():
    policy, batch = STATE.policy(n_action_steps=2, actions_per_query=1), STATE.batch()
    decoded = []
    policy.model.head.register_forward_hook(lambda _, args, out: decoded.append(out.shape[1]))
    policy.select_action(batch)
    policy.predict_action_chunk(batch)
    assert decoded == [2, T]


@pytest.mark.parametrize(("weighting", "theirs"), [("act", 0.3), ("recency", -0.3)])
def test_ensembling_equals_lerobots(weighting, theirs):
    policy = STATE.policy(
        execution="ensemble", replan_interval=1, temporal_ensemble_coeff=0.3, ensemble_weighting=weighting
    )
    theirs = ACTTemporalEnsembler(theirs, T)
    generator = torch.Generator().manual_seed(5)
    for _ in range(12):
        batch = {"observation.state": torch.randn(B, 6, generator=generator)}
        expected = theirs.update(policy.predict_action_chunk(batch))
        torch.testing.assert_close(policy.select_action(batch), expected)


def test_strided_predictions_are_interpolated():
    policy, batch = STATE.policy(chunk_stride=3, gripper_dims=[1]), STATE.batch()
    chunk = policy.predict_action_chunk(batch)
    keyframes = STATE.policy(actions_per_query=policy.config.actions_per_query).predict_action_chunk(batch)
    assert chunk.shape == (B, 3 * (T - 1) + 1, A)
    torch.testing.assert_close(chunk[:, ::3], keyframes)
    torch.testing.assert_close(chunk[:, 2::3, 1], keyframes[:, :-1, 1])
    assert policy.config.action_delta_indices == [0, 3, 6, 9, 12]


@pytest.mark.parametrize("n_action_steps", range(1, 14))
def test_what_is_executed_does_not_depend_on_how_much_was_decoded(n_action_steps):
    execution = {"execution": "open_loop", "n_action_steps": n_action_steps}
    policy, batch = STATE.policy(chunk_stride=3, **execution), STATE.batch()
    expected = policy.predict_action_chunk(batch)[:, :n_action_steps]
    actions = torch.stack([policy.select_action(batch) for _ in range(n_action_steps)], dim=1)
    torch.testing.assert_close(actions, expected)


def test_tools_can_see_when_the_next_inference_is_due():
    policy, batch = STATE.policy(execution="open_loop", n_action_steps=3), STATE.batch()
    due = []
    for _ in range(4):
        due.append(len(policy._action_queue) == 0)
        policy.select_action(batch)
    assert due == [True, False, False, True]


def test_the_average_acts_and_the_weights_train():
    policy, batch = ENVIRONMENT.policy(), ENVIRONMENT.batch()
    train(policy, batch, steps=5)
    averaged = policy.predict_action_chunk(batch)
    policy.ema.restart(policy.model)
    assert not torch.allclose(averaged, policy.predict_action_chunk(batch))
    assert policy.eval().forward(batch)[0].item() == pytest.approx(policy.train().forward(batch)[0].item())


def test_the_average_resumes_exactly(tmp_path):
    policy, batch = ENVIRONMENT.policy(), ENVIRONMENT.batch()
    train(policy, batch, steps=3)
    policy.save_pretrained(tmp_path)
    resumed = ActChunkedPolicy.from_pretrained(tmp_path)
    for one in (policy, resumed):
        train(one, batch, steps=3)
    for name, value in policy.state_dict().items():
        assert torch.equal(value, resumed.state_dict()[name]), name


def test_an_average_can_start_at_a_checkpoint_without_one(tmp_path):
    policy, batch = ENVIRONMENT.policy(use_ema=False), ENVIRONMENT.batch()
    train(policy, batch, steps=2)
    policy.save_pretrained(tmp_path)
    loaded = ActChunkedPolicy.from_pretrained(tmp_path, config=ENVIRONMENT.config(use_ema=True))
    assert torch.equal(loaded.predict_action_chunk(batch), policy.predict_action_chunk(batch))


def test_an_average_can_be_left_behind(tmp_path):
    policy, batch = ENVIRONMENT.policy(), ENVIRONMENT.batch()
    train(policy, batch, steps=3)
    policy.save_pretrained(tmp_path)
    loaded = ActChunkedPolicy.from_pretrained(tmp_path, config=ENVIRONMENT.config(use_ema=False))
    assert not any(name.startswith("ema.") for name in loaded.state_dict())
    assert torch.equal(loaded.model.decoder.start, policy.model.decoder.start)


def test_without_averaging_no_second_network_is_kept():
    assert len(STATE.policy().state_dict()) == len(STATE.policy().model.state_dict())


def test_a_checkpoint_that_does_not_fit_is_refused(tmp_path):
    STATE.policy().save_pretrained(tmp_path)
    with pytest.raises(RuntimeError, match="Missing key"):
        ActChunkedPolicy.from_pretrained(tmp_path, config=STATE.config(n_encoder_layers=3))


def test_loading_a_checkpoint_needs_no_cached_backbone(tmp_path, monkeypatch):
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    settings = {"vision_backbone": "resnet18", "backbone_norm": "frozen_batch"}
    MIXED.policy(**settings).save_pretrained(tmp_path)
    config = MIXED.config(**settings, pretrained_backbone_weights="ResNet18_Weights.IMAGENET1K_V1")
    ActChunkedPolicy.from_pretrained(tmp_path, config=config)
    with pytest.raises(ConfigurationError, match="nothing is downloaded for you"):
        ActChunkedPolicy(config)


def test_the_backbone_learns_at_its_own_rate():
    rest, backbone = CAMERAS.policy(optimizer_lr_backbone=0.5).get_optim_params()
    assert "lr" not in rest
    assert backbone["lr"] == 0.5
    assert len(backbone["params"]) == 12
    assert len(STATE.policy().get_optim_params()) == 1


@pytest.mark.parametrize("key", ["observation.state", "action"])
def test_a_nan_in_a_batch_is_traced_to_its_key(key):
    policy, batch = STATE.policy(), STATE.batch()
    batch[key][0, 0] = torch.nan
    with pytest.raises(DatasetError, match=f"'{key}' in the batch holds a NaN"):
        policy.forward(batch)


def test_diverged_weights_are_told_from_bad_data():
    policy = STATE.policy()
    policy.model.style_token.data.fill_(torch.inf)
    with pytest.raises(DatasetError, match="all inputs are finite: the weights have diverged, lower"):
        policy.forward(STATE.batch())


def test_another_state_size_is_refused():
    batch = {**STATE.batch(), "observation.state": torch.zeros(B, 14)}
    with pytest.raises(
        FeatureError, match=re.escape("has shape (3, 14), but the policy was built for (B, 6) or (B, 1, 6)")
    ):
        STATE.policy().select_action(batch)


def test_a_nan_in_the_dataset_is_found_at_construction():
    stats = {"observation.state": {"mean": [float("nan")]}}
    with pytest.raises(DatasetError, match=r"statistic 'mean' of 'observation\.state'"):
        ActChunkedPolicy(STATE.config(), dataset_stats=stats)


def test_adapters_reach_every_attention_and_feed_forward_layer():
    pattern = STATE.policy()._get_default_peft_targets()["target_modules"]
    names = [name for name, _ in VECTORS.policy().named_modules() if re.fullmatch(pattern, name)]
    assert len(names) == 2 * 6 + 6  # two encoder layers and one decoder layer without self-attention
    assert not any("style" in name for name in names)


def test_adapters_and_averaging_exclude_each_other():
    policy = ENVIRONMENT.policy()
    policy.config.pretrained_path = "somewhere"
    with pytest.raises(ConfigurationError, match="use_ema does not follow PEFT adapters"):
        policy._validate_peft_config(None)


def test_sharding_units_exist():
    classes = {type(module).__name__ for module in STATE.policy().modules()}
    assert set(ActChunkedPolicy._fsdp_wrap_modules) <= classes


@pytest.mark.filterwarnings("ignore:invalid escape sequence:DeprecationWarning")  # in LeRobot's template
def test_the_model_card_ends_with_what_the_policy_reads_and_how_it_acts(monkeypatch):
    monkeypatch.setattr("huggingface_hub.ModelCard.validate", lambda *_, **__: None)  # asks the real Hub
    policy = STATE.policy()
    card = policy.generate_model_card("me/cube", "act_chunked", None, None)
    assert card.text.endswith(policy_section(policy.config, command=sys.argv))
    assert "observation.state" in card.text


def test_sampled_chunks_differ_and_repeat_with_their_numbers():
    policy, batch = SAMPLED.policy(), SAMPLED.batch()
    policy.reset(episode_seeds=range(B))
    first, second = policy.predict_action_chunk(batch), policy.predict_action_chunk(batch)
    assert not torch.equal(first, second)
    policy.reset(episode_seeds=range(B))
    assert torch.equal(policy.predict_action_chunk(batch), first)
    noise = SAMPLED.noise(B)
    assert torch.equal(
        policy.predict_action_chunk(batch, **noise), policy.predict_action_chunk(batch, **noise)
    )


def test_several_samples_of_each_observation():
    policy, batch = SAMPLED.policy(z_hold="chunk"), SAMPLED.batch()
    policy.reset(episode_seeds=range(B))
    samples = policy.predict_samples(batch, 2)
    assert samples.shape == (2, B, T, A)
    policy.reset(episode_seeds=range(B))
    torch.testing.assert_close(policy.predict_samples(batch, 1)[0], samples[0])
    assert not torch.equal(samples[0], samples[1])


def test_coherence_chooses_among_samples():
    policy = SAMPLED.policy(execution="coherence", n_samples=3, z_hold="chunk", n_action_steps=2)
    batch = SAMPLED.batch()
    actions = [policy.select_action(batch) for _ in range(4)]
    assert actions[0].shape == (B, A)
    assert torch.isfinite(torch.stack(actions)).all()


def test_the_divergence_sets_in_with_optimiser_steps():
    policy, batch = VECTORS.policy(kl_weight=10.0, kl_anneal="linear", kl_anneal_steps=4), VECTORS.batch()
    policy.train()
    shares = []
    for _ in range(6):
        loss, metrics = policy.forward(batch)
        shares.append((loss.item() - metrics["l1_loss"]) / (10 * metrics["kld_loss"]))
        policy.update()
    assert shares == pytest.approx([0, 0.25, 0.5, 0.75, 1, 1], abs=1e-3)


def test_serial_decoding_is_teacher_forcing_on_its_own_actions():
    policy, batch = SERIAL.policy(), SERIAL.batch()
    chunk = policy.predict_action_chunk(batch)
    own = batch | {"action": chunk, "action_is_pad": torch.zeros(B, T, dtype=torch.bool)}
    assert policy.eval().forward(own)[1]["l1_loss"] < 1e-6
    assert policy.forward(batch)[1]["l1_loss"] > 0.1


def test_images_shift_in_training_alone():
    policy, batch = CAMERAS.policy(use_vae=False, random_shift=3), CAMERAS.batch()
    losses = [policy.eval().forward(batch)[1]["l1_loss"] for _ in range(2)]
    assert losses[0] == losses[1]
    losses = [policy.train().forward(batch)[1]["l1_loss"] for _ in range(2)]
    assert losses[0] != losses[1]
