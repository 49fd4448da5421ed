import numpy as np
import pytest

from lerobot_act_chunking.recording.lossless import LosslessEncoder


@pytest.mark.parametrize(("height", "width"), [(16, 24), (33, 47)])
def test_every_pixel_comes_back(height, width):
    rng = np.random.default_rng(0)
    still = rng.integers(0, 256, (height, width, 3), np.uint8)
    frames = [still, still.copy(), *rng.integers(0, 256, (5, height, width, 3), np.uint8)]
    frames[1][3, 5] = 255 - frames[1][3, 5]
    encoder = LosslessEncoder(height, width)
    for frame in frames:
        encoder.append(frame)
    video = encoder.finish()
    assert (video.length, video.height, video.width) == (7, height, width)
    assert np.array_equal(np.stack(list(video.frames())), np.stack(frames))


def test_a_still_scene_is_small():
    frame = np.random.default_rng(0).integers(0, 256, (48, 64, 3), np.uint8)
    encoder = LosslessEncoder(48, 64)
    for _ in range(40):
        encoder.append(frame)
    assert len(encoder.finish().data) < 4 * frame.nbytes
