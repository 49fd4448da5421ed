import errno

import pytest

from lerobot_act_chunking.errors import DatasetError
from lerobot_act_chunking.recording.full_disk import explain_full_disk


@pytest.mark.parametrize(
    "error",
    [
        OSError(errno.ENOSPC, "No space left on device"),
        OSError(errno.EDQUOT, "Disk quota exceeded"),
        RuntimeError("Encoder thread for eye failed: [Errno 28] No space left on device: 'x.mp4'"),
    ],
)
def test_a_full_disk_is_explained(tmp_path, error):
    message = f"the disk is full .*safe in {tmp_path}: free some space and run the same command again"
    with pytest.raises(DatasetError, match=message), explain_full_disk(tmp_path):
        raise error


def test_other_errors_pass_unchanged(tmp_path):
    with pytest.raises(PermissionError), explain_full_disk(tmp_path):
        raise PermissionError(errno.EACCES, "no")
