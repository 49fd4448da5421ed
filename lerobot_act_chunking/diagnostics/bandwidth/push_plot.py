"""The answers to a push as a picture."""

from pathlib import Path
from typing import Any

import numpy as np

from lerobot_act_chunking.diagnostics.bandwidth.push import PushResponse, PushStudy
from lerobot_act_chunking.diagnostics.bandwidth.terminal import describe


def plot_push(study: PushStudy, path: Path) -> Path:
    """One row per execution: what was demanded and commanded, and its share beside the formula; a PNG."""
    from matplotlib.figure import Figure

    n = len(study.responses)
    figure = Figure(figsize=(11, 1.2 + 2.4 * n), layout="constrained")
    figure.suptitle(
        f"{study.task}: object pushed {100 * study.push_m:g} cm at step {study.push_step}, "
        f"{len(study.seeds)} episodes"
    )
    axes = figure.subplots(n, 2, sharex=True, sharey="col", squeeze=False)
    axes[0, 0].set_ylim(0, 1.3 * max(max(response.demanded) for response in study.responses))
    end = max(len(response.shares) for response in study.responses) / study.fps
    for (change, share), response in zip(axes, study.responses, strict=True):
        _draw_change(change, response, study.fps)
        _draw_share(share, response, study.fps)
        change.set_xlim(-0.02 * end, end)
    for ax in axes[-1]:
        ax.set_xlabel("time since the push was first seen [s]")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    return path


def _draw_change(ax: Any, response: PushResponse, fps: float) -> None:
    time = np.arange(len(response.commanded)) / fps
    ax.plot(time, response.demanded, color="0.75", linewidth=4, label="newest chunk")
    ax.plot(time, response.commanded, color="tab:blue", label="command")
    ax.set_title(describe(response.settings), fontsize=10, loc="left")
    ax.set_ylabel("pushed - not pushed\n[rad, RMS of joints]")
    ax.legend(fontsize=8, loc="upper left", ncols=2)
    ax.grid(alpha=0.3)


def _draw_share(ax: Any, response: PushResponse, fps: float) -> None:
    time = np.arange(len(response.shares)) / fps
    if response.expected:
        ax.step(time, response.expected, where="post", color="0.75", linewidth=4, label="formula")
    ax.step(time, response.shares, where="post", color="tab:blue", label="measured")
    ax.axhline(0.9, color="0.6", linewidth=0.8, linestyle="--")
    ax.set_ylabel("share of the newest\nchunk's change")
    ax.set_ylim(-0.1, 1.25)
    ax.legend(fontsize=8, loc="lower right")
    ax.grid(alpha=0.3)
