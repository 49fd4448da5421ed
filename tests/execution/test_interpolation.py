import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.interpolate import PchipInterpolator

from lerobot_act_chunking.execution.interpolation import upsample

SHAPES = st.tuples(st.integers(1, 3), st.integers(2, 9), st.integers(1, 4))
# Small whole numbers make plateaus and equal steps; the others, any slope.
VALUES = st.integers(-2, 2).map(float) | st.floats(-100, 100).map(lambda value: round(value, 3))


def reference(keyframes, stride):
    knots = np.arange(keyframes.shape[1])
    steps = np.arange((keyframes.shape[1] - 1) * stride + 1) / stride
    return PchipInterpolator(knots, keyframes, axis=1)(steps)


@settings(max_examples=150, deadline=None)
@given(
    keyframes=SHAPES.flatmap(lambda shape: arrays(np.float64, shape, elements=VALUES)),
    stride=st.integers(1, 6),
)
def test_equals_scipys(keyframes, stride):
    ours = upsample(torch.from_numpy(keyframes), stride).numpy()
    np.testing.assert_allclose(ours, reference(keyframes, stride), rtol=0, atol=1e-11)


@settings(max_examples=50, deadline=None)
@given(
    keyframes=SHAPES.flatmap(lambda shape: arrays(np.float64, shape, elements=VALUES)),
    stride=st.integers(2, 6),
)
def test_passes_through_the_key_frames_and_never_overshoots(keyframes, stride):
    dense = upsample(torch.from_numpy(keyframes), stride).numpy()
    np.testing.assert_array_equal(dense[:, ::stride], keyframes)
    ends = np.sort(np.stack([keyframes[:, :-1], keyframes[:, 1:]]), axis=0)
    inside = np.repeat(ends, stride, axis=2)
    assert (dense[:, :-1] >= inside[0] - 1e-9).all()
    assert (dense[:, :-1] <= inside[1] + 1e-9).all()


def test_grippers_hold_each_key_frame():
    keyframes = torch.tensor([[[0.0, 0.0], [3.0, 3.0], [6.0, 6.0]]])
    dense = upsample(keyframes, 3, gripper_dims=(1,))[0]
    assert dense[:, 0].tolist() == pytest.approx([0, 1, 2, 3, 4, 5, 6])
    assert dense[:, 1].tolist() == [0, 0, 0, 3, 3, 3, 6]


def test_one_key_frame_and_stride_one_are_left_alone():
    keyframes = torch.rand(3, 5, 4)
    assert torch.equal(upsample(keyframes, 1), keyframes)
    assert torch.equal(upsample(keyframes[:, :1], 4), keyframes[:, :1])


@pytest.mark.parametrize("plateau", [False, True])
def test_gradients_flow_and_are_finite(plateau):
    values = [0.0, 0.0, 0.0, 0.0] if plateau else [0.0, 1.0, -1.0, 2.0]
    keyframes = torch.tensor(values, dtype=torch.float64)[None, :, None].requires_grad_()
    upsample(keyframes, 4).sum().backward()
    assert keyframes.grad.isfinite().all()
    if not plateau:
        assert torch.autograd.gradcheck(lambda k: upsample(k, 4), keyframes)


def test_keeps_single_precision():
    assert upsample(torch.rand(3, 5, 4), 2).dtype == torch.float32
