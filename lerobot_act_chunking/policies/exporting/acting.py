"""What a policy type tells of itself so that it can be exported."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from jaxtyping import Float
from torch import Tensor

from act_chunking_runtime.draws import DrawSpec
from lerobot_act_chunking import policies
from lerobot_act_chunking.data.batch import Observation
from lerobot_act_chunking.errors import ConfigurationError

MODULE = "exporting"
"""In a policy's folder: ``acting_of(policy)`` gives its `Acting`."""


@dataclass(frozen=True)
class Acting:
    """Chunks from observations and random numbers, and nothing else.

    Attributes:
        chunks: the first ``n_action_steps`` of N chunks (N, 1, T, A), normalised, of one window of
            observations and the numbers of ``draws`` by name.
        draws: the random numbers.
    """

    chunks: Callable[[Observation, Mapping[str, Tensor]], Float[Tensor, "N 1 T A"]]
    draws: list[DrawSpec] = field(default_factory=list)


def acting_of(policy: Any) -> Acting:
    """How a policy acts.

    Raises:
        ConfigurationError: it is of a type that cannot be exported, or its settings ask for what a graph
            cannot do.
    """
    check_type(policy.config.type)
    _check_continuing(policy.config)
    return import_module(f"{policies.__name__}.{policy.config.type}.{MODULE}").acting_of(policy)


def check_type(policy_type: str) -> None:
    """Refuse a policy that cannot be exported.

    Raises:
        ConfigurationError: naming the types that can be.
    """
    if policy_type in exportable():
        return
    ways = {
        "temporal_ensemble": "set the execution in the inner policy, and export that",
        "act": "act-chunking import makes an act_chunked of it",
    }
    way = f": {ways[policy_type]}" if policy_type in ways else ""
    raise ConfigurationError(
        f"a policy of type {policy_type} cannot be exported{way}; what can be: {', '.join(exportable())}"
    )


def exportable() -> list[str]:
    """The policy types that can be exported."""
    (folder,) = policies.__path__
    names = sorted(path.name for path in Path(folder).iterdir() if path.is_dir())
    return [name for name in names if find_spec(f"{policies.__name__}.{name}") and _tells(folder, name)]


def _tells(folder: str, name: str) -> bool:
    return (Path(folder) / name / f"{MODULE}.py").is_file()


def _check_continuing(config: Any) -> None:
    """Refuse chunks that are made from the chunk in execution, which a graph does not see."""
    start = getattr(config, "warm_start", "none")
    if start not in ("none", "noise_hold"):
        raise ConfigurationError(
            f"warm_start={start} makes each chunk from the one in execution, which a graph does not see: "
            "export with --policy.warm_start=none, and --policy.execution=crossfade to go over smoothly"
        )
    if config.prefix_steps and config.execution != "open_loop":
        raise ConfigurationError(
            f"prefix_steps={config.prefix_steps} continues the chunk in execution, which no graph sees: "
            "export with --policy.execution=open_loop --policy.replan_interval=null, or a policy that was "
            "trained with prefix_steps=0"
        )
