import torch

from lerobot_act_chunking.nn.augment import random_shift

B, H, h, w = 3, 2, 5, 7


def shifted(max_shift, seed=0):
    images = torch.arange(B * H * 3 * h * w, dtype=torch.float32).view(B, H, 3, h, w)
    return images, random_shift(images, max_shift, torch.Generator().manual_seed(seed))


def moves(before, after):
    """Shifts (rows, columns) of up to 2 that explain an image, borders repeated."""
    rows, columns = torch.arange(h), torch.arange(w)
    return [
        (dy, dx)
        for dy in range(-2, 3)
        for dx in range(-2, 3)
        if torch.equal(
            before[..., (rows + dy).clamp(0, h - 1), :][..., (columns + dx).clamp(0, w - 1)], after
        )
    ]


def test_every_sample_moves_as_a_whole_and_on_its_own():
    seen = set()
    for seed in range(40):
        images, result = shifted(2, seed)
        for before, after in zip(images, result, strict=True):
            (move,) = moves(before, after)
            seen.add(move)
    assert len(seen) == 25


def test_the_same_seed_moves_alike_and_zero_does_not_move():
    assert torch.equal(shifted(2)[1], shifted(2)[1])
    images, result = shifted(0)
    assert torch.equal(images, result)


def test_one_step_has_no_time_axis():
    images = torch.rand(B, 3, h, w)
    assert random_shift(images, 2, torch.Generator().manual_seed(0)).shape == images.shape
