"""What a model card says about an action-chunking policy, beyond LeRobot's text for every policy."""

import re
import shlex
import sys
from typing import Any, Protocol

from huggingface_hub import ModelCard

from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.hub.routing import LOCAL_HUB

_EXECUTION = {
    "open_loop": "each chunk is executed to its end",
    "receding": "the newest chunk replaces the older ones",
    "ensemble": "the weighted mean of all chunks that cover a step",
    "crossfade": "each new chunk is blended in",
    "adaptive": "the weighted mean of the chunks that agree with the newest",
    "coherence": "of several sampled chunks the one that continues the current plan best",
}


class ChunkSettings(Protocol):
    """The part of a policy configuration that the card describes."""

    repo_id: str | None
    input_features: Any
    output_features: Any

    @property
    def execution_settings(self) -> ExecutionSettings:
        """How chunks are executed."""
        ...

    @property
    def type(self) -> str:
        """The policy's registered name."""
        ...


_SECRET = re.compile(r"(--[^=]*(?:token|secret|password|api_key)[^=]*)=.*", re.IGNORECASE)


def extend_card(card: ModelCard, config: ChunkSettings, *, fps: float | None = None) -> ModelCard:
    """LeRobot's card for a policy of this package, with our section and this process's command line added.

    LeRobot's 0.6.1 makes the card in a method of the policy, later ones in a function of their training.
    """
    card.text = card.text.rstrip() + "\n\n" + policy_section(config, command=sys.argv, fps=fps)
    return card


def policy_section(config: ChunkSettings, *, command: list[str], fps: float | None = None) -> str:
    """Markdown that says what goes in, what comes out, how it is executed, how it was trained, how to run it.

    Args:
        config: the policy's configuration.
        command: the command line that trained it (``sys.argv``).
        fps: the dataset's frame rate [Hz], for durations in seconds.
    """
    repo_id = config.repo_id or "<repo id>"
    parts = [
        f"## How `{config.type}` acts",
        _execution(config, fps),
        "**Inputs**",
        _features(config.input_features),
        "**Outputs**",
        _features(config.output_features),
        "## Training command",
        _code(_command_line(command)),
        "## Running it",
        "Install `lerobot_policy_act_chunking`, then, with the folder that the policy was pushed to:",
        _code(f"{LOCAL_HUB}=/path/to/hub lerobot-eval --policy.path={repo_id} --env.type=<type>"),
        f"From the Hugging Face Hub the same command works without `{LOCAL_HUB}`.",
    ]
    return "\n\n".join(parts) + "\n"


def _command_line(command: list[str]) -> str:
    """The command as one would type it: without its folder, and without secrets."""
    if not command:
        return "unknown"
    return shlex.join(
        [command[0].rpartition("/")[2], *(_SECRET.sub(r"\1=...", part) for part in command[1:])]
    )


def _execution(config: ChunkSettings, fps: float | None) -> str:
    settings = config.execution_settings
    covered, used, interval = settings.chunk_size, settings.n_action_steps, settings.replan_interval
    lines = [
        f"- each query predicts a chunk that covers {covered} control steps{_seconds(covered, fps)}",
        f"- a new chunk is asked for every {interval} steps{_seconds(interval, fps)}; the first {used} "
        "actions of each may be executed",
        f"- `execution={settings.execution}`: {_EXECUTION[settings.execution]}",
    ]
    if settings.temporal_ensemble_coeff is not None:
        lines.append(
            f"- `ensemble_weighting={settings.ensemble_weighting}`, "
            f"`temporal_ensemble_coeff={settings.temporal_ensemble_coeff:g}` per step"
        )
    if settings.smoothing_steps > 1:
        lines.append(f"- each chunk is smoothed: the mean over {settings.smoothing_steps} steps is executed")
    if settings.latency_steps:
        lines.append(f"- chunks are used {settings.latency_steps} steps after their observation")
    return "\n".join(lines)


def _seconds(steps: int, fps: float | None) -> str:
    return "" if not fps else f" ({steps / fps:.2f} s at {fps:g} Hz)"


def _features(features: Any) -> str:
    rows = [
        f"| `{name}` | {feature.type.value} | {tuple(feature.shape)} |"
        for name, feature in (features or {}).items()
    ]
    return "\n".join(["| feature | type | shape |", "| --- | --- | --- |", *rows])


def _code(text: str) -> str:
    return f"```bash\n{text}\n```"
