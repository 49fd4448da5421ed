"""A process of its own that pushes numbered versions of one large file until it is done, or killed.

Usage: python push_process.py HUB REPO_ID FILE FIRST COUNT SIZE

FILE lies in a folder of its own, which is what is pushed. The folder is the caller's to remove: this process
may be killed.
"""

import hashlib
import sys
from pathlib import Path

from huggingface_hub import HfApi

from lerobot_act_chunking.hub.routing import route_to
from lerobot_act_chunking.hub.storage import LocalHub


def version_seed(number: int) -> bytes:
    return hashlib.sha256(b"%d" % number).digest()


def write_version(path: Path, number: int, size: int) -> None:
    """``size`` bytes that start with the version's seed and differ everywhere between versions."""
    with path.open("wb") as file:
        block = version_seed(number) * 32768
        for start in range(0, size, len(block)):
            file.write(block[: size - start])


def version_of(content: bytes) -> int:
    """Which version a file is, by its first 32 bytes."""
    return next(number for number in range(100_000) if version_seed(number) == content[:32])


def main() -> None:
    hub, repo_id, file, first, count, size = sys.argv[1:]
    route_to(LocalHub(hub))
    api = HfApi()
    source = Path(file)
    print("ready", flush=True)
    for number in range(int(first), int(first) + int(count)):
        write_version(source, number, int(size))
        api.create_repo(repo_id, exist_ok=True)
        api.upload_folder(repo_id=repo_id, folder_path=source.parent, commit_message=f"version {number}")
        print(f"pushed {number}", flush=True)


if __name__ == "__main__":
    main()
