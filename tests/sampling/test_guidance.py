import torch

from lerobot_act_chunking.sampling.guidance import classifier_free

B, T, A = 3, 5, 4


def test_goes_on_from_the_unconditional_through_the_conditional_estimate():
    conditional, unconditional = torch.randn(2, B, T, A, generator=torch.Generator().manual_seed(0))
    seen = []

    def denoise(x, i):
        seen.append((x, i))
        return torch.cat([conditional, unconditional])

    x = torch.randn(B, T, A, generator=torch.Generator().manual_seed(1))
    for scale, expected in (
        (0.0, unconditional),
        (1.0, conditional),
        (2.5, 2.5 * conditional - 1.5 * unconditional),
    ):
        torch.testing.assert_close(classifier_free(denoise, scale)(x, 7), expected)
    doubled, index = seen[0]
    assert torch.equal(doubled, torch.cat([x, x]))
    assert index == 7


def test_one_network_call_per_evaluation():
    calls = []

    def denoise(x, i):
        calls.append(i)
        return x

    classifier_free(denoise, 3.0)(torch.zeros(B, T, A), 2)
    assert calls == [2]
