"""What `vqbet_chunked` does beyond the contract: its phases, histories, samples."""

import pytest
import torch
from policy_cases import STATE, TOP, VELOCITY, A, B, Case, T, history_batch

from lerobot_act_chunking.errors import DatasetError

PLAIN = Case("plain", "vqbet_chunked", STATE, {"tokenizer": "fsq", "use_ema": False})


def shaken(case=PLAIN, **settings):
    """A policy whose output depends on everything; fresh heads say the same everywhere."""
    policy = case.policy(**settings)
    generator = torch.Generator().manual_seed(2)
    for parameter in policy.parameters():
        parameter.data += 0.3 * torch.randn(parameter.shape, generator=generator)
    return policy


def observation(seed=1, n=B, shape=(6,)):
    return {"observation.state": torch.randn(n, *shape, generator=torch.Generator().manual_seed(seed))}


def snapshot(module):
    return {name: value.clone() for name, value in module.state_dict().items()}


def fresh(**settings):
    """A policy whose tokenizer has learned nothing yet."""
    from lerobot_act_chunking.policies.vqbet_chunked.modeling_vqbet_chunked import VqbetChunkedPolicy

    torch.manual_seed(0)
    return VqbetChunkedPolicy(PLAIN.config(tokenizer="residual_vq", **settings)).train()


def test_first_the_tokenizer_learns_then_the_policy():
    policy = fresh(n_vqvae_training_steps=2)
    optimizer = torch.optim.SGD(policy.get_optim_params(), lr=0.1)
    for step in range(4):
        before = snapshot(policy.tokenizer), snapshot(policy.model)
        loss, metrics = policy.forward(PLAIN.batch())
        assert ("tokenizer_loss" in metrics, "code_loss" in metrics) == (step < 2, step >= 2)
        loss.backward()
        optimizer.step()
        optimizer.zero_grad()
        after = snapshot(policy.tokenizer), snapshot(policy.model)
        moved = [any(not torch.equal(b[k], a[k]) for k in b) for b, a in zip(before, after, strict=True)]
        assert moved == [step < 2, step >= 2]


def test_a_checkpoint_knows_how_much_its_tokenizer_has_learned(tmp_path):
    policy = fresh(n_vqvae_training_steps=3)
    policy.forward(PLAIN.batch())
    policy.save_pretrained(tmp_path)
    loaded = type(policy).from_pretrained(tmp_path).train()
    for one in (policy, loaded):
        one.forward(PLAIN.batch())
    for name, value in policy.state_dict().items():
        assert torch.equal(value, loaded.state_dict()[name]), name
    assert loaded.tokenizer_phase.n_learned == 2


def test_the_average_of_the_weights_begins_with_the_policy():
    policy = fresh(n_vqvae_training_steps=1, use_ema=True)
    policy.update()
    assert policy.ema.step == 0
    policy.forward(PLAIN.batch())
    policy.update()
    assert policy.ema.step == 1


def test_evaluating_teaches_the_tokenizer_nothing():
    policy = fresh(n_vqvae_training_steps=5)
    policy.forward(PLAIN.batch())
    before = snapshot(policy)
    losses = [policy.eval().forward(PLAIN.batch())[0] for _ in range(2)]
    assert torch.equal(*losses)
    for name, value in snapshot(policy).items():
        assert torch.equal(value, before[name]), name


def test_an_untaught_tokenizer_is_mentioned(caplog):
    fresh(n_vqvae_training_steps=5).predict_action_chunk(observation())
    assert "the tokenizer has not learned yet (training step 0)" in caplog.text


def test_a_history_is_what_earlier_steps_observed():
    policy = shaken(n_obs_steps=2)
    first, second = observation(1), observation(2)
    noise = torch.full((B, 2), 0.4)
    window = {key: torch.stack((first[key], second[key]), dim=1) for key in first}
    expected = policy.predict_action_chunk(window, noise=noise)
    policy.reset()
    policy.predict_action_chunk(first, noise=noise)
    torch.testing.assert_close(policy.predict_action_chunk(second, noise=noise), expected)
    policy.reset()
    assert not torch.allclose(policy.predict_action_chunk(second, noise=noise), expected)


def test_each_query_learns_from_its_own_chunk():
    """The features of query q decide the loss of chunk q alone, and see observations up to q alone."""
    case = Case("three inputs", "vqbet_chunked", STATE | VELOCITY | TOP, {"use_ema": False})
    policy = shaken(case, n_obs_steps=3, n_action_pred_token=2, tokenizer="dct")
    batch = history_batch(policy)
    seen = []
    forward = policy.model.forward
    policy.model.forward = lambda *args: seen.append(forward(*args)) or seen[-1]
    policy.forward(batch)
    changed = {**batch, "observation.velocity": batch["observation.velocity"].clone()}
    changed["observation.velocity"][:, 1] += 1
    policy.forward(changed)
    differs = (seen[0] - seen[1]).abs().amax((0, 2)) > 0
    assert differs.tolist() == [False, True, True, True]
    actions = batch["action"].clone()
    actions[:, 0] += 1  # only the first query predicts the first action
    losses = policy.forward(batch)[1], policy.forward({**batch, "action": actions})[1]
    assert losses[0] != losses[1]
    assert policy.windows.tolist() == [[0, 1, 2, 3, 4], [1, 2, 3, 4, 5], [2, 3, 4, 5, 6], [3, 4, 5, 6, 7]]


def test_acting_is_the_current_query_of_training():
    policy = shaken(n_obs_steps=3, n_action_pred_token=2)
    window = policy._window_of({"observation.state": torch.randn(B, 3, 6)})
    torch.testing.assert_close(policy.model.current(window), policy.model(window, 1)[:, 2])


def test_samples_follow_the_predicted_probabilities():
    policy = shaken(vqvae_num_layers=1, top_p=1.0)
    window = policy._window_of(observation(n=1))
    features = policy.model.current(window)
    logits = policy.model.code_head.logits(features, torch.zeros(1, 1, dtype=torch.int64))
    n = 4000
    noise = (torch.arange(n) + 0.5)[:, None, None] / n
    chunks = policy.predict_samples(observation(n=1), n, noise=noise)
    shares = chunks[:, 0].flatten(1).unique(dim=0, return_counts=True)[1].sort(descending=True)[0] / n
    expected = logits[0, 0].softmax(-1).sort(descending=True)[0]
    torch.testing.assert_close(shares, expected[: len(shares)], atol=2 / n, rtol=0)
    assert expected[len(shares) :].sum() < 2 / n


def test_without_temperature_there_is_one_chunk():
    samples = shaken(bet_softmax_temperature=0.0).predict_samples(observation(), 7)
    assert torch.equal(samples, samples[:1].expand_as(samples))


def test_a_held_choice_lasts_until_the_environment_is_reset():
    policy = shaken(code_hold="episode", top_p=1.0, bet_softmax_temperature=5.0)
    first, again = (policy.predict_action_chunk(observation()) for _ in range(2))
    assert torch.equal(first, again)
    other = shaken(code_hold="chunk", top_p=1.0, bet_softmax_temperature=5.0)
    chunks = [other.predict_action_chunk(observation()) for _ in range(8)]
    assert torch.equal(chunks[0], first)
    assert any(not torch.equal(chunks[0], chunk) for chunk in chunks)


def test_every_seed_chooses_otherwise():
    samples = [shaken(noise_seed=seed, top_p=1.0).predict_samples(observation(), 20) for seed in (0, 0, 1)]
    assert torch.equal(samples[0], samples[1])
    assert not torch.equal(samples[0], samples[2])


def test_coherence_chooses_among_samples():
    policy = shaken(execution="coherence", n_samples=6, replan_interval=2)
    events = []
    policy._action_queue.on_chunk = events.append
    for _ in range(4):
        policy.select_action(observation())
    assert [event.chunk.shape for event in events] == [(B, T, A)] * 2


def test_strided_chunks_pass_through_the_predictions():
    policy = shaken(chunk_stride=3)
    policy.reset(episode_seeds=range(B))
    chunk = policy.predict_action_chunk(observation())
    assert chunk.shape == (B, 4 * 3 + 1, A)
    policy.config.chunk_stride = 1
    policy.config.n_action_steps = T
    policy.reset(episode_seeds=range(B))
    torch.testing.assert_close(policy.predict_action_chunk(observation()), chunk[:, ::3])


def test_the_offset_is_learned_at_the_demonstrations_code():
    """What the policy would sample matters for the offset loss of sampled codes alone."""
    for target, same in (("gt_code", True), ("sampled", False)):
        policy = shaken(offset_target=target, focal_gamma=0.0, top_p=1.0)
        losses = []
        for shift in (0.0, 3.0):
            for parameter in policy.model.code_head.parameters():
                parameter.data += shift * torch.randn(
                    parameter.shape, generator=torch.Generator().manual_seed(9)
                )
            losses.append(policy.eval().forward(PLAIN.batch())[1]["offset_loss"])
        assert (losses[0] == losses[1]) == same


def test_a_chunk_that_is_all_padding_teaches_nothing():
    policy = shaken(n_obs_steps=3)
    batch = history_batch(policy)
    batch["action_is_pad"][0] = True
    loss, _ = policy.forward(batch)
    batch["observation.state"] = batch["observation.state"].clone()
    batch["observation.state"][0] += 1
    torch.testing.assert_close(policy.forward(batch)[0], loss)


def test_a_loss_that_is_not_finite_names_the_cause():
    policy, batch = PLAIN.policy(), PLAIN.batch()
    batch["action"][0, 0, 0] = torch.nan
    with pytest.raises(DatasetError, match="'action' in the batch holds a NaN"):
        policy.forward(batch)
