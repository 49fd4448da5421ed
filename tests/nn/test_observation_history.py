"""Observations of several steps as tokens: which is which, and where in time."""

import pytest
import torch
import torch.nn.functional as F  # noqa: N812
from torch import nn

from lerobot_act_chunking.nn.observation import CameraTokens, ObservationEncoder, VectorTokens
from lerobot_act_chunking.nn.positions import image_positions
from lerobot_act_chunking.nn.velocity import FiniteDifferences

B, H, D = 2, 3, 16
VECTORS = {"state": 6, "goal": 4}
SHAPES = {"top": (3, 32, 64), "wrist": (3, 48, 32), "side": (3, 32, 64)}  # 2 x 4, 3 x 2 and 2 x 4 cells
CELLS = {"top": (2, 4), "side": (2, 4), "wrist": (3, 2)}  # in the order of their tokens
N_CELLS = 8 + 8 + 6


class CountingBackbone(nn.Module):
    """Average colour of 16 x 16 cells; counts its calls."""

    def __init__(self):
        super().__init__()
        self.calls = 0

    def forward(self, images):
        self.calls += 1
        return F.avg_pool2d(images, 16)


def make(*, vectors=True, cameras=True, velocity=False, grid=1) -> ObservationEncoder:
    torch.manual_seed(0)
    encoder = ObservationEncoder(
        VectorTokens(VECTORS, D) if vectors else None,
        CameraTokens(SHAPES, D, CountingBackbone(), channels=3) if cameras else None,
        H,
        FiniteDifferences(VECTORS) if velocity else None,
        grid,
    )
    nn.init.normal_(encoder.time)
    if cameras:
        nn.init.normal_(encoder.cameras.identities)
    return encoder.eval()


@pytest.fixture
def vectors():
    generator = torch.Generator().manual_seed(1)
    return {key: torch.randn(B, H, n, generator=generator) for key, n in reversed(VECTORS.items())}


@pytest.fixture
def images():
    generator = torch.Generator().manual_seed(2)
    return {key: torch.rand(B, H, *shape, generator=generator) for key, shape in SHAPES.items()}


def test_vectors_step_by_step_oldest_first(vectors):
    encoder = make(cameras=False)
    tokens, positions = encoder(vectors, {})
    for step in range(H):
        for place, key in enumerate(VECTORS):
            token = encoder.vectors.projections[place](vectors[key][:, step])
            torch.testing.assert_close(tokens[:, 2 * step + place], token)
            at = encoder.vectors.positions[place] + encoder.time[step, 0]
            torch.testing.assert_close(positions[2 * step + place], at)
    assert tokens.shape == (B, 2 * H, D)
    assert positions.shape == (2 * H, D)


def test_velocities_follow_the_vectors_from_the_second_step_on(vectors):
    encoder = make(cameras=False, velocity=True)
    tokens, positions = encoder(vectors, {})
    assert tokens.shape == (B, 2 * H + 2 * (H - 1), D)
    for step in range(1, H):
        for place, key in enumerate(VECTORS):
            change = vectors[key][:, step] - vectors[key][:, step - 1]
            at = 2 * H + 2 * (step - 1) + place
            torch.testing.assert_close(tokens[:, at], encoder.velocities.projections[place](change))
            torch.testing.assert_close(
                positions[at], encoder.velocities.positions[place] + encoder.time[step, 0]
            )


@pytest.mark.parametrize(
    ("kinds", "n"),
    [
        ({}, 2 * H),
        ({"velocity": True}, 2 * H + 2 * (H - 1)),
        ({"vectors": False}, 0),
        ({"cameras": False}, 2 * H),
    ],
)
def test_images_come_after_the_vectors(vectors, images, kinds, n):
    encoder = make(**kinds)
    assert encoder.n_vector_tokens == n
    if "cameras" in kinds:
        assert encoder(vectors, {})[0].shape[1] == n
        return
    black = {key: torch.zeros_like(value) for key, value in images.items()}
    same = (encoder(vectors, images)[0] == encoder(vectors, black)[0]).all(-1).all(0)
    assert same.tolist() == [True] * n + [False] * (len(same) - n)


def test_the_newest_images_are_seen_in_full(images):
    encoder = make(vectors=False)
    tokens, positions = encoder({}, images)
    newest, places = encoder.cameras({key: value[:, -1] for key, value in images.items()})
    torch.testing.assert_close(tokens[:, :N_CELLS], newest)
    torch.testing.assert_close(positions[:N_CELLS], places + encoder.time[-1])


@pytest.mark.parametrize(
    ("grid", "cells"), [(1, [(1, 1)] * 3), (2, [(2, 2)] * 3), (3, [(2, 3), (2, 3), (3, 2)])]
)
def test_earlier_images_are_seen_coarsely(images, grid, cells):
    """Average colours of a grid, which is never finer than the feature map."""
    encoder = make(vectors=False, grid=grid)
    tokens, positions = encoder({}, images)
    at = N_CELLS
    for step in range(H - 1):
        for key, (rows, columns) in zip(CELLS, cells, strict=True):
            colours = F.adaptive_avg_pool2d(F.avg_pool2d(images[key][:, step], 16), (rows, columns))
            expected = encoder.cameras.projection(colours.flatten(2).transpose(1, 2))
            torch.testing.assert_close(tokens[:, at : at + rows * columns], expected)
            identity = encoder.cameras.identities[list(SHAPES).index(key)]
            place = image_positions(rows, columns, D) + identity + encoder.time[step]
            torch.testing.assert_close(positions[at : at + rows * columns], place)
            at += rows * columns
    assert (tokens.shape[1], len(positions)) == (at, at)


def test_one_backbone_call_for_each_shape(images):
    encoder = make(vectors=False)
    encoder({}, images)
    assert encoder.cameras.backbone.calls == 2


@pytest.mark.parametrize("grid", [1, 2])
def test_frames_that_were_kept_give_the_same_tokens(vectors, images, grid):
    """Each frame is looked at when it is new, on its own; features take the place of images."""
    encoder = make(grid=grid, velocity=True)
    looks = [
        encoder.image_features({key: value[:, step] for key, value in images.items()}) for step in range(H)
    ]
    kept = {key: torch.stack([look[key] for look in looks], dim=1) for key in images}
    calls = encoder.cameras.backbone.calls
    from_kept = encoder(vectors | kept, {})
    assert encoder.cameras.backbone.calls == calls
    assert all(map(torch.equal, from_kept, encoder(vectors, images)))


def test_several_steps_are_looked_at_as_one_by_one(images):
    encoder = make()
    together = encoder.image_features(images)
    for step in range(H):
        alone = encoder.image_features({key: value[:, step] for key, value in images.items()})
        assert all(torch.equal(together[key][:, step], alone[key]) for key in images)
    assert make(cameras=False).image_features({}) == {}


def test_time_starts_at_zero_and_is_learned(vectors, images):
    encoder = ObservationEncoder(VectorTokens(VECTORS, D), make().cameras, H)
    assert encoder.time.shape == (H, 1, D)
    assert not encoder.time.any()
    _, positions = encoder(vectors, images)
    positions.square().sum().backward()
    assert (encoder.time.grad.abs().amax((1, 2)) > 0).all()


def test_samples_do_not_mix(vectors, images):
    encoder = make(velocity=True, grid=2)
    tokens, _ = encoder(vectors, images)
    for sample in range(B):
        one = slice(sample, sample + 1)
        alone, _ = encoder({k: v[one] for k, v in vectors.items()}, {k: v[one] for k, v in images.items()})
        torch.testing.assert_close(tokens[one], alone)
