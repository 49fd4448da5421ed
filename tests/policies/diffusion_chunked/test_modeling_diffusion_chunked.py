"""What `diffusion_chunked` does beyond the contract: histories, samples, warm starts, guidance."""

import pytest
import torch
from policy_cases import ENVIRONMENT, STATE, A, B, Case, T

from lerobot_act_chunking.errors import ConfigurationError, DatasetError, FeatureError

HORIZON = 8
PLAIN = Case("plain", "diffusion_chunked", STATE, {"horizon": HORIZON, "actions_per_token": 2})


def shaken(case=PLAIN, **settings):
    """A policy whose output depends on everything; fresh ones start with gates and output closed."""
    policy = case.policy(**settings)
    generator = torch.Generator().manual_seed(2)
    for parameter in policy.parameters():
        parameter.data += 0.1 * torch.randn(parameter.shape, generator=generator)
    return policy


def observation(seed=1, n=B, shape=(6,)):
    return {"observation.state": torch.randn(n, *shape, generator=torch.Generator().manual_seed(seed))}


def training_batch(n=B, **extra):
    generator = torch.Generator().manual_seed(4)
    actions = torch.randn(n, HORIZON, A, generator=generator)
    padding = torch.zeros(n, HORIZON, dtype=torch.bool)
    return {**observation(n=n), "action": actions, "action_is_pad": padding, **extra}


def test_a_history_is_what_earlier_steps_observed():
    policy = shaken(n_obs_steps=2, execution="open_loop", n_action_steps=1)
    first, second = observation(1), observation(2)
    noise = PLAIN.noise(B)["noise"].repeat(1, 2, 1)[:, :HORIZON]
    window = {key: torch.stack((first[key], second[key]), dim=1) for key in first}
    expected = policy.predict_action_chunk(window, noise=noise)
    policy.reset()
    repeated = {key: torch.stack((first[key], first[key]), dim=1) for key in first}
    alone = policy.predict_action_chunk(repeated, noise=noise)
    torch.testing.assert_close(policy.predict_action_chunk(first, noise=noise), alone)
    torch.testing.assert_close(policy.predict_action_chunk(second, noise=noise), expected)
    assert not torch.allclose(alone, expected)


def test_an_environment_that_is_reset_has_no_history():
    policy = shaken(n_obs_steps=2, execution="open_loop", n_action_steps=1)
    first, second = observation(1), observation(2)
    policy.select_action(first)
    policy.reset([1], episode_seeds=[5])
    actions = policy.select_action(second)
    fresh = shaken(n_obs_steps=2, execution="open_loop", n_action_steps=1)
    fresh.reset(episode_seeds=[4, 5, 6])
    torch.testing.assert_close(actions[1], fresh.select_action(second)[1])


def test_chunks_that_begin_in_the_past_are_executed_from_now_on():
    settings = {"n_obs_steps": 3, "align": "first_obs", "execution": "open_loop", "clip_sample": False}
    policy = shaken(**settings)
    policy.reset(episode_seeds=range(B))
    seen = observation(shape=(3, 6))
    chunk = policy.predict_action_chunk(seen)
    assert chunk.shape == (B, HORIZON - 2, A)
    policy.config.align, policy.config.n_action_steps = "current", HORIZON
    policy.reset(episode_seeds=range(B))
    torch.testing.assert_close(policy.predict_action_chunk(seen)[:, 2:], chunk)


def test_strided_chunks_pass_through_the_predictions():
    policy = shaken(chunk_stride=3)
    policy.reset(episode_seeds=range(B))
    chunk = policy.predict_action_chunk(observation())
    assert chunk.shape == (B, 7 * 3 + 1, A)
    policy.config.chunk_stride = 1
    policy.config.n_action_steps = HORIZON
    policy.reset(episode_seeds=range(B))
    torch.testing.assert_close(policy.predict_action_chunk(observation()), chunk[:, ::3])


def test_every_environment_has_its_own_noise_and_every_seed_another():
    same = {key: value[:1].expand(B, -1) for key, value in observation().items()}
    chunk = shaken().predict_action_chunk(same)
    assert not torch.allclose(chunk[0], chunk[1])
    other = shaken(noise_seed=1).predict_action_chunk(same)
    assert not torch.allclose(chunk[0], other[0])
    one = {key: value[:1] for key, value in same.items()}
    torch.testing.assert_close(shaken().predict_action_chunk(one), chunk[:1], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("settings", [{}, {"objective": "ddpm", "sampler": "ddpm", "num_inference_steps": 9}])
def test_resetting_one_environment_leaves_the_noise_of_the_others(settings):
    settings |= {"execution": "open_loop", "n_action_steps": 1, "clip_sample_range": 9.0}
    policy, undisturbed = shaken(**settings), shaken(**settings)
    for one in (policy, undisturbed):
        one.select_action(observation())
    policy.reset(torch.tensor([False, True, False]))
    actions, expected = policy.select_action(observation(2)), undisturbed.select_action(observation(2))
    torch.testing.assert_close(actions[[0, 2]], expected[[0, 2]])
    assert not torch.allclose(actions[1], expected[1])


def test_samples_of_the_same_noise_are_paired():
    policy = shaken()
    noise = torch.randn(4, B, HORIZON, A, generator=torch.Generator().manual_seed(3))
    samples = policy.predict_samples(observation(), 4, noise=noise)
    again = policy.predict_samples(observation(), 4, noise=noise, num_inference_steps=50)
    assert samples.shape == (4, B, HORIZON, A)
    torch.testing.assert_close(samples[2], policy.predict_action_chunk(observation(), noise=noise[2]))
    assert not torch.equal(samples, again)
    assert (samples - again).norm() < 0.7 * (samples - samples.roll(1, 0)).norm()


def test_samples_may_come_from_another_sampler():
    policy = shaken()
    noise = torch.randn(1, B, HORIZON, A, generator=torch.Generator().manual_seed(3))

    def chunk(name, n_steps):
        return policy.predict_samples(
            observation(), 1, noise=noise, sampler=name, num_inference_steps=n_steps
        )

    exact = chunk("heun", 100)
    assert 0 < (chunk("euler", 80) - exact).norm() < 0.6 * (chunk("euler", 10) - exact).norm()
    with pytest.raises(ConfigurationError, match="unknown sampler for flow 'ddim'"):
        policy.predict_samples(observation(), 1, sampler="ddim")


def test_coherence_executes_the_sample_that_continues_the_plan():
    policy = shaken(execution="coherence", replan_interval=2, n_samples=5)
    chunks = []
    policy._action_queue.on_chunk = lambda event: chunks.append(event.chunk)
    for _ in range(3):
        policy.select_action(observation())
    reference = shaken(execution="open_loop")
    candidates = [reference.predict_samples(observation(), 5) for _ in range(2)]
    torch.testing.assert_close(chunks[0], candidates[0][0])
    distances = (candidates[1] - chunks[1]).flatten(2).norm(dim=-1)
    assert (distances.min(0).values < 1e-4).all()


def test_held_noise_stays_with_its_step():
    policy = shaken(warm_start="noise_hold", replan_interval=2)
    drawn = []
    original = policy._held

    def held(*args):
        drawn.append(original(*args))
        return drawn[-1]

    policy._held = held
    for _ in range(5):
        policy.select_action(observation())
    first, second, third = drawn
    assert torch.equal(first[:, 2:], second[:, :-2])
    assert torch.equal(second[:, 2:], third[:, :-2])
    assert not torch.allclose(first[:, :2], third[:, -2:])


@pytest.mark.parametrize("start", ["sdedit", "rtc"])
def test_a_warm_start_stays_near_the_plan(start):
    distances = {}
    for name in ("none", start):
        policy = shaken(warm_start=name, replan_interval=2, execution="receding", sdedit_strength=0.2)
        chunks = []
        policy._action_queue.on_chunk = lambda event, chunks=chunks: chunks.append(event.chunk)
        for _ in range(3):
            policy.select_action(observation())
        distances[name] = (chunks[0][:, 2:] - chunks[1][:, :-2]).norm()
    assert distances[start] < 0.85 * distances["none"]


def test_sdedit_starts_afresh_where_there_is_no_plan():
    policy = shaken(warm_start="sdedit", replan_interval=2, execution="receding")
    for _ in range(2):
        policy.select_action(observation())
    policy.reset([1], episode_seeds=[5])
    actions = policy.select_action(observation(2))
    fresh = shaken(warm_start="sdedit", replan_interval=2, execution="receding")
    fresh.reset(episode_seeds=[4, 5, 6])
    expected = fresh.select_action(observation(2))
    torch.testing.assert_close(actions[1], expected[1])
    assert not torch.allclose(actions[0], expected[0])


@pytest.mark.parametrize("mode", [torch.no_grad, torch.inference_mode, torch.enable_grad])
def test_exact_guidance_does_not_depend_on_how_the_caller_treats_gradients(mode):
    left_over = torch.randn(B, 5, A, generator=torch.Generator().manual_seed(5))
    noise = torch.randn(B, HORIZON, A, generator=torch.Generator().manual_seed(6))
    chunks = []
    for context in (torch.no_grad, mode):
        with context():
            chunk = shaken(rtc_vjp="exact").predict_action_chunk(
                observation(), noise=noise, inference_delay=2, prev_chunk_left_over=left_over
            )
        assert not chunk.requires_grad
        chunks.append(chunk.clone())
    torch.testing.assert_close(*chunks)
    free = shaken().predict_action_chunk(observation(), noise=noise)
    assert (chunks[0][:, :5] - left_over).norm() < (free[:, :5] - left_over).norm()


def test_a_prefix_is_executed_as_planned_and_changes_the_rest():
    policy = shaken(prefix_steps=4, warm_start="prefix")
    left_over = torch.randn(B, 6, A, generator=torch.Generator().manual_seed(5))
    noise = torch.randn(B, HORIZON, A, generator=torch.Generator().manual_seed(6))
    chunk, free = (
        policy.predict_action_chunk(
            observation(), noise=noise, inference_delay=delay, prev_chunk_left_over=left_over
        )
        for delay in (3, 0)
    )
    assert torch.equal(chunk[:, :4], left_over[:, :4])  # whole tokens of two actions
    assert not torch.allclose(chunk[:, 4:], free[:, 4:])
    torch.testing.assert_close(free, policy.predict_action_chunk(observation(), noise=noise))


def test_a_prefix_longer_than_in_training_is_cut_with_a_warning():
    policy = shaken(prefix_steps=2, warm_start="prefix")
    left_over = torch.randn(B, 6, A, generator=torch.Generator().manual_seed(5))
    with pytest.warns(UserWarning, match=r"late for 3 tokens of 2 actions.* at most 1"):
        chunk = policy.predict_action_chunk(observation(), inference_delay=5, prev_chunk_left_over=left_over)
    assert torch.equal(chunk[:, :2], left_over[:, :2])
    assert not torch.allclose(chunk[:, 2:4], left_over[:, 2:4])


def test_given_actions_do_not_count_in_the_loss():
    policy = shaken(prefix_steps=HORIZON - 2).train()
    batch = training_batch(n=64)
    shown = []
    policy.model.denoiser.register_forward_pre_hook(lambda _, args: shown.append(args[0]))
    policy.forward(batch)
    given = (shown[0] == batch["action"]).all(-1)
    lengths = given.sum(1)
    assert set(lengths.tolist()) == {0, 2, 4, 6}
    assert (given == (torch.arange(HORIZON) < lengths[:, None])).all()


def test_guidance_exaggerates_what_a_feature_adds():
    case = Case(
        "goal", "diffusion_chunked", STATE | ENVIRONMENT, {"horizon": HORIZON, "actions_per_token": 2}
    )
    guided = {"guidance_features": ["observation.environment_state"], "condition_dropout": 0.1}
    seen = {**observation(), "observation.environment_state": torch.randn(B, 7)}
    noise = torch.randn(B, HORIZON, A)
    one_step = {"num_inference_steps": 1, **guided}

    def chunk(scale):
        return shaken(case, guidance_scale=scale, **one_step).predict_action_chunk(seen, noise=noise)

    without, with_feature, more = (chunk(scale) for scale in (0.0, 1.0, 2.0))
    torch.testing.assert_close(more, 2 * with_feature - without)
    dropped = {**seen, "observation.environment_state": torch.randn(B, 7)}
    policy = shaken(case, guidance_scale=0.0, **one_step)
    torch.testing.assert_close(policy.predict_action_chunk(dropped, noise=noise), without)


def test_clipping_bounds_the_chunk():
    policy = shaken(objective="ddpm", clip_sample_range=0.05)
    assert policy.predict_action_chunk(observation()).abs().max() <= 0.05 + 1e-6


def test_evaluation_losses_have_the_same_noise_and_training_losses_new_one():
    policy, batch = shaken(), training_batch()
    assert policy.eval().forward(batch)[1] == policy.forward(batch)[1]
    assert policy.train().forward(batch)[1] != policy.forward(batch)[1]


def test_a_loaded_policy_goes_on_with_the_draws(tmp_path):
    torch.manual_seed(0)
    policy, batch = shaken(use_ema=False).train(), training_batch()
    policy.forward(batch)
    policy.save_pretrained(tmp_path)
    loaded = type(policy).from_pretrained(tmp_path).train()
    torch.manual_seed(1)
    assert loaded.forward(batch)[1] == policy.forward(batch)[1]


def test_a_nan_is_named():
    batch = training_batch()
    batch["observation.state"][0, 0] = torch.nan
    with pytest.raises(DatasetError, match=r"observation\.state"):
        shaken().train().forward(batch)


def test_a_window_of_another_length_is_refused():
    with pytest.raises(FeatureError, match=r"shape \(\d, 3, 6\), but the policy was built for \(B, 2, 6\)"):
        shaken(n_obs_steps=2).predict_action_chunk(observation(shape=(3, 6)))


def test_it_says_whether_it_can_continue_a_chunk():
    assert PLAIN.policy().supports_rtc()
    assert not PLAIN.policy(n_obs_steps=2, align="first_obs").supports_rtc()


def test_a_regression_goes_over_from_what_is_left_as_execution_says():
    policy, left_over = PLAIN.policy(objective="two_step", execution="receding"), torch.full((1, 3, A), 9.0)
    chunk = policy.predict_action_chunk(observation(), inference_delay=2, prev_chunk_left_over=left_over)
    alone = policy.predict_action_chunk(observation())
    assert torch.equal(chunk[:, :2], left_over[:, :2].expand(len(chunk), -1, -1))
    assert torch.equal(chunk[:, 2:], alone[:, 2:])
    assert T != HORIZON
