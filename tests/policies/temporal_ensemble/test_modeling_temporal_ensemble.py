"""Chunks of every type of inner policy, executed by the wrapper."""

import pytest
import torch
from lerobot.policies.act.modeling_act import ACTTemporalEnsembler
from wrapped_cases import ACT, CASES, DIFFUSION, OURS, VQBET, A, B

from lerobot_act_chunking.errors import ConfigurationError, FeatureError


@pytest.fixture(params=CASES.values(), ids=CASES)
def case(request):
    return request.param


def act(policy, case, steps, first=0, batch_size=B):
    """Actions (steps, B, A) on changing observations; every call starts from a random state of its own."""
    actions = []
    for step in range(first, first + steps):
        torch.manual_seed(step)
        actions.append(policy.select_action(case.batch(seed=step, batch_size=batch_size)))
    return torch.stack(actions)


def snapshot(batch):
    return {key: value.clone() for key, value in batch.items()}


def assert_unchanged(batch, before):
    assert batch.keys() == before.keys()
    for key, value in before.items():
        assert torch.equal(batch[key], value), key


def test_open_loop_is_the_bare_policy_bit_for_bit(case):
    bare, wrapped = case.bare(), case.wrapped(execution="open_loop", n_action_steps=case.executes)
    assert torch.equal(act(wrapped, case, 11), act(bare, case, 11))


def test_reset_equals_fresh(case):
    used, fresh = case.wrapped(replan_interval=2), case.wrapped(replan_interval=2)
    act(used, case, 3, first=50)
    for policy in (used, fresh):
        policy.reset(episode_seeds=range(3))
    assert torch.equal(act(used, case, 7), act(fresh, case, 7))


def test_the_whole_chunk_comes_from_a_fresh_wrapper(case):
    assert case.wrapped().predict_action_chunk(case.batch()).shape == (B, case.chunk_size, A)


def test_a_chunk_begins_as_the_bare_policy_acts(case):
    torch.manual_seed(0)
    chunk = case.wrapped().predict_action_chunk(case.batch(seed=0))
    bare = case.bare()
    for step in range(case.executes):
        torch.manual_seed(step)
        assert torch.equal(chunk[:, step], bare.select_action(case.batch(seed=0 if step == 0 else 9)))


def test_batches_are_never_changed(case):
    policy, training, batch = case.wrapped(), case.training_batch(), case.batch()
    before = snapshot(training)
    policy.train().forward(training)[0].backward()
    assert_unchanged(training, before)
    batch["action"] = training["action"]
    before = snapshot(batch)
    policy.select_action(batch)
    policy.predict_action_chunk(batch)
    assert_unchanged(batch, before)


def test_training_is_the_inner_policys(case):
    bare, wrapped = case.bare().train(), case.wrapped().train()
    losses = []
    for policy in (bare, wrapped):
        torch.manual_seed(5)
        losses.append(policy.forward(case.training_batch())[0])
        losses[-1].backward()
    assert torch.equal(*losses)
    groups = [list(policy.get_optim_params()) for policy in (bare, wrapped)]
    assert len(groups[0]) == len(groups[1])
    gradients = [
        {name.removeprefix("inner."): p.grad for name, p in policy.named_parameters()}
        for policy in (bare, wrapped)
    ]
    assert gradients[0].keys() == gradients[1].keys()
    for name, gradient in gradients[0].items():
        assert gradient is None or torch.equal(gradient, gradients[1][name]), name


def test_acting_leaves_training_mode(case):
    policy = case.wrapped().train()
    policy.select_action(case.batch())
    assert not policy.inner.training


def test_environments_are_reset_and_replanned_alone(case, monkeypatch):
    without_randomness(case, monkeypatch)
    together, other = case.wrapped(replan_interval=2), case.wrapped(replan_interval=2)
    assert torch.equal(act(together, case, 3), act(other, case, 3))
    together.reset([1], episode_seeds=[5])
    asked = record_batch_sizes(together)
    after = act(together, case, 4, first=3)
    undisturbed = act(other, case, 4, first=3)
    scale = undisturbed.abs().max().item()  # an untrained network may do nearly nothing
    close = min(1e-4, 1e-3 * scale)
    assert torch.allclose(after[:, [0, 2]], undisturbed[:, [0, 2]], rtol=0, atol=close)
    alone = case.wrapped(replan_interval=2)
    alone.reset(episode_seeds=[4, 5, 6])
    fresh = act(alone, case, 4, first=3)
    assert torch.allclose(after[:, 1], fresh[:, 1], rtol=0, atol=close)
    assert not torch.allclose(after[:, 1], undisturbed[:, 1], rtol=0, atol=5e-3 * scale)
    assert asked == [1, 2, 1, 2]


def without_randomness(case, monkeypatch):
    """Samples must not depend on how many environments are predicted together."""
    if case.type == "diffusion":
        monkeypatch.setattr(torch, "randn", lambda *_, size=None, **__: torch.zeros(size))
        scheduler = "diffusers.schedulers.scheduling_ddpm.randn_tensor"
        monkeypatch.setattr(scheduler, lambda shape, **_: torch.zeros(shape))
    if case.type == "vqbet":
        monkeypatch.setattr(
            torch, "multinomial", lambda weights, num_samples: weights.argmax(-1, keepdim=True)
        )


def record_batch_sizes(policy):
    sizes, predict = [], policy.inner.predict_action_chunk

    def recording(batch, **kwargs):
        chunk = predict(batch, **kwargs)
        sizes.append(len(chunk))
        return chunk

    policy.inner.predict_action_chunk = recording
    return sizes


def test_ensembling_is_lerobots():
    ensembler, bare = ACTTemporalEnsembler(0.05, ACT.chunk_size), ACT.bare()
    wrapped = ACT.wrapped(replan_interval=1, temporal_ensemble_coeff=0.05)
    for step in range(30):
        batch = ACT.batch(seed=step)
        expected = ensembler.update(bare.predict_action_chunk(batch))
        torch.testing.assert_close(wrapped.select_action(batch), expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    "inner",
    [
        {**ACT.inner, "temporal_ensemble_coeff": 0.5, "n_action_steps": 1},
        {**OURS.inner, "execution": "ensemble", "replan_interval": 1},
    ],
    ids=lambda inner: inner["type"],
)
def test_execution_of_the_inner_policy_is_not_used(inner):
    case = ACT if inner["type"] == "act" else OURS
    plain = case.wrapped(execution="open_loop")
    config = case.config(execution="open_loop")
    config = type(config)(
        inner=inner,
        input_features=config.input_features,
        output_features=config.output_features,
        device="cpu",
        execution="open_loop",
    )
    policy = type(plain)(config).eval()
    policy.inner.load_state_dict(plain.inner.state_dict())
    assert torch.equal(act(policy, case, 12), act(plain, case, 12))


@pytest.mark.parametrize("case", [DIFFUSION, VQBET], ids=lambda case: case.type)
def test_a_batch_with_a_time_axis_is_its_own_history(case):
    policy, steps = case.wrapped(), case.settings["n_obs_steps"]
    observed = [case.batch(seed=seed) for seed in range(steps)]
    for batch in observed:
        torch.manual_seed(3)
        expected = policy.predict_action_chunk(batch)
    history = {key: torch.stack([batch[key] for batch in observed], dim=1) for key in case.inputs}
    fresh = case.wrapped()
    torch.manual_seed(3)
    assert torch.equal(fresh.predict_action_chunk(history), expected)
    torch.manual_seed(3)
    alone = case.wrapped().predict_action_chunk(observed[0])
    torch.manual_seed(3)
    assert torch.equal(fresh.predict_action_chunk(observed[0]), alone)


def test_coherence_chooses_among_samples_of_one_call():
    policy = DIFFUSION.wrapped(execution="coherence", n_samples=6, replan_interval=2)
    asked = record_batch_sizes(policy)
    chunks = []
    policy._action_queue.on_chunk = lambda event: chunks.append(event.chunk)
    actions = act(policy, DIFFUSION, 5)
    assert asked == [6 * B] * 3
    assert actions.shape == (5, B, A)
    assert torch.equal(actions[:2], chunks[0][:, :2].transpose(0, 1))


def test_samples_of_one_environment_stay_together(monkeypatch):
    without_randomness(DIFFUSION, monkeypatch)
    policy = DIFFUSION.wrapped(execution="coherence", n_samples=6, replan_interval=2)
    plain = DIFFUSION.wrapped(execution="receding", replan_interval=2)
    torch.testing.assert_close(act(policy, DIFFUSION, 5), act(plain, DIFFUSION, 5), rtol=0, atol=1e-4)


def test_sample_weighting_needs_losses_per_sample():
    loss, _ = OURS.wrapped().train().forward(OURS.training_batch(), reduction="none")
    assert loss.shape == (B,)
    with pytest.raises(ConfigurationError, match="one loss per sample, which act does not compute"):
        ACT.wrapped().forward(ACT.training_batch(), reduction="none")


def test_the_average_of_the_weights_is_updated():
    case = type(OURS)(OURS.type, OURS.inputs, {**OURS.settings, "use_ema": True}, 10, 5)
    policy = case.wrapped()
    policy.update()
    assert policy.inner.ema.step == 1
    ACT.wrapped().update()


def test_a_batch_without_inputs_is_refused(case):
    with pytest.raises(FeatureError, match=r"the policy needs observation.state.*batch has only action"):
        case.wrapped().select_action({"action": torch.zeros(B, A)})


def test_a_queued_observation_that_is_missing_is_named():
    batch = DIFFUSION.batch()
    del batch["observation.environment_state"]
    with pytest.raises(FeatureError, match=r"needs observation.environment_state, but the batch has only"):
        DIFFUSION.wrapped().select_action(batch)


def test_a_chunk_shorter_than_its_settings_say_is_refused():
    policy = ACT.wrapped()
    policy.inner.predict_action_chunk = lambda batch: torch.zeros(B, 3, A)
    with pytest.raises(ConfigurationError, match=r"chunks of 3 actions.*set --policy.n_action_steps=3"):
        policy.select_action(ACT.batch())


def test_every_policy_does_real_time_chunking(case):
    policy = case.wrapped()
    assert policy.supports_rtc()
    policy.init_rtc_processor()
    chunk = policy.predict_action_chunk(case.batch(), inference_delay=2, prev_chunk_left_over=None)
    assert chunk.shape == (B, case.chunk_size, A)


@pytest.mark.filterwarnings("ignore:invalid escape sequence:DeprecationWarning")  # in LeRobot's template
def test_the_model_card_says_what_is_read_and_how_chunks_are_executed(monkeypatch):
    monkeypatch.setattr("huggingface_hub.ModelCard.validate", lambda *_: None)  # asks the Hub
    card = ACT.wrapped(replan_interval=3).generate_model_card("me/cube", "temporal_ensemble", None, None)
    assert "a new chunk is asked for every 3 steps" in card.text
    assert "`observation.environment_state` | ENV | (7,)" in card.text
