import torch

from lerobot_act_chunking.nn.history_dropout import drop_history, history_dropout_mask

B, H = 3, 4
FORGET = torch.tensor([False, True, False])


def observations():
    generator = torch.Generator().manual_seed(0)
    return {
        "state": torch.randn(B, H, 6, generator=generator),
        "image": torch.rand(B, H, 3, 8, 5, generator=generator),
    }


def test_the_current_observation_stands_in_for_the_past():
    inputs = observations()
    out = drop_history(inputs, FORGET)
    for key, value in inputs.items():
        assert torch.equal(out[key][:, -1], value[:, -1])
        assert torch.equal(out[key][[0, 2]], value[[0, 2]])
        assert torch.equal(out[key][1], value[1, -1:].expand_as(value[1]))


def test_the_batch_is_not_changed():
    inputs = observations()
    drop_history(inputs, FORGET)
    assert all(torch.equal(value, inputs[key]) for key, value in observations().items())


def test_a_share_of_the_samples_forgets():
    generator = torch.Generator().manual_seed(0)
    forgotten = history_dropout_mask(20_000, 0.3, generator)
    assert abs(forgotten.float().mean() - 0.3) < 0.01
    assert not history_dropout_mask(1000, 0.0, generator).any()


def test_the_generator_decides():
    def draw(seed):
        return history_dropout_mask(50, 0.5, torch.Generator().manual_seed(seed))

    state = torch.get_rng_state()
    assert torch.equal(draw(1), draw(1))
    assert not torch.equal(draw(1), draw(2))
    assert torch.equal(torch.get_rng_state(), state)
