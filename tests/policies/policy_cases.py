"""Small policies of every type there is; a new one adds ``cases_<type>.py`` and inherits the contract."""

from importlib import import_module
from pathlib import Path

from policy_case import (  # noqa: F401
    ENVIRONMENT,
    KINDS,
    STATE,
    TOP,
    VELOCITY,
    WRIST,
    A,
    B,
    Case,
    T,
    history_batch,
)

from lerobot_act_chunking import policies

TYPES = [
    name
    for name in ("act_chunked", "diffusion_chunked", "vqbet_chunked")
    if (Path(policies.__path__[0]) / name).is_dir()
]
CASES: list[Case] = []
for _name in TYPES:
    import_module(f"{policies.__name__}.{_name}.configuration_{_name}")  # registers the type
    _cases = import_module(f"cases_{_name}")
    KINDS[_name] = _cases.KIND
    CASES += _cases.CASES
SIZES = {name: kind.sizes for name, kind in KINDS.items()}

from cases_temporal_ensemble import WRAPPED, WrappedCase  # noqa: E402, F401  (needs the types above)
