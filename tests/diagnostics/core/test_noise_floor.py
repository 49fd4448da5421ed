"""What moves is told from what trembles, whatever its unit and pace."""

import numpy as np
import pytest

from lerobot_act_chunking.diagnostics.core.noise_floor import measure_noise

FPS, SECONDS = 50.0, 8
TIME = np.arange(0, SECONDS, 1 / FPS)


def kind(values: np.ndarray) -> str:
    return measure_noise([values[:, None]] * 3, FPS, ["joint"]).dimensions[0].kind


@pytest.mark.parametrize("hz", [0.25, 1, 2, 4, 5])
@pytest.mark.parametrize("unit", [1e-3, 1.0, 4096.0])
def test_motion_is_no_noise_however_fast(hz, unit):
    assert kind(unit * np.sin(2 * np.pi * hz * TIME)) == "moves"


@pytest.mark.parametrize("unit", [1e-3, 1.0, 4096.0])
def test_trembling_is_noise_and_rest_is_constant(unit):
    tremble = np.random.default_rng(0).normal(size=len(TIME))
    assert kind(unit * tremble) == "noise"
    assert kind(unit * np.round(tremble)) == "noise"
    assert kind(np.full(len(TIME), unit)) == "constant"


def test_a_move_through_noise_moves():
    tremble = np.random.default_rng(0).normal(size=len(TIME))
    move = np.clip(TIME - 3, 0, 2)
    assert kind(move + 0.01 * tremble) == "moves"
    assert kind(move + tremble) == "noise"
