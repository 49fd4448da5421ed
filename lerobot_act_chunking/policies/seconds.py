"""Settings in seconds, as the control steps that policies work with."""

import math

from lerobot_act_chunking.errors import ConfigurationError


def shortest(fps: float) -> float:
    """A time that is one control step [s], in few digits and not below it."""
    return math.ceil(1e4 / fps) / 1e4


def to_stride(prediction_dt: float, fps: float) -> int:
    """Control steps between two predictions.

    Args:
        prediction_dt: time between them [s].
        fps: control steps per second.

    Raises:
        ConfigurationError: it is shorter than a control step.
    """
    if not prediction_dt * fps > 0.5:
        raise ConfigurationError(
            f"prediction_dt={prediction_dt} s is shorter than a control step at fps={fps:g}: "
            f"set prediction_dt={shortest(fps)} or more"
        )
    return round(prediction_dt * fps)


def to_chunk_size(horizon_s: float, fps: float, stride: int) -> int:
    """Predictions whose chunk covers that time, or as little more as the stride allows.

    Args:
        horizon_s: time that a chunk covers [s].
        fps: control steps per second.
        stride: control steps between two predictions.

    Raises:
        ConfigurationError: it is shorter than a control step.
    """
    n_steps = round(horizon_s * fps)
    if n_steps < 1:
        raise ConfigurationError(
            f"horizon_s={horizon_s} s is shorter than a control step at fps={fps:g}: "
            f"set horizon_s={shortest(fps)} or more"
        )
    return -(-(n_steps - 1) // stride) + 1


def to_interval(replan_s: float, fps: float) -> int:
    """Control steps from one chunk to the next.

    Args:
        replan_s: the time between them [s].
        fps: control steps per second.

    Raises:
        ConfigurationError: it is shorter than a control step.
    """
    n_steps = round(replan_s * fps)
    if n_steps < 1:
        raise ConfigurationError(
            f"replan_s={replan_s} s is shorter than a control step at fps={fps:g}: "
            f"set replan_s={shortest(fps)} or more"
        )
    return n_steps
