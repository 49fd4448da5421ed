"""Planted modes: what the benchmark judges by, and that codes keep apart what L2 blends."""

import sys
from pathlib import Path

import numpy as np
from tiers import full_tier

sys.path.append(str(Path(__file__).parents[3] / "benchmarks"))

from planted_paths import CHUNK, LENGTH, Planted, judge

THREE = Planted((0.8, 0.15, 0.05), episodes=40)


def test_modes_are_each_others_rotations():
    experts = THREE.experts
    assert experts.shape == (3, CHUNK, 2)
    turn = 2 * np.pi / 3
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    for mode in range(3):
        np.testing.assert_allclose(experts[mode] @ rotation.T, experts[(mode + 1) % 3], atol=1e-12)


def test_demonstrations_have_their_shares():
    data = THREE.demonstrate(seed=3)
    starts = (data["observation.state"] == 0).all(1).numpy()
    assert starts.sum() == 40
    assert judge(data["action"][starts].numpy(), THREE).counts == [32, 6, 2]
    assert data["action"].shape == (40 * LENGTH, CHUNK, 2)
    assert data["action_is_pad"].sum(1).reshape(40, LENGTH)[0].tolist() == [0] * 6 + list(range(1, 20))


def test_chunks_are_judged_by_the_nearest_expert():
    experts = THREE.experts
    chunks = np.stack([experts[0], experts[0] + 0.1, experts[2], experts.mean(0), experts[1] + 0.2])
    found = judge(chunks, THREE)
    assert found.counts == [2, 0, 1]
    assert found.invalid == 2
    assert found.covered(THREE) == 2


@full_tier
def test_codes_cover_two_modes_that_l2_blends():
    from planted_modes import run

    planted = Planted((0.5, 0.5))
    codes, regression = (run(name, planted, seed=0).judged for name in ("vqbet_chunked", "L2 regression"))
    assert codes.covered(planted) == 2
    assert codes.invalid <= 0.02 * codes.chunks
    assert regression.counts == [0, 0]
    assert regression.distance > 2 * codes.distance
