import math

import pytest
import torch
from lerobot.policies.act.modeling_act import (
    ACTSinusoidalPositionEmbedding2d,
    create_sinusoidal_pos_embedding,
)

from lerobot_act_chunking.nn.positions import ImagePositions, image_positions, sequence_positions


def test_sequence_positions_are_lerobots():
    assert torch.equal(sequence_positions(11, 16), create_sinusoidal_pos_embedding(11, 16))


def test_sequence_positions_by_hand():
    angle = 3 / 10_000 ** (2 / 4)
    expected = torch.tensor([math.sin(3), math.cos(3), math.sin(angle), math.cos(angle)])
    torch.testing.assert_close(sequence_positions(4, 4)[3], expected)


def test_image_positions_are_lerobots():
    theirs = ACTSinusoidalPositionEmbedding2d(8)(torch.zeros(1, 3, 5, 7))[0]
    assert torch.equal(image_positions(5, 7, 16), theirs.flatten(1).T)


def test_image_positions_run_row_by_row_with_y_first():
    positions = image_positions(5, 7, 16).view(5, 7, 16)
    assert torch.equal(positions[2, 0, :8], positions[2, 6, :8])
    assert torch.equal(positions[0, 3, 8:], positions[4, 3, 8:])
    assert positions[0, 0, 0] == pytest.approx(math.sin(2 * math.pi / 5), abs=1e-5)


def test_image_positions_are_kept_for_each_size_and_type():
    positions = ImagePositions(16)
    like = torch.zeros(1)
    first = positions(5, 7, like)
    assert positions(5, 7, like) is first
    assert positions(7, 5, like).shape == first.shape
    assert not torch.equal(positions(7, 5, like), first)
    assert positions(5, 7, like.double()).dtype == torch.float64


def test_positions_first_asked_for_in_inference_mode_serve_training():
    positions = ImagePositions(16)
    with torch.inference_mode():
        positions(5, 7, torch.zeros(1))
    assert not positions(5, 7, torch.zeros(1)).is_inference()
