"""Action-chunking policies and ALOHA simulation for LeRobot.

>>> import lerobot_act_chunking as ac

The names of ``__all__`` are the public interface. Each is imported when it is first used, so that importing
this package stays cheap: it registers the Gymnasium environments and loads neither torch nor LeRobot.
LeRobot's commands import ``lerobot_act_chunking.plugin`` by the discovery shim, which registers the rest.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from lerobot_act_chunking.envs.registration import register_gymnasium_ids

if TYPE_CHECKING:
    from act_chunking_runtime.settings import ExecutionSettings
    from lerobot_act_chunking.envs.demonstration import ExpertOptions
    from lerobot_act_chunking.envs.making import make_env
    from lerobot_act_chunking.errors import (
        ActChunkingError,
        ConfigurationError,
        DatasetError,
        FeatureError,
        WorkerError,
    )
    from lerobot_act_chunking.execution.executor import ChunkExecutor
    from lerobot_act_chunking.executors import Cluster
    from lerobot_act_chunking.policies.act_chunked.configuration_act_chunked import ActChunkedConfig
    from lerobot_act_chunking.policies.diffusion_chunked.configuration_diffusion_chunked import (
        DiffusionChunkedConfig,
    )
    from lerobot_act_chunking.policies.loading import LoadedPolicy, load_policy
    from lerobot_act_chunking.policies.temporal_ensemble.configuration_temporal_ensemble import (
        TemporalEnsembleConfig,
    )
    from lerobot_act_chunking.policies.temporal_ensemble.wrapping import load_wrapped
    from lerobot_act_chunking.policies.vqbet_chunked.configuration_vqbet_chunked import VqbetChunkedConfig
    from lerobot_act_chunking.recording import RecordSpec, record, record_source

    __version__: str

__all__ = [
    "ActChunkedConfig",
    "ActChunkingError",
    "ChunkExecutor",
    "Cluster",
    "ConfigurationError",
    "DatasetError",
    "DiffusionChunkedConfig",
    "ExecutionSettings",
    "ExpertOptions",
    "FeatureError",
    "LoadedPolicy",
    "RecordSpec",
    "TemporalEnsembleConfig",
    "VqbetChunkedConfig",
    "WorkerError",
    "__version__",
    "load_policy",
    "load_wrapped",
    "make_env",
    "record",
    "record_source",
]

_POLICIES = "lerobot_act_chunking.policies"
_MODULES = {
    "lerobot_act_chunking.envs.demonstration": ("ExpertOptions",),
    "lerobot_act_chunking.envs.making": ("make_env",),
    "lerobot_act_chunking.errors": (
        "ActChunkingError",
        "ConfigurationError",
        "DatasetError",
        "FeatureError",
        "WorkerError",
    ),
    "lerobot_act_chunking.execution.executor": ("ChunkExecutor",),
    "lerobot_act_chunking.executors": ("Cluster",),
    "act_chunking_runtime.settings": ("ExecutionSettings",),
    "lerobot_act_chunking.recording": ("RecordSpec", "record", "record_source"),
    f"{_POLICIES}.act_chunked.configuration_act_chunked": ("ActChunkedConfig",),
    f"{_POLICIES}.diffusion_chunked.configuration_diffusion_chunked": ("DiffusionChunkedConfig",),
    f"{_POLICIES}.loading": ("LoadedPolicy", "load_policy"),
    f"{_POLICIES}.temporal_ensemble.configuration_temporal_ensemble": ("TemporalEnsembleConfig",),
    f"{_POLICIES}.temporal_ensemble.wrapping": ("load_wrapped",),
    f"{_POLICIES}.vqbet_chunked.configuration_vqbet_chunked": ("VqbetChunkedConfig",),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}

register_gymnasium_ids()


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used (PEP 562)."""
    if name == "__version__":
        from importlib.metadata import version

        value: Any = version("lerobot_policy_act_chunking")
    elif name in _MODULE_OF:
        value = getattr(import_module(_MODULE_OF[name]), name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; it has: {', '.join(__all__)}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
