"""The diagnosis as a picture."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from lerobot_act_chunking.diagnostics.core.episodes import evenly
from lerobot_act_chunking.diagnostics.latent.density import Density
from lerobot_act_chunking.diagnostics.latent.report import FITTED, LatentReport
from lerobot_act_chunking.diagnostics.latent.terminal import describe, source_name
from lerobot_act_chunking.nn.latents.health import ACTIVE_NATS, ACTIVE_VARIANCE

MOST_DRAWN = 1500
LEAST_NATS = 0.1  # height of the axis of divergences, so that nothing does not look like something


def plot_report(report: LatentReport, path: Path) -> Path:
    """Divergences, the latent space and reconstruction errors into a PNG; returns its path."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 5.2), layout="constrained")
    figure.suptitle(f"{describe(report)}: {report.judgement.diagnosis}")
    axes: Any = figure.subplots(1, 3, width_ratios=(1, 1.25, 1))
    _draw_divergences(axes[0], report)
    _draw_space(axes[1], report)
    _draw_errors(axes[2], report)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    return path


def _draw_divergences(ax: Any, report: LatentReport) -> None:
    """Of each dimension, the largest first; where only the sum is known, the share of each group."""
    health = report.health
    if len(health.kl_by_dimension) == 1:
        _draw_groups(ax, report)
        return
    kl, variance = np.array(health.kl_by_dimension), np.array(health.mean_variance)
    order = np.argsort(-kl, kind="stable")
    active = variance[order] > ACTIVE_VARIANCE
    at = np.arange(len(kl))
    for which, colour, name in ((active, "tab:blue", "active unit"), (~active, "0.75", "inactive")):
        if which.any():
            ax.bar(at[which], kl[order][which], color=colour, label=name)
    shown = slice(None, None, -(-len(at) // 16))
    ax.set_xticks(at[shown], [str(dim) for dim in order[shown]])
    ax.set(xlabel="dimension of the latent", ylabel="KL from N(0, I) [nats]")
    ax.axhline(ACTIVE_NATS, color="0.4", linewidth=0.8, linestyle="--")
    ax.set_ylim(top=max(1.1 * kl.max(), LEAST_NATS))
    ax.set_title(f"Divergence: {health.kl:.3g} nats, {health.active_units} active units")
    ax.legend(fontsize=9)


def _draw_groups(ax: Any, report: LatentReport) -> None:
    at, width = np.arange(len(report.groups)), 0.8 / (1 + len(report.priors))
    bars = {"demonstrations": [group.share for group in report.groups]}
    bars |= {check.name: check.groups for check in report.priors}
    for i, (name, shares) in enumerate(bars.items()):
        ax.bar(at + i * width, 100 * np.array(shares), width, label=name)
    ax.set_xticks(at + 0.4 - width / 2, [str(group + 1) for group in at])
    what = "code" if report.density is None else "component of a density fitted to the styles"
    ax.set(xlabel=what, ylabel="share [%]", title=f"KL {report.health.kl:.3g} nats in all")
    ax.legend(fontsize=9)


def _draw_space(ax: Any, report: LatentReport) -> None:
    """Posterior means and the priors' samples along the directions in which the means differ most."""
    from sklearn.decomposition import PCA

    mean = report.encoded.mean
    plane = PCA(min(2, *mean.shape), random_state=0).fit(mean)
    explained = plane.explained_variance_ratio_
    shown = evenly(len(mean), MOST_DRAWN)
    first = next(iter(report.drawn))
    points = _flat(plane.transform(report.drawn[first][shown]))
    ax.scatter(*points.T, s=6, c="0.7", linewidths=0, label=f"samples of {first}")
    points = _flat(plane.transform(mean[shown]))
    progress = 100 * report.samples.progress[shown]
    image = ax.scatter(*points.T, s=7, c=progress, cmap="viridis", linewidths=0, label="posterior means")
    if report.density is not None and FITTED in report.drawn:
        _draw_components(ax, report.density, np.asarray(plane.components_), np.asarray(plane.mean_))
    ax.figure.colorbar(image, ax=ax, label="place in the episode [%]")
    labels = [
        f"principal component {i + 1} ({share:.0%})" for i, share in enumerate(np.nan_to_num(explained))
    ]
    ax.set(xlabel=labels[0], ylabel=labels[1] if len(labels) > 1 else "", title="Styles")
    ax.legend(fontsize=8, loc="upper left", markerscale=2)


def _draw_components(
    ax: Any, density: Density, directions: Float[np.ndarray, "k L"], centre: Float[np.ndarray, " L"]
) -> None:
    """Two standard deviations around each component."""
    if len(directions) < 2:
        return
    angle = np.linspace(0, 2 * np.pi, 60)
    circle = 2 * np.stack([np.cos(angle), np.sin(angle)])
    for i, (mean, scale) in enumerate(zip(density.means, density.scales, strict=True)):
        flat = directions @ scale
        shape = np.linalg.cholesky(flat @ flat.T + 1e-12 * np.eye(2)) @ circle
        x, y = shape + (directions @ (mean - centre))[:, None]
        ax.plot(x, y, color="tab:red", linewidth=1, label=None if i else f"{FITTED}, 2 sd")


def _draw_errors(ax: Any, report: LatentReport) -> None:
    at = np.arange(len(report.errors))
    names = [source_name(report, source) for source in report.errors]
    colours = ["tab:green" if source == "posterior" else "tab:blue" for source in report.errors]
    bars = ax.barh(at, list(report.errors.values()), color=colours, height=0.7)
    ax.bar_label(bars, fmt="%.3g", padding=3, fontsize=9)
    ax.set_yticks(at, names, fontsize=9)
    ax.invert_yaxis()
    ax.margins(x=0.2)
    ax.set(xlabel="mean absolute error [normalised units]", title="Reconstruction with the style of ...")


def _flat(points: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n 2"]:
    """Points of a plane, also where there is but a line."""
    return np.pad(points, ((0, 0), (0, 2 - points.shape[1])))
