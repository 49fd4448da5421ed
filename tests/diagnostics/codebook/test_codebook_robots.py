"""Random robots with parked parts: what codes lose of their motion is measured on what moves."""

import numpy as np
import pytest
from planted_robots import ROBOTS, demonstrations, plant, with_extras

from lerobot_act_chunking.data.timing import ChunkTiming
from lerobot_act_chunking.diagnostics.codebook.chunks import CodedChunks, cut_chunks
from lerobot_act_chunking.diagnostics.codebook.losses import measure_losses
from lerobot_act_chunking.diagnostics.core.measures import RawUnits


@pytest.mark.parametrize("seed", range(ROBOTS))
def test_what_codes_lose_lies_between_nothing_and_all(seed):
    """Codes that say anything at all, of a robot with parked parts."""
    robot = plant(seed)
    longer = with_extras(robot, seed)
    rng = np.random.default_rng(seed)
    lost = []
    for each in (robot, longer):
        data = demonstrations(each)
        chunks = cut_chunks(data, ChunkTiming(1, 5), 100)
        varies = chunks.actions.var((0, 1))
        wrong = 10.0 ** rng.uniform(-2, 4, len(each.names)) * varies
        wrong[: len(robot.names)] = varies[: len(robot.names)] * 0.25
        errors = np.tile(wrong, (len(chunks), 1))
        codes = np.zeros((len(chunks), 2), int)
        found = measure_losses(
            CodedChunks(chunks, codes, chunks.actions, errors, varies), data, RawUnits(each.names)
        )
        shares = [loss.lost_variance for loss in found.dimensions if loss.lost_variance is not None]
        assert all(0 <= share <= 1 for share in shares)
        lost.append(found.lost_variance)
    assert lost == pytest.approx([0.25, 0.25])
