"""torchvision's weights in torch hub's cache, and how they get there."""

import functools
import hashlib
import logging
from pathlib import Path
from typing import BinaryIO

import httpx
import torch
from filelock import FileLock

from lerobot_act_chunking.durable_files import fill_atomically

TIMEOUT_S = 5.0  # until the server answers, and for each piece of the file

logger = logging.getLogger(__name__)


def cache_file(url: str) -> Path:
    """Where torch hub looks for what is at this address."""
    return Path(torch.hub.get_dir()) / "checkpoints" / url.rsplit("/", 1)[-1]


@functools.cache
def download(url: str) -> str | None:
    """Put weights into torch hub's cache, for all processes at once; tried once in each.

    Args:
        url: whose last part holds the first digits of the file's SHA-256, as torchvision's do.

    Returns:
        Why that is not possible; None once the file is there.
    """
    file = cache_file(url)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with FileLock(f"{file}.lock"):
            if not file.is_file():
                logger.info("downloading %s into %s", url, file.parent)
                fill_atomically(file, lambda target: _fetch(url, target))
    except (httpx.HTTPError, OSError) as error:
        return f"{url} could not be downloaded: {error or type(error).__name__}"
    return None


def _fetch(url: str, target: BinaryIO) -> None:
    digest = hashlib.sha256()
    with httpx.stream("GET", url, follow_redirects=True, timeout=TIMEOUT_S) as response:
        response.raise_for_status()
        for piece in response.iter_bytes():
            digest.update(piece)
            target.write(piece)
    expected = url.rsplit("-", 1)[-1].split(".", 1)[0]
    if not digest.hexdigest().startswith(expected):
        raise OSError(f"the file's SHA-256 does not begin with {expected}")
